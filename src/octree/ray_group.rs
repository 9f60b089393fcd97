//! Preparing rays eight at a time.

use super::frame::Space;
use super::ray::{LocalRay, MARGIN, ORIGIN_ROUNDING, QueryRay, power_of_two, prepare_with_care};
use crate::geom::Ray;
use crate::simd::{BoxRay, Interval, LANES, Operation, RayBundle, RayRows, Simd};

/// Up to eight rays made ready together, in the frame of the coarse tree: most of what a ray takes before its first box is
/// arithmetic on a few numbers, and eight rays of it cost little more than one.
///
/// Rays that are *plain* are prepared here: from near the model, in a direction that is neither along an axis nor of
/// extraordinary length, with ends that are neither equal nor tiny. The others are prepared one by one, when their turn comes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RayGroup {
    /// Bit `i`: ray `i` is plain.
    plain: u32,
    rows: RayRows,
    /// If all eight rays are plain and go much the same way.
    bundle: Option<RayBundle>,
    origin_error: [f32; LANES],
    direction_sum: [f32; LANES],
    /// The largest magnitude in each ray's direction as it came.
    longest: [f32; LANES],
    /// See [`QueryRay::local_low`], [`QueryRay::local_high`] and [`QueryRay::local_inner`].
    outer: [[f32; LANES]; 2],
    inner: [[f32; LANES]; 2],
}

/// Plain directions have a largest magnitude from `2^-60` up, and below `2^61`.
const LONGEST_MIN: f32 = 1.0 / (1u64 << 60) as f32;
const LONGEST_END: f32 = (1u64 << 61) as f32;

/// Plain rays end there or later, and begin there or later or at 0: the ends then round to f32 like other numbers.
const END_MIN: f32 = 1.0 / (1u128 << 100) as f32;

/// A bit for each lane.
const ALL: u32 = (1 << LANES) - 1;

impl RayGroup {
    /// For `rays`, of which those from the ninth on are left out.
    #[inline(always)]
    pub fn new<S: Simd>(simd: S, rays: &[Ray], space: &Space) -> RayGroup {
        simd.enter(Make { rays, space })
    }

    #[inline(always)]
    fn make<S: Simd>(simd: S, rays: &[Ray], space: &Space) -> RayGroup {
        let zero = simd.splat(0.0);
        let mut rows = [zero; LANES];
        let [bx, by, bz] = space.frame.base;
        let scale = space.frame.scale;
        for (row, ray) in rows.iter_mut().zip(rays) {
            let ([ox, oy, oz], [dx, dy, dz]) = (ray.origin, ray.direction);
            let low = [(ox - bx) * scale, (oy - by) * scale, (oz - bz) * scale, dx];
            *row = simd.narrow(&low, &[dy, dz, ray.t_min, ray.t_max]);
        }
        let [ox, oy, oz, dx, dy, dz, t_min, t_max] = simd.transpose(&rows);

        // Every comparison fails for NaN, and for the lanes without a ray.
        let (ax, ay, az) = (simd.abs(dx), simd.abs(dy), simd.abs(dz));
        let longest = simd.max(simd.max(ax, ay), az);
        let mut plain = simd.le(simd.splat(LONGEST_MIN), longest);
        plain = simd.and(plain, simd.lt(longest, simd.splat(LONGEST_END)));
        let longest = simd.to_array(longest);
        let (mut down, mut up) = ([0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            // 2^-exponent and 2^exponent; garbage, but not used, for a direction that is not plain.
            let power = longest[lane].to_bits() & 0x7f80_0000;
            down[lane] = f32::from_bits(0x7f00_0000u32.wrapping_sub(power));
            up[lane] = f32::from_bits(power);
        }
        let down = simd.load(&down);
        let (dx, dy, dz) = (simd.mul(dx, down), simd.mul(dy, down), simd.mul(dz, down));
        let sum = simd.add(simd.add(ax, ay), az);
        let direction_sum = simd.mul(simd.mul(simd.splat(1.0 + 1e-6), down), sum);
        let below = simd.splat(space.parallel.below);
        plain = simd.and(plain, simd.le(below, simd.abs(dx)));
        plain = simd.and(plain, simd.le(below, simd.abs(dy)));
        plain = simd.and(plain, simd.le(below, simd.abs(dz)));
        plain = simd.and(plain, within(simd, space, 0, ox));
        plain = simd.and(plain, within(simd, space, 1, oy));
        plain = simd.and(plain, within(simd, space, 2, oz));
        let farthest = simd.max(simd.max(simd.abs(ox), simd.abs(oy)), simd.abs(oz));
        let rounding = simd.mul(farthest, simd.splat(ORIGIN_ROUNDING));
        let origin_error = simd.add(rounding, simd.splat(f32::MIN_POSITIVE));

        // Rounded ends in order are ends in order.
        let end_min = simd.splat(END_MIN);
        // A negative number that rounds to zero is none that a ray may begin at.
        let is_zero = simd.and(simd.le(t_min, zero), simd.lt(zero, simd.flip_sign(simd.splat(1.0), t_min)));
        plain = simd.and(plain, simd.or(simd.le(end_min, t_min), is_zero));
        plain = simd.and(plain, simd.and(simd.le(end_min, t_max), simd.lt(t_min, t_max)));
        let unit = simd.mul(simd.load(&up), simd.splat(space.scale_f32));
        let (begin, end) = (simd.mul(t_min, unit), simd.mul(t_max, unit));
        // What rounds to infinity need not be that.
        let finite_end = simd.mul(simd.min(t_max, simd.splat(f32::MAX)), unit);
        let plain = simd.bits(plain);
        let (direction, origin) = ([dx, dy, dz], [ox, oy, oz]);
        RayGroup {
            plain,
            rows: RayRows::new(simd, &direction, &origin),
            bundle: match plain {
                ALL => RayBundle::new(simd, &direction, &origin, space.together),
                _ => None,
            },
            origin_error: simd.to_array(origin_error),
            direction_sum: simd.to_array(direction_sum),
            longest,
            outer: [simd.to_array(simd.max(before(simd, begin), zero)), simd.to_array(after(simd, end))],
            inner: [simd.to_array(after(simd, begin)), simd.to_array(before(simd, finite_end))],
        }
    }

    /// Puts ray `lane`, which is `ray`, into `query` and `local`. Returns why it is not valid, if it is not. (The results
    /// are arguments because returned ones would be copied through memory.)
    #[inline(always)]
    pub fn prepare<S: Simd>(
        &self,
        simd: S,
        lane: usize,
        ray: &Ray,
        space: &Space,
        query: &mut QueryRay,
        local: &mut LocalRay,
    ) -> Option<&'static str> {
        if self.plain >> lane & 1 == 0 {
            return prepare_with_care(simd, ray, space, query, local);
        }
        let lane = lane % LANES;
        let exponent = (self.longest[lane].to_bits() >> 23) as i32 - 127;
        *query = QueryRay {
            origin: ray.origin,
            origin_error: 0.0,
            direction_sum: self.direction_sum[lane],
            widen: BoxRay::WIDEN_LEAST,
            t_factors: [power_of_two(i64::from(exponent)), space.frame.scale],
            t_start: 0.0,
            is_plain: true,
        };
        local.test = *self.rows.get(lane);
        (local.base, local.origin_error) = (space.frame.base, self.origin_error[lane]);
        None
    }

