//! A proven bound on the radiance that any ray can bring back.

use crate::scene::{Effect, EffectPlan, Scene, Surface};

/// A bound on the radiance that any ray can bring back.
///
/// No surface sends on more than it gets: the weights of the rays it spawns add up to `rho <= 1` ([`Surface`]'s
/// table; Fresnel's shares add up to 1, absorption and masking only take, and with interreflection diffuse reflectance is
/// kept within what mirror and transmission leave). Where one of several rays is chosen by luck, its weight over its
/// probability is in the throughput already. With `local` the most that a surface adds of its own (emission, ambient light and
/// direct light), `across` the sum of the radiances of all area lights, which is the most that a ray gathers on its
/// way, and `beyond` the most that a ray sees that hits nothing, two bounds hold and the lesser is used:
///
/// - `L <= B` for any `B` with `across + beyond <= B` and `across + local_m + rho_m B <= B` for every material `m`;
/// - `L <= work * (across + max(local, beyond))`: each generation of a tree adds at most its largest local term, and a
///   tree of `work` rays has at most `work` generations.
///
/// What direct light adds to a surface at most:
///
/// - diffuse: the sum of what the lights give at perpendicular incidence. A light with extent gives the integral of `L cos /
///   pi`, at most `L`; several of them, and the environment, at most the sum of their radiances.
/// - highlight: for a light without extent the same, as the term is at most 1; for one with extent at most `2 L`, the whole
///   hemisphere without the cosine, over pi.
/// - rough mirror: for lights with extent at most `L`, as the lobe's integral is at most 1. For lights without, `pi D G / (4
///   cos) <= 1 / (2 alpha^3)`, as `D <= 1 / (pi alpha^2)` and `G1(cos) / cos <= 2 / alpha`.
/// - rough glass: the same for its reflected part, and `2 / (alpha^3 (1 - m)^2)` for the refracted one, with `m` the
///   lesser of `eta` and `1 / eta`, `eta` any ratio of indices that it can have: Walter's denominator `(eta cos + cos')^2`
///   is at least `(1 - eta)^2`, or `(eta - 1)^2`, which is larger.
///
/// Where pictures change the terms of a material, `m` stands for each of the ends of what they can make of it: both bounds are
/// about sums that are linear in the metalness, and the lobes of the ends are the sharpest
/// ([`Mixture::ends`](crate::scene::Mixture::ends)).
///
/// Weights of multiple importance sampling are at most 1, so the bounds hold for each of its terms.
#[derive(Clone, Copy, Debug)]
pub(super) struct RadianceBound {
    fixed_point: f64,
    per_generation: f64,
}

impl RadianceBound {
    pub fn new(scene: &Scene, surfaces: &[Surface], plan: &EffectPlan) -> RadianceBound {
        let channel_max = |colour: [f64; 3]| colour.into_iter().fold(0.0, f64::max);
        let beyond = match scene.environment() {
            Some(environment) => environment.radiance_max(),
            None => scene.background().map(f64::from),
        };
        // From lights without extent, and from those with extent and the environment.
        let (mut sharp, mut wide, mut across) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        let add = |sum: &mut [f64; 3], light: [f64; 3]| {
            for (sum, channel) in sum.iter_mut().zip(light) {
                *sum += channel;
            }
        };
        for light in scene.lights() {
            if !light.is_area() {
                if plan.has(Effect::DirectLight) {
                    add(&mut sharp, light.irradiance_max());
                }
            } else if plan.has(Effect::AreaLight) {
                add(&mut wide, light.irradiance_max());
                add(&mut across, light.irradiance_max());
            }
        }
        if plan.has(Effect::EnvironmentLight) {
            add(&mut wide, beyond);
        }
        let across = channel_max(across);
        let beyond = channel_max(beyond);
        let (mut fixed_point, mut per_generation) = (across + beyond, across + beyond);
        // The least step between two media decides how sharp a refracted lobe can be.
        let indices = || {
            let glasses = surfaces.iter().filter(|surface| surface.is_transparent());
            glasses.map(|surface| surface.refractive_index).chain([1.0])
        };
        for surface in surfaces {
            let alpha_cubed = surface.alpha * surface.alpha * surface.alpha;
            let local = channel_max([0, 1, 2].map(|channel| {
                let (sharp, wide) = (sharp[channel], wide[channel]);
                let mut local = surface.emission[channel]
                    + surface.diffuse[channel] * f64::from(scene.ambient()[channel])
                    + (surface.diffuse[channel] + surface.highlight[channel]) * sharp
                    + (surface.diffuse[channel] + 2.0 * surface.highlight[channel]) * wide;
                if surface.alpha > 0.0 {
                    let passed_on = surface.mirror[channel] + surface.transmission;
                    local += passed_on * (wide + sharp / (2.0 * alpha_cubed));
                    if surface.refracts() && sharp > 0.0 {
                        let step = indices().filter(|index| *index != surface.refractive_index).fold(
                            1.0,
                            |least: f64, index| {
                                let ratio = index / surface.refractive_index;
                                least.min(1.0 - ratio.min(1.0 / ratio))
                            },
                        );
                        local += surface.transmission * sharp * 2.0 / (alpha_cubed * step * step);
                    }
                }
                local
            }));
            let mut passed_on = channel_max(surface.mirror) + surface.transmission;
            if plan.has(Effect::Interreflection) {
                let rho = [0, 1, 2]
                    .map(|channel| surface.mirror[channel] + surface.transmission + surface.diffuse[channel]);
                passed_on = channel_max(rho);
            }
            let passed_on = passed_on.min(1.0);
            per_generation = per_generation.max(across + local);
            if across + local > 0.0 {
                // Infinite for a lossless surface that also shines; then the other bound holds.
                fixed_point = fixed_point.max((across + local) / (1.0 - passed_on));
            }
        }
        RadianceBound { fixed_point, per_generation }
    }

