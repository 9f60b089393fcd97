//! One ray against eight triangles: a test that may only reject.
//!
//! Moeller and Trumbore's test (1997) in f32 on vertices relative to a rounded origin, with a bound on every rounding.
//! A lane is rejected only if the exact test on exact inputs would reject it too (I3); what is left goes to the f64
//! decision. With `u = 2^-24`, `D` the sum of the direction's magnitudes, `M` a bound on the magnitude of a vertex
//! relative to the origin, `S` a bound on the magnitude of an edge, `d` the rounding of the origin and `v` that of a
//! vertex (0 where f32 vertices are exact), per axis, the operation counts are:
//!
//! | quantity | magnitude | roundings on the longest path |
//! |---|---|---|
//! | `U = (o - a) . (dir x e2)`, `V = dir . ((o - a) x e1)` | `2 D M S` | 1 + 1 + 1 (inputs) + 2 (cross) + 3 (dot) = 8 |
//! | `det = e1 . (dir x e2)` | `2 D S S` | 8 |
//! | `T = e2 . ((o - a) x e1)` | `6 M S S` | 8 |
//!
//! `d` adds `2 D S d` to `U` and `V` and `6 S S d` to `T`; `v` enters `o - a` like `d` and each edge twice. The counts
//! below are 11, which also covers adding `U` to `V`, the rounding of the bounds themselves and second-order terms.

use super::lanes::{LANES, Simd};

/// 11 roundings of f32.
const ROUNDINGS: f32 = 11.0 / (1u32 << 24) as f32;

/// Eight triangles by vertex and axis.
#[derive(Clone, Copy)]
pub struct Packet<S: Simd> {
    a: [S::F; 3],
    b: [S::F; 3],
    c: [S::F; 3],
}

impl<S: Simd> Packet<S> {
    /// From vertex indices: lane `i` is triangle `i`; lanes from `triangles.len()` on repeat the first.
    ///
    /// # Panics
    /// If `triangles` is empty or an index is not below `vertices.len()`.
    #[inline(always)]
    pub fn from_indices(simd: S, vertices: &[[f32; 3]], triangles: &[[u16; 3]]) -> Packet<S> {
        let mut lanes = [[[0.0f32; LANES]; 3]; 3];
        for lane in 0..LANES {
            let triangle = triangles[if lane < triangles.len() { lane } else { 0 }];
            for corner in 0..3 {
                let vertex = vertices[usize::from(triangle[corner])];
                for axis in 0..3 {
                    lanes[corner][axis][lane] = vertex[axis];
                }
            }
        }
        Packet { a: load3(simd, &lanes[0]), b: load3(simd, &lanes[1]), c: load3(simd, &lanes[2]) }
    }

    /// Its vertices, axis by axis.
    #[inline(always)]
    pub(super) fn vertices(&self) -> [[S::F; 3]; 3] {
        [self.a, self.b, self.c]
    }
}

/// Triangles by vertex and axis in nine rows (`a.x, a.y, a.z, b.x, ...`), one after the other.
#[derive(Clone, Copy)]
pub struct PacketRows<'n> {
    /// At least nine rows and seven numbers.
    numbers: &'n [f32],
    count: usize,
}

impl<'n> PacketRows<'n> {
    /// `count` triangles from the beginning of `numbers` on.
    ///
    /// # Panics
    /// If `numbers` is shorter than nine rows of `count` and seven numbers more, which loads reach but lanes do not show.
    #[inline(always)]
    pub fn new(numbers: &'n [f32], count: usize) -> PacketRows<'n> {
        assert!(9 * count + LANES - 1 <= numbers.len());
        PacketRows { numbers, count }
    }

    /// Lane `i` is triangle `first + i`. Lanes past the last triangle hold what follows: mask them.
    ///
    /// # Panics
    /// If `first` is not below the number of triangles.
    #[inline(always)]
    pub fn packet<S: Simd>(&self, simd: S, first: usize) -> Packet<S> {
        assert!(first < self.count);
        let three = 3 * self.count;
        // SAFETY: the last row begins after eight, and `first` is at most its last place: eight numbers from there reach
        // seven past the nine rows, which `new` has found to be there.
        unsafe {
            Packet {
                a: self.load_rows(simd, first),
                b: self.load_rows(simd, first + three),
                c: self.load_rows(simd, first + three + three),
            }
        }
    }

    /// # Safety
    /// `numbers` goes on for two rows and eight numbers from `start`.
    #[inline(always)]
    unsafe fn load_rows<S: Simd>(&self, simd: S, start: usize) -> [S::F; 3] {
        // SAFETY: the caller's promise.
        unsafe {
            [
                simd.load_unchecked(self.numbers, start),
                simd.load_unchecked(self.numbers, start + self.count),
                simd.load_unchecked(self.numbers, start + 2 * self.count),
            ]
        }
    }
}

#[inline(always)]
fn load3<S: Simd>(simd: S, rows: &[[f32; LANES]; 3]) -> [S::F; 3] {
    [simd.load(&rows[0]), simd.load(&rows[1]), simd.load(&rows[2])]
}

/// A ray ready for triangle tests.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct TriangleRay {
    /// Origin, rounded.
    pub origin: [f32; 3],
    /// Direction, rounded; largest magnitude 1 to 2.
    pub direction: [f32; 3],
}

