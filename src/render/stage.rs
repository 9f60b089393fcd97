//! Everything about a picture that stays the same while it is made, in the form that shading wants.

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use super::bound::RadianceBound;
use super::detail::forced::{self, ForcedDetails};
use super::detail::maps::{CutOuts, MaterialMaps, cut_outs, maps};
use super::draft::Draft;
use super::random::{Dimension, SampleKey, VertexId};
use super::sampling::{MIDDLE, pixel_offset};
use super::settings::{PathEnd, RenderSettings};
use super::tiles::TileGrid;
use crate::geom::Ray;
use crate::model::MaterialRecord;
use crate::scene::{
    AreaEmitter, Effect, EffectPlan, Emitter, Environment, EnvironmentEmitter, Light, Scene, Surface, Terms,
    View,
};
use crate::texture::{TextureCache, Textures};
use crate::trace::{Hit, MaterialSet};
use crate::units::{MaterialId, TriangleId};

/// A [`Surface`] as vectors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shader {
    /// What it sends everywhere without lamps, where pictures change neither emission nor diffuse colour.
    pub glow: DVec3,
    pub emission: DVec3,
    /// Whether that is not black.
    pub glows: bool,
    pub diffuse: DVec3,
    pub highlight: DVec3,
    pub has_highlight: bool,
    /// The part of it that lights with extent show too.
    pub area_highlight: DVec3,
    pub exponent: Exponent,
    pub mirror: DVec3,
    pub transmission: f64,
    /// The most that passes anywhere on the material.
    pub transmission_max: f64,
    pub absorption: DVec3,
    pub refractive_index: f64,
    /// GGX roughness of mirror and glass; 0 if smooth.
    pub alpha: f64,
    /// Rank among overlapping media.
    pub priority: u8,
    /// Whether it bounds a body that light passes through: refracts or absorbs.
    pub is_medium: bool,
    /// Whether lamps show on it.
    pub is_lit: bool,
    /// Whether it looks different if its normal does, here or elsewhere on the material.
    pub depends_on_normal: bool,
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
    /// Of a material that looks so where no picture changes it, and lies between `ends` where some do.
    fn new(surface: &Surface, ends: &[Surface], ambient: DVec3) -> Shader {
        let anywhere = |holds: fn(&Surface) -> bool| ends.iter().any(holds);
        let diffuse = DVec3::from_array(surface.diffuse);
        Shader {
            glow: DVec3::from_array(surface.emission) + diffuse * ambient,
            emission: DVec3::from_array(surface.emission),
            glows: surface.emission != [0.0; 3],
            diffuse,
            highlight: DVec3::from_array(surface.highlight),
            has_highlight: surface.highlight != [0.0; 3],
            area_highlight: DVec3::from_array(surface.area_highlight),
            exponent: Exponent::new(surface.exponent),
            mirror: DVec3::from_array(surface.mirror),
            transmission: surface.transmission,
            transmission_max: ends.iter().fold(0.0, |most, end| end.transmission.max(most)),
            absorption: DVec3::from_array(surface.absorption),
            refractive_index: surface.refractive_index,
            alpha: surface.alpha,
            priority: surface.priority,
            is_medium: anywhere(|end| end.refracts() || end.is_transparent() && end.absorption != [0.0; 3]),
            is_lit: surface.is_lit(),
            depends_on_normal: anywhere(Surface::depends_on_normal),
        }
    }

    /// Takes the terms of one place.
    pub fn mix(&mut self, terms: &Terms) {
        let Terms { diffuse, highlight, area_highlight, exponent, mirror, transmission, alpha } = *terms;
        (self.diffuse, self.highlight, self.area_highlight) = (diffuse, highlight, area_highlight);
        (self.mirror, self.transmission, self.alpha) = (mirror, transmission, alpha);
        self.has_highlight = highlight != DVec3::ZERO;
        self.exponent = Exponent::new(exponent);
        self.is_lit = diffuse != DVec3::ZERO || self.has_highlight || alpha > 0.0;
    }

    /// Whether it splits light by Fresnel's equations.
    pub fn is_glass(&self) -> bool {
        self.transmission > 0.0 && self.refractive_index != 1.0
    }
}

/// Names a sample.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelSample {
    /// Its pixel.
    pub x: u32,
    pub y: u32,
    /// Which of the pixel's, or, with [`SECOND_SET`], of its second set.
    pub number: u32,
}

