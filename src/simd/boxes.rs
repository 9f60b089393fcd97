//! One ray against eight boxes.
//!
//! The test never misses a box that the ray meets (I3). With `u = 2^-24`, the inverse `i` of a direction rounds twice
//! (direction and quotient). The entry of a slab is `plane * i - o * i`, with `o * i` rounded beforehand: as if the origin
//! were `o (1 + e)`, `|e| <= u`. So all errors of the origin, that of its conversion to f32 too, are shifts of it by a few
//! `u |o|`, and [`BoxRay::set_origin`] moves it by more than that towards earlier entries and later exits. What remains
//! are a fused operation's rounding, or that of product and sum without one (of which `u |plane| <= u |plane - o| + u |o|`
//! is another such shift), and those of the inverse: a factor of at most `(1 + u)^4` on entry and exit each (after Ize,
//! "Robust BVH Ray Traversal", 2013), for which the exit's inverse is scaled up by more than `(1 + u)^8`.

use super::lanes::{LANES, Simd};

/// Eight boxes: lowest x, y, z, then highest x, y, z, eight lanes each. A lane that holds no box has lowest `+inf` and
/// highest `-inf`, which no ray meets.
pub type Boxes = [[f32; LANES]; 6];

/// A ray ready for box tests. Directions are scaled so that the largest magnitude is in `1.0 .. 2.0`.
#[derive(Clone, Copy)]
pub struct BoxRay<S: Simd> {
    // By name, not in an array: what is only ever named can live in registers.
    x: Axis<S>,
    y: Axis<S>,
    z: Axis<S>,
    /// The inverse by axis in lanes 0 to 2, and what to widen the origin by.
    inverse: S::F,
    widen: S::F,
}

/// One axis of a ray.
#[derive(Clone, Copy)]
struct Axis<S: Simd> {
    /// Makes the entry into a slab from its nearer plane: `plane * near_inverse + near_offset`.
    near_inverse: S::F,
    near_offset: S::F,
    /// Makes the exit from the farther plane.
    far_inverse: S::F,
    far_offset: S::F,
    /// Row of `Boxes` that the ray enters by, 0 ..= 5; the opposite row it leaves by. Kept in range by `set_direction`.
    near_row: usize,
    far_row: usize,
}

/// More than `(1 + 2^-24)^8`, with room for the rounding of the product with it.
const WIDEN: f32 = 1.0 + 1.0 / (1u32 << 20) as f32;

/// Widens the origin so that results in the subnormal range, which lose absolute accuracy, cannot matter.
const TINY: f32 = 1.0 / (1u128 << 120) as f32;

/// Eight roundings of an f32. Conversion, the shift itself, the product with the inverse and that of the plane take one each.
const ORIGIN_ROUNDING: f32 = 1.0 / (1u32 << 21) as f32;

/// How directions that are almost or exactly along an axis are treated, for coordinates of a certain magnitude.
#[derive(Clone, Copy, Debug)]
pub struct Parallel {
    /// A direction component below this is taken as parallel to the axis' planes.
    pub below: f32,
    /// What stands for its inverse: products with coordinates are finite.
    inverse: f32,
    /// More than a ray drifts on such an axis, and enough for products with `inverse` to be beyond the model.
    widen: f32,
}

impl Parallel {
    /// For coordinates and parameters below `2^exponent`; at most 48.
    pub fn new(exponent: i32) -> Parallel {
        let exponent = exponent.clamp(-48, 48);
        let power = |exponent: i32| f32::from_bits(((127 + exponent.clamp(-126, 127)) as u32) << 23);
        // With t below 2^exponent, the drift is below 2^(2 exponent - 110); and that times the inverse is 2^exponent.
        Parallel {
            below: power(exponent - 110),
            inverse: power(110 - exponent),
            widen: power(2 * exponent - 108) + TINY,
        }
    }
}

/// The axes along which a ray hardly moves, for [`BoxRay::set_direction`].
#[derive(Clone, Copy, Debug)]
pub struct ParallelAxes {
    /// What stands for the inverse on parallel axes, else 0.
    inverse: [f32; LANES],
    widen: [f32; LANES],
}

