//! Everything about a picture that stays the same while it is made, in the form that shading wants.

use glam::DVec3;

use super::sampling::pixel_offset;
use super::settings::RenderSettings;
use super::tiles::TileGrid;
use crate::geom::Ray;
use crate::model::MaterialRecord;
use crate::scene::{Effect, EffectPlan, Emitter, Scene, Surface, View};
use crate::trace::MaterialSet;
use crate::units::MaterialId;

/// A [`Surface`] as vectors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shader {
    pub emission: DVec3,
    pub diffuse: DVec3,
    pub highlight: DVec3,
    pub exponent: Exponent,
    pub mirror: DVec3,
    pub transmission: f64,
    pub absorption: DVec3,
    pub refractive_index: f64,
    /// Whether lamps show on it.
    pub is_lit: bool,
}

/// Exponent of a highlight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Exponent {
    /// A whole number, as nearly always: squarings instead of a power function.
    Whole(u32),
    /// Any other.
    Real(f64),
}

impl Exponent {
    fn new(exponent: f64) -> Exponent {
        if exponent <= 65_536.0 && exponent.fract() == 0.0 {
            Exponent::Whole(exponent as u32)
        } else {
            Exponent::Real(exponent)
        }
    }

    /// `base` (0 ..= 1) to this power. The multiplications are written out because `f64::powi` may differ between
    /// platforms (I2).
    pub fn of(self, base: f64) -> f64 {
        match self {
            Exponent::Real(exponent) => libm::pow(base, exponent),
            Exponent::Whole(mut exponent) => {
                let (mut power, mut square) = (1.0, base);
                while exponent > 0 {
                    if exponent & 1 == 1 {
                        power *= square;
                    }
                    square *= square;
                    exponent >>= 1;
                }
                power
            }
        }
    }
}

impl Shader {
    fn new(surface: &Surface) -> Shader {
        Shader {
            emission: DVec3::from_array(surface.emission),
            diffuse: DVec3::from_array(surface.diffuse),
            highlight: DVec3::from_array(surface.highlight),
            exponent: Exponent::new(surface.exponent),
            mirror: DVec3::from_array(surface.mirror),
            transmission: surface.transmission,
            absorption: DVec3::from_array(surface.absorption),
            refractive_index: surface.refractive_index,
            is_lit: surface.is_lit(),
        }
    }
}

/// The unchanging part of a render.
#[derive(Debug)]
pub(crate) struct Stage {
    pub grid: TileGrid,
    pub settings: RenderSettings,
    pub view: View,
    pub emitters: Vec<Emitter>,
    pub background: DVec3,
    pub ambient: DVec3,
    shaders: Vec<Shader>,
    /// Materials that shadows shine through; none if there are none.
    pub transparent: Option<MaterialSet>,
    bound: RadianceBound,
    pub direct: bool,
    pub shadows: bool,
    pub reflection: bool,
    pub transmission: bool,
    /// Whether lamps are visited although they cannot matter, and so on.
    pub force_shadows: bool,
    pub force_reflection: bool,
    pub force_transmission: bool,
}

impl Stage {
    pub fn new(
        scene: &Scene,
        materials: &[MaterialRecord],
        plan: &EffectPlan,
        settings: &RenderSettings,
    ) -> Stage {
        let surfaces: Vec<Surface> = materials.iter().map(|record| plan.surface(record)).collect();
        let transparent: MaterialSet = surfaces
            .iter()
            .zip(0..=u16::MAX)
            .filter(|(surface, _)| surface.is_transparent())
            .map(|(_, id)| MaterialId(id))
            .collect();
        let force_shadows = plan.forces(Effect::Shadows);
        Stage {
            grid: settings.grid(),
            settings: *settings,
            view: scene.camera().view(settings.width, settings.height),
            emitters: scene
                .lights()
                .iter()
                .filter(|light| !light.is_dark())
                .map(|light| light.emitter())
                .collect(),
            background: DVec3::from_array(scene.background().map(f64::from)),
            ambient: DVec3::from_array(scene.ambient().map(f64::from)),
            bound: RadianceBound::new(scene, &surfaces, plan.has(Effect::DirectLight)),
            shaders: surfaces.iter().map(Shader::new).collect(),
            transparent: (!transparent.is_empty()).then_some(transparent),
            direct: plan.has(Effect::DirectLight) || plan.forces(Effect::DirectLight) || force_shadows,
            shadows: plan.has(Effect::Shadows),
            reflection: plan.has(Effect::Reflection),
            transmission: plan.has(Effect::Transmission),
            force_shadows,
            force_reflection: plan.forces(Effect::Reflection),
            force_transmission: plan.forces(Effect::Transmission),
        }
    }

