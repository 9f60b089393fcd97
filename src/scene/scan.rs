//! The traits of a scene and its materials that call for effects, and the verdict on each effect in words.

use super::effect::{Effect, EffectOptions, EffectSet};
use super::mixture::{Mixture, Simulated, Terms, Variation};
use super::plan::AttributeKinds;
use super::{Light, Scene, Surface};
use crate::model::MaterialRecord;
use crate::texture::Encoding;

/// Whether an effect is called for, and why or why not.
pub(super) struct Verdict {
    pub called_for: bool,
    pub reason: String,
}

fn yes(reason: impl Into<String>) -> Verdict {
    Verdict { called_for: true, reason: reason.into() }
}

fn no(reason: impl Into<String>) -> Verdict {
    Verdict { called_for: false, reason: reason.into() }
}

/// What the materials in use and the lights are like.
#[derive(Default)]
pub(super) struct Traits {
    lit: Group,
    diffuse: Group,
    glowing: Group,
    mirrors: Group,
    glossy: Group,
    glass: Group,
    frosted: Group,
    transparent: Group,
    absorbing: Group,
    ranked: Group,
    /// Materials that look different if their normal does.
    shaded: Group,
    textured: Group,
    cut_out: Group,
    bumped: Group,
    varied: Group,
    point_lights: usize,
    area_lights: usize,
    attributes: AttributeKinds,
    /// Whether instances move while the shutter is open.
    are_moving: bool,
}

