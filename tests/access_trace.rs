//! Recorded accesses: what is written comes back, damage is found, and what is said of a trace agrees with naive twins and
//! with runs.

#[path = "support/access_model.rs"]
mod access_model;
#[path = "support/compiling.rs"]
mod compiling;
#[path = "support/mod.rs"]
mod support;

use std::io::{self, Write};
use std::sync::Arc;

use access_model::{Query, Shared, compare, record};
use compiling::{Mesh, compile};
use outcrop::access::{AccessRecorder, AccessTrace, MissRatioCurve, QueryKind, optimum_loads, replay};
use outcrop::cache::Policy;
use outcrop::compile::CompileOptions;
use outcrop::error::AccessTraceError;
use outcrop::free_memory::FollowFreeMemory;
use outcrop::geom::Ray;
use outcrop::octree::{LazyOctree, OctreeOptions};
use outcrop::procedural::Terrain;
use outcrop::source::MemorySource;
use outcrop::trace::Occlusion;
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};
use proptest::prelude::*;
use support::numbers::Random;

/// A trace with all that the format has: two streams, both kinds, empty queries, repetitions, more than one chunk.
fn sample(queries: usize) -> (Vec<u8>, Vec<Query>) {
    let mut random = Random(7);
    let mut any = move |count: u64| (random.bits() % count) as u32;
    let mut queries: Vec<_> = (0..queries)
        .map(|_| {
            let kind = if any(3) == 0 { QueryKind::Occlusion } else { QueryKind::Closest };
            (any(2), kind, (0..any(6)).map(|_| any(100)).collect::<Vec<u32>>())
        })
        .collect();
    // Every second query repeats.
    for index in (1..queries.len()).step_by(2) {
        queries[index] = queries[index - 1].clone();
    }
    (record(100, &queries), queries)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn what_was_recorded_comes_back_and_is_judged_as_by_twins(
        block_count in 1_u32..20,
        queries in prop::collection::vec((0_u32..3, any::<bool>(), prop::collection::vec(any::<u32>(), 0..5)), 0..60),
    ) {
        let queries: Vec<_> = queries
            .into_iter()
            .map(|(stream, occlusion, blocks)| {
                let kind = if occlusion { QueryKind::Occlusion } else { QueryKind::Closest };
                (stream, kind, blocks.into_iter().map(|block| block % block_count).collect())
            })
            .collect();
        compare(block_count, &queries);
    }
}

#[test]
fn a_long_trace_comes_back() {
    let (bytes, queries) = sample(40_000);
    let trace = AccessTrace::from_bytes(bytes).unwrap();
    for stream in 0..2 {
        let mut back = Vec::new();
        trace.visit(|query| {
            for _ in 0..if query.stream == stream { query.count } else { 0 } {
                back.push((stream, query.kind, query.blocks.to_vec()));
            }
        });
        assert!(queries.iter().filter(|query| query.0 == stream).eq(&back));
    }
}

#[test]
fn every_truncation_every_flipped_bit_and_every_extra_byte_is_found() {
    let (bytes, _) = sample(60);
    assert!(AccessTrace::from_bytes(bytes.clone()).is_ok());
    for length in 0..bytes.len() {
        assert!(AccessTrace::from_bytes(bytes[..length].to_vec()).is_err(), "cut to {length}");
    }
    for bit in 0..8 * bytes.len() {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(AccessTrace::from_bytes(damaged).is_err(), "bit {bit}");
    }
    for extra in [0, 1, 255] {
        let mut damaged = bytes.clone();
        damaged.push(extra);
        assert!(matches!(
            AccessTrace::from_bytes(damaged),
            Err(AccessTraceError::Damaged { offset, .. }) if offset == bytes.len() as u64
        ));
    }
}

#[test]
fn what_is_not_a_trace_is_called_that() {
    assert!(matches!(AccessTrace::from_bytes(b"ply".to_vec()), Err(AccessTraceError::NotATrace)));
    let (mut newer, _) = sample(1);
    newer[12] = 9;
    assert!(matches!(
        AccessTrace::from_bytes(newer),
        Err(AccessTraceError::Version { found: 9, supported: 1 })
    ));
    assert!(matches!(AccessTrace::open("no such file"), Err(AccessTraceError::Io(_))));
    let refused = AccessRecorder::new(Box::new(io::sink()), u32::MAX, Bytes(64));
    assert!(matches!(refused.err(), Some(AccessTraceError::TooManyBlocks { block_count: u32::MAX, .. })));
}

