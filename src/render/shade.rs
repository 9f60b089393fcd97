//! What becomes of a hit: the light it shows by itself, the point that lights are asked for, the rays that leave it.

use glam::DVec3;

use super::absorption::absorb;
use super::children::Child;
use super::detail::{Detail, Seen};
use super::follow::Leaving;
use super::hot::EffectsOfLoop;
use super::media::index_ratio;
use super::paths::{PathTracer, Point};
use super::query::RayQuery;
use super::response::Scatter;
use super::ways::{Course, Kind};
use crate::error::TraceError;
use crate::geom::offset_origin;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Adds background, emission and ambient light, lists the points to be lit, and spawns children.
    pub(super) fn shade<E: EffectsOfLoop>(&mut self) -> Result<(), TraceError> {
        self.points.clear();
        self.scatters.clear();
        self.details.clear();
        self.next_heads.clear();
        self.next_rays.clear();
        self.next_walks.clear();
        let stage = self.stage;
        for index in 0..self.rays.len() {
            let mut head = self.head::<E>(index);
            let slot = head.slot as usize;
            let border = if E::SAMPLED && stage.nested { Some(self.borders.borders[index]) } else { None };
            let inside = border.and_then(|border| border.before);
            let Some(hit) = self.hits[index] else {
                if E::SAMPLED {
                    let (ray, walk) = (self.rays[index], self.walks[index]);
                    let medium = inside.map_or(DVec3::ZERO, |medium| stage.shader(medium).absorption);
                    let mut seen = self.gathered(&ray, &walk, f64::INFINITY, medium);
                    seen += self.seen_beyond(&ray, &walk) * absorb(medium, f64::INFINITY);
                    self.radiance[slot] += head.throughput * seen;
                } else {
                    self.radiance[slot] += head.throughput * stage.background;
                }
                self.advance_from_stack::<E>(head.slot);
                continue;
            };
            let shader = stage.shader(hit.material);
            let direction = DVec3::from_array(self.rays[index].direction);
            let (position, geometric) = (hit.position(), DVec3::from_array(hit.normal()));
            let is_behind = geometric.dot(direction) > 0.0;
            // The normal of a needle may vanish in rounding; then the surface is taken to face the ray.
            let normal = geometric.try_normalize().map_or(-direction, |n| if is_behind { -n } else { n });
            // The segment that ends here ran through the inside.
            let medium = match inside {
                Some(medium) => stage.shader(medium).absorption,
                None if border.is_none() && is_behind && shader.transmission_max > 0.0 => shader.absorption,
                None => DVec3::ZERO,
            };
            if E::SAMPLED && !stage.areas.is_empty() {
                let (ray, walk) = (self.rays[index], self.walks[index]);
                let gathered = self.gathered(&ray, &walk, hit.t, medium);
                self.radiance[slot] += head.throughput * gathered;
            }
            head.throughput = self.absorbed::<E>(head.throughput, medium, hit.t);
            let error = border.map_or(hit.position_error(), |border| border.error.max(hit.position_error()));
            let origin_on =
                |side: DVec3| offset_origin(position, error, geometric.to_array(), side.to_array());
            if E::SAMPLED && border.is_some_and(|border| border.is_none()) {
                // Two bodies overlap, and this surface is inside the stronger one.
                self.counters.passed_surfaces += 1;
                let child = Child {
                    kind: Kind::Transmission,
                    direction,
                    throughput: head.throughput,
                    origin: origin_on(-normal),
                    course: Course::Straight,
                };
                self.follow::<E>(index, &head, &Leaving::new(shader, normal), [Some(child), None, None]);
                continue;
            }
            let mut point = Point {
                slot: head.slot,
                material: hit.material,
                throughput: head.throughput,
                position: DVec3::from_array(position),
                normal,
                origin: origin_on(normal),
                view: -direction,
            };
            let local;
            let mut shader = shader;
            let mut place = Scatter::OF_MATERIAL;
            if E::DETAILED {
                let width = self.walks[index].cone.width_at(hit.t);
                let seen = Seen { geometric: normal, is_behind, view: -direction, width };
                if stage.are_moving {
                    self.query.at_time(self.times[slot]);
                }
                let detail = Detail::at(stage, &mut self.query, &mut self.counters, &hit, shader, &seen)?;
                point.normal = detail.normal;
                if stage.forced_details.is_some() {
                    self.radiance[slot] += head.throughput * (detail.forced * 0.0);
                }
                if detail.lift != DVec3::ZERO {
                    // The offset keeps its side: the lift never leads to the other.
                    point.position += detail.lift;
                    point.origin = (DVec3::from_array(point.origin) + detail.lift).to_array();
                }
                if let Some(found) = detail.shader {
                    // As many as there are points, which are as many as there are samples.
                    place = self.details.len() as u32;
                    self.details.push(found);
                    local = found;
                    shader = &local;
                }
            }
            self.glow::<E>(&head, shader);
            let is_lit = stage.direct || E::SAMPLED && stage.samples_lights();
            let eta =
                if E::SECONDARY { index_ratio(stage, shader, border.as_ref(), is_behind) } else { None };
            let is_forced =
                stage.force_shadows || E::SAMPLED && (stage.force_areas || stage.force_environment);
            if is_lit && (shader.is_lit || is_forced) {
                self.points.push(point);
                if E::SAMPLED {
                    let walk = self.walks[index];
                    let vertex = walk.vertex;
                    let far_origin = origin_on(-normal);
                    self.scatters.push(Scatter { walk, vertex, far_origin, eta, detail: place });
                }
            }
            if E::SECONDARY {
                self.spawn::<E>(index, &head, shader, &point, normal, eta, || origin_on(-normal));
            }
        }
        Ok(())
    }
}
