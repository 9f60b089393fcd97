//! What is to be pictured: camera, lights, shading terms of the materials, and the [`EffectPlan`] that says which
//! effects a scene calls for.
//!
//! Geometry is not here: it stays in the compiled file. Everything in a [`Scene`] but the picture of an
//! [`Environment`] is small and plain data. Each effect has a file of its own: `lens`, `motion`, `area_light`,
//! `environment`, `finish`.

mod area_light;
mod camera;
mod description;
mod effect;
mod environment;
mod finish;
#[cfg(feature = "gltf")]
mod gltf;
mod lens;
mod light;
mod mixture;
mod motion;
mod plan;
mod scan;
mod sphere;
mod surface;

pub(crate) use area_light::AreaEmitter;
pub use area_light::LightShape;
pub use camera::{Camera, Projection, View};
pub use description::Scene;
pub use effect::{Effect, EffectOptions, EffectSet};
pub(crate) use environment::EnvironmentEmitter;
pub use environment::{Environment, EnvironmentImage};
pub use finish::Finish;
#[cfg(feature = "gltf")]
pub use gltf::GltfView;
pub use lens::Lens;
pub(crate) use light::Emitter;
pub use light::{Falloff, Light};
pub(crate) use mixture::{Look, METALNESS_CHANNEL, Mixture, ROUGHNESS_CHANNEL, Terms, Variation};
pub use plan::{AttributeKinds, EffectDecision, EffectPlan};
pub(crate) use sphere::{cosine_direction, frame_around, to_frame};
pub use surface::Surface;
