//! Triangles per second from a mesh in memory to a compiled file: `cargo bench --bench compile`.
//!
//! The mesh is small, so that a run takes seconds; `docs/results/compile.md` has the big ones.

use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

use criterion::{Criterion, Throughput};
use outcrop::MemoryBudget;
use outcrop::block::{BlockData, Codec, DecodeScratch};
use outcrop::compile::{CompileOptions, CompileReport, Control, PrecisionChoice, Threads, compile_shape};
use outcrop::model::ModelReader;
use outcrop::procedural::{Gears, Shape, Tessellation};
use outcrop::units::{BlockId, Bytes};

fn compile(gears: &Gears, options: &CompileOptions, budget: Bytes, output: &Path) -> CompileReport {
    let budget = MemoryBudget::new(budget);
    compile_shape(gears, output, options, &budget, &mut |_| Control::Continue).expect("compiles")
}

/// That the file holds every triangle once.
fn check(report: &CompileReport, path: &Path) {
    let bytes = std::fs::read(path).expect("is there");
    let model = ModelReader::parse(&bytes).expect("opens");
    let mut seen = vec![false; report.triangles as usize];
    let mut scratch = DecodeScratch::with_limits(model.limits);
    let mut data = BlockData::with_limits(model.limits);
    for (index, entry) in model.blocks.iter().enumerate() {
        let stored = &bytes[entry.offset as usize..][..entry.stored_bytes as usize];
        model.decode_block(BlockId(index as u32), stored, &mut scratch, &mut data).expect("decodes");
        for id in &data.ids {
            assert!(!std::mem::replace(&mut seen[*id as usize], true), "triangle {id} twice");
        }
    }
    assert!(seen.iter().all(|seen| *seen), "a triangle is missing");
}

fn main() {
    let gears = Gears::with_tessellation(4, Tessellation::STANDARD).expect("a valid size");
    let place = tempfile::tempdir().expect("a directory");
    let output = place.path().join("gears.outcrop");
    let mut criterion =
        Criterion::default().sample_size(10).measurement_time(Duration::from_secs(5)).configure_from_args();
    let mut group = criterion.benchmark_group("compile");
    group.throughput(Throughput::Elements(gears.triangle_count()));
    let options = CompileOptions::default();
    let lattice = PrecisionChoice::Lattice { exponent: -24 };
    let cases = [
        ("lz4", options.clone(), Bytes::mib(512)),
        ("raw", CompileOptions { codec: Codec::Raw, ..options.clone() }, Bytes::mib(512)),
        ("lattice", CompileOptions { precision: lattice, ..options.clone() }, Bytes::mib(512)),
        ("spill", options.clone(), Bytes::mib(20)),
        ("two threads", CompileOptions { threads: Threads::Count(2), ..options }, Bytes::mib(512)),
    ];
    for (name, options, budget) in cases {
        let report = compile(&gears, &options, budget, &output);
        assert_eq!(report.triangles, gears.triangle_count());
        check(&report, &output);
        group.bench_function(name, |bencher| {
            bencher.iter(|| black_box(compile(&gears, &options, budget, &output)));
        });
    }
    group.finish();
    criterion.final_summary();
}
