//! From the model's f64 space to the f32 space of a tree, for boxes and for rays.
//!
//! A tree's space is `(x - base) * scale`. The base is the block's (or the model's centre for the coarse tree), exact in
//! f64; the scale is one power of two for the whole model, 1 unless its coordinates are so large or so small that f32
//! products would leave their range. Where anything is rounded, it is rounded outward.

use crate::geom::{Aabb, Ray, RayFrame, round_down_f32, round_up_f32};
use crate::simd::{BoxRay, ErrorBounds, Interval, InverseDirection, Simd, TriangleRay};

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

/// A ray on its way through both levels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct QueryRay {
    /// For the decisions in f64.
    pub exact: RayFrame,
    /// Start of the traversal in the model's space, `exact.origin()` moved along the ray to near the model, and how far
    /// off it can be per axis. Both are exact (and the error 0) unless the ray starts far from the model.
    origin: [f64; 3],
    origin_error: [f64; 3],
    /// The direction with its largest component in `1 .. 2`.
    direction: [f64; 3],
    pub inverse: InverseDirection,
    direction_sum: f32,
    /// `t` to local units: first one factor, then the other (their product can leave the range of f64).
    t_factors: [f64; 2],
    /// Local parameter of the start of the traversal.
    t_start: f64,
}

impl QueryRay {
    /// Prepares a valid ray for trees with `scale` inside `bounds`.
    #[inline(always)]
    pub fn new(ray: &Ray, scale: f64, bounds: &Aabb) -> QueryRay {
        let exact = RayFrame::new(ray);
        let mut direction = exact.direction();
        let mut to_scaled = 1.0 / exact.scale();
        let longest = direction.iter().fold(0.0f64, |longest, x| longest.max(x.abs()));
        if !(1.0..2.0).contains(&longest) && longest > 0.0 {
            // Only for the shortest and longest directions that f64 can hold.
            let exponent = ((longest.to_bits() >> 52) & 0x7ff) as i32 - 1023;
            let factor = f64::from_bits(((1023 - exponent) as u64) << 52);
            direction = direction.map(|x| x * factor);
            to_scaled /= factor;
        }
        let mut query = QueryRay {
            origin: exact.origin(),
            exact,
            origin_error: [0.0; 3],
            direction,
            inverse: InverseDirection::new(direction),
            direction_sum: (1.0 + 1e-6) * direction.iter().map(|x| x.abs()).sum::<f64>() as f32,
            t_factors: [to_scaled, scale],
            t_start: 0.0,
        };
        query.approach(bounds, scale);
        query
    }

    /// Moves the start of a ray that comes from far away to the model, so that f32 can tell the model's parts apart.
    #[inline(always)]
    fn approach(&mut self, bounds: &Aabb, scale: f64) {
        let far = (0..3).any(|axis| {
            let size = bounds.max[axis] - bounds.min[axis];
            let distance = (bounds.min[axis] - self.origin[axis]).max(self.origin[axis] - bounds.max[axis]);
            distance > 16.0 * size && distance > 0.0
        });
        if far {
            self.approach_from_far(bounds, scale);
        }
    }

    #[cold]
    #[inline(never)]
    fn approach_from_far(&mut self, bounds: &Aabb, scale: f64) {
        // Any parameter will do; the entry into a box of twice the model's size is a good one.
        let margin = 0.5 * bounds.extent().iter().fold(0.0f64, |largest, x| largest.max(*x));
        let mut entry = 0.0f64;
        for axis in 0..3 {
            let d = self.direction[axis];
            let plane = if d > 0.0 { bounds.min[axis] - margin } else { bounds.max[axis] + margin };
            let t = (plane - self.origin[axis]) / d;
            if t.is_finite() && t > entry {
                entry = t;
            }
        }
        let moved = [0, 1, 2].map(|axis| self.origin[axis] + entry * self.direction[axis]);
        // Product and sum round once each; doubled for the rounding of the bound itself.
        let error = [0, 1, 2].map(|axis| {
            f64::EPSILON * ((entry * self.direction[axis]).abs() + moved[axis].abs()) + f64::MIN_POSITIVE
        });
        if entry > 0.0 && moved.iter().chain(&error).all(|x| x.is_finite()) {
            self.origin = moved;
            self.origin_error = error;
            self.t_start = entry * scale;
        }
    }

    #[inline(always)]
    fn to_local(&self, t: f64) -> f64 {
        t * self.t_factors[0] * self.t_factors[1] - self.t_start
    }

    /// The parameter of a local one, rounded.
    #[inline(always)]
    pub fn from_local(&self, local: f32) -> f64 {
        (f64::from(local) + self.t_start) / self.t_factors[1] / self.t_factors[0]
    }

    /// At least the local parameter of `t`, by a factor of `1 + 2^-20` or more, and at least 0.
    #[inline(always)]
    pub fn local_high(&self, t: f64) -> f32 {
        let local = self.to_local(t) + (self.t_start.abs() * MARGIN_F64);
        // Hits beyond the range of f64 all have t = f64::MAX. The comparison keeps NaN (infinity minus infinity) out.
        if t < f64::MAX && local < f64::INFINITY {
            round_up_f32(local.max(0.0) * (1.0 + MARGIN)).max(f32::MIN_POSITIVE)
        } else {
            f32::INFINITY
        }
    }

