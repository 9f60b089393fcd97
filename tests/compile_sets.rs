//! Whatever goes in comes out: every triangle once, bit for bit, for any budget, thread count and block size.

#[path = "support/compiling.rs"]
mod compiling;
#[path = "support/numbers.rs"]
mod numbers;

use compiling::{Mesh, Vertices, assert_same, compile, read_back};
use numbers::Random;
use outcrop::block::Codec;
use outcrop::compile::{CompileOptions, Threads};
use outcrop::procedural::{Gears, Needles, Soup, Tessellation, TorusField};
use outcrop::units::Bytes;
use proptest::prelude::*;

const ROOMY: Bytes = Bytes::mib(256);
/// About the least that works.
const TIGHT: Bytes = Bytes::mib(18);

fn gears() -> Mesh {
    Mesh::of(&Gears::with_tessellation(2, Tessellation::new(12).unwrap()).unwrap())
}

#[test]
fn every_triangle_is_stored_once_and_bit_for_bit() {
    let gears = gears();
    let (report, bytes) = compile(&gears, &CompileOptions::default(), ROOMY);
    assert_same(&gears, &bytes);
    assert_eq!(report.triangles, gears.triangles.len() as u64);
    assert_eq!((report.error_bound, report.degenerate, report.duplicates, report.skipped), (0.0, 0, 0, 0));
    for mesh in
        [Mesh::of(&Soup::new(20_000, 0.02, 1).unwrap()), Mesh::of(&TorusField::new(2, 40, 20, 3).unwrap())]
    {
        let (_, bytes) = compile(&mesh, &CompileOptions::default(), ROOMY);
        assert_same(&mesh, &bytes);
    }
}

#[test]
fn the_file_does_not_depend_on_threads_budget_or_order_of_calls() {
    let mut mesh = Mesh::of(&Gears::with_tessellation(3, Tessellation::new(12).unwrap()).unwrap());
    let (_, expected) = compile(&mesh, &CompileOptions::default(), ROOMY);
    for (threads, budget, batch) in [(2, ROOMY, 1000), (3, TIGHT, 1), (1, TIGHT, 100_000)] {
        mesh.batch = batch;
        let threads = if threads == 1 { Threads::One } else { Threads::Count(threads) };
        let options = CompileOptions { threads, ..CompileOptions::default() };
        let (report, bytes) = compile(&mesh, &options, budget);
        assert_eq!(report.spill_bytes > 0, budget == TIGHT);
        assert!(bytes == expected, "threads or budget show in the file");
    }
    let pool = std::sync::Arc::new(rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap());
    let options = CompileOptions { threads: Threads::Pool(pool.clone()), ..CompileOptions::default() };
    let (_, bytes) = compile(&mesh, &options, ROOMY);
    assert!(bytes == expected, "the caller's pool shows in the file");
    // From inside the pool too, where waiting for its other threads could wait for ever.
    let (_, bytes) = pool.install(|| compile(&mesh, &options, ROOMY));
    assert!(bytes == expected);
}

#[test]
fn faces_may_come_before_the_last_vertex_is_known() {
    let mut mesh = gears();
    mesh.complete_first = false;
    for budget in [ROOMY, TIGHT] {
        let (_, bytes) = compile(&mesh, &CompileOptions::default(), budget);
        assert_same(&mesh, &bytes);
    }
}

#[test]
fn block_sizes_and_codecs_change_the_packing_only() {
    let mesh = gears();
    let mut counts = Vec::new();
    for block_bytes in [4 << 10, 16 << 10, 64 << 10, 256 << 10] {
        let codec = if block_bytes == 16 << 10 { Codec::Raw } else { Codec::Lz4 };
        let options = CompileOptions { block_bytes, codec, ..CompileOptions::default() };
        let (report, bytes) = compile(&mesh, &options, ROOMY);
        assert_same(&mesh, &bytes);
        assert_eq!(read_back(&bytes).0.limits.block_bytes_max, block_bytes);
        counts.push(report.blocks);
    }
    assert!(counts.is_sorted_by(|a, b| a > b), "{counts:?}");
    let options = CompileOptions { codec: Codec::Lzo, ..CompileOptions::default() };
    let small = Mesh::of(&Soup::new(500, 0.1, 1).unwrap());
    assert_same(&small, &compile(&small, &options, ROOMY).1);
}