    pub fn of(&self, work: u64) -> f64 {
        self.fixed_point.min(work as f64 * self.per_generation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::MaterialRecord;
    use crate::scene::{Camera, EffectOptions, Environment, Finish, Light, LightShape};

    #[test]
    fn the_radiance_bound_follows_from_the_materials() {
        let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap();
        let scene = Scene::new(camera)
            .with_background([0.5; 3])
            .with_light(Light::directional([0.0, -1.0, 0.0], [2.0, 1.0, 0.0]));
        let bound = |record: MaterialRecord| {
            let records = [record];
            let plan = EffectPlan::of_materials(&scene, &records, &EffectOptions::default());
            RadianceBound::new(&scene, &records.each_ref().map(|record| plan.surface(&scene, record)), &plan)
        };
        let matt = bound(MaterialRecord { diffuse: [0.5; 3], ..MaterialRecord::default() });
        assert_eq!((matt.of(1), matt.of(1000)), (1.0, 1.0));
        // Half mirror: 0.5 * 2 of its own, plus the highlight 0.5 * 2, and half of what comes in.
        let mirror = bound(MaterialRecord {
            diffuse: [0.5; 3],
            specular: [0.5; 3],
            mirror: true,
            ..MaterialRecord::default()
        });
        assert_eq!((mirror.of(1), mirror.of(1000)), (2.0, 4.0));
        // Lossless and lit: bounded only by the number of rays.
        let lossless = bound(MaterialRecord {
            diffuse: [0.0; 3],
            specular: [1.0; 3],
            mirror: true,
            ..MaterialRecord::default()
        });
        assert_eq!(lossless.of(1000), 2000.0);
    }

    #[test]
    fn lights_with_extent_and_rough_lobes_count() {
        let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap();
        let panel = Light::area(LightShape::Sphere { center: [9.0; 3], radius: 1.0 }, [4.0; 3]);
        let scene = Scene::new(camera).with_background([0.5; 3]).with_light(panel);
        let bound = |scene: &Scene, record: MaterialRecord| {
            let plan = EffectPlan::of_materials(scene, [&record], &EffectOptions::default());
            RadianceBound::new(scene, &[plan.surface(scene, &record)], &plan).of(1000)
        };
        let matt = MaterialRecord { diffuse: [0.5; 3], ..MaterialRecord::default() };
        // Gathered on the way, and 0.5 * 4 received; that is more than the background.
        assert_eq!(bound(&scene, matt.clone()), 6.0);
        // With half of what comes in sent on.
        assert_eq!(bound(&scene.clone().with_interreflection(), matt.clone()), 12.0);
        let sky = Scene::new(camera).with_environment(Environment::Constant([2.0; 3]));
        assert_eq!(bound(&sky, matt), 2.0);
        let chrome = MaterialRecord {
            diffuse: [0.0; 3],
            specular: [0.5; 3],
            mirror: true,
            ..MaterialRecord::default()
        };
        let sun = Scene::new(camera)
            .with_light(Light::directional([0.0, -1.0, 0.0], [1.0; 3]))
            .with_finish("", Finish::rough(0.5f32.sqrt()));
        // alpha = 1/2: 0.5 / (2 / 8), twice for half of what comes in.
        assert!((bound(&sun, chrome) - 4.0).abs() < 1e-5);
    }
}
