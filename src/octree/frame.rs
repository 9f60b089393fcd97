//! From the model's f64 space to the f32 space of a tree, for boxes and for rays.
//!
//! A tree's space is `(x - base) * scale`. The base is the block's (or the model's centre for the coarse tree), exact in
//! f64; the scale is one power of two for the whole model, 1 unless its coordinates are so large or so small that f32
//! products would leave their range. Where anything is rounded, it is rounded outward.

use crate::geom::{Aabb, Ray, RayFrame, round_down_f32, round_up_f32};
use crate::simd::{BoxRay, ErrorBounds, Interval, LANES, Parallel, ParallelAxes, Simd, TriangleRay};

/// The f32 space of one tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    pub base: [f64; 3],
    pub scale: f64,
}

/// Coordinates between 2^-40 and 2^40 need no scale.
const PLAIN_EXPONENT: i32 = 40;

impl Frame {
    /// The scale for a model whose largest coordinate, relative to the bases of its trees, is `reach`: such that scaled
    /// coordinates are below 2 and products of three of them stay in the range of f32.
    pub fn scale_for(reach: f64) -> f64 {
        let exponent = ((reach.to_bits() >> 52) & 0x7ff) as i32 - 1023;
        if reach == 0.0 || !reach.is_finite() || exponent.abs() <= PLAIN_EXPONENT {
            1.0
        } else {
            // Both the power and its inverse stay normal.
            f64::from_bits(((1023 - exponent.clamp(-1000, 1000)) as u64) << 52)
        }
    }

    /// A position in the tree's space, rounded to nearest, and whether that was exact. Overflow gives the largest f32.
    pub fn to_local(self, position: [f64; 3]) -> ([f32; 3], bool) {
        let mut exact = true;
        let local = [0, 1, 2].map(|axis| {
            let x = ((position[axis] - self.base[axis]) * self.scale) as f32;
            let x = x.clamp(f32::MIN, f32::MAX);
            exact &= self.base[axis] + f64::from(x) / self.scale == position[axis];
            x
        });
        (local, exact)
    }

    /// A box in the tree's space: lowest and highest corner, rounded outward.
    pub fn box_to_local(self, bounds: &Aabb) -> ([f32; 3], [f32; 3]) {
        // The difference rounds once and the scale is a power of two: two units of f64, dwarfed by the f32 step only if
        // the difference is not itself an f32, so step in f64 first.
        let low = [0, 1, 2].map(|axis| {
            let difference = bounds.min[axis] - self.base[axis];
            let exact = self.base[axis] == 0.0;
            round_down_f32(if exact { difference } else { difference.next_down() } * self.scale)
        });
        let high = [0, 1, 2].map(|axis| {
            let difference = bounds.max[axis] - self.base[axis];
            let exact = self.base[axis] == 0.0;
            round_up_f32(if exact { difference } else { difference.next_up() } * self.scale)
        });
        (low, high)
    }
}

/// Where the rays of an octree travel: what preparing one needs to know about the model.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Space {
    bounds: Aabb,
    /// The coarse tree's frame, in which rays start.
    frame: Frame,
    /// The model's box in that frame with sixteen times its size around it, in lanes 0 to 2: rays from within are traced
    /// from where they start.
    near_low: [f32; LANES],
    near_high: [f32; LANES],
    parallel: Parallel,
}

impl Space {
    pub fn new(bounds: Aabb, frame: Frame) -> Space {
        let margin = 16.0 * bounds.extent().iter().fold(0.0f64, |largest, x| largest.max(*x));
        let mut near = ([f32::MIN; LANES], [f32::MAX; LANES]);
        for axis in 0..3 {
            near.0[axis] = ((bounds.min[axis] - margin - frame.base[axis]) * frame.scale) as f32;
            near.1[axis] = ((bounds.max[axis] + margin - frame.base[axis]) * frame.scale) as f32;
        }
        let reach = (0..3).fold(0.0f32, |reach, axis| reach.max(near.0[axis].abs()).max(near.1[axis].abs()));
        // Three more for the bases of blocks and for parameters, which are not along an axis.
        let parallel = Parallel::new((reach.to_bits() >> 23) as i32 - 127 + 4);
        if frame.scale > power_of_two(60) {
            // The exact ray's rounding of its origin could show: prepare every ray with care.
            near = ([f32::NAN; LANES], [f32::NAN; LANES]);
        }
        Space { bounds, frame, near_low: near.0, near_high: near.1, parallel }
    }
}

/// A ray made ready for the traversal of both levels: what does not change from frame to frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct QueryRay {
    /// Start of the traversal in the model's space: the ray's origin, or a point on the ray nearer to the model.
    origin: [f64; 3],
    /// How far off that is, per axis.
    origin_error: f64,
    /// Sum of the magnitudes of the local direction.
    direction_sum: f32,
    /// `t` to local units: first one factor, then the other (their product can leave the range of f64).
    t_factors: [f64; 2],
    /// Local parameter of the start of the traversal.
    t_start: f64,
}