/// Added to a sample's number: it is one of a second set of samples of its pixel, which is as well stratified as the first and has nothing to
/// do with it.
pub(crate) const SECOND_SET: u32 = 1 << 31;

/// A sample's way into the scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CameraSample {
    pub ray: Ray,
    /// From 0, when the shutter opens, to 1.
    pub time: f64,
}

/// The compiled forms of the path loop, each of which knows all that those before it know; see [`super::hot`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Loop {
    /// No ray goes on from a hit, and none glows.
    Matt,
    /// Smooth mirrors and glass.
    Whitted,
    /// Everything, gated at run time.
    Sampled,
    /// And attributes of corners.
    Detailed,
}

/// The unchanging part of a render.
#[derive(Debug)]
pub(crate) struct Stage {
    pub grid: TileGrid,
    pub settings: RenderSettings,
    pub view: View,
    pub emitters: Vec<Emitter>,
    /// Lights with extent; a black one where they are only forced.
    pub areas: Vec<AreaEmitter>,
    /// What is sampled as light from all around; a black one where it is only forced.
    pub environment: Option<EnvironmentEmitter>,
    /// What rays that hit nothing see in place of the background.
    pub surroundings: Option<EnvironmentEmitter>,
    pub background: DVec3,
    pub ambient: DVec3,
    shaders: Vec<Shader>,
    /// For each material, the form that its hits ask for on triangles without and with normals of corners.
    loops: Vec<[Loop; 2]>,
    /// Materials that shadows shine through; none if there are none.
    pub transparent: Option<MaterialSet>,
    /// Those of them that do not bend light.
    pub straight: Option<MaterialSet>,
    bound: RadianceBound,
    /// The form that serves all surfaces that there are.
    pub path_loop: Loop,
    /// The form that the scene asks for whatever rays meet.
    pub least_loop: Loop,
    pub direct: bool,
    pub shadows: bool,
    pub reflection: bool,
    pub transmission: bool,
    pub interreflection: bool,
    pub nested: bool,
    /// Whether any surface has a rough lobe.
    pub has_rough: bool,
    pub roulette: bool,
    /// Whether the environment is sampled, not only forced.
    pub lit_by_environment: bool,
    /// Whether lamps are visited although they cannot matter, and so on.
    pub force_shadows: bool,
    pub force_reflection: bool,
    pub force_transmission: bool,
    pub force_absorption: bool,
    pub force_emission: bool,
    pub force_areas: bool,
    pub force_environment: bool,
    pub force_glossy: bool,
    pub force_frosted: bool,
    pub force_interreflection: bool,
    pub force_nested: bool,
    pub force_lens: bool,
    pub force_shutter: bool,
    /// Whether instances move while the shutter is open.
    pub are_moving: bool,
    pub smooth: bool,
    /// What is looked up on surfaces although it cannot matter.
    pub forced_details: Option<ForcedDetails>,
    /// The pictures of each material; empty if the plan needs none.
    maps: Vec<MaterialMaps>,
    /// Materials that are not there everywhere.
    pub cut_outs: Option<CutOuts>,
    /// Where tiles of pictures come from, if there are any.
    pub textures: Option<Arc<TextureCache>>,
    /// Where pixels are kept between pictures, if each goes on with the one before.
    pub draft: Option<Draft>,
}

