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

/// A ray ready for box tests. Directions are scaled so that the largest magnitude is in `1.0 .. 2.0`. Single numbers, spread
/// over the lanes where they are used: from memory that costs what loading a vector does, and a ray stays small.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct BoxRay {
    x: Axis,
    y: Axis,
    z: Axis,
}

/// One axis of a ray: six words.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Axis {
    /// Makes the entry into a slab from its nearer plane: `plane * near_inverse + near_offset`.
    near_inverse: f32,
    near_offset: f32,
    /// Makes the exit from the farther plane.
    far_inverse: f32,
    far_offset: f32,
    rows: Rows,
}

/// The rows of [`Boxes`] that a ray enters and leaves slabs by: eight times 0 ..= 5, where the row begins, so that no instruction
/// is spent on finding it. Nothing else is ever written here.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Rows {
    near: u32,
    far: u32,
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

    /// What to widen the origin by, per axis: for [`BoxRay::set_origin`].
    pub fn widen(&self) -> [f32; 3] {
        [self.widen[0], self.widen[1], self.widen[2]]
    }

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

impl BoxRay {
    /// No ray yet: both setters are to be called.
    pub const UNSET: BoxRay = {
        let axis = Axis {
            near_inverse: 0.0,
            near_offset: 0.0,
            far_inverse: 0.0,
            far_offset: 0.0,
            rows: Rows::of(0, false),
        };
        BoxRay { x: axis, y: axis, z: axis }
    };

    /// What to widen the origin of an oblique ray by that is exact before it is rounded to f32: as [`ParallelAxes::NONE`].
    pub const WIDEN_LEAST: [f32; 3] = [TINY; 3];

    /// Whether the direction in lanes 0 to 2 is along no axis.
    #[inline(always)]
    pub fn is_oblique<S: Simd>(simd: S, direction: S::F, parallel: &Parallel) -> bool {
        simd.bits(simd.le(simd.splat(parallel.below), simd.abs(direction))) & 7 == 7
    }

    /// Sets the direction, in lanes 0 to 2, rounded. The origin is to be set after it.
    #[inline(always)]
    pub fn set_direction<S: Simd>(&mut self, simd: S, direction: S::F, parallel: &ParallelAxes) {
        let zero = simd.splat(0.0);
        let stand_in = simd.load(&parallel.inverse);
        let inverse = simd.div(simd.splat(1.0), direction);
        let inverse = simd.select(simd.lt(zero, stand_in), stand_in, inverse);
        let negative = simd.bits(simd.lt(inverse, zero)) as usize;
        let near = simd.to_array(inverse);
        let far = simd.to_array(simd.mul(inverse, simd.splat(WIDEN)));
        self.x.set_direction(near[0], far[0], 0, negative & 1);
        self.y.set_direction(near[1], far[1], 1, negative >> 1 & 1);
        self.z.set_direction(near[2], far[2], 2, negative >> 2 & 1);
    }

    /// Sets the origin, rounded to nearest. `widen`: [`ParallelAxes::widen`] of the direction.
    #[inline(always)]
    pub fn set_origin<S: Simd>(&mut self, simd: S, origin: [f32; 3], widen: [f32; 3]) {
        let near_inverse = [self.x.near_inverse, self.y.near_inverse, self.z.near_inverse];
        let far_inverse = [self.x.far_inverse, self.y.far_inverse, self.z.far_inverse];
        let (near, far) = offsets(
            simd,
            first_three(simd, origin),
            first_three(simd, widen),
            first_three(simd, near_inverse),
            first_three(simd, far_inverse),
        );
        let (near, far) = (simd.to_array(near), simd.to_array(far));
        (self.x.near_offset, self.x.far_offset) = (near[0], far[0]);
        (self.y.near_offset, self.y.far_offset) = (near[1], far[1]);
        (self.z.near_offset, self.z.far_offset) = (near[2], far[2]);
    }

    /// Lets the origin be anywhere, so that every box passes but the empty ones.
    pub fn set_origin_unknown(&mut self) {
        for axis in [&mut self.x, &mut self.y, &mut self.z] {
            (axis.near_offset, axis.far_offset) = (f32::MIN, f32::MAX);
        }
    }

