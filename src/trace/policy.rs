//! How the triangles of a leaf are decided. What people choose for speed has a type of its own, so that the traversal is compiled
//! for it and has no branch; [`Selected`] chooses between the others where they are used, because each further type compiles
//! every query once more.

use super::exact::ExactRay;
use crate::geom::{Ray, TriangleHit, intersect_plain};
use crate::octree::{QueryRay, Tier};
use crate::simd::{ErrorBounds, Interval, Packet, Shear, Simd, TriangleRay};
use crate::stats::TraceCounters;

/// A triangle that a kernel let through.
pub(super) struct Candidate<'c> {
    /// Its place in the packet.
    pub lane: usize,
    pub vertices: &'c [[f64; 3]; 3],
    pub ray: &'c Ray,
    pub query: &'c QueryRay,
    /// Where hits begin and end, both included.
    pub t_min: f64,
    pub t_max: f64,
}

/// A way to decide.
pub(super) trait Policy {
    /// Whether the leaves that it is compiled for are expanded; `None` for any.
    const EXPANDED: Option<bool>;
    /// What it needs of a ray beside what all have.
    type Ray<S: Simd>: Copy;
    /// What its kernel knows of the lanes that it let through.
    type Seen<S: Simd>;

    /// Prepares a ray for a tier that the policy is for. Directions are the same in all frames.
    fn prepare<S: Simd>(simd: S, tier: Tier, triangles: &TriangleRay) -> Self::Ray<S>;

    /// The lanes of `packet` that may be hit within `interval`. `bounds`: for the ray in this block, and a bound on the
    /// magnitude of the packet's edges.
    fn candidates<S: Simd>(
        simd: S,
        prepared: &Self::Ray<S>,
        triangles: &TriangleRay,
        packet: &Packet<S>,
        bounds: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
    ) -> (u32, Self::Seen<S>);

    /// [`Policy::candidates`], and those of them that need no decision. `inner` lies inside the ray's interval.
    fn candidates_and_certain<S: Simd>(
        simd: S,
        prepared: &Self::Ray<S>,
        triangles: &TriangleRay,
        packet: &Packet<S>,
        bounds: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
        inner: &Interval<S::F>,
    ) -> (u32, u32, Self::Seen<S>);

    /// Whether a candidate is hit, and where.
    fn settle<S: Simd>(
        simd: S,
        seen: &Self::Seen<S>,
        candidate: &Candidate<'_>,
        exact: &mut ExactRay,
        counters: &mut TraceCounters,
    ) -> Option<TriangleHit>;
}

/// f32 rejects, f64 or exact arithmetic decides.
pub(super) struct Certified<const EXPANDED: bool>;

impl<const EXPANDED: bool> Policy for Certified<EXPANDED> {
    const EXPANDED: Option<bool> = Some(EXPANDED);
    type Ray<S: Simd> = ();
    type Seen<S: Simd> = ();

    #[inline(always)]
    fn prepare<S: Simd>(_: S, _: Tier, _: &TriangleRay) {}

    #[inline(always)]
    fn candidates<S: Simd>(
        simd: S,
        (): &(),
        triangles: &TriangleRay,
        packet: &Packet<S>,
        bounds: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
    ) -> (u32, ()) {
        (triangles.survivors(simd, packet, bounds, interval), ())
    }

    #[inline(always)]
    fn candidates_and_certain<S: Simd>(
        simd: S,
        (): &(),
        triangles: &TriangleRay,
        packet: &Packet<S>,
        bounds: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
        inner: &Interval<S::F>,
    ) -> (u32, u32, ()) {
        let (survivors, certain) = triangles.survivors_and_certain(simd, packet, bounds, interval, inner);
        (survivors, certain, ())
    }

    #[inline(always)]
    fn settle<S: Simd>(
        _: S,
        (): &(),
        candidate: &Candidate<'_>,
        exact: &mut ExactRay,
        counters: &mut TraceCounters,
    ) -> Option<TriangleHit> {
        let Candidate { ray, query, vertices, t_min, t_max, .. } = *candidate;
        counters.decisions += 1;
        let frame = exact.frame(ray, query.is_plain(), t_min, t_max);
        frame.intersect_inlined(vertices, &mut counters.exact_fallbacks)
    }
}

/// The kernel's f32 test decides; leaves are expanded.
pub(super) struct Fast;

impl Policy for Fast {
    const EXPANDED: Option<bool> = Some(true);
    type Ray<S: Simd> = ();
    type Seen<S: Simd> = [S::F; 3];

    #[inline(always)]
    fn prepare<S: Simd>(_: S, _: Tier, _: &TriangleRay) {}

    #[inline(always)]
    fn candidates<S: Simd>(
        simd: S,
        (): &(),
        triangles: &TriangleRay,
        packet: &Packet<S>,
        _: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
    ) -> (u32, [S::F; 3]) {
        triangles.decide(simd, packet, interval)
    }

    #[inline(always)]
    fn candidates_and_certain<S: Simd>(
        simd: S,
        (): &(),
        triangles: &TriangleRay,
        packet: &Packet<S>,
        _: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
        _: &Interval<S::F>,
    ) -> (u32, u32, [S::F; 3]) {
        let (hits, seen) = triangles.decide(simd, packet, interval);
        (hits, hits, seen)
    }

