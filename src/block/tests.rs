use super::*;
use crate::geom::Precision;
use crate::units::BlockId;

#[test]
fn smoke() {
    let limits = BlockLimits { block_bytes_max: 65536 };
    let verts: Vec<[f32; 3]> = (0..1000).map(|i| [i as f32 * 0.25, -0.0, 1e-42]).collect();
    let tris: Vec<[u16; 3]> = (0..998).map(|i| [i, i + 1, i + 2]).collect();
    let ids: Vec<u64> = (0..998).map(|i| i * i * 7).collect();
    let mats: Vec<u16> = (0..998).map(|i| i / 300).collect();
    let input =
        BlockInput { vertices: VertexInput::Float32(&verts), triangles: &tris, ids: &ids, materials: &mats };
    for codec in [Codec::Raw, Codec::Lz4, Codec::Lzo] {
        let mut out = Vec::new();
        encode(&input, Precision::Float32, limits, codec, &mut EncodeScratch::with_limits(limits), &mut out)
            .unwrap();
        let mut data = BlockData::with_limits(limits);
        let check = BlockCheck {
            block: BlockId(7),
            checksum: checksum(&out),
            triangle_count: 998,
            vertex_count: 1000,
            material_range: [0, 3],
        };
        decode(&out, &check, Precision::Float32, limits, &mut DecodeScratch::with_limits(limits), &mut data)
            .unwrap();
        assert_eq!(
            (&data.triangles, &data.ids, &data.materials, &data.vertices),
            (&tris, &ids, &mats, &verts)
        );
    }
}

#[test]
fn naive_compiler_opens() {
    use crate::source::{BlockSource, MemorySource, testing::memory_model};
    let limits = BlockLimits { block_bytes_max: 4096 };
    let tris: Vec<_> = (0..3000)
        .map(|i| [0, 1, 2].map(|c| [f64::from(i + c), f64::from((i + c) % 7), f64::from(c * i) * 0.5]))
        .collect();
    let source =
        MemorySource::new(memory_model(&tris, limits, Codec::Lz4, Precision::Float32).unwrap()).unwrap();
    assert_eq!(source.model().triangle_count, 3000);
    let (mut bytes, mut data) = (Vec::new(), BlockData::with_limits(limits));
    let mut scratch = DecodeScratch::with_limits(limits);
    for block in 0..source.model().blocks.len() as u32 {
        source.read_block(BlockId(block), &mut bytes).unwrap();
        source.model().decode_block(BlockId(block), &bytes, &mut scratch, &mut data).unwrap();
        for (t, id) in data.triangles.iter().zip(&data.ids) {
            assert_eq!(t.map(|v| data.position(v.into())), tris[*id as usize]);
        }
    }
}