/// One triangle per call of `corners`, no vertex shared.
fn loose(count: u32, corners: impl Fn(u32) -> [[f32; 3]; 3]) -> Mesh {
    let vertices = (0..count).flat_map(corners).collect();
    let triangles = (0..count).map(|index| [0, 1, 2].map(|corner| 3 * index + corner)).collect();
    Mesh::new(Vertices::Float32(vertices), triangles)
}

#[test]
fn hard_distributions() {
    let small = CompileOptions { block_bytes: 4 << 10, ..CompileOptions::default() };
    let unit = |at: [f32; 3], size: f32| {
        [at, [at[0] + size, at[1], at[2]], [at[0], at[1] + size, at[2] + 0.5 * size]]
    };
    let cases = [
        ("one triangle", loose(1, |_| unit([1.0, 2.0, 3.0], 1.0))),
        ("all the same", loose(5000, |_| unit([0.25; 3], 0.5))),
        ("a point", loose(3000, |_| [[1.5; 3]; 3])),
        (
            "one far outlier",
            loose(4000, |i| if i == 17 { unit([1e30; 3], 1e29) } else { unit([i as f32; 3], 1.0) }),
        ),
        (
            "sizes by powers of two",
            loose(2000, |i| unit([(i as f32 * 0.1 - 100.0).exp2(); 3], (i as f32 * 0.1 - 110.0).exp2())),
        ),
        (
            "one centroid, many sizes",
            loose(3000, |i| {
                let size = 1.0 + i as f32;
                [[-size, -size, 0.0], [size, 0.0, -size], [0.0, size, size]]
            }),
        ),
        ("a flat sheet", loose(3000, |i| unit([(i % 60) as f32, (i / 60) as f32, 0.0], 1.0))),
        (
            "a line",
            loose(3000, |i| [[i as f32, 0.0, 0.0], [i as f32 + 1.0, 0.0, 0.0], [i as f32 + 0.5, 0.0, 0.0]]),
        ),
        (
            "full range of f32",
            loose(1000, |i| {
                let x = if i % 2 == 0 { f32::MAX } else { -f32::MAX };
                [[x, -x, x], [-x, x, i as f32], [0.0, x, -x]]
            }),
        ),
        ("tiny and zero", loose(1000, |i| unit([f32::from_bits(i), -0.0, 0.0], f32::from_bits(1)))),
        // 4 KiB hold exactly 89 triangles without shared vertices: (12 * 3 + 10) * 89 = 4094.
        ("exactly full", loose(89, |i| unit([i as f32, 0.0, 0.0], 0.5))),
        ("one too many", loose(90, |i| unit([i as f32, 0.0, 0.0], 0.5))),
    ];
    for (name, mesh) in &cases {
        for options in [&CompileOptions::default(), &small] {
            let (report, bytes) = compile(mesh, options, ROOMY);
            assert_same(mesh, &bytes);
            match *name {
                "exactly full" => assert_eq!(report.blocks, 1),
                "one too many" if options.block_bytes == 4 << 10 => assert_eq!(report.blocks, 2),
                "a point" | "a line" => assert_eq!(report.degenerate, report.triangles),
                _ => {}
            }
        }
    }
    let needles = Mesh::of(&Needles::new(4000, 1e-6, 5).unwrap());
    let options = CompileOptions { precision: outcrop::compile::PrecisionChoice::Float32, ..small };
    let (report, bytes) = compile(&needles, &options, ROOMY);
    assert_eq!(report.triangles, needles.triangles.len() as u64);
    read_back(&bytes);
}

#[test]
fn skewed_geometry_is_parted_again() {
    // 300,000 triangles in one cell of the grid: an outlier makes it coarse.
    let mut random = Random(1);
    let mut vertices: Vec<[f32; 3]> = (0..1000).map(|_| [(); 3].map(|()| random.unit() as f32)).collect();
    vertices.push([1e9; 3]);
    let triangles: Vec<[u32; 3]> =
        (0..300_000_u32).map(|i| [i % 1000, (i / 7) % 1000, i.wrapping_mul(31) % 1001]).collect();
    let mut mesh = Mesh::new(Vertices::Float32(vertices), triangles);
    mesh.materials = (0..300_000_u32).map(|i| (i / 1000 % 3) as u16).collect();
    let (_, expected) = compile(&mesh, &CompileOptions::default(), ROOMY);
    assert_same(&mesh, &expected);
    let options = CompileOptions { threads: Threads::Count(2), ..CompileOptions::default() };
    assert!(compile(&mesh, &options, Bytes::mib(40)).1 == expected);
    // The same number of triangles with one centroid: nothing but order can part them.
    let mesh = loose(140_000, |i| {
        let size = 1.0 + (i % 1000) as f32;
        [[-size, -size, 0.0], [size, 0.0, -size], [0.0, size, size]]
    });
    assert_same(&mesh, &compile(&mesh, &CompileOptions::default(), ROOMY).1);
}

