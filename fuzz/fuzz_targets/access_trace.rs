//! Any bytes as a recorded trace; and any queries recorded, read back and judged as by naive twins.
#![no_main]

use libfuzzer_sys::fuzz_target;
use outcrop::access::{AccessTrace, MissRatioCurve, QueryKind};

#[path = "../../tests/support/access_model.rs"]
mod access_model;

fuzz_target!(|input: &[u8]| {
    if let Ok(trace) = AccessTrace::from_bytes(input.to_vec()) {
        // A few bytes can say that a query was repeated for years.
        if trace.totals().accesses < 1 << 16 {
            assert_eq!(MissRatioCurve::of(&trace).accesses(), trace.totals().accesses);
        }
    }
    let [blocks, rest @ ..] = input else { return };
    let block_count = 1 + u32::from(blocks % 12);
    let queries: Vec<_> = rest
        .chunks(4)
        .take(40)
        .map(|chunk| {
            let kind = if chunk[0] & 1 == 0 { QueryKind::Closest } else { QueryKind::Occlusion };
            let stream = u32::from(chunk[0] >> 1 & 1);
            (stream, kind, chunk[1..].iter().map(|block| u32::from(*block) % block_count).collect())
        })
        .collect();
    access_model::compare(block_count, &queries);
});
