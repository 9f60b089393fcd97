//! One ray against eight triangles, watertight in f32.
//!
//! S. Woop, C. Benthin, I. Wald, "Watertight Ray/Triangle Intersection", Journal of Computer Graphics Techniques 2 (2013):
//! vertices relative to the origin are sheared so that the ray runs along z, and the edge functions are those of their
//! 2D images. Triangles with a common edge see the same two images, so the same product differences with opposite sign: no ray
//! passes between them. Where a function is zero in f32, f64 decides, in which products of f32 numbers are exact.
//! The products must not be fused: `fma(a, b, -c d)` is not `-fma(c, d, -a b)`.
//!
//! What the paper does not promise: `t` and the weights are as good as f32 lets them be, the image of a needle may be
//! turned or flat, and all that holds for vertices and origin as they are in f32, of one frame.

use super::lanes::{LANES, Simd};
use super::triangles::{Interval, Packet};

/// A ray's shear.
#[derive(Clone, Copy)]
pub struct Shear<S: Simd> {
    /// Axes that become x, y and z.
    axes: [usize; 3],
    x: S::F,
    y: S::F,
    z: S::F,
}

/// The image of a vertex in the plane across the ray, and its depth before scaling.
struct Image<F> {
    x: F,
    y: F,
    depth: F,
}

impl<S: Simd> Shear<S> {
    /// For a direction, not zero.
    #[inline(always)]
    pub fn new(simd: S, direction: [f32; 3]) -> Shear<S> {
        let [x, y, z] = [direction[0].abs(), direction[1].abs(), direction[2].abs()];
        let depth = if x > y {
            if x > z { 0 } else { 2 }
        } else if y > z {
            1
        } else {
            2
        };
        let (across, up) = ((depth + 1) % 3, (depth + 2) % 3);
        // Keeps the winding.
        let (across, up) = if direction[depth] < 0.0 { (up, across) } else { (across, up) };
        let inverse = 1.0 / direction[depth];
        Shear {
            axes: [across, up, depth],
            x: simd.splat(direction[across] / direction[depth]),
            y: simd.splat(direction[up] / direction[depth]),
            z: simd.splat(inverse),
        }
    }

    #[inline(always)]
    fn image(&self, simd: S, vertex: [S::F; 3], origin: [S::F; 3]) -> Image<S::F> {
        let away = simd.sub3(vertex, origin);
        let depth = away[self.axes[2]];
        Image {
            x: simd.sub(away[self.axes[0]], simd.mul(self.x, depth)),
            y: simd.sub(away[self.axes[1]], simd.mul(self.y, depth)),
            depth,
        }
    }

    /// Which lanes are hit inside `interval` from `origin`, and `t`, `u`, `v` of each (meaningful where hit).
    #[inline(always)]
    pub fn decide(
        &self,
        simd: S,
        packet: &Packet<S>,
        origin: [S::F; 3],
        interval: &Interval<S::F>,
    ) -> (u32, [S::F; 3]) {
        let [a, b, c] = packet.vertices();
        let (a, b, c) =
            (self.image(simd, a, origin), self.image(simd, b, origin), self.image(simd, c, origin));
        let mut u = simd.sub(simd.mul(c.x, b.y), simd.mul(c.y, b.x));
        let mut v = simd.sub(simd.mul(a.x, c.y), simd.mul(a.y, c.x));
        let mut w = simd.sub(simd.mul(b.x, a.y), simd.mul(b.y, a.x));
        let zero = simd.splat(0.0);
        let is_zero = |x: S::F| simd.and(simd.le(x, zero), simd.le(zero, x));
        let open = simd.bits(simd.or(simd.or(is_zero(u), is_zero(v)), is_zero(w)));
        if open != 0 {
            u = in_double(simd, open, u, [&c, &b]);
            v = in_double(simd, open, v, [&a, &c]);
            w = in_double(simd, open, w, [&b, &a]);
        }
        let negative = simd.or(simd.or(simd.lt(u, zero), simd.lt(v, zero)), simd.lt(w, zero));
        let positive = simd.or(simd.or(simd.lt(zero, u), simd.lt(zero, v)), simd.lt(zero, w));
        let mixed = simd.bits(simd.and(negative, positive));
        let det = simd.add(simd.add(u, v), w);
        let t = simd.add(simd.add(simd.mul(u, a.depth), simd.mul(v, b.depth)), simd.mul(w, c.depth));
        let t = simd.flip_sign(simd.mul(t, self.z), det);
        let magnitude = simd.abs(det);
        let mut hit = simd.and(simd.lt(zero, magnitude), simd.le(simd.mul(interval.low, magnitude), t));
        hit = simd.and(hit, simd.le(t, simd.mul(interval.high, magnitude)));
        let hits = simd.bits(hit) & !mixed;
        if hits == 0 {
            return (0, [zero; 3]);
        }
        (hits, [simd.div(t, magnitude), simd.div(v, det), simd.div(w, det)])
    }
}

