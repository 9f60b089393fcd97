//! What a path carries beside its ray where effects are sampled: the name of the vertex, how its direction came about, and
//! the bodies it is inside of; and the weights by which light found in two ways is counted once.

use glam::DVec3;

use super::detail::Cone;
use super::media::MediumStack;
use super::random::{SampleKey, VertexId};

/// The state of a path in a loop that samples effects.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Walk {
    pub key: SampleKey,
    /// Where the ray is about to arrive.
    pub vertex: VertexId,
    /// Density over solid angle with which its direction was sampled; 0 if it was not: camera, mirror, smooth glass. Straight
    /// passage keeps the density.
    pub density: f64,
    /// Where the direction was sampled, and the normal there.
    pub from: DVec3,
    pub normal: DVec3,
    /// Whether a diffuse bounce lies behind: from then on one ray goes on, not a tree.
    pub has_bounced: bool,
    pub media: MediumStack,
    /// What of a picture it sees at once; kept in the *Detailed* loop only.
    pub cone: Cone,
}

impl Walk {
    /// From the camera.
    pub fn start(key: SampleKey) -> Walk {
        Walk {
            key,
            vertex: VertexId::CAMERA,
            density: 0.0,
            from: DVec3::ZERO,
            normal: DVec3::ZERO,
            has_bounced: false,
            media: MediumStack::EMPTY,
            cone: Cone::default(),
        }
    }

    /// The share with which light counts that this ray sees, and that a light sample at `from` finds with `light_density`.
    pub fn share(&self, light_density: f64) -> f64 {
        if self.density > 0.0 { share(self.density, light_density) } else { 1.0 }
    }
}

/// The power heuristic (E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, section 9.2): the share
/// of a way of sampling with density `own` where another has density `other`.
pub(crate) fn share(own: f64, other: f64) -> f64 {
    if other == 0.0 {
        return 1.0;
    }
    // As a quotient the squares cannot overflow.
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up_to_one() {
        for (a, b) in [(1.0, 1.0), (0.3, 12.0), (1e-300, 1e300), (1e200, 1e-200), (5.0, f64::MIN_POSITIVE)] {
            assert!((share(a, b) + share(b, a) - 1.0).abs() < 1e-15, "{a} {b}");
        }
        assert_eq!(share(0.7, 0.0), 1.0);
    }
}
