//! Which effects a scene calls for, and why.
//!
//! An effect that is not called for costs nothing (I6): its weights are zero in every [`Surface`], so no ray of it is
//! ever made and no block is loaded for it.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use super::{Scene, Surface};
use crate::model::{MaterialRecord, Model};

/// Something that light does, at the price of rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Effect {
    /// Lamps light diffuse surfaces and make highlights.
    DirectLight,
    /// One ray per point and lamp that asks what stands between.
    Shadows,
    /// Mirrors, and the reflected part of glass.
    Reflection,
    /// Light passes through surfaces: refracted, straight, and through shadows.
    Transmission,
    /// More than one sample per pixel.
    Antialiasing,
}

impl Effect {
    /// All effects.
    pub const ALL: [Effect; 5] = [
        Effect::DirectLight,
        Effect::Shadows,
        Effect::Reflection,
        Effect::Transmission,
        Effect::Antialiasing,
    ];

    /// The name used in reports.
    pub fn name(self) -> &'static str {
        match self {
            Effect::DirectLight => "direct light",
            Effect::Shadows => "shadows",
            Effect::Reflection => "reflection",
            Effect::Transmission => "transmission",
            Effect::Antialiasing => "antialiasing",
        }
    }
}

/// A set of effects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EffectSet(u8);

impl EffectSet {
    /// No effect.
    pub const EMPTY: EffectSet = EffectSet(0);
    /// Every effect.
    pub const ALL: EffectSet = EffectSet((1 << Effect::ALL.len()) - 1);

    /// This set and `effect`.
    #[must_use]
    pub const fn with(self, effect: Effect) -> EffectSet {
        EffectSet(self.0 | 1 << effect as u8)
    }

    /// Whether `effect` is in the set.
    pub const fn contains(self, effect: Effect) -> bool {
        self.0 >> effect as u8 & 1 == 1
    }
}

impl FromIterator<Effect> for EffectSet {
    fn from_iter<I: IntoIterator<Item = Effect>>(effects: I) -> EffectSet {
        effects.into_iter().fold(EffectSet::EMPTY, EffectSet::with)
    }
}

/// What the caller wants beside what the scene calls for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EffectOptions {
    /// Samples per pixel; above 1 calls for antialiasing.
    pub samples_per_pixel: u32,
    /// Left out even if the scene calls for it. The picture changes. ([`Effect::Antialiasing`] is left out by
    /// asking for one sample.)
    pub switched_off: EffectSet,
    /// Traced even if the scene has no use for it, and multiplied by zero: the picture does not change by a bit. For
    /// tests and for measuring what the plan saves.
    pub forced: EffectSet,
}

impl Default for EffectOptions {
    fn default() -> EffectOptions {
        EffectOptions { samples_per_pixel: 1, switched_off: EffectSet::EMPTY, forced: EffectSet::EMPTY }
    }
}

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

/// The effects that a scene calls for, each with its reason, and those that it does not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EffectPlan {
    /// In the order of [`Effect::ALL`].
    decisions: Vec<EffectDecision>,
    needed: EffectSet,
    forced: EffectSet,
}