    /// Tests eight boxes against the part of the ray between `t_min` and `t_max`. Bit `i` of the result is set if the
    /// ray may meet box `i`, and lane `i` of the first result is then a lower bound, up to a factor of `1 + 2^-21`, of
    /// where (never less than `t_min`). A clear bit is certain if the ray's true interval lies inside
    /// `t_min ..= t_max`.
    #[inline(always)]
    pub fn test<S: Simd>(&self, simd: S, boxes: &Boxes, t_min: S::F, t_max: S::F) -> (S::F, u32) {
        let (mut near, mut far) = (t_min, t_max);
        self.x.clip(simd, self.x.rows.planes(simd, boxes), &mut near, &mut far);
        self.y.clip(simd, self.y.rows.planes(simd, boxes), &mut near, &mut far);
        self.z.clip(simd, self.z.rows.planes(simd, boxes), &mut near, &mut far);
        (near, simd.bits(simd.le(near, far)))
    }

    /// [`BoxRay::test`] for packed boxes, except for the lanes that hold no box.
    #[inline(always)]
    pub fn test_packed<S: Simd>(
        &self,
        simd: S,
        boxes: &PackedBoxes,
        t_min: S::F,
        t_max: S::F,
    ) -> (S::F, u32) {
        let (mut near, mut far) = (t_min, t_max);
        self.x.clip(simd, self.x.packed_planes(simd, boxes), &mut near, &mut far);
        self.y.clip(simd, self.y.packed_planes(simd, boxes), &mut near, &mut far);
        self.z.clip(simd, self.z.packed_planes(simd, boxes), &mut near, &mut far);
        (near, simd.bits(simd.le(near, far)) & boxes.used)
    }
}

/// Where the rows begin that hold the lowest and the highest coordinates of an axis.
const LOW_ROWS: [u32; 3] = [0, LANES as u32, 2 * LANES as u32];
const HIGH_ROWS: [u32; 3] = [3 * LANES as u32, 4 * LANES as u32, 5 * LANES as u32];

/// What is added to the products with the inverses: for entries and for exits.
#[inline(always)]
fn offsets<S: Simd>(
    simd: S,
    origin: S::F,
    widen: S::F,
    near_inverse: S::F,
    far_inverse: S::F,
) -> (S::F, S::F) {
    let step = simd.mul_add(simd.abs(origin), simd.splat(ORIGIN_ROUNDING), widen);
    // Entries are earlier and exits later if the origin is farther along the ray, and nearer, respectively.
    let step = simd.flip_sign(step, near_inverse);
    let near = simd.mul(simd.sub(simd.splat(0.0), simd.add(origin, step)), near_inverse);
    (near, simd.mul(simd.sub(step, origin), far_inverse))
}

/// Three numbers in the first lanes.
#[inline(always)]
fn first_three<S: Simd>(simd: S, [x, y, z]: [f32; 3]) -> S::F {
    simd.load(&[x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0])
}

/// Words of a [`BoxRay`].
pub(super) const BOX_RAY_WORDS: usize = size_of::<BoxRay>() / 4;

/// Eight rays made ready for box tests at once, word by word of a [`BoxRay`]: oblique ones ([`BoxRay::is_oblique`]) with
/// origins that are exact before they are rounded to f32. The same as [`BoxRay::set_direction`] and [`BoxRay::set_origin`]
/// for each, at a fraction of the price. Lane `i` is ray `i`: directions, largest magnitude 1 to 2, and origins, both rounded.
#[inline(always)]
pub(super) fn box_ray_words<S: Simd>(
    simd: S,
    direction: &[S::F; 3],
    origin: &[S::F; 3],
) -> [S::F; BOX_RAY_WORDS] {
    let [a, b, c, d, e, f] = axis_words(simd, direction[0], origin[0], 0);
    let [g, h, i, j, k, l] = axis_words(simd, direction[1], origin[1], 1);
    let [m, n, o, p, q, r] = axis_words(simd, direction[2], origin[2], 2);
    [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r]
}

/// The words of an [`Axis`], in its order.
#[inline(always)]
fn axis_words<S: Simd>(simd: S, direction: S::F, origin: S::F, axis: usize) -> [S::F; 6] {
    let inverse = simd.div(simd.splat(1.0), direction);
    let far_inverse = simd.mul(inverse, simd.splat(WIDEN));
    let (near_offset, far_offset) = offsets(simd, origin, simd.splat(TINY), inverse, far_inverse);
    let negative = simd.lt(inverse, simd.splat(0.0));
    // As bits.
    let low = simd.splat(f32::from_bits(LOW_ROWS[axis]));
    let high = simd.splat(f32::from_bits(HIGH_ROWS[axis]));
    let (near_row, far_row) = (simd.select(negative, high, low), simd.select(negative, low, high));
    [inverse, near_offset, far_inverse, far_offset, near_row, far_row]
}

impl Rows {
    /// For rays that go up or down `axis`.
    #[inline(always)]
    pub const fn of(axis: usize, goes_down: bool) -> Rows {
        let (low, high) = (LOW_ROWS[axis], HIGH_ROWS[axis]);
        if goes_down { Rows { near: high, far: low } } else { Rows { near: low, far: high } }
    }

