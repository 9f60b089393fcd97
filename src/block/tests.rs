//! Twins and oracles for the parts of the codec that are fast, hand-written, or both.

use proptest::prelude::*;

use super::planes::{gather, merge, split, width_of};
use super::shapes::{self, Connectivity, DISTANCES_SLACK, Parents, Streams};
use super::{
    BLOCK_HEADER_BYTES, BlockCheck, BlockData, BlockLimits, DecodeScratch, Fault, checksum, decode, lzo,
};
use crate::geom::Precision;
use crate::procedural::random::Random;
use crate::units::BlockId;

// --- LZO against the decoder that comes with the encoder ----------------------------------------------------------

/// Bytes with repeats at every distance that the format has an instruction for.
fn compressible(seed: u64, length: usize) -> Vec<u8> {
    let mut generator = Random::new(seed);
    let mut random = || generator.next_u64() as usize;
    let mut bytes: Vec<u8> = Vec::with_capacity(length + 400);
    while bytes.len() < length {
        let count = 1 + random() % [3, 20, 400][random() % 3];
        let distance = 1 + random() % [4, 900, 2000, 3000, 16000, 48000][random() % 6];
        if random() % 3 == 0 || distance > bytes.len() {
            bytes.extend((0..count.min(40)).map(|_| random() as u8));
        } else {
            for _ in 0..count {
                bytes.push(bytes[bytes.len() - distance]);
            }
        }
    }
    bytes.truncate(length);
    bytes
}

fn unpack(stored: &[u8], length: usize) -> Result<Vec<u8>, lzo::Error> {
    let mut payload = vec![0xee; length];
    let written = lzo::decompress(stored, &mut payload)?;
    payload.truncate(written);
    Ok(payload)
}

#[test]
fn lzo_decodes_what_the_encoder_writes() {
    for (seed, length) in (0..60).map(|i| (i, [1, 2, 3, 4, 17, 100, 1000, 5000, 70_000][i as usize % 9])) {
        let bytes = compressible(seed, length);
        let stored = lzokay_native::compress(&bytes).unwrap();
        assert_eq!(lzokay_native::decompress_all(&stored, Some(length)).unwrap(), bytes);
        assert_eq!(unpack(&stored, length).unwrap(), bytes, "seed {seed}");
        // More room does no harm; less is an error.
        assert_eq!(unpack(&stored, length + 5).unwrap(), bytes);
        assert!(unpack(&stored, length - 1).is_err());
    }
}

#[test]
#[expect(clippy::unusual_byte_groupings, reason = "the groups are the fields of an instruction")]
fn lzo_decodes_every_instruction() {
    // 200 literals.
    let mut long = vec![17 + 200];
    let literals: Vec<u8> = (0..200).map(|i| i as u8 ^ 0x5a).collect();
    long.extend(&literals);
    // 3 bytes from distance (2 << 3) + 1 + 1 = 18, one literal.
    long.extend([0b010_001_01, 2, 0xaa]);
    // After one literal: 2 bytes from distance (3 << 2) + 2 + 1 = 15, no literal.
    long.extend([0b0000_10_00, 3]);
    // After none: 4 literals.
    long.extend([1, 9, 8, 7, 6]);
    // Distance 7 and length 2 + 31 + 255 + 5, overlapping itself: low 14 bits are the distance less one.
    long.extend([0b001_00000, 0, 5, 6 << 2, 0]);
    // End mark.
    long.extend([17, 0, 0]);
    let mut expected = literals;
    let copy = |bytes: &mut Vec<u8>, distance: usize, count: usize| {
        (0..count).for_each(|_| bytes.push(bytes[bytes.len() - distance]));
    };
    copy(&mut expected, 18, 3);
    expected.push(0xaa);
    copy(&mut expected, 15, 2);
    expected.extend([9, 8, 7, 6]);
    copy(&mut expected, 7, 293);
    assert_eq!(unpack(&long, expected.len()).unwrap(), expected);
    assert_eq!(lzokay_native::decompress_all(&long, None).unwrap(), expected);
}

#[test]
fn damaged_lzo_is_an_error() {
    let bytes = compressible(7, 600);
    let stored = lzokay_native::compress(&bytes).unwrap();
    for length in 0..stored.len() {
        assert!(unpack(&stored[..length], bytes.len()).is_err(), "prefix of {length}");
    }
    let longer = [&stored[..], &[0]].concat();
    assert!(unpack(&longer, bytes.len()).is_err());
    // Any flip gives bytes or an error inside the input, never a panic.
    for bit in 0..8 * stored.len() {
        let mut damaged = stored.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        if let Err(error) = unpack(&damaged, bytes.len()) {
            assert!(error.offset <= damaged.len());
        }
    }
}