/// The largest magnitude.
fn longest(direction: [f64; 3]) -> f64 {
    direction[0].abs().max(direction[1].abs()).max(direction[2].abs())
}

#[inline(always)]
const fn power_of_two(exponent: i64) -> f64 {
    f64::from_bits(((1023 + exponent) as u64) << 52)
}

/// Checks a ray and prepares it, in the frame of the coarse tree, into `query` and `local`. Returns why the ray is not
/// valid, if it is not. (The results are arguments because returned ones would be copied through memory.)
#[inline(always)]
pub(crate) fn prepare<S: Simd>(
    simd: S,
    ray: &Ray,
    space: &Space,
    query: &mut QueryRay,
    local: &mut LocalRay<S>,
) -> Option<&'static str> {
    // The common case in f32, all axes at once: from near the model, in a direction that is neither along an axis nor of
    // extraordinary length. Every comparison fails for NaN.
    let [x, y, z] = ray.direction;
    let [x, y, z] = [x as f32, y as f32, z as f32];
    let (ax, ay, az) = (x.abs(), y.abs(), z.abs());
    let longest = if ax > ay { ax } else { ay };
    let longest = if longest > az { longest } else { az };
    let exponent = (longest.to_bits() >> 23) as i32 - 127;
    // Garbage, but not used, for a direction that is not plain.
    let factor = f32::from_bits(((127 - exponent) as u32) << 23);
    let mut direction = [x * factor, y * factor, z * factor];
    let mut lanes = simd.load(&[direction[0], direction[1], direction[2], 1.0, 1.0, 1.0, 1.0, 1.0]);
    let (mut origin, mut origin_lanes) = local_origin(simd, ray.origin, &space.frame);
    let near = simd.and(
        simd.le(simd.load(&space.near_low), origin_lanes),
        simd.le(origin_lanes, simd.load(&space.near_high)),
    );
    let plain = (exponent.abs() <= 60)
        & (simd.bits(near) & 7 == 7)
        & BoxRay::is_oblique(simd, lanes, &space.parallel)
        & (ray.t_min >= 0.0)
        & (ray.t_min <= ray.t_max)
        & (ray.t_min < f64::INFINITY);
    query.origin = ray.origin;
    query.origin_error = 0.0;
    query.direction_sum = (1.0 + 1e-6) * factor * (ax + ay + az);
    query.t_factors = [power_of_two(i64::from(exponent)), space.frame.scale];
    query.t_start = 0.0;
    let mut parallel = ParallelAxes::NONE;
    let mut error = origin_error(origin);
    let mut invalid = None;
    if !plain {
        let careful = Careful::new(ray, space);
        (*query, direction, parallel, invalid) =
            (careful.query, careful.direction, careful.parallel, careful.invalid);
        lanes = simd.load(&[direction[0], direction[1], direction[2], 1.0, 1.0, 1.0, 1.0, 1.0]);
        (origin, origin_lanes) = local_origin(simd, query.origin, &space.frame);
        error = query.origin_error_in(&space.frame, origin);
    }
    local.boxes.set_direction(simd, lanes, &parallel);
    local.boxes.set_origin(simd, origin_lanes);
    local.triangles.origin = simd.splat3(origin);
    local.triangles.direction = simd.splat3(direction);
    local.base = space.frame.base;
    local.origin = origin;
    local.origin_error = error;
    local.forget_origin_if_lost(simd);
    invalid
}

/// What a ray takes that is not plain.
struct Careful {
    query: QueryRay,
    direction: [f32; 3],
    parallel: ParallelAxes,
    invalid: Option<&'static str>,
}

/// An origin in a frame, rounded: two roundings in f64 and one in f32. Also in lanes 0 to 2.
#[inline(always)]
fn local_origin<S: Simd>(simd: S, origin: [f64; 3], frame: &Frame) -> ([f32; 3], S::F) {
    let x = ((origin[0] - frame.base[0]) * frame.scale) as f32;
    let y = ((origin[1] - frame.base[1]) * frame.scale) as f32;
    let z = ((origin[2] - frame.base[2]) * frame.scale) as f32;
    ([x, y, z], simd.load(&[x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0]))
}

