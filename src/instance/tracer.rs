//! One thread's way through instances.

use std::ops::ControlFlow;

use super::goal::{Any, Closest, Goal};
use super::instances::Instances;
use super::walk::{Stack, Walk};
use crate::error::{LoadError, TraceError};
use crate::geom::{Ray, RayFrame};
use crate::simd::{AnyOperation, Simd, SimdLevel, dispatch};
use crate::stats::TraceCounters;
use crate::trace::{Hit, MaterialSet, Occlusion, Tracer};
use crate::units::TriangleId;

/// Answers queries over instances on one thread, with memory of its own.
///
/// Hits are as in a model in which each instance is written out, every vertex moved by
/// [`Affine::point`](crate::geom::Affine::point), and are numbered as [`InstanceTriangle`](super::InstanceTriangle) says; their
/// vertices are in the world.
pub struct InstanceTracer<'o> {
    instances: &'o Instances,
    /// One for each model.
    tracers: Vec<Tracer<'o>>,
    stack: Stack,
    /// Of the rays of the next call, if any instance moves.
    times: Vec<f64>,
    counters: TraceCounters,
}

impl Instances {
    /// A tracer for the calling thread, or for one that it is sent to.
    ///
    /// # Errors
    /// As for [`LazyOctree::tracer`](crate::LazyOctree::tracer).
    pub fn tracer(&self) -> Result<InstanceTracer<'_>, TraceError> {
        let tracers = self.octrees().iter().map(|octree| octree.tracer()).collect::<Result<_, _>>()?;
        Ok(InstanceTracer {
            instances: self,
            tracers,
            stack: Stack::new(),
            times: Vec::new(),
            counters: TraceCounters::default(),
        })
    }
}