    /// At most the local parameter of `t`, by a factor of `1 - 2^-20` or more; `-inf` instead of a negative number.
    #[inline(always)]
    pub fn local_low(&self, t: f64) -> f32 {
        let local = self.to_local(t) - (self.t_start.abs() * MARGIN_F64);
        if local >= 0.0 {
            let low = (local * (1.0 - MARGIN)).min(f64::from(f32::MAX));
            round_down_f32(low)
        } else {
            f32::NEG_INFINITY
        }
    }

    /// An interval that certainly lies inside `t_min ..= t_max`.
    #[inline(always)]
    pub fn local_inner(&self, t_min: f64, t_max: f64) -> (f32, f32) {
        let high = self.to_local(t_max) - (self.t_start.abs() * MARGIN_F64);
        let high =
            if high > 0.0 { round_down_f32((high * (1.0 - MARGIN)).min(f64::from(f32::MAX))) } else { -1.0 };
        (self.local_high(t_min), high)
    }
}

/// More than any rounding of a parameter in f32 arithmetic: 2^-19.
const MARGIN: f64 = 1.0 / (1u32 << 19) as f64;
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
    #[inline(always)]
    pub fn new(simd: S, query: &QueryRay, frame: &Frame) -> LocalRay<S> {
        let (low, high, origin, origin_error) = local_origin(query, frame);
        let direction = query.direction.map(|x| simd.splat(x as f32));
        LocalRay {
            boxes: BoxRay::new(simd, low, high, &query.inverse),
            triangles: TriangleRay {
                origin: origin.map(|x| simd.splat(x)),
                direction,
                bounds: ErrorBounds::new(0.0, 0.0, 0.0, 0.0),
            },
            base: frame.base,
            origin,
            origin_error,
        }
    }

    /// Moves the ray into the space of another tree of the same model; costs nothing if that has the same base.
    #[inline(always)]
    pub fn enter_frame(&mut self, simd: S, query: &QueryRay, frame: &Frame) {
        if frame.base == self.base {
            return;
        }
        let (low, high, origin, origin_error) = local_origin(query, frame);
        self.boxes.set_origin(simd, low, high, &query.inverse);
        self.triangles.origin = origin.map(|x| simd.splat(x));
        (self.base, self.origin, self.origin_error) = (frame.base, origin, origin_error);
    }

    /// Sets the bounds of the reject test for triangles between `low` and `high` whose vertices are off by at most
    /// `vertex_error` per axis.
    #[inline(always)]
    pub fn set_reach(&mut self, query: &QueryRay, low: &[f32; 3], high: &[f32; 3], vertex_error: f32) {
        let mut reach = 0.0f32;
        for axis in 0..3 {
            let farther = (high[axis] - self.origin[axis]).max(self.origin[axis] - low[axis]);
            reach = reach.max(farther);
        }
        let reach = reach * (1.0 + 1e-6) + self.origin_error + vertex_error;
        self.triangles.bounds = ErrorBounds::new(query.direction_sum, reach, self.origin_error, vertex_error);
    }
}

/// The ray's origin in a frame: bounds below and above, a rounded value, and how far off that is.
#[inline(always)]
fn local_origin(query: &QueryRay, frame: &Frame) -> ([f32; 3], [f32; 3], [f32; 3], f32) {
    let (mut low, mut high, mut origin) = ([0.0f32; 3], [0.0f32; 3], [0.0f32; 3]);
    let mut error = f32::MIN_POSITIVE;
    for axis in 0..3 {
        let difference = query.origin[axis] - frame.base[axis];
        // A difference with 0 is exact; any other rounds once.
        let rounding = if frame.base[axis] == 0.0 { 0.0 } else { f64::EPSILON * difference.abs() };
        let (local, slack) =
            (difference * frame.scale, (query.origin_error[axis] + rounding) * frame.scale * (1.0 + 1e-9));
        low[axis] = round_down_f32(local - slack);
        high[axis] = round_up_f32(local + slack);
        if !(low[axis] >= f32::MIN && high[axis] <= f32::MAX) {
            // A ray that starts outside the range of f32 and does not approach: every box passes on this axis but
            // the empty ones, whose infinite corners must not meet an infinite origin.
            (low[axis], high[axis]) = (f32::MIN, f32::MAX);
        }
        origin[axis] = (local as f32).clamp(f32::MIN, f32::MAX);
        error = error.max(1.000_001 * (high[axis] - low[axis]));
    }
    (low, high, origin, error)
}

/// The interval of a query in f32, the same number in every lane.
#[inline(always)]
pub(crate) fn splat_interval<S: Simd>(simd: S, low: f32, high: f32) -> Interval<S::F> {
    Interval { low: simd.splat(low), high: simd.splat(high) }
}