    /// What the tables take, those needed only to make them included.
    pub fn bytes(&self) -> usize {
        self.shaders.len() * (size_of::<Shader>() + size_of::<Surface>())
            + self.emitters.len() * size_of::<Emitter>()
    }

    /// The shading terms of a material.
    pub fn shader(&self, material: MaterialId) -> &Shader {
        // The decoder refuses blocks that name materials outside their directory entry's range, and the directory
        // refuses ranges outside the table (I5).
        &self.shaders[usize::from(material.0)]
    }

    /// Whether a path that carries `throughput` into a tree of at most `work` rays can add more than the caller's
    /// contribution bound.
    pub fn is_worth_following(&self, throughput: DVec3, work: u64) -> bool {
        throughput.max_element() * self.bound.of(work) > self.settings.contribution_bound
    }

    /// The ray of a sample of pixel (`x`, `y`): a pure function of scene and settings (I2).
    pub fn camera_ray(&self, x: u32, y: u32, sample: u32) -> Ray {
        let settings = &self.settings;
        let pixel = u64::from(y) * u64::from(settings.width) + u64::from(x);
        let offset = pixel_offset(settings.seed, pixel, sample, settings.samples_per_pixel, settings.filter);
        self.view.ray(f64::from(x) + offset[0], f64::from(y) + offset[1])
    }

    /// The most that any ray can bring back in any channel, in trees of at most `work_budget` rays.
    pub fn radiance_max(&self) -> f64 {
        self.bound.of(self.settings.work_budget)
    }
}

/// A bound on the radiance that any ray can bring back.
///
/// No surface sends on more than it gets: the weights of the rays it spawns add up to `rho <= 1` ([`Surface`]'s
/// table; Fresnel's shares add up to 1, absorption only takes). With `local` the most that a surface adds of its own
/// (emission, ambient and direct light), two bounds hold and the lesser is used:
///
/// - `L <= B` for any `B` with `background <= B` and `local_m + rho_m B <= B` for every material `m`;
/// - `L <= work * max(local, background)`: each generation of a tree adds at most its largest local term, and a tree
///   of `work` rays has at most `work` generations.
#[derive(Clone, Copy, Debug)]
struct RadianceBound {
    fixed_point: f64,
    per_generation: f64,
}

impl RadianceBound {
    fn new(scene: &Scene, surfaces: &[Surface], direct: bool) -> RadianceBound {
        let channel_max = |colour: [f64; 3]| colour.into_iter().fold(0.0, f64::max);
        let background = channel_max(scene.background().map(f64::from));
        let mut received = [0.0; 3];
        if direct {
            for light in scene.lights() {
                for (sum, channel) in received.iter_mut().zip(light.irradiance_max()) {
                    *sum += channel;
                }
            }
        }
        let (mut fixed_point, mut per_generation) = (background, background);
        for surface in surfaces {
            let local = channel_max([0, 1, 2].map(|channel| {
                surface.emission[channel]
                    + surface.diffuse[channel] * f64::from(scene.ambient()[channel])
                    + (surface.diffuse[channel] + surface.highlight[channel]) * received[channel]
            }));
            let passed_on = (channel_max(surface.mirror) + surface.transmission).min(1.0);
            per_generation = per_generation.max(local);
            if local > 0.0 {
                // Infinite for a lossless surface that also shines; then the other bound holds.
                fixed_point = fixed_point.max(local / (1.0 - passed_on));
            }
        }
        RadianceBound { fixed_point, per_generation }
    }

    fn of(&self, work: u64) -> f64 {
        self.fixed_point.min(work as f64 * self.per_generation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Camera, EffectOptions, Light};

    #[test]
    fn the_radiance_bound_follows_from_the_materials() {
        let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap();
        let scene = Scene::new(camera)
            .with_background([0.5; 3])
            .with_light(Light::directional([0.0, -1.0, 0.0], [2.0, 1.0, 0.0]));
        let bound = |record: MaterialRecord| {
            let records = [record];
            let plan = EffectPlan::of_materials(&scene, &records, &EffectOptions::default());
            RadianceBound::new(&scene, &records.each_ref().map(|record| plan.surface(record)), true)
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
    fn whole_and_real_exponents_agree() {
        assert_eq!(Exponent::new(8.0), Exponent::Whole(8));
        assert_eq!(Exponent::new(8.5), Exponent::Real(8.5));
        for exponent in [0u32, 1, 2, 7, 100, 65_536] {
            for base in [0.0, 0.3, 0.999, 1.0] {
                let (whole, real) =
                    (Exponent::Whole(exponent).of(base), Exponent::Real(f64::from(exponent)).of(base));
                assert!((whole - real).abs() < 1e-11, "{base} ^ {exponent}: {whole} {real}");
            }
        }
    }
}
