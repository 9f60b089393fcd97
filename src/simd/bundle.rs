//! Eight rays against eight boxes at once: which boxes any of the rays may meet.
//!
//! Interval arithmetic. On each axis all rays go the same way, so all enter a slab by the same plane. For a plane `p`, origins
//! between `a` and `b` and inverse directions between `i` and `j`, every ray's `(p - o) / d` lies between the least and the
//! greatest of the products of `p - a` and `p - b` with `i` and `j`; of these the test takes the two that can be the bound.
//! Roundings: difference, product, direction and quotient round by a factor of at most `1 + 2^-24` each, for which the
//! inverses are moved apart by one of `1 + 2^-20`; that of the origins to f32 is a shift of `2^-24` of them, for which they are
//! moved apart by eight times as much.

use super::boxes::{BoxRay, Boxes, Rows};
use super::lanes::{LANES, Simd};

/// What a box test needs to know of eight rays that go much the same way.
#[derive(Clone, Copy, Debug)]
pub struct RayBundle {
    axes: [BundleAxis; 3],
}

#[derive(Clone, Copy, Debug)]
struct BundleAxis {
    /// Bounds on the inverse of the direction, of one sign.
    inverse_low: f32,
    inverse_high: f32,
    /// The origin that is farthest along the axis in the rays' sense, and the one that is least far.
    near_origin: f32,
    far_origin: f32,
    rows: Rows,
}

/// Most that components of directions (largest magnitude 1 to 2) may differ by: with more, rays soon part.
const SPREAD_MAX: f32 = 0.125;

/// More than the roundings of a product of a difference with an inverse.
const ROUNDINGS: f32 = 1.0 / (1u32 << 20) as f32;

/// Eight times that of an origin to f32.
const ORIGIN_ROUNDING: f32 = 1.0 / (1u32 << 21) as f32;

impl RayBundle {
    /// The bundle of eight rays, oblique ones ([`BoxRay::is_oblique`]); `None` if they part too soon to be worth it: they go
    /// different ways on some axis, or directions or origins (by more than `origin_spread_max`) are too far apart.
    #[inline(always)]
    pub fn new<S: Simd>(
        simd: S,
        direction: &[S::F; 3],
        origin: &[S::F; 3],
        origin_spread_max: f32,
    ) -> Option<RayBundle> {
        let zero = simd.splat(0.0);
        let [dx, dy, dz] = *direction;
        let negative =
            [simd.bits(simd.lt(dx, zero)), simd.bits(simd.lt(dy, zero)), simd.bits(simd.lt(dz, zero))];
        if negative.iter().any(|bits| *bits != 0 && *bits != 0xff) {
            return None;
        }
        let rows = simd.transpose(&[dx, dy, dz, origin[0], origin[1], origin[2], zero, zero]);
        let (mut low, mut high) = (rows[0], rows[0]);
        for row in &rows[1..] {
            (low, high) = (simd.min(low, *row), simd.max(high, *row));
        }
        let spread = simd.to_array(simd.sub(high, low));
        let most =
            [SPREAD_MAX, SPREAD_MAX, SPREAD_MAX, origin_spread_max, origin_spread_max, origin_spread_max];
        if spread.iter().zip(most).any(|(spread, most)| *spread > most) {
            return None;
        }
        // Of one sign, so that the greatest has the least inverse.
        let one = simd.splat(1.0);
        let (inverse_low, inverse_high) = (simd.div(one, high), simd.div(one, low));
        let slack = simd.splat(ROUNDINGS);
        let inverse_low = simd.to_array(simd.sub(inverse_low, simd.mul(simd.abs(inverse_low), slack)));
        let inverse_high = simd.to_array(simd.mul_add(simd.abs(inverse_high), slack, inverse_high));
        let largest = simd.max(simd.abs(low), simd.abs(high));
        let step = simd.mul_add(largest, simd.splat(ORIGIN_ROUNDING), simd.splat(BoxRay::WIDEN_LEAST[0]));
        let (low, high) = (simd.to_array(simd.sub(low, step)), simd.to_array(simd.add(high, step)));
        let axis = |axis: usize| {
            let goes_down = negative[axis] != 0;
            let (least, most) = (low[axis + 3], high[axis + 3]);
            BundleAxis {
                inverse_low: inverse_low[axis],
                inverse_high: inverse_high[axis],
                near_origin: if goes_down { least } else { most },
                far_origin: if goes_down { most } else { least },
                rows: Rows::of(axis, goes_down),
            }
        };
        Some(RayBundle { axes: [axis(0), axis(1), axis(2)] })
    }

    /// Tests eight boxes against the parts of the rays between `t_min` and `t_max`, which hold those of all rays. Bit `i` of the
    /// result is clear only if no ray meets box `i`; lane `i` of the first result is then a lower bound, up to a factor of
    /// `1 + 2^-21`, of where the first of them does (never less than `t_min`).
    #[inline(always)]
    pub fn test<S: Simd>(&self, simd: S, boxes: &Boxes, t_min: S::F, t_max: S::F) -> (S::F, u32) {
        let (mut near, mut far) = (t_min, t_max);
        let [x, y, z] = &self.axes;
        x.clip(simd, boxes, &mut near, &mut far);
        y.clip(simd, boxes, &mut near, &mut far);
        z.clip(simd, boxes, &mut near, &mut far);
        (near, simd.bits(simd.le(near, far)))
    }
}

impl BundleAxis {
    #[inline(always)]
    fn clip<S: Simd>(&self, simd: S, boxes: &Boxes, near: &mut S::F, far: &mut S::F) {
        let (low, high) = (simd.splat(self.inverse_low), simd.splat(self.inverse_high));
        let (near_plane, far_plane) = self.rows.planes(simd, boxes);
        let before = simd.sub(near_plane, simd.splat(self.near_origin));
        let behind = simd.sub(far_plane, simd.splat(self.far_origin));
        let entry = simd.min(simd.mul(before, low), simd.mul(before, high));
        let exit = simd.max(simd.mul(behind, low), simd.mul(behind, high));
        // NaN adds no constraint: `max` and `min` then keep their second operand.
        *near = simd.max(entry, *near);
        *far = simd.min(exit, *far);
    }
}

const _: () = assert!(LANES == 8);