#[test]
fn a_writer_that_fails_is_told_at_the_end() {
    struct Full(usize);
    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0 = self.0.checked_sub(bytes.len()).ok_or(io::ErrorKind::StorageFull)?;
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    assert!(AccessRecorder::new(Box::new(Full(10)), 5, Bytes(64)).is_err());
    let recorder = AccessRecorder::new(Box::new(Full(40)), 5, Bytes(64)).unwrap();
    let mut log = recorder.log();
    log.begin(QueryKind::Closest);
    log.enter(BlockId(1));
    drop(log);
    match recorder.finish() {
        Err(AccessTraceError::Io(error)) => assert_eq!(error.kind(), io::ErrorKind::StorageFull),
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_empty_trace_needs_nothing() {
    let trace = AccessTrace::from_bytes(record(9, &[])).unwrap();
    let curve = MissRatioCurve::of(&trace);
    assert_eq!((curve.accesses(), curve.touched(), curve.loads(3)), (0, 0, 0));
    assert_eq!(curve.memory_need(1.0).unwrap().slots, 0);
    assert_eq!(optimum_loads(&trace, 2), 0);
}

/// A terrain in many small blocks.
fn terrain() -> Arc<dyn BlockSource> {
    let options = CompileOptions { block_bytes: 4 << 10, ..Default::default() };
    let (report, bytes) = compile(&Mesh::of(&Terrain::new(100, 4).unwrap()), &options, Bytes::mib(64));
    assert!(report.blocks > 100);
    Arc::new(MemorySource::new(bytes).unwrap())
}

/// Rays from above, each followed by two shadow rays; what they met, and the tracer's loads.
fn run(octree: &LazyOctree) -> (Vec<Option<u64>>, u64) {
    let mut random = Random(5);
    let mut tracer = octree.tracer().unwrap();
    let mut answers = Vec::new();
    for _ in 0..3000 {
        let origin = [0.9 * random.signed(), 0.9 * random.signed(), 2.0];
        let direction = [0.5 * random.signed(), 0.5 * random.signed(), -1.0];
        let hit = tracer.closest_hit(&Ray::new(origin, direction)).unwrap();
        answers.push(hit.map(|hit| hit.triangle.0));
        let Some(hit) = hit else { continue };
        let shadows =
            [[1.0, 0.2, 0.1], [-0.3, 1.0, 0.2]].map(|to| Ray { t_min: 1e-6, ..Ray::new(hit.position(), to) });
        let mut blocked = [Occlusion::Clear; 2];
        tracer.occluded(&shadows, None, &mut blocked).unwrap();
        answers.extend(blocked.map(|answer| Some(u64::from(answer == Occlusion::Blocked))));
    }
    (answers, tracer.counters().blocks_loaded)
}

/// A trace recorded once foretells the loads of every policy and cache size, to the last load.
#[test]
fn a_replay_loads_what_a_run_loads() {
    let source = terrain();
    let open = |policy, slots_max| {
        let options = OctreeOptions { policy, slots_max, ..Default::default() };
        LazyOctree::open(Arc::clone(&source), &MemoryBudget::new(Bytes::mib(256)), options).unwrap()
    };
    let mut recorded = open(Policy::Lru, Some(20));
    let output = Shared::default();
    let recorder = recorded.record_accesses(Box::new(output.clone())).unwrap();
    let (reference, _) = run(&recorded);
    let totals = recorder.finish().unwrap();
    let trace = AccessTrace::from_bytes(output.take()).unwrap();
    assert_eq!((trace.totals(), trace.stream_count()), (totals, 1));
    assert!(totals.queries > 5000 && totals.accesses > totals.queries / 2, "{totals:?}");
    assert_eq!(trace.slot_bytes(), recorded.cache().slot_bytes());
    let curve = MissRatioCurve::of(&trace);

    for policy in Policy::ALL {
        for slots in [1, 3, 9, 40, 90, 1000] {
            let octree = open(policy, Some(slots));
            let (answers, loads) = run(&octree);
            assert_eq!(answers, reference, "answers do not depend on policy, slots or recording");
            let slots = octree.cache().slot_count();
            let counts = replay(&trace, policy, slots, octree.pins_per_tracer());
            assert_eq!(counts.loads, loads, "{policy:?} with {slots} slots");
            assert_eq!(counts.touched, octree.blocks_touched());
            assert_eq!(counts.accesses, totals.accesses);
            assert!(optimum_loads(&trace, slots) <= loads);
            if policy == Policy::Lru {
                assert_eq!(replay(&trace, policy, slots, 0).loads, curve.loads(slots));
            }
        }
    }
    let need = curve.memory_need(1.5).unwrap();
    assert!(curve.loads_per_touched_block(need.slots) <= 1.5);
    assert!(curve.loads_per_touched_block(need.slots - 1) > 1.5);
    assert!(need.bytes >= Bytes(u64::from(need.slots) * trace.slot_bytes().0));
    assert!(curve.memory_need(0.5).is_none());
}

/// The system never has as much free as is to be kept free: the cache makes do with the least, and answers are the same.
#[test]
#[cfg(target_os = "linux")]
fn a_cache_that_may_take_nothing_answers_the_same() {
    let source = terrain();
    let open = |follow_free_memory| {
        let options = OctreeOptions { follow_free_memory, ..Default::default() };
        LazyOctree::open(Arc::clone(&source), &MemoryBudget::new(Bytes::mib(256)), options).unwrap()
    };
    let (reference, loads) = run(&open(None));
    let keep_free = Some(FollowFreeMemory { keep_free: Bytes(u64::MAX) });
    let scarce = open(keep_free);
    assert_eq!(scarce.cache().slot_limit(), 1);
    let (answers, scarce_loads) = run(&scarce);
    assert_eq!(answers, reference);
    assert!(scarce_loads > loads, "{scarce_loads} and {loads} loads");
}
