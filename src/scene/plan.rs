//! Which effects a scene calls for, and why.
//!
//! An effect that is not called for costs nothing (I6): its weights are zero in every [`Surface`], so no ray of it is
//! ever made and no block is loaded for it.

use std::fmt::Write as _;

use smallvec::SmallVec;

use super::effect::{Effect, EffectOptions, EffectSet};
use super::mixture::{Mixture, Simulated, Terms, Variation};
use super::scan::{self, Verdict};
use super::{Scene, Surface};
use crate::model::{MaterialRecord, Model};

/// The verdict on one effect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EffectDecision {
    /// Which effect.
    pub effect: Effect,
    /// Whether it is simulated.
    pub needed: bool,
    /// Why, or why not.
    pub reason: String,
}

/// Which attributes the corners of any triangles have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AttributeKinds {
    /// Texture coordinates.
    pub uvs: bool,
    /// Normals.
    pub normals: bool,
}

/// The effects that a scene calls for, each with its reason, and those that it does not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EffectPlan {
    /// In the order of [`Effect::ALL`].
    decisions: Vec<EffectDecision>,
    needed: EffectSet,
    forced: EffectSet,
    switched_off: EffectSet,
}

impl EffectPlan {
    /// Looks at camera, lights and surroundings of `scene`, at the materials that blocks of `model` use, and at `options`.
    ///
    /// A material counts as used if a block's material range holds it, so no block is read.
    pub fn scan(scene: &Scene, model: &Model, options: &EffectOptions) -> EffectPlan {
        let mut used = vec![false; model.materials.len()];
        for range in model.material_ranges() {
            let [low, high] = range.map(usize::from);
            let end = used.len().min(high + 1);
            used[low.min(end)..end].fill(true);
        }
        let used = model.materials.iter().zip(used).filter(|(_, used)| *used).map(|(record, _)| record);
        let attributes =
            AttributeKinds { uvs: model.attributes.have_uvs(), normals: model.attributes.have_normals() };
        EffectPlan::of_parts(scene, used, attributes, options)
    }

