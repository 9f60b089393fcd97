//! One ray against eight boxes.
//!
//! The test never misses a box that the ray meets (I3). For each axis the entry is `(near - o) * inv`; the subtraction,
//! the inverse and the product each round once, so entry and exit are off by a factor of at most `(1 + u)^3` each
//! (Ize, "Robust BVH Ray Traversal", 2013). [`BoxRay::new`] therefore scales the exit's inverse up by more than
//! `(1 + u)^6`, and the origin is given as an interval, so that rounding it only widens the slabs.

use super::lanes::{LANES, Simd};

/// Eight boxes: lowest x, y, z, then highest x, y, z, eight lanes each. A lane that holds no box has lowest `+inf` and
/// highest `-inf`, which no ray meets.
pub type Boxes = [[f32; LANES]; 6];

/// A ray ready for box tests. Directions are scaled so that the largest magnitude is in `1.0 .. 2.0`.
#[derive(Clone, Copy)]
pub struct BoxRay<S: Simd> {
    /// The end of the origin's interval that makes the entry earlier.
    near_origin: [S::F; 3],
    /// The end that makes the exit later.
    far_origin: [S::F; 3],
    near_inverse: [S::F; 3],
    far_inverse: [S::F; 3],
    /// Row of `Boxes` that the ray enters by, 0 ..= 5; the opposite row it leaves by. Private: kept in range by `new`.
    near_row: [usize; 3],
    far_row: [usize; 3],
}

/// More than `(1 + 2^-24)^6`, with room for the rounding of the inverse itself.
const WIDEN: f64 = 1.0 + 1.0 / (1u64 << 20) as f64;

/// Widens the origin so that products in the subnormal range, which lose absolute accuracy, cannot matter: next to
/// numbers below 2^-96 it is larger than their rounding, and differences of larger f32 are 0 or at least 2^-120.
const TINY: f32 = 1.0 / (1u128 << 120) as f32;

/// How far a ray can drift on an axis whose direction's inverse overflows (magnitude below 2^-127), with `t` at most
/// 2^63 inside any model's frame.
const DRIFT: f32 = 1.0 / (1u64 << 60) as f32;

impl<S: Simd> BoxRay<S> {
    /// A ray whose origin lies between `origin_low` and `origin_high` (inclusive).
    #[inline(always)]
    pub fn new(
        simd: S,
        origin_low: [f32; 3],
        origin_high: [f32; 3],
        inverse: &InverseDirection,
    ) -> BoxRay<S> {
        let zero = simd.splat(0.0);
        let mut ray = BoxRay {
            near_origin: [zero; 3],
            far_origin: [zero; 3],
            near_inverse: [zero; 3],
            far_inverse: [zero; 3],
            near_row: [0; 3],
            far_row: [0; 3],
        };
        for axis in 0..3 {
            ray.near_inverse[axis] = simd.splat(inverse.near[axis]);
            ray.far_inverse[axis] = simd.splat(inverse.far[axis]);
        }
        ray.set_origin(simd, origin_low, origin_high, inverse);
        ray
    }

    /// Gives the ray another origin (for a block with another base).
    #[inline(always)]
    pub fn set_origin(
        &mut self,
        simd: S,
        origin_low: [f32; 3],
        origin_high: [f32; 3],
        inverse: &InverseDirection,
    ) {
        for axis in 0..3 {
            let low = simd.splat(origin_low[axis] - inverse.widen[axis]);
            let high = simd.splat(origin_high[axis] + inverse.widen[axis]);
            let negative = inverse.negative[axis];
            (self.near_origin[axis], self.far_origin[axis]) =
                if negative { (low, high) } else { (high, low) };
            self.near_row[axis] = if negative { axis + 3 } else { axis };
            self.far_row[axis] = if negative { axis } else { axis + 3 };
        }
    }

    /// Tests eight boxes against the part of the ray between `t_min` and `t_max`. Bit `i` of the result is set if the
    /// ray may meet box `i`, and lane `i` of the first result is then a lower bound, up to a factor of `1 + 2^-21`, of
    /// where (never less than `t_min`). A clear bit is certain if the ray's true interval lies inside
    /// `t_min ..= t_max`.
    #[inline(always)]
    pub fn test(&self, simd: S, boxes: &Boxes, t_min: S::F, t_max: S::F) -> (S::F, u32) {
        // SAFETY: `test_rows` asks for rows 0 ..= 5 only.
        self.test_rows(simd, |row| simd.load(unsafe { boxes.get_unchecked(row) }), t_min, t_max)
    }

    /// [`BoxRay::test`] for packed boxes, except for the lanes that hold no box.
    #[inline(always)]
    pub fn test_packed(&self, simd: S, boxes: &PackedBoxes, t_min: S::F, t_max: S::F) -> (S::F, u32) {
        let (near, hits) = self.test_rows(simd, |row| boxes.row(simd, row), t_min, t_max);
        (near, hits & boxes.used)
    }

