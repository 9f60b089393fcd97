//! `SlotCache` against a model, and each replacement policy against a naive twin, on random programs.

#[path = "support/cache_model.rs"]
mod cache_model;
#[path = "support/naive_policies.rs"]
mod naive_policies;

use cache_model::{Op, run};
use naive_policies::{Naive, NaiveClock, NaiveLru, NaiveS3Fifo};
use outcrop::cache::{Clock, Lru, Policy, ReplacementPolicy, S3Fifo};
use outcrop::units::BlockId;
use proptest::prelude::*;

fn op() -> impl Strategy<Value = Op> {
    (any::<u8>(), any::<u8>()).prop_map(|(kind, argument)| Op::from_bytes(kind, argument))
}

fn policy() -> impl Strategy<Value = Policy> {
    prop::sample::select(Policy::ALL.to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 512, ..ProptestConfig::default() })]

    #[test]
    fn behaves_as_the_model(
        policy in policy(),
        slots in 0_u32..6,
        blocks in 1_u32..12,
        ops in prop::collection::vec(op(), 0..120),
    ) {
        run(policy, slots, blocks, &ops);
    }

    #[test]
    fn behaves_as_the_model_when_large(policy in policy(), ops in prop::collection::vec(op(), 300)) {
        run(policy, 60, 80, &ops);
    }

    #[test]
    fn lru_evicts_as_its_twin(slots in 0_u32..40, steps in prop::collection::vec(any::<[u8; 3]>(), 0..600)) {
        compare(Lru::new(), NaiveLru::default(), slots, &steps);
    }

    #[test]
    fn clock_evicts_as_its_twin(slots in 0_u32..40, steps in prop::collection::vec(any::<[u8; 3]>(), 0..600)) {
        compare(Clock::new(), NaiveClock::default(), slots, &steps);
    }

    #[test]
    fn s3_fifo_evicts_as_its_twin(slots in 0_u32..40, steps in prop::collection::vec(any::<[u8; 3]>(), 0..600)) {
        compare(S3Fifo::new(), NaiveS3Fifo::new(slots), slots, &steps);
    }
}

/// Admits, uses and evicts on both, with some slots refused.
fn compare<P: ReplacementPolicy>(mut policy: P, mut naive: impl Naive, slots: u32, steps: &[[u8; 3]]) {
    policy.start(slots);
    let mut empty: Vec<u32> = (0..slots).rev().collect();
    let mut resident: Vec<u32> = Vec::new();
    for &[kind, argument, mask] in steps {
        let any = |slots: &[u32]| slots.get(usize::from(argument) % slots.len().max(1)).copied();
        match (kind % 4, empty.is_empty()) {
            (0, false) => {
                let slot = empty.swap_remove(usize::from(argument) % empty.len());
                policy.admit(slot, BlockId(u32::from(mask)));
                naive.admit(slot, u32::from(mask));
                resident.push(slot);
            }
            (0 | 1, _) => {
                // Every so often all slots are pinned, or a part of them.
                let refused =
                    |slot: u32| mask < 60 && !(slot + u32::from(mask)).is_multiple_of(4) || mask == 60;
                let mut victim = None;
                policy.victim(&mut |slot| {
                    let taken = !refused(slot);
                    if taken {
                        victim = Some(slot);
                    }
                    taken
                });
                assert_eq!(victim, naive.victim(&refused));
                assert_eq!(
                    victim.is_some(),
                    resident.iter().any(|slot| !refused(*slot)),
                    "offers every slot"
                );
                resident.retain(|slot| Some(*slot) != victim);
                empty.extend(victim);
            }
            _ => {
                if let Some(slot) = any(&resident) {
                    policy.hit(slot);
                    naive.hit(slot);
                }
            }
        }
        for slot in 0..slots {
            assert_eq!(policy.is_resident(slot), resident.contains(&slot));
        }
    }
}