proptest! {
    #[test]
    fn any_bytes_are_no_reason_to_panic_for_lzo(stored in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = unpack(&stored, 1000);
    }
}

// --- Byte planes against one number at a time -----------------------------------------------------------------------

proptest! {
    #[test]
    fn planes_are_put_back_together(column in prop::collection::vec(any::<u32>(), 0..100), width in 0u8..=4) {
        let mask = if width == 0 { 0 } else { u32::MAX >> (32 - 8 * u32::from(width)) };
        let column: Vec<u32> = column.iter().map(|value| value & mask).collect();
        let mut planes = Vec::new();
        split(&column, width, &mut planes);
        prop_assert_eq!(planes.len(), column.len() * usize::from(width));
        let naive: Vec<u32> =
            (0..column.len()).map(|index| gather(&planes, width, column.len(), index) as u32).collect();
        prop_assert_eq!(&naive, &column);
        let mut fast = vec![0xdead_beef; column.len()];
        merge(&planes, width, &mut fast);
        prop_assert_eq!(&fast, &column);
        prop_assert!(column.iter().all(|value| width_of(u64::from(*value)) <= width));
    }
}

// --- Connectivity against a decoder that takes one corner at a time -------------------------------------------------

type Decoded = (Vec<[u16; 3]>, Vec<Option<[usize; 3]>>);

/// The meaning of the streams, spelled out.
fn decode_naively(streams: &Streams<'_>, vertex_count: usize, predicted: usize) -> Option<Decoded> {
    let mut named = streams.named.iter();
    let (low, high) = streams.far.split_at(streams.far.len() / 2);
    let mut far = low.iter().zip(high).map(|(low, high)| usize::from(*low) | usize::from(*high) << 8);
    let (mut triangles, mut parents) = (Vec::new(), Vec::new());
    let mut before = [0u16; 3];
    for code in streams.shapes {
        let sources = [code / 25, code / 5 % 5, code % 5];
        if *code >= 125 {
            return None;
        }
        let mut triangle = [0u16; 3];
        for corner in 0..3 {
            triangle[corner] = match sources[corner] {
                0 => {
                    let (a, b) = (sources[(corner + 1) % 3], sources[(corner + 2) % 3]);
                    let across = (1..=3).contains(&a) && (1..=3).contains(&b) && a != b;
                    let lane = |source: u8| usize::from(before[usize::from(source) - 1]);
                    let mut edge = [a, b];
                    edge.sort_unstable();
                    parents.push(across.then(|| [lane(edge[0]), lane(edge[1]), lane(6 - a - b)]));
                    parents.len() as u16 - 1
                }
                4 => {
                    let less_one = match *named.next()? {
                        255 => far.next()?,
                        byte => usize::from(byte),
                    };
                    parents.len().checked_sub(less_one + 1)? as u16
                }
                source => before[usize::from(source) - 1],
            };
        }
        triangles.push(triangle);
        before = triangle;
    }
    let used = named.next().is_none() && far.next().is_none() && parents.len() == vertex_count;
    // The first vertex has none that it could be predicted from.
    let used = used && !matches!(parents.first(), Some(Some(_)));
    let hits = parents.iter().flatten().count();
    (used && hits == predicted).then_some((triangles, parents))
}

fn decode_fast(streams: &Streams<'_>, vertex_count: usize, predicted: usize) -> Result<Decoded, Fault> {
    // Contents from a block before must not show.
    let mut distances = vec![0x1234; 3 * streams.shapes.len() + DISTANCES_SLACK];
    let mut triangles = vec![[9999; 3]; streams.shapes.len()];
    let mut parents = vec![Parents::default(); vertex_count + 1];
    shapes::decode(streams, predicted, &mut distances, &mut triangles, &mut parents)?;
    let parents = parents[..vertex_count].iter().map(|parents| parents.parallelogram()).collect();
    Ok((triangles, parents))
}

/// Renumbers vertices in the order of their first use.
fn in_first_use_order(triangles: &[[u16; 3]]) -> (Vec<[u16; 3]>, usize) {
    let mut numbers = std::collections::HashMap::new();
    let number = |index: &u16| {
        let next = numbers.len() as u16;
        *numbers.entry(*index).or_insert(next)
    };
    let flat: Vec<u16> = triangles.as_flattened().iter().map(number).collect();
    (flat.as_chunks::<3>().0.to_vec(), numbers.len())
}