impl Careful {
    /// For any ray: along an axis, of any length, from any distance.
    #[cold]
    #[inline(never)]
    fn new(ray: &Ray, space: &Space) -> Careful {
        let invalid = ray.validate().err();
        // The exact ray rounds what is out of range for it; boxes must be met by the ray that triangles are.
        let exact = RayFrame::new(ray);
        let exponent = (longest(exact.direction()).to_bits() >> 52) as i64 - 1023;
        // 0 for all but the shortest and longest directions that f64 can hold. A zero direction is one that the exact
        // ray refuses: it hits nothing.
        let factor = power_of_two(-exponent.clamp(-100, 100));
        let direction = exact.direction().map(|x| x * factor);
        let mut query = QueryRay {
            origin: exact.origin(),
            origin_error: 0.0,
            direction_sum: (1.0 + 1e-6) * direction.iter().map(|x| x.abs() as f32).sum::<f32>(),
            t_factors: [1.0 / exact.scale() / factor, space.frame.scale],
            t_start: 0.0,
        };
        let near = (0..3).all(|axis| {
            let x = ((query.origin[axis] - space.frame.base[axis]) * space.frame.scale) as f32;
            space.near_low[axis] <= x && x <= space.near_high[axis]
        });
        if !near {
            query.approach(direction, space);
        }
        let error = (query.origin_error + COORDINATE_ROUNDING) * space.frame.scale;
        let parallel = ParallelAxes::new(direction, error as f32 * (1.0 + 1e-6), &space.parallel);
        Careful { query, direction: direction.map(|x| x as f32), parallel, invalid }
    }
}

impl QueryRay {
    /// No ray yet.
    pub const UNSET: QueryRay = QueryRay {
        origin: [0.0; 3],
        origin_error: 0.0,
        direction_sum: 0.0,
        t_factors: [1.0; 2],
        t_start: 0.0,
    };

    /// More than the error of the ray's origin in a frame, where it is rounded to `local`.
    #[inline(always)]
    fn origin_error_in(&self, frame: &Frame, local: [f32; 3]) -> f32 {
        let moved = (self.origin_error + COORDINATE_ROUNDING) * frame.scale;
        origin_error(local) + moved as f32 * (1.0 + 1e-6)
    }

    /// Moves the start of a ray that comes from far away to near the model, so that f32 can tell the model's parts
    /// apart. (`t_factors` is exact also where its first factor is subnormal: it is a power of two.)
    fn approach(&mut self, direction: [f64; 3], space: &Space) {
        // Any parameter will do; the entry into a box of twice the model's size is a good one.
        let bounds = &space.bounds;
        let margin = 0.5 * bounds.extent().iter().fold(0.0f64, |largest, x| largest.max(*x));
        let mut entry = 0.0f64;
        for (axis, d) in direction.into_iter().enumerate() {
            let plane = if d > 0.0 { bounds.min[axis] - margin } else { bounds.max[axis] + margin };
            let t = (plane - self.origin[axis]) / d;
            if t.is_finite() && t > entry {
                entry = t;
            }
        }
        // A little before the entry, whatever the rounding: no hit is behind the start.
        entry *= 1.0 - 1.0 / (1u64 << 45) as f64;
        let moved = [0, 1, 2].map(|axis| self.origin[axis] + entry * direction[axis]);
        // Product and sum round once each; doubled for the rounding of the bound itself.
        let error = (0..3).fold(f64::MIN_POSITIVE, |error, axis| {
            error.max(f64::EPSILON * ((entry * direction[axis]).abs() + moved[axis].abs()))
        });
        if entry > 0.0 && moved.iter().chain([&error]).all(|x| x.is_finite()) {
            self.origin = moved;
            self.origin_error = error;
            self.t_start = entry * space.frame.scale;
        }
    }

    #[inline(always)]
    fn local_parameter(&self, t: f64) -> f64 {
        t * self.t_factors[0] * self.t_factors[1] - self.t_start
    }

    /// The parameter of a local one, rounded.
    #[inline(always)]
    pub fn ray_parameter(&self, local: f32) -> f64 {
        (f64::from(local) + self.t_start) / self.t_factors[1] / self.t_factors[0]
    }

    /// At least the local parameter of `t`, by a factor of `1 + 2^-20` or more, and greater than 0.
    #[inline(always)]
    pub fn local_high(&self, t: f64) -> f32 {
        let local = self.local_parameter(t) + self.t_start * MARGIN_F64;
        let high = local as f32 * (1.0 + MARGIN) + f32::MIN_POSITIVE;
        // Hits beyond the range of f64 all have t = f64::MAX; NaN is infinity minus infinity.
        if t >= f64::MAX || high.is_nan() {
            f32::INFINITY
        } else if high > 0.0 {
            high
        } else {
            f32::MIN_POSITIVE
        }
    }

    /// At most the local parameter of `t`, by a factor of `1 - 2^-20` or more, or 0: no part of the model is before the
    /// start of the traversal.
    #[inline(always)]
    pub fn local_low(&self, t: f64) -> f32 {
        let local = self.local_parameter(t) - self.t_start * MARGIN_F64;
        let low = local as f32 * (1.0 - MARGIN) - f32::MIN_POSITIVE;
        // NaN is infinity minus infinity. What overflows is clamped to a number that no infinity is below.
        if low > 0.0 { low.min(f32::MAX) } else { 0.0 }
    }

