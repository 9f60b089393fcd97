//! A scene: everything about a picture but its geometry and its size.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Camera, Effect, EffectSet, Environment, Finish, Light};
use crate::error::RenderError;
use crate::geom::Aabb;
use crate::model::MaterialRecord;
use crate::texture::{Encoding, Textures};

/// Camera, lights and what is seen where nothing is hit. Materials come from the compiled model; a scene may add a
/// [`Finish`] to them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    camera: Camera,
    lights: Vec<Light>,
    background: [f32; 3],
    ambient: [f32; 3],
    environment: Option<Environment>,
    interreflection: bool,
    finishes: Vec<(String, Finish)>,
    #[serde(skip)]
    textures: Option<Arc<Textures>>,
}

impl Scene {
    /// A scene without lights before a black background.
    pub fn new(camera: Camera) -> Scene {
        Scene {
            camera,
            lights: Vec::new(),
            background: [0.0; 3],
            ambient: [0.0; 3],
            environment: None,
            interreflection: false,
            finishes: Vec::new(),
            textures: None,
        }
    }

    /// A scene that shows a model inside `bounds` in a picture of `aspect` = width / height without further
    /// choices: [`Camera::framing`], [`Light::automatic`], a pale background and a little ambient light.
    pub fn automatic(bounds: &Aabb, aspect: f64) -> Scene {
        Scene::new(Camera::framing(bounds, aspect)).with_automatic_lights()
    }

    /// Adds the lights, background and ambient light of [`Scene::automatic`].
    #[must_use]
    pub fn with_automatic_lights(mut self) -> Scene {
        self.lights.extend(Light::automatic(&self.camera));
        self.with_background([0.70, 0.78, 0.86]).with_ambient([0.08, 0.085, 0.09])
    }

    /// Puts another camera in the place of the first.
    #[must_use]
    pub fn with_camera(mut self, camera: Camera) -> Scene {
        self.camera = camera;
        self
    }

    /// Adds a light.
    #[must_use]
    pub fn with_light(mut self, light: Light) -> Scene {
        self.lights.push(light);
        self
    }

    /// Adds lights.
    #[must_use]
    pub fn with_lights(mut self, lights: impl IntoIterator<Item = Light>) -> Scene {
        self.lights.extend(lights);
        self
    }

    /// Sets the linear RGB radiance of rays that hit nothing. It lights nothing but through such rays:
    /// [`Scene::with_environment`] does.
    #[must_use]
    pub fn with_background(mut self, radiance: [f32; 3]) -> Scene {
        self.background = radiance;
        self
    }

    /// Sets a constant light that every diffuse surface receives, shadowed or not, in the unit of
    /// [`Light::intensity`]: a stand-in for interreflection.
    #[must_use]
    pub fn with_ambient(mut self, irradiance: [f32; 3]) -> Scene {
        self.ambient = irradiance;
        self
    }

    /// Sets surroundings that light the scene and are seen in place of the background.
    #[must_use]
    pub fn with_environment(mut self, environment: Environment) -> Scene {
        self.environment = Some(environment);
        self
    }

    /// Asks for diffuse interreflection: light that comes to a matt surface from other surfaces and, without an environment,
    /// from the background. No surface then sends on more than it gets: where diffuse reflectance, mirror and transmission of a
    /// material add up to more than 1, the diffuse part is made smaller.
    #[must_use]
    pub fn with_interreflection(mut self) -> Scene {
        self.interreflection = true;
        self
    }

    /// Adds a finish to the materials named `material`. Of two for the same name the later counts.
    #[must_use]
    pub fn with_finish(mut self, material: impl Into<String>, finish: Finish) -> Scene {
        self.finishes.push((material.into(), finish));
        self
    }

    /// Sets the pictures that materials name ([`Textures::open`]). They do not travel: a scene with pictures cannot be rendered by the
    /// workers of a cluster, which say so.
    #[must_use]
    pub fn with_textures(mut self, textures: Arc<Textures>) -> Scene {
        self.textures = Some(textures);
        self
    }