    /// If there are eight rays, all of them plain, that go much the same way: for finding out what any of them may meet.
    #[inline(always)]
    pub fn bundle(&self) -> Option<&RayBundle> {
        self.bundle.as_ref()
    }

    /// A number that no ray of the group begins before, if all are plain.
    #[inline(always)]
    pub fn first_low(&self) -> f32 {
        self.outer[0].iter().fold(f32::INFINITY, |least, low| if *low < least { *low } else { least })
    }

    /// An interval that holds all of ray `lane`, which is plain.
    #[inline(always)]
    pub fn outer(&self, lane: usize) -> (f32, f32) {
        (self.outer[0][lane % LANES], self.outer[1][lane % LANES])
    }

    /// An interval that lies inside ray `lane`, which is plain.
    #[inline(always)]
    pub fn inner<S: Simd>(&self, simd: S, lane: usize) -> Interval<S::F> {
        let [low, high] = [self.inner[0][lane % LANES], self.inner[1][lane % LANES]];
        Interval { low: simd.splat(low), high: simd.splat(high) }
    }
}

/// [`RayGroup::make`], once for each set of instructions and not for each kernel.
struct Make<'m> {
    rays: &'m [Ray],
    space: &'m Space,
}

impl<S: Simd> Operation<S> for Make<'_> {
    type Output = RayGroup;

    #[inline(always)]
    fn run(self, simd: S) -> RayGroup {
        RayGroup::make(simd, self.rays, self.space)
    }
}

/// Which of eight coordinates are near the model.
#[inline(always)]
fn within<S: Simd>(simd: S, space: &Space, axis: usize, x: S::F) -> S::M {
    simd.and(simd.le(simd.splat(space.near_low[axis]), x), simd.le(x, simd.splat(space.near_high[axis])))
}

/// More than parameters that are not negative, by more than all roundings.
#[inline(always)]
fn after<S: Simd>(simd: S, t: S::F) -> S::F {
    simd.add(simd.mul(t, simd.splat(1.0 + MARGIN)), simd.splat(f32::MIN_POSITIVE))
}

/// Less than they, and finite.
#[inline(always)]
fn before<S: Simd>(simd: S, t: S::F) -> S::F {
    let less = simd.sub(simd.mul(t, simd.splat(1.0 - MARGIN)), simd.splat(f32::MIN_POSITIVE));
    simd.min(less, simd.splat(f32::MAX))
}

#[cfg(test)]
mod tests {
    use super::super::frame::Frame;
    use super::*;
    use crate::geom::{Aabb, RayFrame};
    use crate::simd::{AnyOperation, SimdLevel, dispatch};

    /// The intervals of groups against those that single rays compute in f64.
    struct Intervals(Space);

    impl AnyOperation for Intervals {
        type Output = (u32, u32);