impl ParallelAxes {
    /// For a direction that is oblique ([`BoxRay::is_oblique`]) and an origin that is exact before it is rounded to f32.
    pub const NONE: ParallelAxes = ParallelAxes { inverse: [0.0; LANES], widen: [TINY; LANES] };

    /// For any direction whose largest magnitude is in `1.0 .. 2.0`, and an origin that is off by `origin_error` per
    /// axis before it is rounded to f32.
    pub fn new(direction: [f64; 3], origin_error: f32, parallel: &Parallel) -> ParallelAxes {
        let mut axes = ParallelAxes::NONE;
        for (axis, component) in direction.into_iter().enumerate() {
            if component.abs() < f64::from(parallel.below) {
                // The slab holds the ray's origin, give or take the drift, or the ray never meets it.
                axes.inverse[axis] = parallel.inverse;
                axes.widen[axis] = parallel.widen;
            }
            axes.widen[axis] += origin_error;
        }
        axes
    }
}

impl<S: Simd> BoxRay<S> {
    /// Whether the direction in lanes 0 to 2 is along no axis.
    #[inline(always)]
    pub fn is_oblique(simd: S, direction: S::F, parallel: &Parallel) -> bool {
        simd.bits(simd.le(simd.splat(parallel.below), simd.abs(direction))) & 7 == 7
    }

    /// No ray yet: both setters are to be called.
    #[inline(always)]
    pub fn unset(simd: S) -> BoxRay<S> {
        let zero = simd.splat(0.0);
        let axis = Axis {
            near_inverse: zero,
            near_offset: zero,
            far_inverse: zero,
            far_offset: zero,
            near_row: 0,
            far_row: 0,
        };
        BoxRay { x: axis, y: axis, z: axis, inverse: zero, widen: zero }
    }

    /// Sets the direction, in lanes 0 to 2, rounded. The origin is to be set after it.
    #[inline(always)]
    pub fn set_direction(&mut self, simd: S, direction: S::F, parallel: &ParallelAxes) {
        let zero = simd.splat(0.0);
        let stand_in = simd.load(&parallel.inverse);
        let inverse = simd.div(simd.splat(1.0), direction);
        let inverse = simd.select(simd.lt(zero, stand_in), stand_in, inverse);
        let negative = simd.bits(simd.lt(inverse, zero)) as usize;
        let near = simd.to_array(inverse);
        let far = simd.to_array(simd.mul(inverse, simd.splat(WIDEN)));
        self.x.set_direction(simd, near[0], far[0], 0, negative & 1);
        self.y.set_direction(simd, near[1], far[1], 1, negative >> 1 & 1);
        self.z.set_direction(simd, near[2], far[2], 2, negative >> 2 & 1);
        self.inverse = inverse;
        self.widen = simd.load(&parallel.widen);
    }

    /// Sets the origin, in lanes 0 to 2, rounded to nearest.
    #[inline(always)]
    pub fn set_origin(&mut self, simd: S, origin: S::F) {
        let step = simd.mul_add(simd.abs(origin), simd.splat(ORIGIN_ROUNDING), self.widen);
        // Entries are earlier and exits later if the origin is farther along the ray, and nearer, respectively.
        let step = simd.flip_sign(step, self.inverse);
        let zero = simd.splat(0.0);
        let far_inverse = simd.mul(self.inverse, simd.splat(WIDEN));
        let near = simd.mul(simd.sub(zero, simd.add(origin, step)), self.inverse);
        let far = simd.mul(simd.sub(step, origin), far_inverse);
        self.set_offsets(simd, near, far);
    }

    /// Lets the origin be anywhere, so that every box passes but the empty ones.
    pub fn set_origin_unknown(&mut self, simd: S) {
        self.set_offsets(simd, simd.splat(f32::MIN), simd.splat(f32::MAX));
    }

    #[inline(always)]
    fn set_offsets(&mut self, simd: S, near: S::F, far: S::F) {
        let (near, far) = (simd.to_array(near), simd.to_array(far));
        (self.x.near_offset, self.x.far_offset) = (simd.splat(near[0]), simd.splat(far[0]));
        (self.y.near_offset, self.y.far_offset) = (simd.splat(near[1]), simd.splat(far[1]));
        (self.z.near_offset, self.z.far_offset) = (simd.splat(near[2]), simd.splat(far[2]));
    }