/// `p.x q.y - p.y q.x` of the lanes in `open` once more, in f64; the other lanes as they are.
#[cold]
#[inline(never)]
fn in_double<S: Simd>(simd: S, open: u32, single: S::F, [p, q]: [&Image<S::F>; 2]) -> S::F {
    let mut lanes = simd.to_array(single);
    let (px, py, qx, qy) = (simd.to_array(p.x), simd.to_array(p.y), simd.to_array(q.x), simd.to_array(q.y));
    for i in (0..LANES).filter(|i| open >> i & 1 == 1) {
        lanes[i] = (f64::from(px[i]) * f64::from(qy[i]) - f64::from(py[i]) * f64::from(qx[i])) as f32;
    }
    simd.load(&lanes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::{AnyOperation, PacketRows, SimdLevel, dispatch};

    /// The paper's listing for one triangle: `t`, `u`, `v`.
    fn scalar(
        origin: [f32; 3],
        direction: [f32; 3],
        triangle: &[[f32; 3]; 3],
        high: f32,
    ) -> Option<[f32; 3]> {
        let largest = direction.iter().fold(0.0f32, |largest, x| largest.max(x.abs()));
        let kz = if direction[2].abs() == largest {
            2
        } else if direction[1].abs() == largest {
            1
        } else {
            0
        };
        let (mut kx, mut ky) = ((kz + 1) % 3, (kz + 2) % 3);
        if direction[kz] < 0.0 {
            (kx, ky) = (ky, kx);
        }
        let (sx, sy) = (direction[kx] / direction[kz], direction[ky] / direction[kz]);
        let sz = 1.0 / direction[kz];
        let [a, b, c] = triangle.map(|p| {
            let p = [0, 1, 2].map(|axis| p[axis] - origin[axis]);
            [p[kx] - sx * p[kz], p[ky] - sy * p[kz], p[kz]]
        });
        let edge = |p: [f32; 3], q: [f32; 3]| p[0] * q[1] - p[1] * q[0];
        let mut edges = [edge(c, b), edge(a, c), edge(b, a)];
        if edges.contains(&0.0) {
            let edge = |p: [f32; 3], q: [f32; 3]| {
                (f64::from(p[0]) * f64::from(q[1]) - f64::from(p[1]) * f64::from(q[0])) as f32
            };
            edges = [edge(c, b), edge(a, c), edge(b, a)];
        }
        let [u, v, w] = edges;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let det = u + v + w;
        let t = (u * a[2] + v * b[2] + w * c[2]) * sz;
        let (t, magnitude) = (if det < 0.0 { -t } else { t }, det.abs());
        (det != 0.0 && t >= 0.0 && t <= high * magnitude).then(|| [t / magnitude, v / det, w / det])
    }

    struct Random(u64);

    impl Random {
        /// In -1 to 1, on a coarse grid half of the time, so that vertices and edges are met exactly.
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let x = (self.0 >> 40) as f32 / (1 << 23) as f32 - 1.0;
            if self.0 >> 39 & 1 == 0 { (x * 4.0).round() / 4.0 } else { x }
        }

        fn vector(&mut self) -> [f32; 3] {
            [self.next(), self.next(), self.next()]
        }
    }

    /// A fan of eight triangles round a vertex of the plane, bent out of it, and a ray at one of its edges.
    struct Fans;

    impl AnyOperation for Fans {
        type Output = (u32, u32);

        fn run<S: Simd>(self, simd: S) -> Self::Output {
            let mut random = Random(5);
            let (mut hit_count, mut on_border) = (0, 0);
            for round in 0..20_000 {
                let center = random.vector();
                let rim: [[f32; 3]; LANES] = std::array::from_fn(|i| {
                    let corner = [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]][i];
                    [
                        center[0] + corner[0] as f32,
                        center[1] + corner[1] as f32,
                        center[2] + 0.1 * random.next(),
                    ]
                });
                let triangles: [[[f32; 3]; 3]; LANES] =
                    std::array::from_fn(|i| [center, rim[i], rim[(i + 1) % LANES]]);
                // At the middle, or on a spoke or near it.
                let along = if round % 3 == 0 { 0.0 } else { 0.5 * random.next().abs() };
                let spoke = rim[round % LANES];
                let target = [0, 1, 2].map(|axis| center[axis] + along * (spoke[axis] - center[axis]));
                let origin =
                    [target[0] + 0.3 * random.next(), target[1] + 0.3 * random.next(), target[2] + 4.0];
                let direction = [0, 1, 2].map(|axis| target[axis] - origin[axis]);
                let high = if round % 7 == 0 { 0.5 } else { f32::MAX };

                let mut rows = [0.0f32; 10 * LANES];
                for (lane, triangle) in triangles.iter().enumerate() {
                    for (number, x) in triangle.iter().flatten().enumerate() {
                        rows[number * LANES + lane] = *x;
                    }
                }
                let packet = PacketRows::new(&rows, LANES).packet(simd, 0);
                let interval = Interval { low: simd.splat(0.0), high: simd.splat(high) };
                let shear = Shear::new(simd, direction);
                let (hits, [t, u, v]) = shear.decide(simd, &packet, simd.splat3(origin), &interval);
                let (t, u, v) = (simd.to_array(t), simd.to_array(u), simd.to_array(v));
                for (lane, triangle) in triangles.iter().enumerate() {
                    let found = (hits >> lane & 1 == 1).then(|| [t[lane], u[lane], v[lane]]);
                    assert_eq!(
                        found,
                        scalar(origin, direction, triangle, high),
                        "round {round}, lane {lane}"
                    );
                    on_border += u32::from(found.is_some_and(|[_, u, v]| u == 0.0 || v == 0.0));
                }
                // The fan is closed round the target.
                assert!(hits != 0 || high == 0.5, "round {round} leaks");
                hit_count += hits.count_ones();
            }
            (hit_count, on_border)
        }
    }

    #[test]
    fn the_kernel_is_the_paper_s_listing_and_fans_do_not_leak() {
        for level in [SimdLevel::Portable, SimdLevel::best()] {
            let (hits, on_border) = dispatch(level, Fans);
            assert!(hits > 15_000 && on_border > 1000, "{hits} {on_border}");
        }
    }
}