#[test]
fn degenerate_and_duplicate_triangles_are_counted_and_kept() {
    let vertices =
        vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0], [0.0; 3], [-0.0, 0.0, 0.0]];
    let triangles = vec![
        [0, 1, 2],
        [1, 2, 0], // the same, turned
        [2, 1, 0], // and from behind
        [4, 1, 2], // by another vertex in the same place
        [5, 1, 2], // the two zeros are different bits
        [0, 1, 3], // on a line
        [1, 1, 2], // an edge
    ];
    let mesh = Mesh::new(Vertices::Float32(vertices), triangles);
    let (report, bytes) = compile(&mesh, &CompileOptions::default(), ROOMY);
    assert_same(&mesh, &bytes);
    assert_eq!((report.duplicates, report.degenerate), (3, 2));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn random_meshes_come_back(
        seed in any::<u64>(),
        vertex_count in 3..400_usize,
        triangle_count in 1..3000_usize,
        scales in prop::array::uniform3(-20..20_i32),
        material_count in 1..5_u16,
        complete_first in any::<bool>(),
        batch in prop_oneof![Just(1_usize), 2..50_usize, Just(5000)],
        threads in 1..3_usize,
        block_bytes in prop_oneof![Just(4_u32 << 10), Just(64 << 10)],
    ) {
        let mut random = Random(seed);
        let vertices = (0..vertex_count)
            .map(|_| scales.map(|scale| random.signed() as f32 * (scale as f32).exp2()))
            .collect();
        let triangles: Vec<[u32; 3]> =
            (0..triangle_count).map(|_| [0; 3].map(|_| random.index(vertex_count) as u32)).collect();
        let mut mesh = Mesh::new(Vertices::Float32(vertices), triangles);
        mesh.materials = (0..triangle_count).map(|_| random.below(material_count.into()) as u16).collect();
        // All materials are known to the sink even if the last ones are unused.
        (mesh.complete_first, mesh.batch) = (complete_first, batch);
        let threads = if threads == 1 { Threads::One } else { Threads::Count(threads) };
        let options = CompileOptions { threads, block_bytes, ..CompileOptions::default() };
        let (_, bytes) = compile(&mesh, &options, ROOMY);
        assert_same(&mesh, &bytes);
    }
}

#[test]
fn faces_in_no_order_are_joined_with_their_vertices() {
    // More vertices than the tight budget holds, and faces that jump about among them.
    let mut mesh = Mesh::of(&Gears::with_tessellation(4, Tessellation::new(12).unwrap()).unwrap());
    let count = mesh.triangles.len();
    let order: Vec<usize> = (0..count).map(|index| index * 48_611 % count).collect();
    mesh.triangles = order.iter().map(|index| mesh.triangles[*index]).collect();
    mesh.materials = (0..count).map(|index| (index / 10_000 % 3) as u16).collect();
    for complete_first in [true, false] {
        mesh.complete_first = complete_first;
        let (_, expected) = compile(&mesh, &CompileOptions::default(), ROOMY);
        assert_same(&mesh, &expected);
        let (report, bytes) = compile(&mesh, &CompileOptions::default(), Bytes::mib(20));
        assert!(report.spill_bytes > 0 && bytes == expected);
    }
    // A triangle that is not finite is named by its own vertices, not by those of its batch.
    let Vertices::Float32(vertices) = &mut mesh.vertices else { unreachable!("gears are in f32") };
    vertices[100_000][2] = f32::NAN;
    let users: Vec<usize> = (0..count).filter(|index| mesh.triangles[*index].contains(&100_000)).collect();
    let options = CompileOptions { skip_not_finite: true, ..CompileOptions::default() };
    let (report, bytes) = compile(&mesh, &options, Bytes::mib(20));
    assert_eq!(report.skipped, users.len() as u64);
    let (_, stored) = read_back(&bytes);
    let missing: Vec<usize> = (0..count).filter(|index| stored[*index].is_none()).collect();
    assert_eq!(missing, users);
}