    /// An interval that certainly lies inside `t_min ..= t_max`.
    #[inline(always)]
    pub fn local_inner(&self, t_min: f64, t_max: f64) -> (f32, f32) {
        let local = self.local_parameter(t_max) - self.t_start * MARGIN_F64;
        let high = local as f32 * (1.0 - MARGIN) - f32::MIN_POSITIVE;
        (self.local_high(t_min), if high > 0.0 { high.min(f32::MAX) } else { -1.0 })
    }
}

/// More than any rounding of a parameter in f32 arithmetic, with room for that of the product with it: 2^-18.
const MARGIN: f32 = 1.0 / (1u32 << 18) as f32;
/// More than the rounding of a difference of parameters in f64.
const MARGIN_F64: f64 = 4.0 * f64::EPSILON;

/// A query ray in one tree's space.
#[derive(Clone, Copy)]
pub(crate) struct LocalRay<S: Simd> {
    pub boxes: BoxRay<S>,
    pub triangles: TriangleRay<S>,
    base: [f64; 3],
    origin: [f32; 3],
    /// How far `origin` is off, per axis.
    origin_error: f32,
}

impl<S: Simd> LocalRay<S> {
    /// No ray yet.
    #[inline(always)]
    pub fn unset(simd: S) -> LocalRay<S> {
        let zero = simd.splat(0.0);
        LocalRay {
            boxes: BoxRay::unset(simd),
            triangles: TriangleRay {
                origin: [zero; 3],
                direction: [zero; 3],
                bounds: ErrorBounds::new(0.0, 0.0, 0.0, 0.0),
            },
            base: [0.0; 3],
            origin: [0.0; 3],
            origin_error: 0.0,
        }
    }

    /// Moves the ray into the space of another tree of the same model; costs nothing if that has the same base.
    #[inline(always)]
    pub fn enter_frame(&mut self, simd: S, query: &QueryRay, frame: &Frame) {
        if frame.base == self.base {
            return;
        }
        let (origin, lanes) = local_origin(simd, query.origin, frame);
        self.boxes.set_origin(simd, lanes);
        self.triangles.origin = simd.splat3(origin);
        (self.base, self.origin) = (frame.base, origin);
        self.origin_error = query.origin_error_in(frame, origin);
        self.forget_origin_if_lost(simd);
    }

    /// For a ray that starts near or outside the end of the range of f32 and does not approach: every box passes, and no
    /// triangle is rejected.
    #[inline(always)]
    fn forget_origin_if_lost(&mut self, simd: S) {
        if self.origin_error.is_nan() || self.origin_error >= LOCAL_MAX {
            self.boxes.set_origin_unknown(simd);
            self.triangles.origin = simd.splat3([0.0; 3]);
            (self.origin, self.origin_error) = ([0.0; 3], f32::INFINITY);
        }
    }

    /// Sets the bounds of the reject test for triangles between `low` and `high` whose vertices are off by at most
    /// `vertex_error` per axis.
    #[inline(always)]
    pub fn set_reach(&mut self, query: &QueryRay, low: &[f32; 3], high: &[f32; 3], vertex_error: f32) {
        let mut reach = 0.0f32;
        for axis in 0..3 {
            let (above, below) = (high[axis] - self.origin[axis], self.origin[axis] - low[axis]);
            let farther = if above > below { above } else { below };
            reach = if farther > reach { farther } else { reach };
        }
        let reach = reach * (1.0 + 1e-6) + self.origin_error + vertex_error;
        self.triangles.bounds = ErrorBounds::new(query.direction_sum, reach, self.origin_error, vertex_error);
    }
}

/// More than the rounding of an origin by [`local_origin`].
#[inline(always)]
fn origin_error(origin: [f32; 3]) -> f32 {
    let (x, y, z) = (origin[0].abs(), origin[1].abs(), origin[2].abs());
    let largest = if x > y { x } else { y };
    let largest = if largest > z { largest } else { z };
    largest * (1.0 / (1u32 << 23) as f32) + f32::MIN_POSITIVE
}

/// Largest error of an origin with which the tests still make sense; coordinates of a frame stay below 2^41.
const LOCAL_MAX: f32 = 1e30;

/// By how much the exact ray may round an origin: see [`RayFrame`].
const COORDINATE_ROUNDING: f64 = power_of_two(-252);

/// The interval of a query in f32, the same number in every lane.
#[inline(always)]
pub(crate) fn splat_interval<S: Simd>(simd: S, low: f32, high: f32) -> Interval<S::F> {
    Interval { low: simd.splat(low), high: simd.splat(high) }
}
