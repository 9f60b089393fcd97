//! Any bytes as one block. The checksum is made right, so that everything behind it is reached.
#![no_main]

use libfuzzer_sys::fuzz_target;
use outcrop::block::{BlockCheck, BlockData, BlockLimits, DecodeScratch, checksum, decode};
use outcrop::geom::{Lattice, Precision};
use outcrop::units::BlockId;

fuzz_target!(|input: &[u8]| {
    let [kind, bytes @ ..] = input else { return };
    let limits = BlockLimits { block_bytes_max: 16 << 10 };
    let precision = match kind % 3 {
        0 => Precision::Float32,
        1 => Precision::Lattice(Lattice { exponent: -10 }),
        _ => Precision::Lattice(Lattice { exponent: -150 }),
    };
    // The counts that the header claims are those of the directory, for the same reason as the checksum.
    let count = |at: usize| bytes.get(at..at + 2).map_or(1, |two| u32::from(u16::from_le_bytes([two[0], two[1]])));
    let check = BlockCheck {
        block: BlockId(0),
        checksum: checksum(bytes),
        triangle_count: count(10),
        vertex_count: count(12),
        material_range: [0, 1000],
    };
    let mut data = BlockData::with_limits(limits);
    let mut scratch = DecodeScratch::with_limits(limits);
    match decode(bytes, &check, precision, limits, &mut scratch, &mut data) {
        Err(error) => assert!(error.offset <= bytes.len() as u64 && data == BlockData::default()),
        Ok(()) => {
            assert!(data.triangles.as_flattened().iter().all(|index| usize::from(*index) < data.vertices.len()));
            assert!(data.ids.windows(2).all(|pair| pair[0] < pair[1]));
            assert!(data.materials.iter().all(|material| *material <= 1000));
            for vertex in 0..data.vertices.len() {
                assert!(data.position(vertex).iter().all(|x| x.is_finite()));
            }
        }
    }
});
