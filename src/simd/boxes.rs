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
    /// What to widen the origin by, per axis.
    widen: [f32; 3],
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
    /// Eight times the row of `Boxes` (0 ..= 5) that the ray enters by, and of the opposite one, which it leaves by: where the
    /// row begins, so that no instruction is spent on finding it. Nothing else is ever written here.
    near_row: u32,
    far_row: u32,
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
        BoxRay { x: axis, y: axis, z: axis, widen: [0.0; 3] }
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
        self.widen = [parallel.widen[0], parallel.widen[1], parallel.widen[2]];
    }

    /// Sets the origin, each coordinate in all lanes, rounded to nearest.
    #[inline(always)]
    pub fn set_origin(&mut self, simd: S, origin: &[S::F; 3]) {
        self.x.set_origin(simd, origin[0], simd.splat(self.widen[0]));
        self.y.set_origin(simd, origin[1], simd.splat(self.widen[1]));
        self.z.set_origin(simd, origin[2], simd.splat(self.widen[2]));
    }

    /// Lets the origin be anywhere, so that every box passes but the empty ones.
    pub fn set_origin_unknown(&mut self, simd: S) {
        let (near, far) = (simd.splat(f32::MIN), simd.splat(f32::MAX));
        (self.x.near_offset, self.x.far_offset) = (near, far);
        (self.y.near_offset, self.y.far_offset) = (near, far);
        (self.z.near_offset, self.z.far_offset) = (near, far);
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

/// Eight rays made ready for box tests at once: oblique ones ([`BoxRay::is_oblique`]) with origins that are exact before they
/// are rounded to f32. The same as [`BoxRay::set_direction`] and [`BoxRay::set_origin`] for each, at a third of the price.
#[derive(Clone, Copy, Debug)]
pub struct BoxRays {
    axes: [AxisOfRays; 3],
}

/// One axis of eight rays: see [`Axis`].
#[derive(Clone, Copy, Debug)]
struct AxisOfRays {
    near_inverse: [f32; LANES],
    near_offset: [f32; LANES],
    far_inverse: [f32; LANES],
    far_offset: [f32; LANES],
    /// The rows, as bits.
    near_row: [f32; LANES],
    far_row: [f32; LANES],
}

impl BoxRays {
    /// Lane `i` is ray `i`: directions, largest magnitude 1 to 2, and origins, both rounded.
    #[inline(always)]
    pub fn new<S: Simd>(simd: S, direction: &[S::F; 3], origin: &[S::F; 3]) -> BoxRays {
        BoxRays {
            axes: [
                AxisOfRays::new(simd, direction[0], origin[0], 0),
                AxisOfRays::new(simd, direction[1], origin[1], 1),
                AxisOfRays::new(simd, direction[2], origin[2], 2),
            ],
        }
    }

    /// Puts ray `lane` (below 8) into `ray`.
    #[inline(always)]
    pub fn get<S: Simd>(&self, simd: S, lane: usize, ray: &mut BoxRay<S>) {
        let lane = lane % LANES;
        self.axes[0].get(simd, lane, &mut ray.x);
        self.axes[1].get(simd, lane, &mut ray.y);
        self.axes[2].get(simd, lane, &mut ray.z);
        ray.widen = [TINY; 3];
    }
}

impl AxisOfRays {
    #[inline(always)]
    fn new<S: Simd>(simd: S, direction: S::F, origin: S::F, axis: usize) -> AxisOfRays {
        let inverse = simd.div(simd.splat(1.0), direction);
        let far_inverse = simd.mul(inverse, simd.splat(WIDEN));
        let (near_offset, far_offset) = offsets(simd, origin, simd.splat(TINY), inverse, far_inverse);
        let negative = simd.lt(inverse, simd.splat(0.0));
        let (low, high) =
            (simd.splat(f32::from_bits(LOW_ROWS[axis])), simd.splat(f32::from_bits(HIGH_ROWS[axis])));
        AxisOfRays {
            near_inverse: simd.to_array(inverse),
            near_offset: simd.to_array(near_offset),
            far_inverse: simd.to_array(far_inverse),
            far_offset: simd.to_array(far_offset),
            near_row: simd.to_array(simd.select(negative, high, low)),
            far_row: simd.to_array(simd.select(negative, low, high)),
        }
    }

    #[inline(always)]
    fn get<S: Simd>(&self, simd: S, lane: usize, axis: &mut Axis<S>) {
        axis.near_inverse = simd.splat(self.near_inverse[lane]);
        axis.near_offset = simd.splat(self.near_offset[lane]);
        axis.far_inverse = simd.splat(self.far_inverse[lane]);
        axis.far_offset = simd.splat(self.far_offset[lane]);
        // As `AxisOfRays::new` put them there.
        (axis.near_row, axis.far_row) = (self.near_row[lane].to_bits(), self.far_row[lane].to_bits());
    }
}

impl<S: Simd> Axis<S> {
    /// `negative` is 1 or 0.
    #[inline(always)]
    fn set_direction(&mut self, simd: S, near_inverse: f32, far_inverse: f32, axis: usize, negative: usize) {
        self.near_inverse = simd.splat(near_inverse);
        self.far_inverse = simd.splat(far_inverse);
        let rows =
            if negative == 1 { [HIGH_ROWS[axis], LOW_ROWS[axis]] } else { [LOW_ROWS[axis], HIGH_ROWS[axis]] };
        [self.near_row, self.far_row] = rows;
    }

    #[inline(always)]
    fn set_origin(&mut self, simd: S, origin: S::F, widen: S::F) {
        (self.near_offset, self.far_offset) =
            offsets(simd, origin, widen, self.near_inverse, self.far_inverse);
    }

    /// Where the ray enters and leaves the slabs of eight boxes.
    #[inline(always)]
    fn planes(&self, simd: S, boxes: &Boxes) -> (S::F, S::F) {
        let numbers = boxes.as_flattened();
        // SAFETY: the rows are eight times 0 ..= 5, and six rows of eight numbers are there.
        unsafe {
            (
                simd.load_unchecked(numbers, self.near_row as usize),
                simd.load_unchecked(numbers, self.far_row as usize),
            )
        }
    }

    #[inline(always)]
    fn packed_planes(&self, simd: S, boxes: &PackedBoxes) -> (S::F, S::F) {
        // SAFETY: the rows are eight times 0 ..= 5.
        unsafe { (boxes.row(simd, self.near_row as usize), boxes.row(simd, self.far_row as usize)) }
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

    /// The boxes as the test sees them.
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