proptest! {
    #[test]
    fn connectivity_comes_back(
        triangles in prop_oneof![
            prop::collection::vec(prop::array::uniform3(0u16..6), 1..40),
            prop::collection::vec(prop::array::uniform3(0u16..900), 1..700),
            (2u16..40, 1usize..300).prop_map(|(row, count)| (0..count as u16)
                .map(|i| if i % 2 == 0 { [i / 2, i / 2 + 1, i / 2 + row] } else { [i / 2 + 1, i / 2 + row + 1, i / 2 + row] })
                .collect()),
        ],
    ) {
        let (triangles, vertex_count) = in_first_use_order(&triangles);
        let mut streams = Connectivity::default();
        streams.encode(&triangles, vertex_count).unwrap();
        let far: Vec<u8> = streams.far.iter().map(|distance| *distance as u8)
            .chain(streams.far.iter().map(|distance| (*distance >> 8) as u8)).collect();
        let view = Streams { shapes: &streams.shapes, named: &streams.named, far: &far };
        let (fast, parents) = decode_fast(&view, vertex_count, streams.predicted).unwrap();
        prop_assert_eq!(&fast, &triangles);
        let encoded: Vec<_> = streams.parents.iter().map(|parents| parents.parallelogram()).collect();
        prop_assert_eq!(&parents, &encoded);
        prop_assert_eq!(decode_naively(&view, vertex_count, streams.predicted), Some((fast, parents)));
        // One vertex too few or too many is noticed on both sides.
        prop_assert!(Connectivity::default().encode(&triangles, vertex_count + 1).is_err());
        prop_assert!(decode_fast(&view, vertex_count + 1, encoded.iter().flatten().count()).is_err());
    }

    #[test]
    fn any_streams_decode_alike(
        shapes in prop::collection::vec(prop_oneof![Just(0u8), 0u8..=130], 1..12),
        named in prop::collection::vec(prop_oneof![0u8..6, Just(255u8)], 0..20),
        far in prop::collection::vec(0u16..9, 0..3),
        extra in 0usize..2,
    ) {
        let far: Vec<u8> = far.iter().map(|distance| *distance as u8).chain(far.iter().map(|_| 0)).collect();
        let new: usize = shapes.iter().map(|code| [code / 25, code / 5 % 5, code % 5].iter().filter(|s| **s == 0).count()).sum();
        let named_count: usize = shapes.iter().map(|code| [code / 25, code / 5 % 5, code % 5].iter().filter(|s| **s == 4).count()).sum();
        let named = &named[..named.len().min(named_count + extra).min(3 * shapes.len())];
        let streams = Streams { shapes: &shapes, named, far: &far };
        let mut agreed = 0;
        for predicted in 0..=shapes.len() {
            let naive = decode_naively(&streams, new.max(1), predicted);
            let fast = decode_fast(&streams, new.max(1), predicted);
            agreed += usize::from(naive.is_some());
            prop_assert_eq!(fast.ok(), naive);
        }
        prop_assert!(agreed <= 1);
    }
}

#[test]
fn no_first_vertex_is_predicted() {
    // Vertex 0 across an edge of the triangle before the first: itself, which is not known yet.
    let shapes = [7, 0];
    let streams = Streams { shapes: &shapes, named: &[], far: &[] };
    assert!(decode_fast(&streams, 4, 1).is_err());
    let later = [31, 7, 0];
    let streams = Streams { shapes: &later, named: &[], far: &[] };
    assert!(decode_fast(&streams, 4, 1).is_err());

    let mut bytes = vec![0; BLOCK_HEADER_BYTES];
    bytes[0] = 0xb1;
    // Two triangles, four vertices, one of them predicted, one run of ids, one of materials.
    for (at, count) in [(10, 2), (12, 4), (14, 1), (20, 1), (22, 1), (24, 8)] {
        bytes[at] = count;
    }
    bytes.extend([7, 0, 1, 0, 0, 0, 1, 0]);
    let check = BlockCheck {
        block: BlockId(0),
        checksum: checksum(&bytes),
        triangle_count: 2,
        vertex_count: 4,
        material_range: [0, 0],
    };
    let limits = BlockLimits { block_bytes_max: 4096 };
    let mut scratch = DecodeScratch::with_limits(limits);
    let mut outcomes = [0.0, 7.0].map(|before| {
        let mut data = BlockData::with_limits(limits);
        data.vertices.resize(9, [before; 3]);
        let decoded = decode(&bytes, &check, Precision::Float32, limits, &mut scratch, &mut data);
        decoded.map(|()| data.vertices.clone())
    });
    outcomes.sort_by_key(|outcome| outcome.is_err());
    assert_eq!(outcomes[0], outcomes[1], "what was decoded before shows");
}