impl Stage {
    pub fn new(
        scene: &Scene,
        materials: &[MaterialRecord],
        plan: &EffectPlan,
        settings: &RenderSettings,
    ) -> Stage {
        // The ends of what pictures can make of each material, one after the other: nearly always one.
        let mut ends: Vec<Surface> = Vec::with_capacity(materials.len());
        let mut ends_of: Vec<Range<usize>> = Vec::with_capacity(materials.len());
        for record in materials {
            let start = ends.len();
            ends.extend(plan.ends(scene, record));
            ends_of.push(start..ends.len());
        }
        let materials_that = |holds: &dyn Fn(&Surface) -> bool| {
            let is_any = |place: &Range<usize>| ends[place.clone()].iter().any(holds);
            let chosen = ends_of.iter().zip(0..=u16::MAX).filter(|(place, _)| is_any(place));
            let set: MaterialSet = chosen.map(|(_, id)| MaterialId(id)).collect();
            (!set.is_empty()).then_some(set)
        };
        let force_areas = plan.forces(Effect::AreaLight);
        let force_environment = plan.forces(Effect::EnvironmentLight);
        let force_shadows = plan.forces(Effect::Shadows);
        let mut areas: Vec<AreaEmitter> = Vec::new();
        if plan.has(Effect::AreaLight) {
            areas.extend(
                scene
                    .lights()
                    .iter()
                    .filter(|light| !light.is_dark())
                    .filter_map(|light| light.area_emitter()),
            );
        } else if force_areas {
            areas.push(AreaEmitter::black(DVec3::from_array(scene.camera().eye())));
        }
        let surroundings = scene.environment().map(EnvironmentEmitter::new);
        let lit_by_environment = plan.has(Effect::EnvironmentLight);
        let environment = if lit_by_environment {
            surroundings.clone()
        } else {
            force_environment.then(|| EnvironmentEmitter::new(&Environment::Constant([0.0; 3])))
        };
        let mut camera = *scene.camera();
        if !plan.has(Effect::DepthOfField) {
            camera = camera.without_lens();
        }
        if !plan.has(Effect::MotionBlur) {
            camera = camera.at_rest();
        }
        let forced_details = ForcedDetails::of(scene, plan);
        let forces = |effect| plan.forces(effect) && !plan.has(effect);
        let ambient = DVec3::from_array(scene.ambient().map(f64::from));
        let mut stage = Stage {
            grid: settings.grid(),
            settings: *settings,
            view: camera.view(settings.width, settings.height),
            emitters: scene
                .lights()
                .iter()
                .filter(|light| !light.is_dark())
                .filter_map(|light| light.emitter())
                .collect(),
            areas,
            environment,
            surroundings,
            background: DVec3::from_array(scene.background().map(f64::from)),
            ambient,
            bound: RadianceBound::new(scene, &ends, plan),
            shaders: materials
                .iter()
                .zip(&ends_of)
                .map(|(record, of)| Shader::new(&plan.surface(scene, record), &ends[of.clone()], ambient))
                .collect(),
            loops: Vec::new(),
            transparent: materials_that(&|surface| surface.is_transparent()),
            straight: materials_that(&|surface| surface.is_transparent() && !surface.refracts()),
            path_loop: Loop::Sampled,
            least_loop: Loop::Sampled,
            direct: plan.has(Effect::DirectLight) || plan.forces(Effect::DirectLight) || force_shadows,
            shadows: plan.has(Effect::Shadows),
            reflection: plan.has(Effect::Reflection),
            transmission: plan.has(Effect::Transmission),
            interreflection: plan.has(Effect::Interreflection),
            nested: plan.has(Effect::NestedMedia),
            has_rough: ends.iter().any(|surface| surface.alpha > 0.0),
            roulette: settings.path_end == PathEnd::Roulette,
            lit_by_environment,
            force_shadows,
            force_reflection: plan.forces(Effect::Reflection),
            force_transmission: plan.forces(Effect::Transmission),
            force_absorption: forces(Effect::Absorption),
            force_emission: forces(Effect::Emission),
            force_areas,
            force_environment,
            force_glossy: plan.forces(Effect::GlossyReflection),
            force_frosted: plan.forces(Effect::RoughRefraction),
            force_interreflection: plan.forces(Effect::Interreflection),
            force_nested: plan.forces(Effect::NestedMedia),
            force_lens: plan.forces(Effect::DepthOfField) && !plan.has(Effect::DepthOfField),
            are_moving: false,
            force_shutter: plan.forces(Effect::MotionBlur) && !plan.has(Effect::MotionBlur),
            smooth: plan.has(Effect::SmoothNormals),
            forced_details,
            maps: maps(scene, materials, plan, forced_details.as_ref()),
            cut_outs: None,
            textures: None,
            draft: None,
        };
        if stage.emitters.is_empty() && (force_shadows || plan.forces(Effect::DirectLight)) {
            // In a direction along which no face or edge of a usual model lies: rays along a face meet far more triangles than others.
            stage.emitters.extend(Light::directional([0.37, -1.0, -0.53], [0.0; 3]).emitter());
        }
        stage.cut_outs = cut_outs(&stage.maps, stage.transparent.as_ref());
        stage.least_loop = stage.loop_of_scene();
        stage.loops = (0..=u16::MAX).zip(&ends_of).map(|(id, _)| stage.loops_of(MaterialId(id))).collect();
        stage.path_loop = stage.loops.iter().flatten().copied().fold(stage.least_loop, Loop::max);
        stage
    }

