//! Light that samples may get, until it is known whether anything stands in its way.

use glam::DVec3;

use super::places::{NONE, Places};
use super::samples::Sample;
use crate::geom::Ray;
use crate::render::shadows::{OpenClaim, Walker};

/// A claim of a sample.
pub(super) struct Claim {
    pub sample: u32,
    pub contribution: DVec3,
    pub lost: f64,
    pub ray: Ray,
    /// Its way through transparent surfaces.
    pub walker: Walker,
    /// Whether it passes only surfaces that do not bend light.
    pub straight_only: bool,
    /// The sample's next claim.
    next: u32,
}

/// The claims of all samples, each sample's in a list.
pub(super) struct Claims {
    claims: Places<Claim>,
}

impl Claims {
    pub fn new(capacity: u32) -> Claims {
        Claims { claims: Places::new(capacity) }
    }

    /// What [`Claims::new`] allocates for each.
    pub const BYTES_OF_ONE: usize = Places::<Claim>::BYTES_OF_ONE;

    pub fn room(&self) -> u32 {
        self.claims.room()
    }

    /// Puts a claim at the end of its sample's. Who calls it has made sure that there is room.
    pub fn add(&mut self, place: u32, sample: &mut Sample, open: OpenClaim) -> u32 {
        let OpenClaim { contribution, ray, straight_only, .. } = open;
        let (walker, lost) = (Walker::new(0, &ray), 0.0);
        let claim = Claim { sample: place, contribution, lost, ray, walker, straight_only, next: NONE };
        let index = self.claims.add(claim);
        match sample.last_claim {
            NONE => sample.first_claim = index,
            last => self.claims.get_mut(last).next = index,
        }
        sample.last_claim = index;
        sample.open += 1;
        index
    }

    pub fn get_mut(&mut self, index: u32) -> &mut Claim {
        self.claims.get_mut(index)
    }

    /// Adds what all claims of a sample brought, in the order in which they came, and forgets them.
    pub fn settle(&mut self, sample: &mut Sample) {
        let mut index = sample.first_claim;
        while index != NONE {
            let claim = self.claims.get(index);
            sample.radiance += claim.contribution;
            sample.lost_by_shadows += claim.lost;
            let next = claim.next;
            self.claims.remove(index);
            index = next;
        }
        (sample.first_claim, sample.last_claim) = (NONE, NONE);
    }
}
