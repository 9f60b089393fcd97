//! What goes into a block comes out of it, bit for bit: every codec, precision and block size, and inputs at the limits.

#[path = "support/numbers.rs"]
mod numbers;

use std::collections::HashMap;

use numbers::Random;
use outcrop::block::{
    BlockCheck, BlockData, BlockInput, BlockLimits, Codec, DecodeScratch, EncodeScratch, VertexInput,
    checksum, decode, encode, is_wide,
};
use outcrop::error::EncodeError;
use outcrop::geom::{Lattice, Precision};
use outcrop::units::BlockId;
use proptest::prelude::*;

#[derive(Clone, Debug)]
enum Vertices {
    Float32(Vec<[f32; 3]>),
    Lattice(i32, Vec<[i64; 3]>),
}

#[derive(Clone, Debug)]
struct Block {
    vertices: Vertices,
    triangles: Vec<[u16; 3]>,
    ids: Vec<u64>,
    materials: Vec<u16>,
}

impl Block {
    fn precision(&self) -> Precision {
        match self.vertices {
            Vertices::Float32(_) => Precision::Float32,
            Vertices::Lattice(exponent, _) => Precision::Lattice(Lattice { exponent }),
        }
    }

    fn input(&self) -> BlockInput<'_> {
        let vertices = match &self.vertices {
            Vertices::Float32(vertices) => VertexInput::Float32(vertices),
            Vertices::Lattice(_, vertices) => VertexInput::Lattice(vertices),
        };
        BlockInput { vertices, triangles: &self.triangles, ids: &self.ids, materials: &self.materials }
    }

    /// Encodes, decodes and compares; returns the stored bytes.
    fn comes_back(&self, limits: BlockLimits, codec: Codec) -> Vec<u8> {
        let mut stored = vec![1, 2, 3];
        let mut scratch = EncodeScratch::with_limits(limits);
        let (input, precision) = (self.input(), self.precision());
        encode(&input, precision, limits, codec, &mut scratch, &mut stored).unwrap();
        let check = BlockCheck {
            block: BlockId(3),
            checksum: checksum(&stored),
            triangle_count: self.triangles.len() as u32,
            vertex_count: input.vertices.count() as u32,
            material_range: [*self.materials.iter().min().unwrap(), *self.materials.iter().max().unwrap()],
        };
        let mut data = BlockData::with_limits(limits);
        let places = (data.vertices.as_ptr(), data.triangles.as_ptr(), data.ids.as_ptr());
        let mut scratch = DecodeScratch::with_limits(limits);
        decode(&stored, &check, precision, limits, &mut scratch, &mut data).unwrap();
        assert_eq!(places, (data.vertices.as_ptr(), data.triangles.as_ptr(), data.ids.as_ptr()));
        assert_eq!(
            (&data.triangles, &data.ids, &data.materials),
            (&self.triangles, &self.ids, &self.materials)
        );
        match &self.vertices {
            Vertices::Float32(vertices) => {
                let bits = |v: &[f32; 3]| v.map(f32::to_bits);
                assert!(data.vertices.iter().map(bits).eq(vertices.iter().map(bits)));
                assert_eq!((data.base, data.vertices_wide.len()), ([0.0; 3], 0));
            }
            Vertices::Lattice(exponent, vertices) => {
                let lattice = Lattice { exponent: *exponent };
                assert_eq!(data.vertices.len(), vertices.len());
                assert_eq!(!data.vertices_wide.is_empty(), is_wide(lattice, vertices));
                for (index, vertex) in vertices.iter().enumerate() {
                    let position = vertex.map(|x| lattice.position(x));
                    assert_eq!(data.position(index), position);
                    for (axis, near) in data.vertices[index].into_iter().enumerate() {
                        let offset = position[axis] - data.base[axis];
                        assert!(offset >= 0.0 && near >= 0.0);
                        assert_eq!(near, (offset as f32).min(f32::MAX));
                    }
                }
            }
        }
        stored
    }
}

