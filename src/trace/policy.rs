//! How the triangles of a leaf are decided: a type for each [`Tier`](crate::octree::Tier), so that the traversal is
//! compiled once for each and no tier costs another a branch.

use super::exact::ExactRay;
use crate::geom::{Ray, TriangleHit, intersect_plain};
use crate::octree::QueryRay;
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
    /// What it needs of a ray beside what all have.
    type Ray<S: Simd>: Copy;
    /// What its kernel knows of the lanes that it let through.
    type Seen<S: Simd>;

    /// Prepares a ray. Directions are the same in all frames.
    fn prepare<S: Simd>(simd: S, triangles: &TriangleRay) -> Self::Ray<S>;

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
    #[inline(always)]
    fn candidates_and_certain<S: Simd>(
        simd: S,
        prepared: &Self::Ray<S>,
        triangles: &TriangleRay,
        packet: &Packet<S>,
        bounds: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
        _inner: &Interval<S::F>,
    ) -> (u32, u32, Self::Seen<S>) {
        let (candidates, seen) = Self::candidates(simd, prepared, triangles, packet, bounds, interval);
        (candidates, 0, seen)
    }

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
pub(super) struct Certified;

impl Policy for Certified {
    type Ray<S: Simd> = ();
    type Seen<S: Simd> = ();

    #[inline(always)]
    fn prepare<S: Simd>(_: S, _: &TriangleRay) {}

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

/// Exact arithmetic decides every triangle.
pub(super) struct Exact;

impl Policy for Exact {
    type Ray<S: Simd> = ();
    type Seen<S: Simd> = ();

    #[inline(always)]
    fn prepare<S: Simd>(_: S, _: &TriangleRay) {}

    #[inline(always)]
    fn candidates<S: Simd>(
        _: S,
        (): &(),
        _: &TriangleRay,
        _: &Packet<S>,
        _: (&ErrorBounds<S>, f32),
        _: &Interval<S::F>,
    ) -> (u32, ()) {
        (u32::MAX, ())
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
        counters.exact_fallbacks += 1;
        exact.frame(ray, query.is_plain(), t_min, t_max).intersect_exactly(vertices)
    }
}

/// f32 rejects, a plain test in f64 decides.
pub(super) struct Double;

impl Policy for Double {
    type Ray<S: Simd> = ();
    type Seen<S: Simd> = ();

    #[inline(always)]
    fn prepare<S: Simd>(_: S, _: &TriangleRay) {}

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
    fn settle<S: Simd>(
        _: S,
        (): &(),
        candidate: &Candidate<'_>,
        _: &mut ExactRay,
        counters: &mut TraceCounters,
    ) -> Option<TriangleHit> {
        let Candidate { ray, vertices, t_min, t_max, .. } = *candidate;
        counters.decisions += 1;
        intersect_plain(&Ray { t_min, t_max, ..*ray }, vertices)
    }
}

/// The kernel's f32 test decides.
pub(super) struct Fast;

impl Policy for Fast {
    type Ray<S: Simd> = ();
    type Seen<S: Simd> = [S::F; 3];

    #[inline(always)]
    fn prepare<S: Simd>(_: S, _: &TriangleRay) {}

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

/// The kernel's watertight f32 test decides.
pub(super) struct Watertight;

impl Policy for Watertight {
    type Ray<S: Simd> = Shear<S>;
    type Seen<S: Simd> = [S::F; 3];

    #[inline(always)]
    fn prepare<S: Simd>(simd: S, triangles: &TriangleRay) -> Shear<S> {
        Shear::new(simd, triangles.direction)
    }

    #[inline(always)]
    fn candidates<S: Simd>(
        simd: S,
        shear: &Shear<S>,
        triangles: &TriangleRay,
        packet: &Packet<S>,
        _: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
    ) -> (u32, [S::F; 3]) {
        shear.decide(simd, packet, simd.splat3(triangles.origin), interval)
    }

    #[inline(always)]
    fn candidates_and_certain<S: Simd>(
        simd: S,
        shear: &Shear<S>,
        triangles: &TriangleRay,
        packet: &Packet<S>,
        _: (&ErrorBounds<S>, f32),
        interval: &Interval<S::F>,
        _: &Interval<S::F>,
    ) -> (u32, u32, [S::F; 3]) {
        let (hits, seen) = shear.decide(simd, packet, simd.splat3(triangles.origin), interval);
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
