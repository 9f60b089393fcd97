//! What is to be pictured: camera, lights, shading terms of the materials, and the [`EffectPlan`] that says which
//! effects a scene calls for.
//!
//! Geometry is not here: it stays in the compiled file. Everything in a [`Scene`] is small and plain data.

mod camera;
mod description;
mod effects;
mod light;
mod surface;

pub use camera::{Camera, Projection, View};
pub use description::Scene;
pub use effects::{Effect, EffectDecision, EffectOptions, EffectPlan, EffectSet};
pub(crate) use light::Emitter;
pub use light::{Falloff, Light};
pub use surface::Surface;
