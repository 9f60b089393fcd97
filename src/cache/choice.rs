//! A policy chosen when the program runs.

use std::sync::Arc;

use crate::budget::MemoryBudget;
use crate::error::BudgetError;
use crate::free_memory::{FollowFreeMemory, SystemMemory};
use crate::units::Bytes;

use super::{Clock, FollowingCache, GeometryCache, Lru, ReplacementPolicy, S3Fifo, SlotCache};

/// The replacement policies of this room, for callers that choose among them. Hits never depend on it, only how often
/// a block is loaded does; `docs/results/policies.md` has the figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Policy {
    /// See [`Lru`].
    #[default]
    Lru,
    /// See [`Clock`].
    Clock,
    /// See [`S3Fifo`].
    S3Fifo,
}

/// Something to be done with a policy whose type is known only inside: [`Policy::with`].
pub(crate) trait WithPolicy {
    type Output;

    fn run<P: ReplacementPolicy + Default>(self) -> Self::Output;
}

impl Policy {
    /// All of them.
    pub const ALL: [Policy; 3] = [Policy::Lru, Policy::Clock, Policy::S3Fifo];

    /// Its usual name, in lower case: `lru`, `clock`, `s3-fifo`.
    pub fn name(self) -> &'static str {
        match self {
            Policy::Lru => "lru",
            Policy::Clock => "clock",
            Policy::S3Fifo => "s3-fifo",
        }
    }

    pub(crate) fn with<W: WithPolicy>(self, work: W) -> W::Output {
        match self {
            Policy::Lru => work.run::<Lru>(),
            Policy::Clock => work.run::<Clock>(),
            Policy::S3Fifo => work.run::<S3Fifo>(),
        }
    }

    /// [`SlotCache::bytes_needed`] with this policy.
    pub fn bytes_needed(self, slot_count: u32, slot_bytes: Bytes, block_count: u32) -> Bytes {
        self.with(Footprint { slot_count, slot_bytes, block_count })
    }

    /// [`SlotCache::new`] with this policy, as a [`FollowingCache`] of the [`SystemMemory`] if `follow` says so; then
    /// `slots_min` is how many slots it keeps in any case.
    ///
    /// # Errors
    /// As for [`SlotCache::new`].
    pub fn cache(
        self,
        slot_count: u32,
        slot_bytes: Bytes,
        block_count: u32,
        budget: &MemoryBudget,
        follow: Option<(FollowFreeMemory, u32)>,
    ) -> Result<Arc<dyn GeometryCache>, BudgetError> {
        self.with(Make { slot_count, slot_bytes, block_count, budget, follow })
    }
}

struct Footprint {
    slot_count: u32,
    slot_bytes: Bytes,
    block_count: u32,
}

impl WithPolicy for Footprint {
    type Output = Bytes;

    fn run<P: ReplacementPolicy + Default>(self) -> Bytes {
        SlotCache::<P>::bytes_needed(self.slot_count, self.slot_bytes, self.block_count)
    }
}

struct Make<'b> {
    slot_count: u32,
    slot_bytes: Bytes,
    block_count: u32,
    budget: &'b MemoryBudget,
    follow: Option<(FollowFreeMemory, u32)>,
}

impl WithPolicy for Make<'_> {
    type Output = Result<Arc<dyn GeometryCache>, BudgetError>;

    fn run<P: ReplacementPolicy + Default>(self) -> Self::Output {
        let Make { slot_count, slot_bytes, block_count, budget, follow } = self;
        let cache = SlotCache::new(slot_count, slot_bytes, block_count, P::default(), budget)?;
        Ok(match follow {
            None => Arc::new(cache),
            Some((follow, slots_min)) => {
                Arc::new(FollowingCache::new(cache, Box::new(SystemMemory::new()), follow, slots_min))
            }
        })
    }
}
