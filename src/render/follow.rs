//! How a ray tree goes on: the work that is left is divided among the rays that leave a hit, one goes on at once, and the others
//! wait on the sample's stack.

use glam::DVec3;

use super::children::Child;
use super::hot::EffectsOfLoop;
use super::paths::{Head, PathTracer, Waiting};
use super::query::RayQuery;
use super::stage::{Loop, Shader};
use super::walk::Walk;
use super::ways::{Course, Kind};
use crate::geom::Ray;

/// What rays leave.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaving {
    normal: DVec3,
    /// Roughness, and whether it splits light by Fresnel's equations, at this place.
    alpha: f64,
    is_glass: bool,
}

impl Leaving {
    pub fn new(shader: &Shader, normal: DVec3) -> Leaving {
        Leaving { normal, alpha: shader.alpha, is_glass: shader.is_glass() }
    }
}

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Divides the work that is left among the children by the square root of their throughput: by throughput itself faint but
    /// long chains starve, in equal parts the main path through a stack of panes does. The child with least work becomes the
    /// sample's head and the others wait: so the head's work at least halves whenever a ray comes to wait, which bounds the
    /// stack.
    pub(super) fn follow<E: EffectsOfLoop>(
        &mut self,
        index: usize,
        head: &Head,
        leaving: &Leaving,
        children: [Option<Child>; 3],
    ) {
        let (slot, work) = (head.slot, head.work - 1);
        let mut rays: smallvec::SmallVec<[(Child, u64); 3]> =
            children.into_iter().flatten().map(|child| (child, work)).collect();
        // Too little work for all: those that carry most have it.
        while rays.len() > 1 && (rays.len() as u64) > work {
            let carried = |ray: &(Child, u64)| ray.0.throughput.max_element();
            let least = (1..rays.len())
                .fold(0, |least, ray| if carried(&rays[ray]) <= carried(&rays[least]) { ray } else { least });
            let (cut, _) = rays.remove(least);
            self.cut_work(slot, &cut);
        }
        if rays.len() > 1 {
            let weights: smallvec::SmallVec<[f64; 3]> =
                rays.iter().map(|(child, _)| child.throughput.max_element().sqrt()).collect();
            let (total, count) = (weights.iter().sum::<f64>(), rays.len() as u64);
            let mut left = work;
            let last = rays.len() - 1;
            for (place, weight) in weights.iter().enumerate().take(last) {
                // At least one ray for each of the others.
                let others = count - 1 - place as u64;
                let share = ((work as f64 * (weight / total)) as u64).clamp(1, left - others);
                rays[place].1 = share;
                left -= share;
            }
            rays[last].1 = left;
            rays.sort_by_key(|(_, share)| *share);
        }
        let place = slot as usize * self.stack_depth;
        for (child, share) in rays.iter().skip(1).rev() {
            let ray = self.count_ray::<E>(leaving, child);
            let place = place + usize::from(self.waiting_counts[slot as usize]);
            self.waiting[place] = Some(Waiting { ray, work: *share, throughput: child.throughput });
            if E::SAMPLED {
                self.waiting_walks[place] = Some(self.walk_on(index, leaving, child));
            }
            self.waiting_counts[slot as usize] += 1;
        }
        match rays.first() {
            Some((child, share)) if *share > 0 => {
                let ray = self.count_ray::<E>(leaving, child);
                self.next_rays.push(ray);
                self.next_heads.push(Head { slot, work: *share, throughput: child.throughput });
                if E::SAMPLED {
                    let walk = self.walk_on(index, leaving, child);
                    self.next_walks.push(walk);
                }
            }
            cut => {
                if let Some((child, _)) = cut {
                    let child = *child;
                    self.cut_work(slot, &child);
                }
                self.advance_from_stack::<E>(slot);
            }
        }
    }

    /// Books a ray for which no work is left.
    fn cut_work(&mut self, slot: u32, child: &Child) {
        self.counters.work_cuts += 1;
        self.lost[slot as usize] += child.throughput.max_element() * self.stage.radiance_max();
    }

    fn count_ray<E: EffectsOfLoop>(&mut self, leaving: &Leaving, child: &Child) -> Ray {
        let counters = &mut self.counters;
        match (child.kind, child.course) {
            (Kind::Bounce, _) => counters.bounce_rays += 1,
            (_, Course::Sampled(_)) if E::SAMPLED => {
                *if leaving.is_glass { &mut counters.frosted_rays } else { &mut counters.glossy_rays } += 1;
            }
            (Kind::Reflection, _) => counters.reflection_rays += 1,
            (Kind::Transmission, _) => counters.transmission_rays += 1,
        }
        Ray::new(child.origin, child.direction.to_array())
    }

    /// The state of the path of `child`, which goes on where the ray of the head numbered `index` ends.
    fn walk_on(&self, index: usize, leaving: &Leaving, child: &Child) -> Walk {
        let before = &self.walks[index];
        let mut walk = Walk { vertex: before.vertex.child(child.kind as u32), ..*before };
        let goes_through = child.kind == Kind::Transmission;
        if goes_through && self.stage.nested {
            let border = &self.borders.borders[index];
            walk.media = if border.is_medium { border.media } else { walk.media };
        }
        match child.course {
            Course::Straight => {}
            Course::Lawful => walk.density = 0.0,
            Course::Sampled(density) => {
                walk.density = density;
                walk.from = DVec3::from_array(child.origin);
                walk.normal = leaving.normal;
            }
        }
        walk.has_bounced |= child.kind == Kind::Bounce;
        if self.stage.path_loop == Loop::Detailed
            && let Some(hit) = &self.hits[index]
        {
            // The hit that it leaves is still there.
            walk.cone = before.cone.on(hit.t, leaving.alpha, child.kind == Kind::Bounce);
        }
        walk
    }

    /// Makes the ray that waited last the sample's head; without one the sample is done.
    pub(super) fn advance_from_stack<E: EffectsOfLoop>(&mut self, slot: u32) {
        if !E::SECONDARY {
            return;
        }
        let count = &mut self.waiting_counts[slot as usize];
        if *count == 0 {
            return;
        }
        *count -= 1;
        let place = slot as usize * self.stack_depth + usize::from(*count);
        if let Some(waiting) = self.waiting[place].take() {
            self.next_rays.push(waiting.ray);
            self.next_heads.push(Head { slot, work: waiting.work, throughput: waiting.throughput });
            if E::SAMPLED {
                self.next_walks.extend(self.waiting_walks[place].take());
            }
        }
    }
}
