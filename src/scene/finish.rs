//! What a scene adds to a material that the model file's terms cannot say.

use serde::{Deserialize, Serialize};

use crate::error::RenderError;

/// A finish for the material of a certain name: roughness and rank among nested media.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Finish {
    /// 0 is smooth: mirrors and glass as the model says. Up to 1, reflection and refraction are blurred by microfacets of the
    /// GGX distribution with `alpha = roughness^2`.
    pub roughness: f32,
    /// Rank of a transparent material where bodies overlap: a body of higher priority displaces those of lower. Bodies whose
    /// surfaces coincide (water in a glass) become one border. Without any priority in the scene each surface refracts
    /// against air, as if bodies never touched.
    pub priority: Option<u8>,
}

impl Finish {
    /// Rough, without a priority.
    pub fn rough(roughness: f32) -> Finish {
        Finish { roughness, priority: None }
    }

    /// Smooth, with a priority.
    pub fn nested(priority: u8) -> Finish {
        Finish { roughness: 0.0, priority: Some(priority) }
    }

    /// Says what is wrong with the finish, if anything is.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if the roughness is not in 0 ..= 1.
    pub fn validate(&self) -> Result<(), RenderError> {
        if (0.0..=1.0).contains(&self.roughness) {
            return Ok(());
        }
        let reason = format!("a roughness of {} is not between 0 and 1", self.roughness);
        Err(RenderError::Setting { what: "finish", reason })
    }

    /// GGX's alpha; 0 if the surface is smooth.
    pub(super) fn alpha(&self) -> f64 {
        /// Below this a lobe is as good as a mirror, and its peak too high for sums of f64.
        const ALPHA_MIN: f64 = 1e-3;
        let roughness = f64::from(self.roughness);
        if roughness > 0.0 { (roughness * roughness).max(ALPHA_MIN) } else { 0.0 }
    }
}