impl Traits {
    pub fn of<'m>(
        scene: &Scene,
        materials: impl IntoIterator<Item = &'m MaterialRecord>,
        attributes: AttributeKinds,
        are_moving: bool,
        options: &EffectOptions,
    ) -> Traits {
        let mut traits = Traits { attributes, are_moving, ..Traits::default() };
        let shining = |light: &&Light| !light.is_dark();
        traits.area_lights = scene.lights().iter().filter(shining).filter(|light| light.is_area()).count();
        traits.point_lights = scene.lights().iter().filter(shining).count() - traits.area_lights;
        let is_off = |effect| options.switched_off.contains(effect);
        let finishes = scene.textures().filter(|_| attributes.uvs && !is_off(Effect::FinishMaps));
        let is_shining = scene.environment().is_some_and(|environment| !environment.is_dark());
        let simulated = Simulated {
            highlights: traits.point_lights > 0 && !is_off(Effect::DirectLight)
                || traits.area_lights > 0 && !is_off(Effect::AreaLight)
                || is_shining && !is_off(Effect::EnvironmentLight),
            reflection: !is_off(Effect::Reflection),
            transmission: !is_off(Effect::Transmission),
            glossy: !is_off(Effect::GlossyReflection),
            frosted: !is_off(Effect::RoughRefraction),
            // What pictures change does not depend on it.
            keeps_energy: false,
        };
        for record in materials {
            let finish = scene.finish(record);
            let variation = finishes.map_or(Variation::default(), |textures| {
                Variation::of(record, &finish, &simulated, textures)
            });
            traits.varied.add(variation.is_any(), record);
            // Whatever pictures make of it.
            let mixture = Mixture::new(record, &finish);
            let ends = mixture.ends(variation);
            let most = ends.iter().fold(ends[0], |most: Terms, end| most.max(end));
            let surface = Surface::of_terms(record, &finish, &most);
            let rough = surface.alpha > 0.0;
            traits.lit.add(surface.is_lit(), record);
            traits.diffuse.add(surface.diffuse != [0.0; 3], record);
            traits.glowing.add(surface.emission != [0.0; 3], record);
            traits.mirrors.add(surface.is_mirror(), record);
            traits.glossy.add(surface.is_mirror() && rough, record);
            traits.glass.add(surface.refracts(), record);
            traits.frosted.add(surface.refracts() && rough, record);
            traits.transparent.add(surface.is_transparent(), record);
            traits.absorbing.add(surface.is_transparent() && surface.absorption != [0.0; 3], record);
            traits.shaded.add(surface.depends_on_normal(), record);
            if let (Some(images), Some(textures)) = (&record.images, scene.textures()) {
                let color = images.diffuse.as_ref().and_then(|map| textures.find(&map.path, Encoding::Srgb));
                let has_alpha = color.is_some_and(|texture| textures.has_alpha(texture));
                let is_bumped = images.bump.is_some() || images.normal.is_some();
                let glows = surface.emission != [0.0; 3] && !is_off(Effect::Emission);
                let has_colors = images.diffuse.is_some()
                    || images.specular.is_some()
                    || images.emission.is_some() && glows;
                traits.textured.add(has_colors, record);
                traits.cut_out.add(images.opacity.is_some() || has_alpha, record);
                traits.bumped.add(is_bumped && surface.depends_on_normal(), record);
            }
            traits.ranked.add(surface.is_transparent() && finish.priority.is_some(), record);
        }
        traits
    }

    /// The verdict on `effect` in a plan that holds `needed` so far.
    pub fn verdict(
        &self,
        effect: Effect,
        scene: &Scene,
        needed: EffectSet,
        options: &EffectOptions,
    ) -> Verdict {
        let count = |count: usize, one: &str, many: &str| match count {
            1 => format!("1 {one}"),
            count => format!("{count} {many}"),
        };
        let lights = count(self.point_lights, "light", "lights");
        let area_lights = count(self.area_lights, "area light", "area lights");
        let is_off = |effect| options.switched_off.contains(effect);
        match effect {
            Effect::DirectLight => match (self.point_lights, self.lit.count) {
                (0, _) => no("the scene has no light without extent that shines"),
                (_, 0) => no("no material is diffuse or has a highlight"),
                _ => yes(format!("{lights} on {}", self.lit.describe("lit material", "lit materials"))),
            },
            Effect::Shadows => {
                let mut hidden = Vec::new();
                if needed.contains(Effect::DirectLight) {
                    hidden.push(lights);
                }
                // These come after it, but only the light that they give matters here.
                if self.area_lights > 0 && self.lit.count > 0 && !is_off(Effect::AreaLight) {
                    hidden.push(area_lights);
                }
                if self.has_lighting_environment(scene) && !is_off(Effect::EnvironmentLight) {
                    hidden.push("the environment".to_string());
                }
                match hidden.is_empty() {
                    true => no("there is no direct light"),
                    false => yes(format!("{} may be hidden", hidden.join(" and "))),
                }
            }
            Effect::AreaLight => match self.area_lights {
                0 => no("no light has extent"),
                _ if self.lit.count == 0 => yes(format!("{area_lights} may be seen")),
                _ => yes(format!("{area_lights} on {}", self.lit.describe("lit material", "lit materials"))),
            },
            Effect::EnvironmentLight => match scene.environment() {
                None => no("the scene has no environment"),
                Some(environment) if environment.is_dark() => no("the environment is black"),
                Some(_) if self.lit.count == 0 => no("no material is diffuse or has a highlight"),
                Some(_) => yes(format!(
                    "the environment shines on {}",
                    self.lit.describe("lit material", "lit materials")
                )),
            },
            Effect::Reflection => {
                // Without transmission nothing refracts, so glass alone calls for no reflection either.
                let glass_reflects = self.glass.count > 0 && !is_off(Effect::Transmission);
                let mirrors = self.mirrors.describe("mirror", "mirrors");
                let glass = format!("{} by Fresnel", self.glass.describe("glass", "glasses"));
                match (self.mirrors.count > 0, glass_reflects) {
                    (true, true) => yes(format!("{mirrors}; {glass}")),
                    (true, false) => yes(mirrors),
                    (false, true) => yes(glass),
                    (false, false) => no("no material is a mirror or refracts"),
                }
            }
            Effect::GlossyReflection => {
                self.glossy.calls_if(needed, Effect::Reflection, ["rough mirror", "rough mirrors"])
            }
            Effect::Transmission => match self.transparent.count {
                0 => no("every material is opaque"),
                _ => yes(self.transparent.describe("transparent material", "transparent materials")),
            },
            Effect::RoughRefraction => {
                self.frosted.calls_if(needed, Effect::Transmission, ["rough glass", "rough glasses"])
            }
            Effect::Absorption => self.absorbing.calls_if(
                needed,
                Effect::Transmission,
                ["absorbing material", "absorbing materials"],
            ),
            Effect::NestedMedia => {
                if self.ranked.count == 0 {
                    no("no transparent material has a priority")
                } else if self.transparent.count < 2 {
                    no("only one material is transparent, so it has no other to nest with")
                } else {
                    self.ranked.calls_if(
                        needed,
                        Effect::Transmission,
                        ["material with a priority", "materials with a priority"],
                    )
                }
            }
            Effect::Interreflection => {
                if !scene.has_interreflection() {
                    no("the scene did not ask for it")
                } else if self.diffuse.count == 0 {
                    no("no material is diffuse")
                } else if !self.shines(scene, !is_off(Effect::Emission)) {
                    no("nothing in the scene shines")
                } else {
                    yes(format!("between {}", self.diffuse.describe("diffuse material", "diffuse materials")))
                }
            }
            Effect::DepthOfField => match scene.camera().lens() {
                None => no("the camera has no lens"),
                Some(lens) if lens.radius == 0.0 => no("the lens has radius 0"),
                Some(lens) => {
                    yes(format!("a lens of radius {} in focus at {}", lens.radius, lens.focus_distance))
                }
            },
            Effect::MotionBlur => match (scene.camera().is_moving(), self.are_moving) {
                (false, false) => no("the camera rests"),
                (true, false) => yes("the camera moves while the shutter is open"),
                (false, true) => yes("instances move while the shutter is open"),
                (true, true) => yes("camera and instances move while the shutter is open"),
            },
            Effect::Antialiasing => match options.samples_per_pixel {
                0 | 1 => no("one sample per pixel was asked for"),
                samples => yes(format!("{samples} samples per pixel were asked for")),
            },
            Effect::Textures => {
                self.by_images(scene, &self.textured, ["material with pictures", "materials with pictures"])
            }
            Effect::AlphaCutouts => {
                self.by_images(scene, &self.cut_out, ["material with holes", "materials with holes"])
            }
            Effect::BumpMaps => {
                self.by_images(scene, &self.bumped, ["material with bumps", "materials with bumps"])
            }
            Effect::FinishMaps => {
                let nouns = ["material whose finish varies", "materials whose finish varies"];
                self.by_images(scene, &self.varied, nouns)
            }
            Effect::Emission => match self.glowing.count {
                0 => no("no material glows"),
                _ => yes(self.glowing.describe("glowing material", "glowing materials")),
            },
            Effect::SmoothNormals => match (self.attributes.normals, self.shaded.count) {
                (false, _) => no("no triangle has normals at its corners"),
                (true, 0) => no("no material is lit, reflects or refracts"),
                (true, _) => yes(format!(
                    "the model has normals, on {}",
                    self.shaded.describe("material that shows them", "materials that show them")
                )),
            },
        }
    }

    /// An effect of pictures on the surfaces of a group.
    fn by_images(&self, scene: &Scene, group: &Group, [one, many]: [&str; 2]) -> Verdict {
        match (scene.textures(), self.attributes.uvs, group.count) {
            (None, ..) => no("the scene has no images"),
            (_, false, _) => no("no triangle has texture coordinates"),
            (_, _, 0) => no(format!("there are no {many}")),
            _ => yes(group.describe(one, many)),
        }
    }

    fn has_lighting_environment(&self, scene: &Scene) -> bool {
        self.lit.count > 0 && scene.environment().is_some_and(|environment| !environment.is_dark())
    }

    /// Whether there is any light to be passed on; that of glowing materials only if they glow.
    fn shines(&self, scene: &Scene, with_emission: bool) -> bool {
        let surroundings = match scene.environment() {
            Some(environment) => !environment.is_dark(),
            None => scene.background() != [0.0; 3],
        };
        surroundings
            || self.point_lights + self.area_lights > 0
            || with_emission && self.glowing.count > 0
            || scene.ambient() != [0.0; 3]
    }
}