    /// Tests eight boxes against the part of the ray between `t_min` and `t_max`. Bit `i` of the result is set if the
    /// ray may meet box `i`, and lane `i` of the first result is then a lower bound, up to a factor of `1 + 2^-21`, of
    /// where (never less than `t_min`). A clear bit is certain if the ray's true interval lies inside
    /// `t_min ..= t_max`.
    #[inline(always)]
    pub fn test(&self, simd: S, boxes: &Boxes, t_min: S::F, t_max: S::F) -> (S::F, u32) {
        let (mut near, mut far) = (t_min, t_max);
        self.x.clip(simd, self.x.planes(simd, boxes), &mut near, &mut far);
        self.y.clip(simd, self.y.planes(simd, boxes), &mut near, &mut far);
        self.z.clip(simd, self.z.planes(simd, boxes), &mut near, &mut far);
        (near, simd.bits(simd.le(near, far)))
    }

    /// [`BoxRay::test`] for packed boxes, except for the lanes that hold no box.
    #[inline(always)]
    pub fn test_packed(&self, simd: S, boxes: &PackedBoxes, t_min: S::F, t_max: S::F) -> (S::F, u32) {
        let (mut near, mut far) = (t_min, t_max);
        self.x.clip(simd, self.x.packed_planes(simd, boxes), &mut near, &mut far);
        self.y.clip(simd, self.y.packed_planes(simd, boxes), &mut near, &mut far);
        self.z.clip(simd, self.z.packed_planes(simd, boxes), &mut near, &mut far);
        (near, simd.bits(simd.le(near, far)) & boxes.used)
    }
}

impl<S: Simd> Axis<S> {
    /// `negative` is 1 or 0.
    #[inline(always)]
    fn set_direction(&mut self, simd: S, near_inverse: f32, far_inverse: f32, axis: usize, negative: usize) {
        self.near_inverse = simd.splat(near_inverse);
        self.far_inverse = simd.splat(far_inverse);
        self.near_row = axis + 3 * negative;
        self.far_row = axis + 3 - 3 * negative;
    }

    /// Where the ray enters and leaves the slabs of eight boxes.
    #[inline(always)]
    fn planes(&self, simd: S, boxes: &Boxes) -> (S::F, S::F) {
        // SAFETY: `set_direction` puts only 0 ..= 5 into the rows, and nothing else writes them.
        let (near, far) = unsafe { (boxes.get_unchecked(self.near_row), boxes.get_unchecked(self.far_row)) };
        (simd.load(near), simd.load(far))
    }

    #[inline(always)]
    fn packed_planes(&self, simd: S, boxes: &PackedBoxes) -> (S::F, S::F) {
        (boxes.row(simd, self.near_row), boxes.row(simd, self.far_row))
    }

    /// Narrows `near ..= far` to what lies between two planes.
    #[inline(always)]
    fn clip(&self, simd: S, (near_plane, far_plane): (S::F, S::F), near: &mut S::F, far: &mut S::F) {
        let entry = simd.mul_add(near_plane, self.near_inverse, self.near_offset);
        let exit = simd.mul_add(far_plane, self.far_inverse, self.far_offset);
        // NaN, from infinities of opposite sign, adds no constraint: `max` and `min` then keep their second operand.
        *near = simd.max(entry, *near);
        *far = simd.min(exit, *far);
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
                for (row, cell) in packed.cells.iter_mut().zip(cell) {
                    row[lane] = *cell;
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

    /// The boxes as the test sees them.
    pub fn unpack(&self) -> Boxes {
        let mut boxes = [[f32::INFINITY; LANES]; 6];
        for (row, sides) in boxes.iter_mut().enumerate() {
            for (lane, side) in sides.iter_mut().enumerate() {
                if self.used >> lane & 1 == 1 {
                    *side = f32::from(self.cells[row][lane]) * self.step[row] + self.base[row];
                } else if row >= 3 {
                    *side = f32::NEG_INFINITY;
                }
            }
        }
        boxes
    }

    #[inline(always)]
    fn row<S: Simd>(&self, simd: S, row: usize) -> S::F {
        let cells = simd.load_bytes(&self.cells[row]);
        simd.mul_add(cells, simd.splat(self.step[row]), simd.splat(self.base[row]))
    }
}
