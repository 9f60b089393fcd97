//! What a scene adds to a material that the model file's terms cannot say.

use serde::{Deserialize, Serialize};

use crate::error::RenderError;
use crate::model::MaterialRecord;

/// A finish for the material of a certain name: roughness, instead of the model's, and rank among nested media.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Finish {
    /// 0 is smooth. Up to 1, reflection and refraction are blurred by microfacets of the GGX distribution with
    /// `alpha = roughness^2`. Without it the material has the roughness of its record ([`MaterialRecord::roughness`]) and of its
    /// picture; with it none of them counts.
    pub roughness: Option<f32>,
    /// Rank of a transparent material where bodies overlap: a body of higher priority displaces those of lower. Bodies whose
    /// surfaces coincide (water in a glass) become one border. Without any priority in the scene each surface refracts
    /// against air, as if bodies never touched.
    pub priority: Option<u8>,
}

impl Finish {
    /// Rough, without a priority.
    pub fn rough(roughness: f32) -> Finish {
        Finish { roughness: Some(roughness), priority: None }
    }

    /// As rough as the model says, with a priority.
    pub fn nested(priority: u8) -> Finish {
        Finish { roughness: None, priority: Some(priority) }
    }

    /// Says what is wrong with the finish, if anything is.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if the roughness is not in 0 ..= 1.
    pub fn validate(&self) -> Result<(), RenderError> {
        match self.roughness {
            Some(roughness) if !(0.0..=1.0).contains(&roughness) => {
                let reason = format!("a roughness of {roughness} is not between 0 and 1");
                Err(RenderError::Setting { what: "finish", reason })
            }
            _ => Ok(()),
        }
    }

    /// The roughness of a material with this finish, 0 to 1. A record's that makes no sense counts as the nearest that does.
    pub(super) fn roughness_of(&self, record: &MaterialRecord) -> f64 {
        let roughness = f64::from(self.roughness.unwrap_or(record.roughness));
        // What is not a number is not greater than 0 either.
        if roughness > 0.0 { roughness.min(1.0) } else { 0.0 }
    }
}

/// Below this a lobe is as good as a mirror, and its peak too high for sums of f64.
pub(super) const ALPHA_MIN: f64 = 1e-3;

/// GGX's alpha of a roughness (0 to 1); 0 if the surface is smooth.
pub(super) fn alpha_of(roughness: f64) -> f64 {
    if roughness > 0.0 { (roughness * roughness).clamp(ALPHA_MIN, 1.0) } else { 0.0 }
}
