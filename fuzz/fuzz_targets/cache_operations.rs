//! Any sequence of cache calls, against a model.
#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../../tests/support/cache_model.rs"]
mod cache_model;

use cache_model::{Op, run};
use outcrop::cache::Policy;

fuzz_target!(|input: &[u8]| {
    let [policy, slots, blocks, rest @ ..] = input else { return };
    let policy = Policy::ALL[usize::from(*policy) % Policy::ALL.len()];
    let ops: Vec<Op> = rest.chunks_exact(2).map(|pair| Op::from_bytes(pair[0], pair[1])).collect();
    run(policy, u32::from(slots % 17), 1 + u32::from(blocks % 48), &ops);
});
