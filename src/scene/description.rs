//! A scene: everything about a picture but its geometry and its size.

use serde::{Deserialize, Serialize};

use super::{Camera, Light};
use crate::error::RenderError;
use crate::geom::Aabb;

/// Camera, lights and what is seen where nothing is hit. Materials come from the compiled model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    camera: Camera,
    lights: Vec<Light>,
    background: [f32; 3],
    ambient: [f32; 3],
}

impl Scene {
    /// A scene without lights before a black background.
    pub fn new(camera: Camera) -> Scene {
        Scene { camera, lights: Vec::new(), background: [0.0; 3], ambient: [0.0; 3] }
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

    /// Sets the linear RGB radiance of rays that hit nothing.
    #[must_use]
    pub fn with_background(mut self, radiance: [f32; 3]) -> Scene {
        self.background = radiance;
        self
    }

    /// Sets a constant light that every diffuse surface receives, shadowed or not, in the unit of
    /// [`Light::intensity`].
    #[must_use]
    pub fn with_ambient(mut self, irradiance: [f32; 3]) -> Scene {
        self.ambient = irradiance;
        self
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The lights, in the order in which their light is summed.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }

    /// Linear RGB radiance of rays that hit nothing.
    pub fn background(&self) -> [f32; 3] {
        self.background
    }

    /// The constant light on diffuse surfaces.
    pub fn ambient(&self) -> [f32; 3] {
        self.ambient
    }

    /// Checks what construction did not.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a light that [`Light::validate`] refuses, or a background or ambient colour
    /// that is negative or not finite.
    pub fn validate(&self) -> Result<(), RenderError> {
        self.lights.iter().try_for_each(Light::validate)?;
        for (what, colour) in [("background", self.background), ("ambient light", self.ambient)] {
            if colour.iter().any(|channel| !(*channel >= 0.0 && channel.is_finite())) {
                let reason = "each channel must be finite and not negative".to_string();
                return Err(RenderError::Setting { what, reason });
            }
        }
        Ok(())
    }
}
