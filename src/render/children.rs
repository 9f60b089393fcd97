//! Which rays leave a hit: of the ways that its effects give, those that are worth following.

use glam::DVec3;

use super::follow::Leaving;
use super::hot::EffectsOfLoop;
use super::mirror::reflect;
use super::paths::{Head, PathTracer, Point};
use super::query::RayQuery;
use super::random::Dimension;
use super::stage::Shader;
use super::ways::{Course, Kind, Way, Ways};
use crate::geom::Ray;

/// A ray that a hit spawns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Child {
    pub kind: Kind,
    pub direction: DVec3,
    pub throughput: DVec3,
    pub origin: [f64; 3],
    /// How its direction came about.
    pub course: Course,
}

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Decides which rays leave `point`, whose triangle has the normal `geometric`, and makes one the sample's next head.
    #[expect(clippy::too_many_arguments, reason = "all belong to one hit")]
    pub(super) fn spawn<E: EffectsOfLoop>(
        &mut self,
        index: usize,
        head: &Head,
        shader: &Shader,
        point: &Point,
        geometric: DVec3,
        eta: Option<f64>,
        far_origin: impl Fn() -> [f64; 3],
    ) {
        let stage = self.stage;
        let direction = -point.view;
        let mut ways = Ways::new(shader, direction);
        let is_rough = E::SAMPLED && shader.alpha > 0.0;
        let facet = if is_rough { self.facet(index, shader, point) } else { point.normal };
        if let Some(eta) = eta {
            ways.refract(shader, direction, facet, eta);
        }
        if is_rough {
            ways.gloss(point, shader.alpha, facet);
            if let Some(eta) = eta {
                ways.frost(point, shader.alpha, eta);
            }
        }
        if E::DETAILED {
            ways.keep_sides(point, geometric);
        }
        if !stage.reflection {
            ways.reflection.weight = DVec3::ZERO;
        }
        if E::SAMPLED {
            self.interreflect(&mut ways, index, shader, point);
        }
        let remaining = head.work - 1;
        let mut children: [Option<Child>; 3] = [None; 3];
        let Ways { transmission, reflection, bounce } = ways;
        for (place, way) in [transmission, reflection, bounce].into_iter().enumerate() {
            let Way { kind, weight, course, .. } = way;
            if !E::SAMPLED && kind == Kind::Bounce {
                break;
            }
            let throughput = head.throughput * weight;
            let make = |throughput: DVec3| {
                let towards = || match kind {
                    Kind::Transmission => direction,
                    Kind::Reflection => reflect(direction, point.normal),
                    Kind::Bounce => point.normal,
                };
                Child {
                    kind,
                    direction: way.direction.unwrap_or_else(towards),
                    throughput,
                    origin: if kind == Kind::Transmission { far_origin() } else { point.origin },
                    course,
                }
            };
            if stage.is_worth_following(throughput, remaining.max(1)) {
                children[place] = Some(make(throughput));
                continue;
            }
            let carries = throughput.max_element() > 0.0;
            if E::SAMPLED && stage.roulette && carries {
                let (walk, bound) = (&self.walks[index], stage.settings.contribution_bound);
                let most = stage.contribution_max(throughput, remaining.max(1));
                self.counters.random_numbers += 1;
                self.counters.roulette_numbers += 1;
                if walk.key.one(walk.vertex, Dimension::Roulette(place as u32)) * bound < most {
                    children[place] = Some(make(throughput * (bound / most)));
                    continue;
                }
                self.counters.roulette_ends += 1;
            } else if carries {
                self.counters.contribution_cuts += 1;
                self.lost[head.slot as usize] += throughput.max_element() * stage.radiance_max();
            }
            let forced = match kind {
                Kind::Transmission => stage.force_transmission,
                Kind::Reflection => stage.force_reflection,
                Kind::Bounce => stage.force_interreflection && !stage.interreflection,
            };
            if forced {
                let child = make(throughput);
                self.forced.push(Ray::new(child.origin, child.direction.to_array()));
            }
        }
        if E::SAMPLED {
            self.force_rough(index, shader, point, eta);
            if self.walks[index].has_bounced {
                self.choose(index, &mut children);
            }
        }
        self.follow::<E>(index, head, &Leaving::new(shader, point.normal), children);
    }

    /// Of several rays one goes on, by luck in proportion to what they carry, and carries for all: after a diffuse bounce a
    /// tree would cost more than it is worth.
    fn choose(&mut self, index: usize, children: &mut [Option<Child>; 3]) {
        let weights = children.map(|child| child.map_or(0.0, |child| child.throughput.max_element()));
        let total: f64 = weights.iter().sum();
        if children.iter().flatten().count() < 2 {
            return;
        }
        let walk = &self.walks[index];
        let mut rest = walk.key.one(walk.vertex, Dimension::Choice) * total;
        self.counters.random_numbers += 1;
        self.counters.bounce_numbers += 1;
        let mut chosen = None;
        for (child, weight) in children.iter().zip(weights) {
            if weight == 0.0 {
                continue;
            }
            chosen = child.map(|child| Child { throughput: child.throughput * (total / weight), ..child });
            if rest < weight {
                break;
            }
            rest -= weight;
        }
        *children = [chosen, None, None];
    }
}