    /// The form that is asked for by something else than a surface.
    fn loop_of_scene(&self) -> Loop {
        let is_sampled = !self.areas.is_empty()
            || self.environment.is_some()
            || self.surroundings.is_some()
            || self.interreflection
            || self.nested
            || self.roulette
            || self.forces_a_sampled_effect();
        if self.forced_details.is_some() {
            Loop::Detailed
        } else if is_sampled {
            Loop::Sampled
        } else if self.force_reflection
            || self.force_transmission
            || self.force_absorption
            || self.force_emission
        {
            Loop::Whitted
        } else {
            Loop::Matt
        }
    }

    /// The form that hits on a material ask for, on triangles without and with normals of corners.
    fn loops_of(&self, material: MaterialId) -> [Loop; 2] {
        let shader = self.shader(material);
        let flat = if self.maps(material).are_seen() {
            Loop::Detailed
        } else if shader.alpha > 0.0 {
            Loop::Sampled
        } else if shader.glows || shader.mirror != DVec3::ZERO || shader.transmission > 0.0 {
            Loop::Whitted
        } else {
            Loop::Matt
        };
        [flat, if self.is_smooth(shader) { Loop::Detailed } else { flat }]
    }

    /// Whether normals of corners show on a material.
    pub fn is_smooth(&self, shader: &Shader) -> bool {
        self.smooth && shader.depends_on_normal
    }

    /// The form that these hits ask for, where `may_have_normals` knows what the directory says of their triangle's corners: an
    /// effect of a surface that nothing meets costs nothing (I6).
    pub fn loop_of_hits(&self, hits: &[Option<Hit>], may_have_normals: impl Fn(TriangleId) -> bool) -> Loop {
        let mut found = self.least_loop;
        if found == self.path_loop {
            return found;
        }
        for hit in hits.iter().flatten() {
            let [flat, smooth] = self.loops[usize::from(hit.material.0)];
            found = found.max(flat);
            if smooth > found && may_have_normals(hit.triangle) {
                found = smooth;
            }
            if found == self.path_loop {
                break;
            }
        }
        found
    }

    /// Whether forced effects trace rays that need the sampled loop.
    pub fn forces_a_sampled_effect(&self) -> bool {
        self.force_areas
            || self.force_environment
            || self.force_glossy
            || self.force_frosted
            || self.force_interreflection
            || self.force_nested
            || self.force_lens
            || self.force_shutter
    }

    /// The way into the scene of sample `sample` of `pixel`, which lies at `(x, y)` of the image.
    #[inline(always)]
    pub fn camera_sample(&self, pixel: u64, sample: u32, x: f64, y: f64) -> CameraSample {
        if !(self.view.has_lens() || self.draws_time()) {
            // Without luck it draws no numbers, and needs no key for them (I6).
            return CameraSample { ray: self.view.ray(x, y), time: 0.0 };
        }
        self.lucky_camera_sample(pixel, sample, x, y)
    }

    /// [`Stage::camera_sample`] through a lens or at a time.
    fn lucky_camera_sample(&self, pixel: u64, sample: u32, x: f64, y: f64) -> CameraSample {
        let (has_lens, is_moving) = (self.view.has_lens(), self.draws_time());
        let key = SampleKey::new(self.settings.seed, pixel, sample);
        let lens = if has_lens { key.pair(VertexId::CAMERA, Dimension::Lens) } else { [0.5; 2] };
        let time = if is_moving { key.one(VertexId::CAMERA, Dimension::Shutter) } else { 0.0 };
        CameraSample { ray: self.view.sampled_ray(x, y, lens, time), time }
    }

    /// Whether each sample has a time of its own.
    #[inline]
    pub fn draws_time(&self) -> bool {
        self.view.is_moving() || self.are_moving
    }

