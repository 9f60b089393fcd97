//! Light that samples may get, until it is known whether anything stands in its way.

use glam::DVec3;

use super::samples::{NONE, Sample};
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
    /// The sample's next claim, or the next free place.
    next: u32,
}

/// Places for claims.
pub(super) struct Claims {
    claims: Vec<Claim>,
    capacity: u32,
    free_list: u32,
    count: u32,
}

impl Claims {
    pub fn new(capacity: u32) -> Claims {
        Claims { claims: Vec::with_capacity(capacity as usize), capacity, free_list: NONE, count: 0 }
    }

    /// What [`Claims::new`] allocates for each.
    pub const BYTES_OF_ONE: usize = size_of::<Claim>();

    pub fn room(&self) -> u32 {
        self.capacity - self.count
    }

    /// Puts a claim at the end of its sample's. Who calls it has made sure that there is room.
    pub fn add(&mut self, place: u32, sample: &mut Sample, open: OpenClaim) -> u32 {
        let OpenClaim { contribution, ray, straight_only, .. } = open;
        let (walker, lost) = (Walker::new(0, &ray), 0.0);
        let claim = Claim { sample: place, contribution, lost, ray, walker, straight_only, next: NONE };
        let index = match self.free_list {
            NONE => {
                debug_assert!(self.claims.len() < self.capacity as usize);
                self.claims.push(claim);
                self.claims.len() as u32 - 1
            }
            index => {
                self.free_list = self.claims[index as usize].next;
                self.claims[index as usize] = claim;
                index
            }
        };
        match sample.last_claim {
            NONE => sample.first_claim = index,
            last => self.claims[last as usize].next = index,
        }
        sample.last_claim = index;
        sample.open += 1;
        self.count += 1;
        index
    }

    pub fn get_mut(&mut self, index: u32) -> &mut Claim {
        &mut self.claims[index as usize]
    }

    /// Adds what all claims of a sample brought, in the order in which they came, and forgets them.
    pub fn settle(&mut self, sample: &mut Sample) {
        let mut index = sample.first_claim;
        while let Some(claim) = self.claims.get_mut(index as usize) {
            sample.radiance += claim.contribution;
            sample.lost_by_shadows += claim.lost;
            let next = std::mem::replace(&mut claim.next, self.free_list);
            self.free_list = std::mem::replace(&mut index, next);
            self.count -= 1;
        }
        (sample.first_claim, sample.last_claim) = (NONE, NONE);
    }
}