    #[inline(always)]
    fn test_rows(&self, simd: S, load: impl Fn(usize) -> S::F, t_min: S::F, t_max: S::F) -> (S::F, u32) {
        let (mut near, mut far) = (t_min, t_max);
        for axis in 0..3 {
            // `set_origin` puts only 0 ..= 5 into the rows, and nothing else writes them.
            let (near_plane, far_plane) = (load(self.near_row[axis]), load(self.far_row[axis]));
            let entry = simd.mul(simd.sub(near_plane, self.near_origin[axis]), self.near_inverse[axis]);
            let exit = simd.mul(simd.sub(far_plane, self.far_origin[axis]), self.far_inverse[axis]);
            // 0 * inf, a ray inside a slab's border plane, is NaN: `max` and `min` then keep their second operand.
            near = simd.max(entry, near);
            far = simd.min(exit, far);
        }
        (near, simd.bits(simd.le(near, far)))
    }
}

/// Up to eight boxes on a grid of 256 cells per axis, in 128 bytes, unpacked while they are tested. Rounded outward.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct PackedBoxes {
    /// First and last cell per axis, in the order of [`Boxes`].
    cells: [[u8; LANES]; 6],
    /// Side of cell 0 for each row, low rows moved down and high rows up by more than the rounding of unpacking.
    base: [f32; 6],
    step: [f32; 6],
    /// Bit `i`: lane `i` holds a box.
    used: u32,
}

impl PackedBoxes {
    /// `cells` are boxes by first and last cell (both included) on the grid over `low ..= high`; one with first above
    /// last is not a box. If none is, the whole grid is the only box. Results hold for grids whose sides were computed
    /// with a relative error of at most `2^-22` of the larger corner's magnitude.
    pub fn new(low: [f32; 3], high: [f32; 3], cells: &[[u8; 6]; LANES]) -> PackedBoxes {
        let mut packed = PackedBoxes { cells: [[0; LANES]; 6], base: [0.0; 6], step: [0.0; 6], used: 0 };
        for (lane, cell) in cells.iter().enumerate() {
            if (0..3).all(|axis| cell[axis] <= cell[axis + 3]) {
                packed.used |= 1 << lane;
                for row in 0..6 {
                    packed.cells[row][lane] = cell[row];
                }
            }
        }
        if packed.used == 0 {
            packed.used = 1;
            for row in 3..6 {
                packed.cells[row][0] = 255;
            }
        }
        for axis in 0..3 {
            let step = (high[axis] - low[axis]) * (1.0 / 256.0);
            // Step, product and sum round by at most 2^-24 of the extent (at most twice the magnitude), of the
            // extent and of the magnitude; the grid itself by 2^-22 of the magnitude.
            let slack =
                low[axis].abs().max(high[axis].abs()) * (1.0 / (1u32 << 20) as f32) + f32::MIN_POSITIVE;
            packed.base[axis] = low[axis] - slack;
            packed.base[axis + 3] = low[axis] + step + slack;
            packed.step[axis] = step;
            packed.step[axis + 3] = step;
        }
        packed
    }

    #[inline(always)]
    fn row<S: Simd>(&self, simd: S, row: usize) -> S::F {
        let cells = simd.load_bytes(&self.cells[row]);
        simd.mul_add(cells, simd.splat(self.step[row]), simd.splat(self.base[row]))
    }
}

/// The inverse of a direction, with what the box test needs where it overflows. Independent of the origin.
#[derive(Clone, Copy, Debug)]
pub struct InverseDirection {
    near: [f32; 3],
    far: [f32; 3],
    widen: [f32; 3],
    negative: [bool; 3],
}

impl InverseDirection {
    /// Of a direction whose largest magnitude is in `1.0 .. 2.0`.
    #[inline(always)]
    pub fn new(direction: [f64; 3]) -> InverseDirection {
        let mut result =
            InverseDirection { near: [0.0; 3], far: [0.0; 3], widen: [TINY; 3], negative: [false; 3] };
        for axis in 0..3 {
            let exact = 1.0 / direction[axis];
            let near = exact as f32;
            if near.is_finite() {
                result.near[axis] = near;
                result.far[axis] = (exact * WIDEN) as f32;
                result.negative[axis] = near < 0.0;
            } else {
                // The axis is taken as parallel: the slab holds the ray's origin, give or take the drift, or the ray
                // never meets it.
                result.near[axis] = f32::INFINITY;
                result.far[axis] = f32::INFINITY;
                result.widen[axis] = if direction[axis] == 0.0 { TINY } else { DRIFT };
            }
        }
        result
    }
}