    /// The planes by which a ray enters and leaves the slabs of eight boxes.
    #[inline(always)]
    pub fn planes<S: Simd>(&self, simd: S, boxes: &Boxes) -> (S::F, S::F) {
        let numbers = boxes.as_flattened();
        // SAFETY: the rows are eight times 0 ..= 5, and six rows of eight numbers are there.
        unsafe {
            (
                simd.load_unchecked(numbers, self.near as usize),
                simd.load_unchecked(numbers, self.far as usize),
            )
        }
    }
}

impl Axis {
    /// `negative` is 1 or 0.
    #[inline(always)]
    fn set_direction(&mut self, near_inverse: f32, far_inverse: f32, axis: usize, negative: usize) {
        (self.near_inverse, self.far_inverse) = (near_inverse, far_inverse);
        self.rows = Rows::of(axis, negative == 1);
    }

    #[inline(always)]
    fn packed_planes<S: Simd>(&self, simd: S, boxes: &PackedBoxes) -> (S::F, S::F) {
        // SAFETY: the rows are eight times 0 ..= 5.
        unsafe { (boxes.row(simd, self.rows.near as usize), boxes.row(simd, self.rows.far as usize)) }
    }

    /// Narrows `near ..= far` to what lies between two planes.
    #[inline(always)]
    fn clip<S: Simd>(&self, simd: S, (near_plane, far_plane): (S::F, S::F), near: &mut S::F, far: &mut S::F) {
        let entry = simd.mul_add(near_plane, simd.splat(self.near_inverse), simd.splat(self.near_offset));
        let exit = simd.mul_add(far_plane, simd.splat(self.far_inverse), simd.splat(self.far_offset));
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
    /// For each row, the side of cell 0, low rows moved down and high rows up by more than the rounding of unpacking; and the
    /// step from cell to cell. Eight bytes a row, as for `cells`.
    sides: [[f32; 2]; 6],
    /// Bit `i`: lane `i` holds a box.
    used: u32,
}

impl PackedBoxes {
    /// `cells` are boxes by first and last cell (both included) on the grid over `low ..= high`; one with first above
    /// last is not a box. If none is, the whole grid is the only box. Results hold for grids whose sides were computed
    /// with a relative error of at most `2^-22` of the larger corner's magnitude.
    pub fn new(low: [f32; 3], high: [f32; 3], cells: &[[u8; 6]; LANES]) -> PackedBoxes {
        let mut packed = PackedBoxes { cells: [[0; LANES]; 6], sides: [[0.0; 2]; 6], used: 0 };
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
            packed.sides[axis] = [low[axis] - slack, step];
            packed.sides[axis + 3] = [low[axis] + step + slack, step];
        }
        packed
    }

    /// The boxes as the test sees them, for several rays; and a bit for each lane that holds one. The other lanes hold anything.
    #[inline(always)]
    pub fn unpack_for_tests<S: Simd>(&self, simd: S) -> (Boxes, u32) {
        let mut boxes = [[0.0; LANES]; 6];
        for (row, sides) in boxes.iter_mut().enumerate() {
            // SAFETY: eight times 0 ..= 5.
            *sides = simd.to_array(unsafe { self.row(simd, LANES * row) });
        }
        (boxes, self.used)
    }

    /// The boxes, and lanes that hold none as [`Boxes`] has them.
    pub fn unpack(&self) -> Boxes {
        let mut boxes = [[f32::INFINITY; LANES]; 6];
        for (row, sides) in boxes.iter_mut().enumerate() {
            for (lane, side) in sides.iter_mut().enumerate() {
                if self.used >> lane & 1 == 1 {
                    let [base, step] = self.sides[row];
                    *side = f32::from(self.cells[row][lane]) * step + base;
                } else if row >= 3 {
                    *side = f32::NEG_INFINITY;
                }
            }
        }
        boxes
    }

    /// The sides of row `start / 8`.
    ///
    /// # Safety
    /// `start` is eight times 0 ..= 5.
    #[inline(always)]
    unsafe fn row<S: Simd>(&self, simd: S, start: usize) -> S::F {
        // SAFETY: rows of both tables are eight bytes long, so that `start` is where the caller's row begins in each.
        let (cells, [base, step]) = unsafe {
            let cells = self.cells.as_ptr().byte_add(start);
            (&*cells, *self.sides.as_ptr().byte_add(start))
        };
        simd.mul_add(simd.load_bytes(cells), simd.splat(step), simd.splat(base))
    }
}
