//! A ray made ready for the traversal of both levels.

use super::frame::{Frame, Space};
use crate::geom::{Ray, RayFrame};
use crate::simd::{BoxRay, ErrorBounds, Interval, ParallelAxes, Simd, TestRay};

/// What does not change from frame to frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct QueryRay {
    /// Start of the traversal in the model's space: the ray's origin, or a point on the ray nearer to the model.
    pub(super) origin: [f64; 3],
    /// How far off that is, per axis.
    pub(super) origin_error: f64,
    /// Sum of the magnitudes of the local direction.
    pub(super) direction_sum: f32,
    /// See [`BoxRay::set_origin`].
    pub(super) widen: [f32; 3],
    /// `t` to local units: first one factor, then the other (their product can leave the range of f64).
    pub(super) t_factors: [f64; 2],
    /// Local parameter of the start of the traversal.
    pub(super) t_start: f64,
    /// See [`RayGroup`](super::RayGroup).
    pub(super) is_plain: bool,
}

/// The largest magnitude.
fn longest(direction: [f64; 3]) -> f64 {
    direction[0].abs().max(direction[1].abs()).max(direction[2].abs())
}

#[inline(always)]
pub(crate) const fn power_of_two(exponent: i64) -> f64 {
    f64::from_bits(((1023 + exponent) as u64) << 52)
}

/// Prepares a ray that is not plain (see [`RayGroup`](super::RayGroup)), in the frame of the coarse tree. Returns why the
/// ray is not valid, if it is not.
#[inline(always)]
pub(super) fn prepare_with_care<S: Simd>(
    simd: S,
    ray: &Ray,
    space: &Space,
    query: &mut QueryRay,
    local: &mut LocalRay,
) -> Option<&'static str> {
    Careful::of_ray(ray, space).put(simd, space, query, local);
    ray.validate().err()
}

/// A ray that was moved into the model's space, which rounds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MovedRay {
    pub origin: [f64; 3],
    /// How far off the origin is at most, per axis: what the direction and the model's vertices are off is in it.
    pub origin_error: f64,
    /// Largest magnitude 1 to 2.
    pub direction: [f64; 3],
    /// From the parameter of the ray as it was to that of this one.
    pub t_factor: f64,
}

/// Prepares a moved ray, in the frame of the coarse tree.
#[inline(always)]
pub(crate) fn prepare_moved<S: Simd>(
    simd: S,
    ray: &MovedRay,
    space: &Space,
    query: &mut QueryRay,
    local: &mut LocalRay,
) {
    Careful::of_moved(ray, space).put(simd, space, query, local);
}

/// What a ray takes that is not plain.
struct Careful {
    query: QueryRay,
    direction: [f32; 3],
    parallel: ParallelAxes,
}

/// An origin in a frame, rounded: two roundings in f64 and one in f32.
#[inline(always)]
pub(super) fn local_origin(origin: [f64; 3], frame: &Frame) -> [f32; 3] {
    [
        ((origin[0] - frame.base[0]) * frame.scale) as f32,
        ((origin[1] - frame.base[1]) * frame.scale) as f32,
        ((origin[2] - frame.base[2]) * frame.scale) as f32,
    ]
}

impl Careful {
    /// For any ray: along an axis, of any length, from any distance.
    #[cold]
    #[inline(never)]
    fn of_ray(ray: &Ray, space: &Space) -> Careful {
        // The exact ray rounds what is out of range for it; boxes must be met by the ray that triangles are.
        let exact = RayFrame::new(ray);
        let exponent = (longest(exact.direction()).to_bits() >> 52) as i64 - 1023;
        // 0 for all but the shortest and longest directions that f64 can hold. A zero direction is one that the exact
        // ray refuses: it hits nothing.
        let factor = power_of_two(-exponent.clamp(-100, 100));
        let direction = exact.direction().map(|x| x * factor);
        let mut query = QueryRay {
            origin: exact.origin(),
            t_factors: [1.0 / exact.scale() / factor, space.frame.scale],
            ..QueryRay::UNSET
        };
        let near = (0..3).all(|axis| {
            let x = ((query.origin[axis] - space.frame.base[axis]) * space.frame.scale) as f32;
            space.near_low[axis] <= x && x <= space.near_high[axis]
        });
        if !near {
            query.approach(direction, space);
        }
        Careful::new(query, direction, space)
    }

    #[inline(always)]
    fn of_moved(ray: &MovedRay, space: &Space) -> Careful {
        let mut query = QueryRay {
            origin: ray.origin,
            origin_error: ray.origin_error,
            t_factors: [ray.t_factor, space.frame.scale],
            ..QueryRay::UNSET
        };
        query.approach(ray.direction, space);
        Careful::new(query, ray.direction, space)
    }

    /// With what follows from a query's start and direction.
    #[inline(always)]
    fn new(mut query: QueryRay, direction: [f64; 3], space: &Space) -> Careful {
        if direction == [0.0; 3] {
            // Refused, and without an origin. From far beside the model it would meet the lanes of nodes that hold no box.
            (query.origin, query.origin_error, query.t_start) = (space.frame.base, 0.0, 0.0);
        }
        let error = (query.origin_error + COORDINATE_ROUNDING) * space.frame.scale;
        let parallel = ParallelAxes::new(direction, error as f32 * (1.0 + 1e-6), &space.parallel);
        let direction_sum = (1.0 + 1e-6) * direction.iter().map(|x| x.abs() as f32).sum::<f32>();
        let query = QueryRay { widen: parallel.widen(), direction_sum, ..query };
        Careful { query, direction: direction.map(|x| x as f32), parallel }
    }

