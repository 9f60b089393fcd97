//! Small models compiled in memory with a partition of the test's choosing, and brute force over their triangles.
#![allow(dead_code)]

pub mod numbers;

use std::sync::Arc;

use outcrop::block::{BlockInput, BlockLimits, Codec, EncodeScratch, VertexInput, encode};
use outcrop::geom::{Aabb, Precision, Ray, intersect_certified};
use outcrop::model::{MaterialRecord, ModelWriter, NewBlock, SourceRecord, SubBoxes};
use outcrop::source::MemorySource;
use outcrop::trace::Occlusion;
use outcrop::units::TriangleId;

/// Triangles with exact positions; ids count from 0, the material of triangle `i` is `i % MATERIALS`.
pub type Triangles = Vec<[[f64; 3]; 3]>;

pub const MATERIALS: u16 = 3;

/// Compiles `triangles` into blocks of at most `block_triangles`, cut in the order that `key` sorts them into.
/// Positions must be exact in `precision`.
pub fn compile(
    triangles: &[[[f64; 3]; 3]],
    precision: Precision,
    block_triangles: usize,
    key: impl Fn(usize) -> u64,
) -> Arc<MemorySource> {
    compile_numbered(triangles, precision, block_triangles, key, |i| i as u64)
}

/// [`compile`] with ids of the test's choosing, all different.
pub fn compile_numbered(
    triangles: &[[[f64; 3]; 3]],
    precision: Precision,
    block_triangles: usize,
    key: impl Fn(usize) -> u64,
    id: impl Fn(usize) -> u64,
) -> Arc<MemorySource> {
    let limits = BlockLimits { block_bytes_max: 64 << 10 };
    let mut order: Vec<usize> = (0..triangles.len()).collect();
    order.sort_by_key(|i| (key(*i), *i));
    let mut writer = ModelWriter::new(precision, limits).unwrap();
    let mut scratch = EncodeScratch::with_limits(limits);
    let mut file = vec![0; writer.next_offset() as usize];
    for chunk in order.chunks(block_triangles.min(1300)) {
        let mut members = chunk.to_vec();
        members.sort_unstable_by_key(|i| id(*i));
        let mut vertices: Vec<[f64; 3]> = Vec::new();
        let indices: Vec<[u16; 3]> = members
            .iter()
            .map(|i| {
                triangles[*i].map(|corner| {
                    let found = vertices.iter().position(|v| v.map(f64::to_bits) == corner.map(f64::to_bits));
                    found.unwrap_or_else(|| {
                        vertices.push(corner);
                        vertices.len() - 1
                    }) as u16
                })
            })
            .collect();
        let ids: Vec<u64> = members.iter().map(|i| id(*i)).collect();
        let materials: Vec<u16> = members.iter().map(|i| *i as u16 % MATERIALS).collect();
        let (floats, lattice): (Vec<[f32; 3]>, Vec<[i64; 3]>);
        let input_vertices = match precision {
            Precision::Float32 => {
                floats = vertices
                    .iter()
                    .map(|v| {
                        v.map(|x| {
                            assert_eq!(f64::from(x as f32), x);
                            x as f32
                        })
                    })
                    .collect();
                VertexInput::Float32(&floats)
            }
            Precision::Lattice(l) => {
                lattice = vertices
                    .iter()
                    .map(|v| {
                        v.map(|x| {
                            let coordinate = l.quantize(x).unwrap();
                            assert_eq!(l.position(coordinate), x);
                            coordinate
                        })
                    })
                    .collect();
                VertexInput::Lattice(&lattice)
            }
        };
        let input =
            BlockInput { vertices: input_vertices, triangles: &indices, ids: &ids, materials: &materials };
        let mut stored = Vec::new();
        encode(&input, precision, limits, Codec::Lz4, &mut scratch, &mut stored).unwrap();
        let box_of = |members: &[usize]| {
            let mut bounds = Aabb::EMPTY;
            members.iter().flat_map(|i| triangles[*i]).for_each(|v| bounds.grow(v));
            bounds
        };
        let bounds = box_of(&members);
        let parts: Vec<Aabb> = chunk.chunks(chunk.len().div_ceil(8)).map(box_of).collect();
        writer
            .push(&NewBlock {
                stored: &stored,
                triangle_count: members.len() as u32,
                vertex_count: vertices.len() as u32,
                bounds,
                sub_boxes: SubBoxes::quantize(&bounds, &parts),
                material_range: [*materials.iter().min().unwrap(), *materials.iter().max().unwrap()],
            })
            .unwrap();
        file.extend_from_slice(&stored);
    }
    let materials = vec![MaterialRecord::default(); usize::from(MATERIALS)];
    let sealed = writer.seal(&materials, SourceRecord::default(), None).unwrap();
    file.extend_from_slice(&sealed.tail);
    file[..sealed.header.len()].copy_from_slice(&sealed.header);
    Arc::new(MemorySource::new(file).unwrap())
}

/// Every hit of the ray, by (t, id).
pub fn all_hits(triangles: &[[[f64; 3]; 3]], ray: &Ray) -> Vec<(f64, TriangleId)> {
    let mut hits: Vec<(f64, TriangleId)> = triangles
        .iter()
        .enumerate()
        .filter_map(|(i, vertices)| {
            intersect_certified(ray, vertices, &mut 0).map(|hit| (hit.t, TriangleId(i as u64)))
        })
        .collect();
    hits.sort_by(|a, b| a.partial_cmp(b).unwrap());
    hits
}

/// What a query that tells some materials apart says of a ray that meets something, and something of a material that is not ignored.
pub fn occlusion_of(is_met: bool, is_opaque: bool) -> Occlusion {
    match (is_met, is_opaque) {
        (false, _) => Occlusion::Clear,
        (_, true) => Occlusion::Blocked,
        _ => Occlusion::Filtered,
    }
}

/// Whether the ray meets the box, widened by `slack`: let that be far more than the rounding of the octree's own test.
pub fn may_meet(ray: &Ray, bounds: &Aabb, slack: f64) -> bool {
    let (mut near, mut far) = (ray.t_min, ray.t_max);
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis] - slack, bounds.max[axis] + slack);
        let (origin, direction) = (ray.origin[axis], ray.direction[axis]);
        if direction == 0.0 {
            if origin < low || origin > high {
                return false;
            }
        } else {
            let (a, b) = ((low - origin) / direction, (high - origin) / direction);
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
    }
    near <= far
}