    /// [`EffectPlan::scan`] for a list of materials that are all in use, and triangles without attributes.
    pub fn of_materials<'m>(
        scene: &Scene,
        materials: impl IntoIterator<Item = &'m MaterialRecord>,
        options: &EffectOptions,
    ) -> EffectPlan {
        EffectPlan::of_parts(scene, materials, AttributeKinds::default(), options)
    }

    /// [`EffectPlan::scan`] for a list of materials that are all in use, and what the triangles have beside their place.
    pub fn of_parts<'m>(
        scene: &Scene,
        materials: impl IntoIterator<Item = &'m MaterialRecord>,
        attributes: AttributeKinds,
        options: &EffectOptions,
    ) -> EffectPlan {
        EffectPlan::of_surfaces(scene, materials, attributes, false, options)
    }

    /// [`EffectPlan::of_parts`], where surfaces may move while the shutter is open.
    pub(crate) fn of_surfaces<'m>(
        scene: &Scene,
        materials: impl IntoIterator<Item = &'m MaterialRecord>,
        attributes: AttributeKinds,
        are_moving: bool,
        options: &EffectOptions,
    ) -> EffectPlan {
        let traits = scan::Traits::of(scene, materials, attributes, are_moving, options);
        let mut needed = EffectSet::EMPTY;
        let mut decisions = Vec::with_capacity(Effect::ALL.len());
        // What an effect rests on comes before it, so that one left out takes those that rest on it along.
        for effect in Effect::ALL {
            let Verdict { called_for, reason } = traits.verdict(effect, scene, needed, options);
            let off = options.switched_off.contains(effect) && effect != Effect::Antialiasing;
            let is_needed = called_for && !off;
            if is_needed {
                needed = needed.with(effect);
            }
            let reason = if called_for && off { format!("switched off ({reason})") } else { reason };
            decisions.push(EffectDecision { effect, needed: is_needed, reason });
        }
        EffectPlan { decisions, needed, forced: options.forced, switched_off: options.switched_off }
    }

    /// Whether the scene calls for `effect`.
    pub fn has(&self, effect: Effect) -> bool {
        self.needed.contains(effect)
    }

    /// The effects that the scene calls for.
    pub fn needed(&self) -> EffectSet {
        self.needed
    }

    /// Whether any effect chooses its rays by luck, beside where in the pixel, on the lens and in time a sample begins.
    pub fn has_sampled_effects(&self) -> bool {
        let sampled = [
            Effect::AreaLight,
            Effect::EnvironmentLight,
            Effect::GlossyReflection,
            Effect::RoughRefraction,
            Effect::Interreflection,
        ];
        sampled.into_iter().any(|effect| self.has(effect))
    }

    /// Whether rays of `effect` are traced even where they cannot matter.
    pub fn forces(&self, effect: Effect) -> bool {
        self.forced.contains(effect)
    }

    /// One verdict per effect, in the order of [`Effect::ALL`].
    pub fn decisions(&self) -> &[EffectDecision] {
        &self.decisions
    }

    /// The plan in words, one line per effect: those simulated first, then those not needed.
    pub fn explain(&self) -> String {
        let mut text = String::new();
        for (needed, title) in [(true, "simulated"), (false, "not needed")] {
            for decision in self.decisions.iter().filter(|decision| decision.needed == needed) {
                let forced = if self.forces(decision.effect) && !needed { " (forced)" } else { "" };
                // Writing to a String cannot fail.
                let _ = writeln!(text, "{title}: {}{forced}: {}", decision.effect.name(), decision.reason);
            }
        }
        text
    }

    /// The shading terms of a material of `scene` with all that belongs to effects outside the plan removed, where no picture changes them.
    pub fn surface(&self, scene: &Scene, record: &MaterialRecord) -> Surface {
        let mixture = self.mixture(scene, record);
        self.of_terms(scene, record, &mixture.at(&mixture.factors()))
    }

    /// The terms at the ends of what pictures of roughness and metalness can make of a material: see [`Mixture::ends`]. Those of
    /// [`EffectPlan::surface`] alone if there are none.
    pub(crate) fn ends(&self, scene: &Scene, record: &MaterialRecord) -> SmallVec<[Surface; 4]> {
        let ends = self.mixture(scene, record).ends(self.variation(scene, record));
        ends.iter().map(|terms| self.of_terms(scene, record, terms)).collect()
    }

    /// What pictures of roughness and metalness make of a material.
    pub(crate) fn variation(&self, scene: &Scene, record: &MaterialRecord) -> Variation {
        match scene.textures().filter(|_| self.has(Effect::FinishMaps)) {
            Some(textures) => Variation::of(record, &scene.finish(record), &self.simulated(), textures),
            None => Variation::default(),
        }
    }

    /// What a material is made of, less what belongs to effects outside the plan.
    pub(crate) fn mixture(&self, scene: &Scene, record: &MaterialRecord) -> Mixture {
        Mixture::new(record, &scene.finish(record)).simulated(&self.simulated())
    }

    fn simulated(&self) -> Simulated {
        let lights = [Effect::DirectLight, Effect::AreaLight, Effect::EnvironmentLight];
        Simulated {
            highlights: lights.into_iter().any(|effect| self.has(effect)),
            reflection: self.has(Effect::Reflection),
            transmission: self.has(Effect::Transmission),
            // One that is not needed takes nothing from the other: see `Mixture`.
            glossy: !self.switched_off.contains(Effect::GlossyReflection),
            frosted: !self.switched_off.contains(Effect::RoughRefraction),
            keeps_energy: self.has(Effect::Interreflection),
        }
    }

    fn of_terms(&self, scene: &Scene, record: &MaterialRecord, terms: &Terms) -> Surface {
        let mut surface = Surface::of_terms(record, &scene.finish(record), terms);
        if !self.has(Effect::Emission) {
            surface.emission = [0.0; 3];
        }
        if !self.has(Effect::Absorption) {
            surface.absorption = [0.0; 3];
        }
        surface
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Camera, Environment, Finish, Lens, Light, LightShape};
    use Effect::*;

    fn camera() -> Camera {
        Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap()
    }

    fn scene() -> Scene {
        Scene::new(camera())
    }

    fn lamp() -> Light {
        Light::directional([0.0, -1.0, 0.0], [1.0; 3])
    }

    fn panel(radiance: f32) -> Light {
        Light::area(LightShape::Sphere { center: [0.0, 3.0, 0.0], radius: 0.5 }, [radiance; 3])
    }

    fn material(name: &str) -> MaterialRecord {
        MaterialRecord { name: name.to_string(), ..MaterialRecord::default() }
    }

    fn chrome() -> MaterialRecord {
        MaterialRecord { specular: [0.9; 3], mirror: true, ..material("chrome") }
    }

    fn glass() -> MaterialRecord {
        MaterialRecord { opacity: 0.2, refractive_index: 1.5, ..material("glass") }
    }

    #[track_caller]
    fn check(scene: &Scene, materials: &[MaterialRecord], options: &EffectOptions, expected: &[Effect]) {
        let plan = EffectPlan::of_materials(scene, materials, options);
        let expected: EffectSet = expected.iter().copied().collect();
        assert_eq!(plan.needed(), expected, "{}", plan.explain());
        for effect in Effect::ALL {
            assert_eq!(plan.has(effect), expected.contains(effect));
        }
    }

    #[test]
    fn each_effect_has_its_cause() {
        let matt = material("brick");
        let veil = MaterialRecord { opacity: 0.5, ..material("veil") };
        let options = EffectOptions::default();
        let lit = scene().with_light(lamp());
        check(&scene(), std::slice::from_ref(&matt), &options, &[]);
        check(&lit, std::slice::from_ref(&matt), &options, &[DirectLight, Shadows]);
        check(&lit, &[matt.clone(), chrome()], &options, &[DirectLight, Shadows, Reflection]);
        check(&scene(), &[glass()], &options, &[Reflection, Transmission]);
        check(&scene(), std::slice::from_ref(&veil), &options, &[Transmission]);
        let black_lamp = scene().with_light(Light::directional([0.0, 1.0, 0.0], [0.0; 3]));
        check(&black_lamp, std::slice::from_ref(&matt), &options, &[]);
        let many = EffectOptions { samples_per_pixel: 4, ..options };
        check(&scene(), std::slice::from_ref(&matt), &many, &[Antialiasing]);
        let off = |effect| EffectOptions { switched_off: EffectSet::EMPTY.with(effect), ..options };
        check(&scene(), &[glass()], &off(Transmission), &[]);
        check(&lit, std::slice::from_ref(&matt), &off(DirectLight), &[]);
        check(&lit, &[matt], &off(Shadows), &[DirectLight]);
        let smoke = MaterialRecord { transmission: [0.5; 3], ..veil };
        check(&scene(), std::slice::from_ref(&smoke), &options, &[Transmission, Absorption]);
        check(&scene(), &[smoke], &off(Transmission), &[]);
        let lamp = MaterialRecord { emission: [0.0, 2.0, 0.0], ..material("lamp") };
        check(&scene(), std::slice::from_ref(&lamp), &options, &[Emission]);
        check(&scene(), std::slice::from_ref(&lamp), &off(Emission), &[]);
        // Its light is what there is to be passed on.
        let bounced = scene().with_interreflection();
        check(&bounced, std::slice::from_ref(&lamp), &options, &[Emission, Interreflection]);
        check(&bounced, &[lamp], &off(Emission), &[]);
    }

    #[test]
    fn sampled_effects_have_their_causes() {
        let options = EffectOptions::default();
        let matt = [material("brick")];
        check(&scene().with_light(panel(1.0)), &matt, &options, &[Shadows, AreaLight]);
        check(&scene().with_light(panel(0.0)), &matt, &options, &[]);
        let black = [MaterialRecord { diffuse: [0.0; 3], ..material("soot") }];
        // Seen, but nothing is lit by it.
        check(&scene().with_light(panel(1.0)), &black, &options, &[AreaLight]);
        let sky = |radiance| scene().with_environment(Environment::Constant([radiance; 3]));
        check(&sky(1.0), &matt, &options, &[Shadows, EnvironmentLight]);
        check(&sky(0.0), &matt, &options, &[]);
        check(&sky(1.0), &black, &options, &[]);
        let bounced = scene().with_background([1.0; 3]).with_interreflection();
        check(&bounced, &matt, &options, &[Interreflection]);
        check(&bounced, &black, &options, &[]);
        check(&scene().with_interreflection(), &matt, &options, &[]);
        let rough =
            scene().with_finish("chrome", Finish::rough(0.3)).with_finish("glass", Finish::rough(0.2));
        check(&rough, &[chrome()], &options, &[Reflection, GlossyReflection]);
        check(&rough, &[glass()], &options, &[Reflection, Transmission, RoughRefraction]);
        check(&rough, &matt, &options, &[]);
        let nested = scene().with_finish("glass", Finish::nested(2));
        check(&nested, &[glass()], &options, &[Reflection, Transmission]);
        let water = MaterialRecord { opacity: 0.0, refractive_index: 1.33, ..material("water") };
        check(&nested, &[glass(), water], &options, &[Reflection, Transmission, NestedMedia]);
        let lens = Lens { radius: 0.1, focus_distance: 3.0 };
        check(&Scene::new(camera().with_lens(lens).unwrap()), &matt, &options, &[DepthOfField]);
        let closed = Lens { radius: 0.0, ..lens };
        check(&Scene::new(camera().with_lens(closed).unwrap()), &matt, &options, &[]);
        let end = Camera::pinhole([0.1, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap();
        check(&Scene::new(camera().moving_to(&end).unwrap()), &matt, &options, &[MotionBlur]);
        check(&Scene::new(camera().moving_to(&camera()).unwrap()), &matt, &options, &[]);
    }

    #[test]
    fn the_plan_explains_itself() {
        let names: Vec<_> =
            (0..5).map(|i| MaterialRecord { opacity: 0.5, ..material(&format!("m{i}")) }).collect();
        let lit = scene().with_light(lamp());
        let plan = EffectPlan::of_materials(&lit, &names, &EffectOptions::default());
        let text = plan.explain();
        assert_eq!(text.lines().count(), Effect::ALL.len());
        assert!(text.contains("simulated: transmission: 5 transparent materials: m0, m1, m2, ..."), "{text}");
        assert!(text.contains("not needed: antialiasing: one sample per pixel was asked for"), "{text}");
        assert_eq!(plan.decisions().len(), Effect::ALL.len());
    }

    #[test]
    fn surfaces_lose_what_the_plan_leaves_out() {
        let rough = scene().with_finish("chrome", Finish::rough(0.5)).with_background([1.0; 3]);
        let options = EffectOptions::default();
        let alpha = |scene: &Scene, options: &EffectOptions| {
            EffectPlan::of_materials(scene, &[chrome()], options).surface(scene, &chrome()).alpha
        };
        assert_eq!(alpha(&rough, &options), 0.25);
        let off = EffectOptions { switched_off: EffectSet::EMPTY.with(GlossyReflection), ..options };
        assert_eq!(alpha(&rough, &off), 0.0);
        let lamp = MaterialRecord { emission: [3.0; 3], ..material("lamp") };
        let emission = |options: &EffectOptions| {
            let plan = EffectPlan::of_materials(&rough, std::slice::from_ref(&lamp), options);
            plan.surface(&rough, &lamp).emission
        };
        assert_eq!(emission(&options), [3.0; 3]);
        let dark = EffectOptions { switched_off: EffectSet::EMPTY.with(Emission), ..options };
        assert_eq!(emission(&dark), [0.0; 3]);
        // With interreflection 0.7 + 0.9 is too much.
        let bounced = rough.with_interreflection();
        let plan = EffectPlan::of_materials(&bounced, &[chrome()], &options);
        let surface = plan.surface(&bounced, &chrome());
        assert!((surface.diffuse[0] - 0.1).abs() < 1e-7 && surface.mirror[0] > 0.89);
    }
}
