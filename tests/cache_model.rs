//! `SlotCache<Lru>` against a model, on random programs.

#[path = "support/cache_model.rs"]
mod cache_model;

use cache_model::{Op, run};
use proptest::prelude::*;

fn op() -> impl Strategy<Value = Op> {
    (any::<u8>(), any::<u8>()).prop_map(|(kind, argument)| Op::from_bytes(kind, argument))
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 512, ..ProptestConfig::default() })]

    #[test]
    fn behaves_as_a_list_in_order_of_use(
        slots in 0_u32..6,
        blocks in 1_u32..12,
        ops in prop::collection::vec(op(), 0..120),
    ) {
        run(slots, blocks, &ops);
    }

    #[test]
    fn behaves_as_a_list_when_large(ops in prop::collection::vec(op(), 300)) {
        run(60, 80, &ops);
    }
}