    #[inline(always)]
    fn settle<S: Simd>(
        simd: S,
        seen: &[S::F; 3],
        candidate: &Candidate<'_>,
        _: &mut ExactRay,
        _: &mut TraceCounters,
    ) -> Option<TriangleHit> {
        single(simd, seen, candidate)
    }
}

/// Any tier, any layout.
pub(super) struct Selected;

/// What [`Selected`] needs of a ray.
#[derive(Clone, Copy)]
pub(super) enum SelectedRay<S: Simd> {
    /// The kernel's f32 test decides.
    Fast,
    /// The kernel's watertight f32 test decides.
    Watertight(Shear<S>),
    /// f32 rejects, a plain test in f64 decides.
    Double,
    /// f32 rejects, f64 or exact arithmetic decides.
    Certified,
    /// Exact arithmetic decides every triangle.
    Exact,
}

/// What the kernel of [`Selected`] knows.
pub(super) enum SelectedSeen<F> {
    /// The hits themselves.
    Single([F; 3]),
    Double,
    Certified,
    Exact,
}

impl Policy for Selected {
    const EXPANDED: Option<bool> = None;
    type Ray<S: Simd> = SelectedRay<S>;
    type Seen<S: Simd> = SelectedSeen<S::F>;

    #[inline(always)]
    fn prepare<S: Simd>(simd: S, tier: Tier, triangles: &TriangleRay) -> SelectedRay<S> {
        match tier {
            Tier::Fast => SelectedRay::Fast,
            Tier::Watertight => SelectedRay::Watertight(Shear::new(simd, triangles.direction)),
            Tier::Double => SelectedRay::Double,
            Tier::Certified => SelectedRay::Certified,
            Tier::Exact => SelectedRay::Exact,
        }
    }

    #[inline(always)]
    fn candidates<S: Simd>(
        simd: S,
        prepared: &SelectedRay<S>,
        triangles: &TriangleRay,
        packet: &Packet<S>,
        bounds: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
    ) -> (u32, SelectedSeen<S::F>) {
        match prepared {
            SelectedRay::Fast => {
                let (hits, seen) = triangles.decide(simd, packet, interval);
                (hits, SelectedSeen::Single(seen))
            }
            SelectedRay::Watertight(shear) => {
                let (hits, seen) = shear.decide(simd, packet, simd.splat3(triangles.origin), interval);
                (hits, SelectedSeen::Single(seen))
            }
            SelectedRay::Double => {
                (triangles.survivors(simd, packet, bounds, interval), SelectedSeen::Double)
            }
            SelectedRay::Certified => {
                (triangles.survivors(simd, packet, bounds, interval), SelectedSeen::Certified)
            }
            SelectedRay::Exact => (u32::MAX, SelectedSeen::Exact),
        }
    }

    #[inline(always)]
    fn candidates_and_certain<S: Simd>(
        simd: S,
        prepared: &SelectedRay<S>,
        triangles: &TriangleRay,
        packet: &Packet<S>,
        bounds: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
        inner: &Interval<S::F>,
    ) -> (u32, u32, SelectedSeen<S::F>) {
        if let SelectedRay::Certified = prepared {
            let (survivors, certain) = triangles.survivors_and_certain(simd, packet, bounds, interval, inner);
            return (survivors, certain, SelectedSeen::Certified);
        }
        let (candidates, seen) = Self::candidates(simd, prepared, triangles, packet, bounds, interval);
        let certain = match seen {
            SelectedSeen::Single(_) => candidates,
            SelectedSeen::Double | SelectedSeen::Certified | SelectedSeen::Exact => 0,
        };
        (candidates, certain, seen)
    }

    #[inline(always)]
    fn settle<S: Simd>(
        simd: S,
        seen: &SelectedSeen<S::F>,
        candidate: &Candidate<'_>,
        exact: &mut ExactRay,
        counters: &mut TraceCounters,
    ) -> Option<TriangleHit> {
        let Candidate { ray, query, vertices, t_min, t_max, .. } = *candidate;
        match seen {
            SelectedSeen::Single(seen) => single(simd, seen, candidate),
            SelectedSeen::Double => {
                counters.decisions += 1;
                intersect_plain(&Ray { t_min, t_max, ..*ray }, vertices)
            }
            SelectedSeen::Certified => Certified::<true>::settle(simd, &(), candidate, exact, counters),
            SelectedSeen::Exact => {
                counters.decisions += 1;
                counters.exact_fallbacks += 1;
                exact.frame(ray, query.is_plain(), t_min, t_max).intersect_exactly(vertices)
            }
        }
    }
}

/// A hit as an f32 kernel saw it.
#[inline(always)]
fn single<S: Simd>(simd: S, seen: &[S::F; 3], candidate: &Candidate<'_>) -> Option<TriangleHit> {
    let [t, u, v] = [seen[0], seen[1], seen[2]];
    let lane = candidate.lane;
    Some(TriangleHit {
        t: candidate.query.ray_parameter(simd.to_array(t)[lane]),
        u: f64::from(simd.to_array(u)[lane]),
        v: f64::from(simd.to_array(v)[lane]),
    })
}
