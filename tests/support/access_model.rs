//! Traces made by hand, and naive twins of what is said of them. Shared by the tests and the fuzz target.

use std::io::{self, Write};
use std::sync::{Arc, Mutex};

use outcrop::access::{AccessRecorder, AccessTrace, MissRatioCurve, QueryKind, optimum_loads, replay};
use outcrop::cache::Policy;
use outcrop::units::{BlockId, Bytes};

/// Bytes that are written by one and read by another.
#[derive(Clone, Default)]
pub struct Shared(Arc<Mutex<Vec<u8>>>);

impl Shared {
    pub fn take(&self) -> Vec<u8> {
        std::mem::take(&mut self.0.lock().expect("no writer panics"))
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().expect("no writer panics").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Stream, kind, blocks.
pub type Query = (u32, QueryKind, Vec<u32>);

/// The trace of these queries.
pub fn record(block_count: u32, queries: &[Query]) -> Vec<u8> {
    let output = Shared::default();
    let recorder = AccessRecorder::new(Box::new(output.clone()), block_count, Bytes(640)).expect("memory");
    let streams = queries.iter().map(|query| query.0 + 1).max().unwrap_or(0);
    let mut logs: Vec<_> = (0..streams).map(|_| recorder.log()).collect();
    for (stream, kind, blocks) in queries {
        let log = &mut logs[*stream as usize];
        log.begin(*kind);
        blocks.iter().for_each(|block| log.enter(BlockId(*block)));
    }
    drop(logs);
    let totals = recorder.finish().expect("memory");
    assert_eq!(totals.queries, queries.len() as u64);
    assert_eq!(totals.accesses, queries.iter().map(|query| query.2.len() as u64).sum::<u64>());
    output.take()
}

/// Records the queries, reads them back, and compares all that can be said of them with naive twins.
///
/// # Panics
/// If anything differs.
pub fn compare(block_count: u32, queries: &[Query]) {
    let trace = AccessTrace::from_bytes(record(block_count, queries)).expect("just recorded");
    let mut back: Vec<Query> = Vec::new();
    trace.visit(|query| {
        for _ in 0..query.count {
            back.push((query.stream, query.kind, query.blocks.to_vec()));
        }
    });
    // Short streams are one chunk each, in the order of the logs' ends.
    let mut expected = queries.to_vec();
    expected.sort_by_key(|query| query.0);
    assert_eq!(back, expected);

    let accesses: Vec<u32> = expected.iter().flat_map(|query| query.2.iter().copied()).collect();
    let mut distinct = accesses.clone();
    distinct.sort_unstable();
    distinct.dedup();
    let curve = MissRatioCurve::of(&trace);
    assert_eq!((curve.accesses(), curve.touched()), (accesses.len() as u64, distinct.len() as u64));
    for slots in 0..=block_count + 1 {
        let lru = lru_loads(&accesses, slots as usize);
        assert_eq!(curve.loads(slots), lru, "{slots} slots");
        let best = optimum_loads(&trace, slots);
        assert_eq!(best, farthest_first_loads(&accesses, slots as usize), "{slots} slots");
        for policy in Policy::ALL {
            let counts = replay(&trace, policy, slots, 0);
            assert!(counts.loads >= best, "{policy:?} does better than the best with {slots} slots");
            assert_eq!((counts.accesses, counts.touched), (curve.accesses(), curve.touched()));
            assert!(policy != Policy::Lru || counts.loads == lru);
            // Any number of pins is taken.
            assert!(replay(&trace, policy, slots, slots / 2 + 1).loads >= best);
        }
    }
}

fn lru_loads(accesses: &[u32], slots: usize) -> u64 {
    let mut resident: Vec<u32> = Vec::new();
    let mut loads = 0;
    for block in accesses {
        let before = resident.len();
        resident.retain(|other| other != block);
        loads += u64::from(resident.len() == before);
        resident.push(*block);
        if resident.len() > slots {
            resident.remove(0);
        }
    }
    loads
}

fn farthest_first_loads(accesses: &[u32], slots: usize) -> u64 {
    let mut resident: Vec<u32> = Vec::new();
    let mut loads = 0;
    for (time, block) in accesses.iter().enumerate() {
        if resident.contains(block) {
            continue;
        }
        loads += 1;
        if resident.len() == slots {
            let next_use = |block: &u32| accesses[time..].iter().position(|other| other == block);
            let farthest = (0..slots).max_by_key(|index| next_use(&resident[*index]).unwrap_or(usize::MAX));
            let Some(farthest) = farthest else { continue };
            resident.swap_remove(farthest);
        }
        resident.push(*block);
    }
    loads
}