    #[inline(always)]
    fn put<S: Simd>(self, simd: S, space: &Space, query: &mut QueryRay, local: &mut LocalRay) {
        *query = self.query;
        let [x, y, z] = self.direction;
        local.test.boxes.set_direction(simd, simd.load(&[x, y, z, 1.0, 1.0, 1.0, 1.0, 1.0]), &self.parallel);
        local.test.triangles.direction = self.direction;
        local.move_to(simd, query, &space.frame);
    }
}

impl QueryRay {
    /// No ray yet.
    pub const UNSET: QueryRay = QueryRay {
        origin: [0.0; 3],
        origin_error: 0.0,
        direction_sum: 0.0,
        widen: BoxRay::WIDEN_LEAST,
        t_factors: [1.0; 2],
        t_start: 0.0,
        is_plain: false,
    };

    /// Whether the ray is plain: see [`RayGroup`](super::RayGroup).
    #[inline(always)]
    pub fn is_plain(&self) -> bool {
        self.is_plain
    }

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
            self.origin_error += error;
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
pub(super) const MARGIN: f32 = 1.0 / (1u32 << 18) as f32;
/// More than the rounding of a difference of parameters in f64.
const MARGIN_F64: f64 = 4.0 * f64::EPSILON;

/// A query ray in one tree's space.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalRay {
    pub test: TestRay,
    pub(super) base: [f64; 3],
    /// How far the test's origin is off, per axis.
    pub(super) origin_error: f32,
}

impl LocalRay {
    /// No ray yet.
    pub const UNSET: LocalRay = LocalRay { test: TestRay::UNSET, base: [0.0; 3], origin_error: 0.0 };

    /// Moves the ray into the space of another tree of the same model; costs nothing if that has the same base.
    #[inline(always)]
    pub fn enter_frame<S: Simd>(&mut self, simd: S, query: &QueryRay, frame: &Frame) {
        if frame.base != self.base {
            self.move_to(simd, query, frame);
        }
    }

    #[inline(always)]
    fn move_to<S: Simd>(&mut self, simd: S, query: &QueryRay, frame: &Frame) {
        let origin = local_origin(query.origin, frame);
        self.test.triangles.origin = origin;
        self.test.boxes.set_origin(simd, origin, query.widen);
        self.base = frame.base;
        self.origin_error = query.origin_error_in(frame, origin);
        self.forget_origin_if_lost();
    }

    /// For a ray that starts near or outside the end of the range of f32 and does not approach: every box passes, and no
    /// triangle is rejected.
    #[inline(always)]
    fn forget_origin_if_lost(&mut self) {
        if self.origin_error.is_nan() || self.origin_error >= LOCAL_MAX {
            self.test.boxes.set_origin_unknown();
            (self.test.triangles.origin, self.origin_error) = ([0.0; 3], f32::INFINITY);
        }
    }

    /// The bounds of the reject test for triangles between `low` and `high` whose vertices are off by at most `vertex_error`
    /// per axis.
    #[inline(always)]
    pub fn bounds<S: Simd>(
        &self,
        simd: S,
        query: &QueryRay,
        (low, high): (&[f32; 3], &[f32; 3]),
        vertex_error: f32,
    ) -> ErrorBounds<S> {
        // One instruction, unlike `f32::max`, which orders NaN.
        let max = |a: f32, b: f32| if a > b { a } else { b };
        let [x, y, z] = self.test.triangles.origin;
        let x = max(high[0] - x, x - low[0]);
        let y = max(high[1] - y, y - low[1]);
        let z = max(high[2] - z, z - low[2]);
        let reach = max(max(x, y), z) * (1.0 + 1e-6) + self.origin_error + vertex_error;
        ErrorBounds::new(simd, query.direction_sum, reach, self.origin_error, vertex_error)
    }
}

/// More than the rounding of an origin by [`local_origin`].
#[inline(always)]
fn origin_error(origin: [f32; 3]) -> f32 {
    let (x, y, z) = (origin[0].abs(), origin[1].abs(), origin[2].abs());
    let largest = if x > y { x } else { y };
    let largest = if largest > z { largest } else { z };
    largest * ORIGIN_ROUNDING + f32::MIN_POSITIVE
}

/// Twice the rounding of an f32, relative to its magnitude.
pub(super) const ORIGIN_ROUNDING: f32 = 1.0 / (1u32 << 23) as f32;

/// Largest error of an origin with which the tests still make sense; coordinates of a frame stay below 2^41.
const LOCAL_MAX: f32 = 1e30;

/// By how much the exact ray may round an origin: see [`RayFrame`].
const COORDINATE_ROUNDING: f64 = power_of_two(-252);

/// The interval of a query in f32, the same number in every lane.
#[inline(always)]
pub(crate) fn splat_interval<S: Simd>(simd: S, low: f32, high: f32) -> Interval<S::F> {
    Interval { low: simd.splat(low), high: simd.splat(high) }
}