/// What the reject test must allow for: each error is a polynomial in the packet's longest edge, one in each lane.
#[derive(Clone, Copy)]
pub struct ErrorBounds<S: Simd> {
    quadratic: S::F,
    linear: S::F,
    constant: S::F,
}

// The lanes.
/// Of `U` and `V`, negative: below this they are certainly negative.
const OUTSIDE: usize = 0;
/// Of `U + V` and `det` together.
const SUM: usize = 1;
const DET: usize = 2;
const T: usize = 3;
/// Of `U` and `V`.
const UV: usize = 4;

/// How often the error of `U` and `V` for a `det` of certain sign goes into each lane.
const OF_UV: [f32; LANES] = [-1.0, 2.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
/// How often that of `det` does. Where the sign of `det` is not certain, the exact `U` and `V` are within its error of 0 on
/// either side of the computed sign: two more of it in theirs admit them without a separate case.
const OF_DET: [f32; LANES] = [-2.0, 5.0, 1.0, 0.0, 2.0, 0.0, 0.0, 0.0];
const OF_T: [f32; LANES] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
/// How often the loss in the subnormal range does: once in each of the three.
const OF_TINY: [f32; LANES] = [-3.0, 7.0, 1.0, 1.0, 3.0, 0.0, 0.0, 0.0];

impl<S: Simd> ErrorBounds<S> {
    /// For a direction with sum of magnitudes `direction_sum`, vertices at most `reach` away from the rounded origin
    /// per axis, an origin rounded by at most `origin_error` and vertices by at most `vertex_error` per axis.
    #[inline(always)]
    pub fn new(
        simd: S,
        direction_sum: f32,
        reach: f32,
        origin_error: f32,
        vertex_error: f32,
    ) -> ErrorBounds<S> {
        // Second-order terms and the roundings of these lines.
        const SLACK: f32 = 1.01;
        let d = SLACK * 2.0 * direction_sum;
        let shift = ROUNDINGS * reach + origin_error + vertex_error;
        // Subnormal products lose 2^-149 each, later multiplied by at most `reach` twice.
        let tiny = (1.0 + reach) * (1.0 + reach) * 1e-36;
        let [of_uv, of_det, of_t] = [simd.load(&OF_UV), simd.load(&OF_DET), simd.load(&OF_T)];
        let quadratic =
            simd.mul_add(simd.splat(d * ROUNDINGS), of_det, simd.mul(simd.splat(SLACK * 6.0 * shift), of_t));
        let mut linear = simd.mul(simd.splat(d * shift), of_uv);
        let mut constant = simd.mul(simd.splat(tiny), simd.load(&OF_TINY));
        if vertex_error != 0.0 {
            linear = simd.mul_add(simd.splat(d * 4.0 * vertex_error), of_det, linear);
            linear = simd.mul_add(simd.splat(SLACK * 24.0 * reach * vertex_error), of_t, linear);
            constant = simd.mul_add(simd.splat(d * reach * (2.0 * vertex_error)), of_uv, constant);
        }
        ErrorBounds { quadratic, linear, constant }
    }

    /// The errors for a packet whose edge components are at most `edge` in magnitude.
    #[inline(always)]
    fn at(&self, simd: S, edge: f32) -> [f32; LANES] {
        let edge = simd.splat(edge);
        simd.to_array(simd.mul_add(edge, simd.mul_add(edge, self.quadratic, self.linear), self.constant))
    }
}

/// The part of a ray that matters, rounded in both directions.
#[derive(Clone, Copy)]
pub struct Interval<F: Copy> {
    /// At most the least `t` that can still matter, by a factor of `1 - 2^-20` or more.
    pub low: F,
    /// At least the largest `t` that can still matter, by a factor of `1 + 2^-20` or more.
    pub high: F,
}

/// U, V, T and det of eight triangles, with the sign of det taken out.
struct Weights<F> {
    u: F,
    v: F,
    t: F,
    det: F,
}

impl TriangleRay {
    #[inline(always)]
    fn weights<S: Simd>(&self, simd: S, packet: &Packet<S>) -> Weights<S::F> {
        let (origin, direction) = (simd.splat3(self.origin), simd.splat3(self.direction));
        let e1 = simd.sub3(packet.b, packet.a);
        let e2 = simd.sub3(packet.c, packet.a);
        let to_origin = simd.sub3(origin, packet.a);
        let p = simd.cross(direction, e2);
        let q = simd.cross(to_origin, e1);
        let det = simd.dot(e1, p);
        Weights {
            u: simd.flip_sign(simd.dot(to_origin, p), det),
            v: simd.flip_sign(simd.dot(direction, q), det),
            t: simd.flip_sign(simd.dot(e2, q), det),
            det: simd.abs(det),
        }
    }

    /// Bit `i` is clear only if the ray certainly misses triangle `i` within `interval`. The bounds are for this ray and these
    /// triangles; `edge` bounds the magnitude of the packet's edge components.
    #[inline(always)]
    pub fn survivors<S: Simd>(
        &self,
        simd: S,
        packet: &Packet<S>,
        (bounds, edge): (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
    ) -> u32 {
        self.classify::<S, false>(simd, packet, (bounds, edge), interval, interval).0
    }

    /// [`TriangleRay::survivors`], and the lanes that certainly are hit inside `inner`, whose `low` is at least the
    /// true beginning and whose `high` is at most the true end.
    #[inline(always)]
    pub fn survivors_and_certain<S: Simd>(
        &self,
        simd: S,
        packet: &Packet<S>,
        (bounds, edge): (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
        inner: &Interval<S::F>,
    ) -> (u32, u32) {
        self.classify::<S, true>(simd, packet, (bounds, edge), interval, inner)
    }

    #[inline(always)]
    fn classify<S: Simd, const CERTAIN: bool>(
        &self,
        simd: S,
        packet: &Packet<S>,
        (bounds, edge): (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
        inner: &Interval<S::F>,
    ) -> (u32, u32) {
        let Weights { u, v, t, det } = self.weights(simd, packet);
        let errors = bounds.at(simd, edge);
        let (det_error, t_error) = (simd.splat(errors[DET]), simd.splat(errors[T]));
        let (outside, sum_error) = (simd.splat(errors[OUTSIDE]), simd.splat(errors[SUM]));
        let uv = simd.add(u, v);
        // Every comparison is true for a lane to reject, so NaN (from overflow) keeps the lane.
        let mut reject = simd.or(simd.lt(u, outside), simd.lt(v, outside));
        reject = simd.or(reject, simd.lt(simd.add(det, sum_error), uv));
        let det_high = simd.add(det, det_error);
        reject = simd.or(reject, simd.lt(simd.mul_add(interval.high, det_high, t_error), t));
        // Before the beginning: only where the sign of det, and so of T, is certain.
        let det_low = simd.sub(det, det_error);
        let before = simd.lt(simd.add(t, t_error), simd.mul(interval.low, det_low));
        reject = simd.or(reject, simd.and(before, simd.lt(det_error, det)));
        let survivors = !simd.bits(reject) & 0xff;

        if !CERTAIN || survivors == 0 {
            return (survivors, 0);
        }
        let inside = simd.splat(errors[UV]);
        let mut certain = simd.and(simd.lt(inside, u), simd.lt(inside, v));
        certain = simd.and(certain, simd.lt(simd.add(uv, sum_error), det));
        let begin = simd.mul_add(inner.low, det_high, t_error);
        let end = simd.sub(simd.mul(inner.high, det_low), t_error);
        certain = simd.and(certain, simd.and(simd.lt(begin, t), simd.lt(t, end)));
        certain = simd.and(certain, simd.lt(simd.add(det_error, det_error), det));
        (survivors, simd.bits(certain))
    }

    /// The f32 decision without bounds: which lanes are hit, and `t`, `u`, `v` of each (meaningful where hit).
    #[inline(always)]
    pub fn decide<S: Simd>(
        &self,
        simd: S,
        packet: &Packet<S>,
        interval: &Interval<S::F>,
    ) -> (u32, [S::F; 3]) {
        let Weights { u, v, t, det } = self.weights(simd, packet);
        let zero = simd.splat(0.0);
        let mut hit = simd.and(simd.le(zero, u), simd.le(zero, v));
        hit = simd.and(hit, simd.and(simd.le(simd.add(u, v), det), simd.lt(zero, det)));
        hit = simd.and(hit, simd.le(simd.mul(interval.low, det), t));
        hit = simd.and(hit, simd.le(t, simd.mul(interval.high, det)));
        let hits = simd.bits(hit);
        if hits == 0 {
            return (0, [zero; 3]);
        }
        let inverse = simd.div(simd.splat(1.0), det);
        (hits, [simd.mul(t, inverse), simd.mul(u, inverse), simd.mul(v, inverse)])
    }
}