        fn run<S: Simd>(self, simd: S) -> (u32, u32) {
            let space = self.0;
            let ends = [
                0.0,
                -0.0,
                1e-320,
                1e-45,
                1e-38,
                1e-31,
                1e-20,
                0.3,
                1.0,
                1.0 + f64::EPSILON,
                7.7,
                1e20,
                1e38,
                1e39,
                1e300,
                f64::MAX,
                f64::INFINITY,
                f64::NAN,
                -1e-320,
                -1.0,
            ];
            let lengths = [1e-30, 1e-18, 2e-18, 1.0 - 1e-9, 1.0, 1e10, 1e18, 1e30, f64::NAN, 0.0];
            let (mut plain, mut careful) = (0, 0);
            for length in lengths {
                for t_min in ends {
                    for t_max in ends {
                        let direction = [0.6 * length, -0.7 * length, length];
                        // A coordinate so small that the exact ray rounds it to 0, and either zero.
                        let origin = if plain % 2 == 0 { [0.5, 0.1, -0.3] } else { [1e-300, -0.0, 0.25] };
                        let ray = Ray { t_min, t_max, ..Ray::new(origin, direction) };
                        let group = RayGroup::new(simd, &[ray], &space);
                        let (mut query, mut local) = (QueryRay::UNSET, LocalRay::UNSET);
                        let invalid = group.prepare(simd, 0, &ray, &space, &mut query, &mut local);
                        assert_eq!(invalid.is_some(), ray.validate().is_err(), "{ray:?}");
                        if !query.is_plain() {
                            careful += 1;
                            continue;
                        }
                        plain += 1;
                        // What the exact ray does without looking is what it does when it looks.
                        let exact = [RayFrame::of_plain(&ray), RayFrame::new(&ray)];
                        let [quick, careful] = exact.map(|frame| format!("{frame:?}"));
                        assert_eq!(quick, careful);
                        // More than a rounding and less than the margin on either side of what f64 gives.
                        let (low, high) = group.outer(0);
                        assert!(low <= query.local_low(t_min) * (1.0 + 1e-6), "{ray:?}: {low}");
                        assert!(low >= query.local_low(t_min) * (1.0 - 1e-6), "{ray:?}: {low}");
                        assert!(high >= query.local_high(t_max) * (1.0 - 1e-6), "{ray:?}: {high}");
                        let inner = group.inner(simd, 0);
                        let [begin, end] = [inner.low, inner.high].map(|x| simd.to_array(x)[0]);
                        let (inner_low, inner_high) = query.local_inner(t_min, t_max);
                        assert!(begin >= inner_low * (1.0 - 1e-6), "{ray:?}: {begin}");
                        assert!(end <= inner_high.max(0.0) * (1.0 + 1e-6), "{ray:?}: {end} {inner_high}");
                    }
                }
            }
            (plain, careful)
        }
    }

    #[test]
    fn intervals_hold_what_they_should() {
        for (extent, scale) in [(1.0, 1.0), (1e13, 1.0 / (1u64 << 44) as f64)] {
            let bounds = Aabb { min: [-extent; 3], max: [extent; 3] };
            let space = Space::new(bounds, Frame { base: [0.0; 3], scale }, true);
            for level in [SimdLevel::Portable, SimdLevel::best()] {
                let (plain, careful) = dispatch(level, Intervals(space));
                assert!(plain > 300 && careful > 300, "{plain} {careful}");
            }
        }
    }

    /// Which groups are bundles.
    struct Bundles(Space);

    impl AnyOperation for Bundles {
        type Output = ();

        fn run<S: Simd>(self, simd: S) {
            let space = self.0;
            let fan = |width: f64| {
                (0..LANES).map(move |lane| Ray::new([0.3, 0.2, -1.5], [0.2 + width * lane as f64, 0.3, 1.0]))
            };
            let is_bundle = |rays: &[Ray]| RayGroup::new(simd, rays, &space).bundle().is_some();
            let narrow: Vec<Ray> = fan(0.01).collect();
            assert!(is_bundle(&narrow));
            assert!(!is_bundle(&narrow[1..]), "seven rays");
            assert!(!is_bundle(&fan(0.1).collect::<Vec<_>>()), "rays that part");
            assert!(!is_bundle(&fan(-0.04).collect::<Vec<_>>()), "rays that go different ways");
            let mut one_along = narrow.clone();
            one_along[3].direction[0] = 0.0;
            assert!(!is_bundle(&one_along), "one is not plain");
            let mut one_apart = narrow.clone();
            one_apart[7].origin[1] += 0.5;
            assert!(!is_bundle(&one_apart), "one begins elsewhere");
        }
    }

    #[test]
    fn bundles_are_eight_plain_rays_that_stay_together() {
        let bounds = Aabb { min: [-1.0; 3], max: [1.0; 3] };
        let space = Space::new(bounds, Frame { base: [0.0; 3], scale: 1.0 }, true);
        for level in [SimdLevel::Portable, SimdLevel::best()] {
            dispatch(level, Bundles(space));
        }
    }
}