fn codecs() -> impl Iterator<Item = Codec> {
    Codec::ALL.into_iter().filter(|codec| codec.is_available())
}

fn limits(block_bytes_max: u32) -> BlockLimits {
    BlockLimits { block_bytes_max }
}

/// Keeps the vertices that triangles use, in first-use order, and as many triangles as fit.
fn tidy(triangles: &[[u16; 3]], fits: impl Fn(usize, usize) -> bool) -> (Vec<[u16; 3]>, Vec<u16>) {
    let (mut numbers, mut order, mut tidied) = (HashMap::new(), Vec::new(), Vec::new());
    for triangle in triangles {
        if !fits(order.len() + 3, tidied.len() + 1) {
            break;
        }
        tidied.push(triangle.map(|index| {
            *numbers.entry(index).or_insert_with(|| {
                order.push(index);
                order.len() as u16 - 1
            })
        }));
    }
    (tidied, order)
}

fn float() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -10.0f32..10.0,
        1 => any::<u32>().prop_map(f32::from_bits).prop_filter("finite", |x| x.is_finite()),
        1 => prop::sample::select(vec![0.0, -0.0, 1e-45, -1e-45, f32::MIN_POSITIVE, f32::MAX, f32::MIN, 1.0]),
    ]
}

fn blocks() -> impl Strategy<Value = (Block, u32)> {
    let triangles = prop_oneof![
        prop::collection::vec(prop::array::uniform3(0u16..60), 1..120),
        prop::collection::vec(prop::array::uniform3(0u16..2000), 1..900),
        (2u16..50, 1u16..1500).prop_map(|(row, count)| (0..count)
            .map(|i| match i % 2 {
                0 => [i / 2, i / 2 + 1, i / 2 + row],
                _ => [i / 2 + 1, i / 2 + row + 1, i / 2 + row],
            })
            .collect()),
    ];
    let vertices = prop_oneof![
        prop::collection::vec(prop::array::uniform3(float()), 2000).prop_map(Vertices::Float32),
        Just(Vertices::Float32(vec![[-0.0, 1e-42, 7.5]; 2000])),
        (-210i32..210, 0u32..53, 0u32..53, any::<u64>()).prop_map(|(exponent, place, size, seed)| {
            let mut random = Random(seed);
            let mut any = |bits: u32| random.below(1 << bits) as i64 - (1 << bits) / 2;
            let base = [any(place), any(place), any(place)];
            let vertices = (0..2000).map(|_| base.map(|x| (x + any(size)).clamp(-(1 << 52), 1 << 52)));
            let exponent = exponent.clamp(Lattice::EXPONENT_MIN, Lattice::EXPONENT_MAX);
            Vertices::Lattice(exponent, vertices.collect())
        }),
    ];
    let gap = prop_oneof![8 => Just(1u64), 4 => 1u64..300, 1 => 1u64..1 << 40];
    let ids = (0u64..1 << 50, prop::collection::vec(gap, 2000));
    let materials = prop_oneof![Just(vec![5; 2000]), prop::collection::vec(0u16..4, 2000)];
    let sizes = prop::sample::select(vec![4096u32, 5000, 16384, 65536, 262144]);
    (triangles, vertices, ids, materials, sizes).prop_map(
        |(triangles, vertices, (first, gaps), materials, size)| {
            let may_be_wide = matches!(vertices, Vertices::Lattice(..));
            let (triangles, order) = tidy(&triangles, |v, t| limits(size).fits(v, t, may_be_wide));
            let pick = |index: &u16| usize::from(*index);
            let vertices = match vertices {
                Vertices::Float32(all) => Vertices::Float32(order.iter().map(|i| all[pick(i)]).collect()),
                Vertices::Lattice(exponent, all) => {
                    Vertices::Lattice(exponent, order.iter().map(|i| all[pick(i)]).collect())
                }
            };
            let sum = |id: &mut u64, gap: &u64| {
                *id += gap;
                Some(*id)
            };
            let ids = gaps.iter().take(triangles.len()).scan(first, sum).collect();
            let materials = materials[..triangles.len()].to_vec();
            (Block { vertices, triangles, ids, materials }, size)
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn blocks_come_back((block, size) in blocks()) {
        for codec in codecs() {
            block.comes_back(limits(size), codec);
        }
    }
}

fn plain(triangle_count: usize) -> Block {
    let triangles = (0..triangle_count as u16).map(|i| [i, i + 1, i + 2]).collect();
    let vertices = (0..triangle_count + 2).map(|i| [i as f32, (i * i % 97) as f32 * 0.01, -3.5]).collect();
    Block {
        vertices: Vertices::Float32(vertices),
        triangles,
        ids: (100..).take(triangle_count).collect(),
        materials: vec![2; triangle_count],
    }
}

#[test]
fn ids_at_the_ends_and_with_the_largest_gaps() {
    let mut block = plain(6);
    for ids in [
        vec![0, 1, 2, 3, 4, u64::MAX],
        vec![0, u64::MAX - 4, u64::MAX - 3, u64::MAX - 2, u64::MAX - 1, u64::MAX],
        vec![0, 2, 4, 6, 8, 10],
        vec![u64::MAX - 5, u64::MAX - 4, u64::MAX - 3, u64::MAX - 2, u64::MAX - 1, u64::MAX],
        vec![1, 1 << 20, 1 << 40, 1 << 50, 1 << 60, u64::MAX],
    ] {
        block.ids = ids;
        codecs().for_each(|codec| drop(block.comes_back(limits(4096), codec)));
    }
}

#[test]
fn the_largest_blocks() {
    for size in [BlockLimits::BLOCK_BYTES_LEAST, 65536, BlockLimits::BLOCK_BYTES_MOST] {
        let limits = limits(size);
        // As many triangles as there may be, on few vertices, every index far, every id and material alone.
        let count = limits.triangle_count_max();
        let vertex_count = (size as usize - 10 * count) / 12;
        let mut triangles: Vec<[u16; 3]> =
            (0..vertex_count as u16 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let vertex_count = 3 * triangles.len();
        let mut random = Random(1);
        while triangles.len() < count {
            triangles.push([(); 3].map(|()| random.index(vertex_count) as u16));
        }
        let coordinate =
            |i: usize, axis: u32| f32::from_bits(((i as u32).wrapping_mul(2654435761) >> axis) & 0xbf7f_ffff);
        let block = Block {
            vertices: Vertices::Float32(
                (0..vertex_count).map(|i| [0, 1, 2].map(|a| coordinate(i, a))).collect(),
            ),
            triangles,
            ids: (0..count as u64).map(|i| i << 49).collect(),
            materials: (0..count).map(|i| (i % 2) as u16 * 65535).collect(),
        };
        for codec in codecs() {
            let stored = block.comes_back(limits, codec);
            // A full block that cannot be compressed is stored as it is.
            assert!(stored.len() <= 64 + size as usize + 24 * count);
        }
        // As many vertices as there may be: no triangle shares one.
        let count = size as usize / 46;
        let block = Block {
            vertices: Vertices::Float32(
                (0..3 * count).map(|i| [0, 1, 2].map(|a| coordinate(i, a))).collect(),
            ),
            triangles: (0..count as u16).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ids: (0..count as u64).collect(),
            materials: vec![0; count],
        };
        assert!(limits.vertex_count_max() >= 3 * count && limits.vertex_count_max() < 3 * count + 3);
        codecs().for_each(|codec| drop(block.comes_back(limits, codec)));
    }
}

#[test]
fn the_narrow_lattice_ends_where_it_should() {
    for (span, exponent, wide) in [
        ((1 << 24) - 1, 0, false),
        (1 << 24, 0, true),
        (1, -126, false),
        (1, -127, true),
        ((1 << 24) - 1, 103, false),
        (1, 104, true),
    ] {
        let vertices = vec![[-(1 << 52), 0, 5], [span - (1 << 52), span, 5], [-(1 << 52), 1, 4]];
        assert_eq!(is_wide(Lattice { exponent }, &vertices), wide);
        let block = Block {
            vertices: Vertices::Lattice(exponent, vertices),
            triangles: vec![[0, 1, 2]],
            ids: vec![9],
            materials: vec![0],
        };
        codecs().for_each(|codec| drop(block.comes_back(limits(4096), codec)));
    }
    let corners = vec![[-(1 << 52); 3], [1 << 52; 3], [0, 1, -1]];
    let block = Block {
        vertices: Vertices::Lattice(Lattice::EXPONENT_MAX, corners),
        triangles: vec![[0, 1, 2]],
        ids: vec![0],
        materials: vec![0],
    };
    block.comes_back(limits(4096), Codec::Lz4);
}

#[test]
fn consecutive_ids_and_one_material_cost_almost_nothing() {
    let (few, many) =
        (plain(10).comes_back(limits(65536), Codec::Raw), plain(2900).comes_back(limits(65536), Codec::Raw));
    // One shape and three floats for each further triangle, and nothing else.
    assert!(many.len() - few.len() <= 2890 * (1 + 12));
}

#[test]
fn the_bytes_do_not_depend_on_the_blocks_before() {
    let (limits, blocks) = (limits(65536), [plain(2900), plain(50), plain(700)]);
    for codec in codecs() {
        let mut scratch = EncodeScratch::with_limits(limits);
        let mut stored = Vec::new();
        for block in blocks.iter().chain(blocks.iter().rev()) {
            encode(&block.input(), Precision::Float32, limits, codec, &mut scratch, &mut stored).unwrap();
            assert_eq!(stored, block.comes_back(limits, codec));
        }
    }
}

#[test]
fn input_that_is_not_a_block_is_refused() {
    let limits = limits(4096);
    let refused = |block: &Block, precision, codec| {
        let mut scratch = EncodeScratch::with_limits(limits);
        encode(&block.input(), precision, limits, codec, &mut scratch, &mut Vec::new()).unwrap_err()
    };
    let good = plain(10);
    let bad = |change: &dyn Fn(&mut Block)| {
        let mut block = good.clone();
        change(&mut block);
        assert!(matches!(refused(&block, Precision::Float32, Codec::Raw), EncodeError::Invalid(_)));
    };
    bad(&|block| block.ids[4] = block.ids[3]);
    bad(&|block| block.ids.swap(0, 1));
    bad(&|block| block.ids.truncate(9));
    bad(&|block| block.materials.truncate(9));
    bad(&|block| block.triangles[9][2] = 12);
    bad(&|block| block.triangles[0] = [0, 2, 1]);
    bad(&|block| block.triangles[9] = [0, 1, 2]);
    bad(&|block| block.triangles.clear());
    bad(&|block| block.vertices = Vertices::Float32(vec![[f32::NAN; 3]; 12]));
    bad(&|block| block.vertices = Vertices::Float32(vec![[f32::INFINITY; 3]; 12]));
    bad(&|block| block.vertices = Vertices::Lattice(0, vec![[0; 3]; 12]));
    let mut lattice = good.clone();
    lattice.vertices = Vertices::Lattice(0, vec![[(1 << 52) + 1; 3]; 12]);
    assert!(matches!(refused(&lattice, lattice.precision(), Codec::Raw), EncodeError::Invalid(_)));
    assert!(matches!(
        refused(&plain(257), Precision::Float32, Codec::Lz4),
        EncodeError::TooLarge { triangle_count: 257, vertex_count: 259, wide: false, limit: 4096 }
    ));
    if !Codec::Zstd.is_available() {
        let error = refused(&good, Precision::Float32, Codec::Zstd);
        assert_eq!(error, EncodeError::CodecMissing { codec: "zstd" });
        assert!(error.to_string().contains("zstd"));
    }
}