/// Materials that share a trait: how many, and the first few names.
#[derive(Default)]
struct Group {
    count: usize,
    names: Vec<String>,
}

impl Group {
    const NAMES_MAX: usize = 3;
    /// Names come from the model file; a picture's report is no place for a megabyte of them.
    const NAME_CHARS_MAX: usize = 40;

    fn add(&mut self, member: bool, record: &MaterialRecord) {
        if member {
            self.count += 1;
            if self.names.len() < Self::NAMES_MAX {
                let name: String = record.name.chars().take(Self::NAME_CHARS_MAX).collect();
                self.names.push(if name.is_empty() { "the default material".to_string() } else { name });
            }
        }
    }

    fn describe(&self, one: &str, many: &str) -> String {
        let noun = if self.count == 1 { one } else { many };
        let more = if self.count > self.names.len() { ", ..." } else { "" };
        format!("{} {noun}: {}{more}", self.count, self.names.join(", "))
    }

    /// The verdict on an effect that rests on `basis`.
    fn calls_if(&self, needed: EffectSet, basis: Effect, [one, many]: [&str; 2]) -> Verdict {
        if self.count == 0 {
            no(format!("there is no {one}"))
        } else if !needed.contains(basis) {
            no(format!("there is no {}", basis.name()))
        } else {
            yes(self.describe(one, many))
        }
    }
}