    /// What the tables take, those needed only to make them included.
    pub fn bytes(&self) -> usize {
        // Pictures make up to four ends of a material, in a list that may have doubled.
        let ends = if self.maps.is_empty() { 1 } else { 8 };
        let ends = ends * size_of::<Surface>() + size_of::<Range<usize>>();
        self.shaders.len() * (size_of::<Shader>() + ends + size_of::<[Loop; 2]>())
            + self.maps.len() * size_of::<MaterialMaps>()
            + self.emitters.len() * size_of::<Emitter>()
            + self.areas.len() * size_of::<AreaEmitter>()
    }

    /// Whether hits are asked for attributes, if there are any.
    pub fn needs_attributes(&self) -> bool {
        self.smooth || self.forced_details.is_some() || self.needs_textures()
    }

    /// Whether hits are looked up in pictures.
    pub fn needs_textures(&self) -> bool {
        let is_forced = self.forced_details.is_some_and(|forced| forced.needs_textures());
        is_forced || self.cut_outs.is_some() || self.maps.iter().any(MaterialMaps::are_seen)
    }

    /// The pictures that hits are looked up in, if they are: those of the scene, or a texel where effects are only forced.
    pub fn textures_to_open(&self, scene: &Scene) -> Option<Arc<Textures>> {
        if !self.needs_textures() {
            return None;
        }
        scene.textures().filter(|textures| textures.image_count() > 0).cloned().or_else(forced::stand_in)
    }

    /// The pictures of a material.
    pub fn maps(&self, material: MaterialId) -> &MaterialMaps {
        self.maps.get(usize::from(material.0)).unwrap_or(&MaterialMaps::NONE)
    }

    /// The shading terms of a material.
    #[inline]
    pub fn shader(&self, material: MaterialId) -> &Shader {
        // The decoder refuses blocks that name materials outside their directory entry's range, and the directory
        // refuses ranges outside the table (I5).
        &self.shaders[usize::from(material.0)]
    }

    /// Whether a path that carries `throughput` into a tree of at most `work` rays can add more than the caller's
    /// contribution bound.
    pub fn is_worth_following(&self, throughput: DVec3, work: u64) -> bool {
        self.contribution_max(throughput, work) > self.settings.contribution_bound
    }

    /// A sample's way into the scene: a pure function of scene and settings (I2).
    #[inline(always)]
    pub fn pixel_sample(&self, sample: PixelSample) -> CameraSample {
        let (settings, PixelSample { x, y, .. }) = (&self.settings, sample);
        let (pixel, number) = self.named(sample);
        let offset = pixel_offset(settings.seed, pixel, number, settings.samples_per_pixel, settings.filter);
        self.camera_sample(pixel, number, f64::from(x) + offset[0], f64::from(y) + offset[1])
    }

    /// What names the random numbers of a sample.
    pub fn key(&self, sample: PixelSample) -> SampleKey {
        let (pixel, number) = self.named(sample);
        SampleKey::new(self.settings.seed, pixel, number)
    }

    /// A number for the pixel of a sample and its set, and that of the sample.
    #[inline(always)]
    fn named(&self, PixelSample { x, y, number }: PixelSample) -> (u64, u32) {
        // Films have fewer than 2^63 pixels.
        let set = u64::from(number & SECOND_SET) << 32;
        (set | self.pixel_number(x, y), number & !SECOND_SET)
    }

    fn pixel_number(&self, x: u32, y: u32) -> u64 {
        u64::from(y) * u64::from(self.settings.width) + u64::from(x)
    }

    /// Whether all camera rays run through the middle of their pixel, at the same time, from the same point: then they are what
    /// [`Stage::middle_ray`] gives.
    pub fn has_middle_rays(&self) -> bool {
        self.settings.samples_per_pixel == 1 && !self.view.has_lens() && !self.draws_time()
    }

    /// The ray through the middle of a pixel.
    #[inline(always)]
    pub fn middle_ray(&self, x: u32, y: u32) -> Ray {
        self.view.ray(f64::from(x) + MIDDLE[0], f64::from(y) + MIDDLE[1])
    }

    /// The most that any ray can bring back in any channel, in trees of at most `work_budget` rays.
    pub fn radiance_max(&self) -> f64 {
        self.bound.of(self.settings.work_budget)
    }

    /// The most that a path can add that carries `throughput` into a tree of at most `work` rays.
    pub fn contribution_max(&self, throughput: DVec3, work: u64) -> f64 {
        throughput.max_element() * self.bound.of(work)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