    /// The pictures that materials name.
    pub fn textures(&self) -> Option<&Arc<Textures>> {
        self.textures.as_ref()
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The lights, in the order in which their light is summed: those without extent, then the others.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }

    /// Linear RGB radiance of rays that hit nothing, unless there is an environment.
    pub fn background(&self) -> [f32; 3] {
        self.background
    }

    /// The constant light on diffuse surfaces.
    pub fn ambient(&self) -> [f32; 3] {
        self.ambient
    }

    /// The surroundings, if they light the scene.
    pub fn environment(&self) -> Option<&Environment> {
        self.environment.as_ref()
    }

    /// Whether diffuse interreflection was asked for.
    pub fn has_interreflection(&self) -> bool {
        self.interreflection
    }

    /// The finish of a material.
    pub fn finish(&self, record: &MaterialRecord) -> Finish {
        let found = self.finishes.iter().rev().find(|(name, _)| *name == record.name);
        found.map_or(Finish::default(), |(_, finish)| *finish)
    }

    /// Checks what construction did not.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a light, an environment or a finish that its own `validate` refuses, or a
    /// background or ambient colour that is negative or not finite.
    pub fn validate(&self) -> Result<(), RenderError> {
        self.lights.iter().try_for_each(Light::validate)?;
        self.environment.iter().try_for_each(Environment::validate)?;
        self.finishes.iter().try_for_each(|(_, finish)| finish.validate())?;
        for (what, colour) in [("background", self.background), ("ambient light", self.ambient)] {
            if colour.iter().any(|channel| !(*channel >= 0.0 && channel.is_finite())) {
                let reason = "each channel must be finite and not negative".to_string();
                return Err(RenderError::Setting { what, reason });
            }
        }
        Ok(())
    }

    /// Checks that the pictures of `materials` are there, those of effects in `switched_off` apart.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a picture that is not.
    pub fn validate_textures(
        &self,
        materials: &[MaterialRecord],
        switched_off: EffectSet,
    ) -> Result<(), RenderError> {
        let is_on = |effect| !switched_off.contains(effect);
        for record in materials {
            let Some(images) = record.images.as_deref() else { continue };
            let colors = is_on(Effect::Textures) || is_on(Effect::AlphaCutouts);
            let maps = [
                (&images.diffuse, Encoding::Srgb, colors),
                (&images.specular, Encoding::Srgb, is_on(Effect::Textures)),
                (&images.opacity, Encoding::Linear, is_on(Effect::AlphaCutouts)),
                (&images.bump, Encoding::Linear, is_on(Effect::BumpMaps)),
                (&images.normal, Encoding::Linear, is_on(Effect::BumpMaps)),
                (&images.emission, Encoding::Srgb, is_on(Effect::Textures) && is_on(Effect::Emission)),
                (&images.roughness, Encoding::Linear, is_on(Effect::FinishMaps)),
                (&images.metalness, Encoding::Linear, is_on(Effect::FinishMaps)),
            ];
            for (map, encoding, is_wanted) in maps {
                let Some(map) = map.as_ref().filter(|_| is_wanted) else { continue };
                let found = self.textures.as_ref().and_then(|textures| textures.find(&map.path, encoding));
                if found.is_none() {
                    let reason = format!(
                        "the material {:?} names the image {:?}, which is not open: give the scene the model's images \
                         (`Textures::open`, `Scene::with_textures`) or switch the effects of images off",
                        record.name, map.path
                    );
                    return Err(RenderError::Setting { what: "textures", reason });
                }
            }
        }
        Ok(())
    }

    /// Checks that every finish has its material.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a finish of a material that is not among `materials`.
    pub fn validate_finishes(&self, materials: &[MaterialRecord]) -> Result<(), RenderError> {
        for (name, _) in &self.finishes {
            if !materials.iter().any(|record| record.name == *name) {
                let reason = format!("the model has no material named {name:?}");
                return Err(RenderError::Setting { what: "finish", reason });
            }
        }
        Ok(())
    }
}