impl EffectPlan {
    /// Looks at the lights of `scene`, at the materials that blocks of `model` use, and at `options`.
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
        EffectPlan::of_materials(scene, used, options)
    }

    /// [`EffectPlan::scan`] for a list of materials that are all in use.
    pub fn of_materials<'m>(
        scene: &Scene,
        materials: impl IntoIterator<Item = &'m MaterialRecord>,
        options: &EffectOptions,
    ) -> EffectPlan {
        let mut lit = Group::default();
        let mut mirrors = Group::default();
        let mut glass = Group::default();
        let mut transparent = Group::default();
        for record in materials {
            let surface = Surface::from_record(record);
            lit.add(surface.is_lit(), record);
            mirrors.add(surface.is_mirror(), record);
            glass.add(surface.refracts(), record);
            transparent.add(surface.is_transparent(), record);
        }
        let lamps = scene.lights().iter().filter(|light| !light.is_dark()).count();
        let lamps_text = if lamps == 1 { "1 light".to_string() } else { format!("{lamps} lights") };

        let direct = if lamps == 0 {
            (false, "the scene has no light that shines".to_string())
        } else if lit.count == 0 {
            (false, "no material is diffuse or has a highlight".to_string())
        } else {
            (true, format!("{lamps_text} on {}", lit.describe("lit material", "lit materials")))
        };
        let shadows = if direct.0 {
            (true, format!("{lamps_text} may be hidden"))
        } else {
            (false, "there is no direct light".to_string())
        };
        // Without transmission nothing refracts, so glass alone calls for no reflection either.
        let glass_reflects = glass.count > 0 && !options.switched_off.contains(Effect::Transmission);
        let reflection = match (mirrors.count > 0, glass_reflects) {
            (true, true) => (
                true,
                format!(
                    "{}; {} by Fresnel",
                    mirrors.describe("mirror", "mirrors"),
                    glass.describe("glass", "glasses")
                ),
            ),
            (true, false) => (true, mirrors.describe("mirror", "mirrors")),
            (false, true) => (true, format!("{} by Fresnel", glass.describe("glass", "glasses"))),
            (false, false) => (false, "no material is a mirror or refracts".to_string()),
        };
        let transmission = if transparent.count > 0 {
            (true, transparent.describe("transparent material", "transparent materials"))
        } else {
            (false, "every material is opaque".to_string())
        };
        let samples = options.samples_per_pixel;
        let antialiasing = if samples > 1 {
            (true, format!("{samples} samples per pixel were asked for"))
        } else {
            (false, "one sample per pixel was asked for".to_string())
        };

        let mut needed = EffectSet::EMPTY;
        let decisions = Effect::ALL
            .into_iter()
            .zip([direct, shadows, reflection, transmission, antialiasing])
            .map(|(effect, (called_for, reason))| {
                let off = options.switched_off.contains(effect) && effect != Effect::Antialiasing;
                // Shadows of light that is switched off are not called for either.
                let off =
                    off || (effect == Effect::Shadows && options.switched_off.contains(Effect::DirectLight));
                let reason = if called_for && off { format!("switched off ({reason})") } else { reason };
                let is_needed = called_for && !off;
                if is_needed {
                    needed = needed.with(effect);
                }
                EffectDecision { effect, needed: is_needed, reason }
            })
            .collect();
        EffectPlan { decisions, needed, forced: options.forced }
    }

    /// Whether the scene calls for `effect`.
    pub fn has(&self, effect: Effect) -> bool {
        self.needed.contains(effect)
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

    /// The shading terms of a material with all that belongs to effects outside the plan removed.
    pub fn surface(&self, record: &MaterialRecord) -> Surface {
        let mut surface = Surface::from_record(record);
        if !self.has(Effect::DirectLight) {
            surface.highlight = [0.0; 3];
        }
        if !self.has(Effect::Reflection) {
            surface.mirror = [0.0; 3];
        }
        if !self.has(Effect::Transmission) {
            surface.transmission = 0.0;
        }
        surface
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Camera, Light};

    fn scene() -> Scene {
        Scene::new(Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap())
    }

    fn lamp() -> Light {
        Light::directional([0.0, -1.0, 0.0], [1.0; 3])
    }

    fn material(name: &str) -> MaterialRecord {
        MaterialRecord { name: name.to_string(), ..MaterialRecord::default() }
    }

    #[test]
    fn each_effect_has_its_cause() {
        let matt = material("brick");
        let mirror = MaterialRecord { specular: [0.9; 3], mirror: true, ..material("chrome") };
        let glass = MaterialRecord { opacity: 0.2, refractive_index: 1.5, ..material("glass") };
        let veil = MaterialRecord { opacity: 0.5, ..material("veil") };
        let options = EffectOptions::default();
        let has = |scene: &Scene, materials: &[&MaterialRecord], options: &EffectOptions| {
            let plan = EffectPlan::of_materials(scene, materials.iter().copied(), options);
            Effect::ALL.map(|effect| plan.has(effect))
        };
        let lit = scene().with_light(lamp());
        assert_eq!(has(&scene(), &[&matt], &options), [false; 5]);
        assert_eq!(has(&lit, &[&matt], &options), [true, true, false, false, false]);
        assert_eq!(has(&lit, &[&matt, &mirror], &options), [true, true, true, false, false]);
        assert_eq!(has(&scene(), &[&glass], &options), [false, false, true, true, false]);
        assert_eq!(has(&scene(), &[&veil], &options), [false, false, false, true, false]);
        let black_lamp = scene().with_light(Light::directional([0.0, 1.0, 0.0], [0.0; 3]));
        assert_eq!(has(&black_lamp, &[&matt], &options), [false; 5]);
        let many = EffectOptions { samples_per_pixel: 4, ..options };
        assert_eq!(has(&scene(), &[&matt], &many), [false, false, false, false, true]);
        let no_glass = EffectOptions { switched_off: EffectSet::EMPTY.with(Effect::Transmission), ..options };
        assert_eq!(has(&scene(), &[&glass], &no_glass), [false; 5]);
        let no_light = EffectOptions { switched_off: EffectSet::EMPTY.with(Effect::DirectLight), ..options };
        assert_eq!(has(&lit, &[&matt], &no_light), [false; 5]);
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
    fn sets() {
        assert!(Effect::ALL.iter().all(|effect| EffectSet::ALL.contains(*effect)));
        assert_eq!(Effect::ALL.into_iter().collect::<EffectSet>(), EffectSet::ALL);
        assert!(!EffectSet::EMPTY.with(Effect::Shadows).contains(Effect::Reflection));
    }
}
