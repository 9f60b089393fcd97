//! Encode and decode of full blocks, per codec and precision, on the blocks that a compile of the gears makes; and the
//! cost of the parts that every block pays. Every answer is checked before it is timed.
//!
//! Times are processor time of the thread. `bytes per triangle` is that of the stored blocks, without directory and
//! materials.

#[path = "../tests/support/compiled.rs"]
mod compiled;

use std::hint::black_box;
use std::time::Duration;

use compiled::compiled;
use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use outcrop::BlockSource;
use outcrop::block::{
    BlockCheck, BlockData, BlockInput, BlockLimits, Codec, DecodeScratch, EncodeScratch, VertexInput,
    checksum, decode, encode,
};
use outcrop::compile::{CompileOptions, PrecisionChoice};
use outcrop::geom::Precision;
use outcrop::procedural::Gears;
use outcrop::source::MemorySource;
use outcrop::units::BlockId;

/// Processor time, so that other work on the machine shows as little as it can.
struct ProcessorTime;

impl ProcessorTime {
    #[cfg(unix)]
    fn now() -> Duration {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
    }

    #[cfg(not(unix))]
    fn now() -> Duration {
        static START: std::sync::LazyLock<std::time::Instant> =
            std::sync::LazyLock::new(std::time::Instant::now);
        START.elapsed()
    }
}

impl Measurement for ProcessorTime {
    type Intermediate = Duration;
    type Value = Duration;

    fn start(&self) -> Duration {
        ProcessorTime::now()
    }

    fn end(&self, start: Duration) -> Duration {
        ProcessorTime::now() - start
    }

    fn add(&self, a: &Duration, b: &Duration) -> Duration {
        *a + *b
    }

    fn zero(&self) -> Duration {
        Duration::ZERO
    }

    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_nanos() as f64
    }

    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}

/// Blocks that are timed; enough to leave the first-level cache.
const BLOCKS: usize = 24;

/// About the resolution of f32 on the gears.
const EXPONENT: i32 = -22;

/// The first blocks of the compiled gears (n = 2, 219,744 triangles), decoded.
fn blocks(precision: PrecisionChoice) -> (Precision, BlockLimits, Vec<BlockData>) {
    let options = CompileOptions { precision, codec: Codec::Raw, ..CompileOptions::default() };
    let gears = Gears::new(2).expect("n is small");
    let source = MemorySource::new(compiled(&gears, &options)).expect("a whole file");
    let model = source.model();
    let mut scratch = DecodeScratch::with_limits(model.limits);
    let mut bytes = Vec::new();
    let decoded = (0..BLOCKS as u32).map(BlockId).map(|block| {
        let mut data = BlockData::with_limits(model.limits);
        source.read_block(block, &mut bytes).expect("is there");
        model.decode_block(block, &bytes, &mut scratch, &mut data).expect("is sound");
        data
    });
    (model.precision, model.limits, decoded.collect())
}

fn lattice_vertices(data: &BlockData, precision: Precision) -> Vec<[i64; 3]> {
    let Precision::Lattice(lattice) = precision else { return Vec::new() };
    let quantize = |x| lattice.quantize(x).expect("is on the lattice");
    (0..data.vertices.len()).map(|vertex| data.position(vertex).map(quantize)).collect()
}

fn codecs(criterion: &mut Criterion<ProcessorTime>) {
    for choice in [PrecisionChoice::Float32, PrecisionChoice::Lattice { exponent: EXPONENT }] {
        let (precision, limits, blocks) = blocks(choice);
        let name = if precision == Precision::Float32 { "float32" } else { "lattice" };
        let lattices: Vec<_> = blocks.iter().map(|data| lattice_vertices(data, precision)).collect();
        let inputs: Vec<BlockInput<'_>> = blocks
            .iter()
            .zip(&lattices)
            .map(|(data, lattice)| BlockInput {
                vertices: match precision {
                    Precision::Float32 => VertexInput::Float32(&data.vertices),
                    Precision::Lattice(_) => VertexInput::Lattice(lattice),
                },
                triangles: &data.triangles,
                ids: &data.ids,
                materials: &data.materials,
            })
            .collect();
        let triangles: usize = blocks.iter().map(|data| data.triangles.len()).sum();
        let plain: usize = blocks
            .iter()
            .map(|data| BlockLimits::decoded_bytes(data.vertices.len(), data.triangles.len(), false))
            .sum();
        for codec in Codec::ALL.into_iter().filter(|codec| codec.is_available()) {
            let (mut encoder, mut decoder) =
                (EncodeScratch::with_limits(limits), DecodeScratch::with_limits(limits));
            let mut data = BlockData::with_limits(limits);
            let mut stored = Vec::new();
            for (index, (input, block)) in inputs.iter().zip(&blocks).enumerate() {
                let mut bytes = Vec::new();
                encode(input, precision, limits, codec, &mut encoder, &mut bytes).expect("a valid block");
                let check = BlockCheck {
                    block: BlockId(index as u32),
                    checksum: checksum(&bytes),
                    triangle_count: block.triangles.len() as u32,
                    vertex_count: block.vertices.len() as u32,
                    material_range: [0, u16::MAX],
                };
                decode(&bytes, &check, precision, limits, &mut decoder, &mut data).expect("is sound");
                assert!(data == *block, "{} does not give back block {index}", codec.name());
                stored.push((bytes, check));
            }
            let bytes: usize = stored.iter().map(|(bytes, _)| bytes.len()).sum();
            println!(
                "{name} {}: {:.3} bytes per triangle, {:.2} of {plain} plain bytes",
                codec.name(),
                bytes as f64 / triangles as f64,
                bytes as f64 / plain as f64,
            );
            let mut group = criterion.benchmark_group(format!("block/{name}"));
            group.sample_size(if codec == Codec::Lzo { 10 } else { 40 });
            group.throughput(Throughput::Elements(triangles as u64));
            group.bench_function(BenchmarkId::new("encode", codec.name()), |bencher| {
                let mut out = Vec::new();
                bencher.iter(|| {
                    for input in &inputs {
                        encode(black_box(input), precision, limits, codec, &mut encoder, &mut out)
                            .expect("a valid block");
                    }
                });
            });
            // Per 64 KiB of plain bytes: time divided by `plain / 65,536`.
            group.throughput(Throughput::Bytes(plain as u64));
            group.bench_function(BenchmarkId::new("decode", codec.name()), |bencher| {
                bencher.iter(|| {
                    for (bytes, check) in &stored {
                        decode(black_box(bytes), check, precision, limits, &mut decoder, &mut data)
                            .expect("is sound");
                    }
                });
            });
            if codec == Codec::Lz4 {
                group.throughput(Throughput::Bytes(bytes as u64));
                group.bench_function("checksum", |bencher| {
                    bencher
                        .iter(|| stored.iter().fold(0, |sums, (bytes, _)| sums ^ checksum(black_box(bytes))));
                });
            }
            group.finish();
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().with_measurement(ProcessorTime);
    targets = codecs
}
criterion_main!(benches);