impl InstanceTracer<'_> {
    /// Sets when the rays of the next call are traced, one time each: from 0, when the shutter opens, which holds for rays without
    /// a time, to 1; times beyond count as the nearer of the two. See [`Instances::move_while_open`].
    pub fn at_times(&mut self, times: impl IntoIterator<Item = f64>) {
        self.times.clear();
        // The tree holds boxes of that way only: what goes on behind its end would be lost without a word.
        self.times.extend(times.into_iter().map(|time| time.clamp(0.0, 1.0)));
    }

    /// Finds for each ray the hit with the least (t, triangle number), and puts it at the ray's place in `hits`.
    ///
    /// # Errors
    /// As for [`Tracer::closest_hits`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        self.closest_hits_after(rays, &[], hits)
    }

    /// [`InstanceTracer::closest_hits`] for one ray.
    ///
    /// # Errors
    /// As for [`InstanceTracer::closest_hits`].
    pub fn closest_hit(&mut self, ray: &Ray) -> Result<Option<Hit>, TraceError> {
        let mut hit = [None];
        self.closest_hits(std::slice::from_ref(ray), &mut hit)?;
        Ok(hit[0])
    }

    /// Gives every hit of each ray to `visit`, with the ray's index: the rays in their order, the hits of each by (t, triangle
    /// number), as [`Tracer::all_hits`] does for one model. Each hit is a query for the next one behind the last: memory does not
    /// depend on the number of hits, time does.
    ///
    /// `visit` may end a ray with `Break`; the next ray follows.
    ///
    /// # Errors
    /// As for [`InstanceTracer::closest_hits`]. Hits that were given before the error stand, and are the ray's first ones.
    pub fn all_hits(
        &mut self,
        rays: &[Ray],
        mut visit: impl FnMut(usize, &Hit) -> ControlFlow<()>,
    ) -> Result<(), TraceError> {
        let times = std::mem::take(&mut self.times);
        for (index, ray) in rays.iter().enumerate() {
            // All are admitted at first.
            let mut after = (f64::NAN, TriangleId(0));
            loop {
                self.times.extend(times.get(index));
                let mut hit = [None];
                self.closest_hits_after(std::slice::from_ref(ray), &[after], &mut hit).map_err(|error| {
                    match error {
                        TraceError::InvalidRay { reason, .. } => TraceError::InvalidRay { index, reason },
                        other => other,
                    }
                })?;
                let Some(hit) = hit[0] else { break };
                if visit(index, &hit).is_break() {
                    break;
                }
                after = (hit.t, hit.triangle);
            }
        }
        Ok(())
    }

    /// Finds for each ray the least hit by (t, triangle number) that is strictly greater than the ray's pair in `after`, or the
    /// least of all if `after` is empty. A NaN `t` in `after` admits every hit.
    ///
    /// # Errors
    /// As for [`Tracer::closest_hits`].
    ///
    /// # Panics
    /// If the slices differ in length, an empty `after` apart.
    pub fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        assert!(
            rays.len() == hits.len() && (after.is_empty() || rays.len() == after.len()),
            "one place for each ray"
        );
        let one = |index: usize| Closest { after: after.get(index).copied(), best: None };
        dispatch(
            self.level(),
            Each { tracer: self, rays, goal: one, done: |index, goal: Closest| hits[index] = goal.best },
        )
    }

    /// Finds for each ray whether anything lies between its ends, leaving triangles of the materials in `ignore` apart.
    ///
    /// # Errors
    /// As for [`Tracer::closest_hits`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        assert_eq!(rays.len(), out.len(), "one place for each ray");
        let ignore = ignore.filter(|set| !set.is_empty());
        let one = |_| Any { ignore, filtered: false, blocked: false };
        let done = |index, goal: Any<'_>| {
            out[index] = match (goal.blocked, goal.filtered) {
                (true, _) => Occlusion::Blocked,
                (false, true) => Occlusion::Filtered,
                (false, false) => Occlusion::Clear,
            }
        };
        dispatch(self.level(), Each { tracer: self, rays, goal: one, done })
    }

    /// What this tracer did so far. Nodes of the tree over instances count as box tests, one for each child.
    pub fn counters(&self) -> TraceCounters {
        let mut all = self.counters;
        self.tracers.iter().for_each(|tracer| all.merge(&tracer.counters()));
        all
    }

    /// Lets go of all blocks, so that other tracers can have their slots. Do it before a long pause.
    pub fn release_pins(&mut self) {
        self.tracers.iter_mut().for_each(Tracer::release_pins);
    }

    fn level(&self) -> SimdLevel {
        // All were opened on the same machine.
        self.instances.octrees().first().map_or(SimdLevel::Portable, |octree| octree.simd_level())
    }

    /// One ray through all instances that it may meet.
    #[inline(always)]
    fn follow<S: Simd, G: Goal>(
        &mut self,
        simd: S,
        time: f64,
        frame: &mut RayFrame,
        goal: &mut G,
    ) -> Result<(), LoadError> {
        let InstanceTracer { instances, tracers, stack, counters, .. } = self;
        let instances: &Instances = instances;
        let mut box_tests = 0;
        instances.tree.visit(frame, &mut box_tests, |index, frame| {
            let moved = instances.moved(index, time);
            let placed = moved.as_ref().unwrap_or(&instances.placed[index as usize]);
            let model = placed.model as usize;
            simd.enter(Walk {
                instances,
                index,
                placed,
                octree: &instances.octrees()[model],
                tracer: &mut tracers[model],
                stack: &mut *stack,
                goal: &mut *goal,
                frame,
                counters: &mut *counters,
            })
        })?;
        self.counters.box_tests += box_tests;
        Ok(())
    }
}

/// The same for each ray of a call.
struct Each<'a, 'o, M, D> {
    tracer: &'a mut InstanceTracer<'o>,
    rays: &'a [Ray],
    goal: M,
    done: D,
}

impl<G: Goal, M: Fn(usize) -> G, D: FnMut(usize, G)> AnyOperation for Each<'_, '_, M, D> {
    type Output = Result<(), TraceError>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        let Each { tracer, rays, goal: make, mut done } = self;
        let times = std::mem::take(&mut tracer.times);
        let time_of = |index: usize| times.get(index).copied().unwrap_or(0.0);
        for (index, ray) in rays.iter().enumerate() {
            ray.validate().map_err(|reason| TraceError::InvalidRay { index, reason })?;
            tracer.counters.rays += 1;
            let mut frame = RayFrame::new(ray);
            let (time, mut goal) = (time_of(index), make(index));
            // Written so that NaN changes nothing.
            if let Some(t) = goal.begins().filter(|t| *t > frame.t_min) {
                frame.t_min = t;
            }
            if frame.t_min <= frame.t_max {
                tracer.follow(simd, time, &mut frame, &mut goal)?;
            }
            done(index, goal);
        }
        // The list is kept, the times are not.
        tracer.times = times;
        tracer.times.clear();
        Ok(())
    }
}

impl std::fmt::Debug for InstanceTracer<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("InstanceTracer").finish_non_exhaustive()
    }
}
