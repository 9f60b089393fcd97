//! Round trips, and damage of every kind.

use proptest::prelude::*;

use super::*;
use crate::block::{Codec, checksum};

type Uvs = Vec<Option<[[f32; 2]; 3]>>;
type Normals = Vec<Option<[u32; 3]>>;

fn encode(uvs: &Uvs, normals: &Normals, codec: Codec) -> Option<(Vec<u8>, PageCheck)> {
    let mut out = Vec::new();
    let input = PageInput { uvs, normals };
    let check = encode_page(&input, codec, &mut PageEncodeScratch::default(), &mut out).unwrap();
    check.map(|check| (out, check))
}

fn decode(bytes: &[u8], check: &PageCheck) -> Result<Vec<u8>, crate::error::AttributeError> {
    let mut page = vec![0xee; page_bytes(check.uv_count, check.normal_count)];
    decode_page(bytes, check, &mut PageDecodeScratch::default(), &mut page).map(|()| page)
}

/// A strip of squares with shared corners, every seventh triangle without normals.
fn sample() -> (Uvs, Normals) {
    let uv = |i: usize| [i as f32 * 0.125, -(i as f32) * 0.5];
    let normal = |i: usize| normal_bits([i as f32 * 0.01, 1.0, -0.5]).unwrap();
    let corners = |i: usize| [i, i + 1, i + 2];
    let uvs = (0..90).map(|i| Some(corners(i).map(uv))).collect();
    let normals = (0..100).map(|i| (i % 7 != 0).then(|| corners(i).map(normal))).collect();
    (uvs, normals)
}

#[test]
fn directions_come_back() {
    for axis in 0..3 {
        for sign in [1.0f32, -1.0] {
            let mut normal = [0.0; 3];
            normal[axis] = sign * 3.0;
            let found = normal_of_bits(normal_bits(normal).unwrap());
            assert_eq!(found.map(|x| x as f32), normal.map(|x| x / 3.0));
        }
    }
    for bad in [[0.0; 3], [f32::NAN, 1.0, 0.0], [f32::INFINITY, 0.0, 0.0]] {
        assert_eq!(normal_bits(bad), None);
    }
    let mut worst = 0.0f64;
    for i in 0..20_000 {
        let (a, b) = (f64::from(i) * 0.618, f64::from(i) / 20_000.0 * 2.0 - 1.0);
        let r = (1.0 - b * b).sqrt();
        let normal = [r * a.cos(), b, r * a.sin()];
        let found = normal_of_bits(normal_bits(normal.map(|x| x as f32)).unwrap());
        let length: f64 = found.iter().map(|x| x * x).sum();
        assert!((length - 1.0).abs() < 1e-14);
        let apart: f64 = (0..3).map(|axis| (found[axis] - normal[axis]).powi(2)).sum();
        worst = worst.max(apart.sqrt().to_degrees());
    }
    assert!(worst < 0.005 && worst > 1e-4, "{worst}");
}

#[test]
fn pages_come_back() {
    let (uvs, normals) = sample();
    for codec in Codec::ALL.into_iter().filter(|codec| codec.is_available()) {
        let (bytes, check) = encode(&uvs, &normals, codec).unwrap();
        let page = decode(&bytes, &check).unwrap();
        for index in 0..PAGE_TRIANGLES {
            let found = corner_attributes(&page, index);
            assert_eq!(found.uvs, uvs.get(index).copied().flatten());
            let expected = normals.get(index).copied().flatten().map(|bits| bits.map(normal_of_bits));
            assert_eq!(found.normals, expected);
        }
        // Each value once.
        assert_eq!((check.uv_count, bytes.len() < 16 + 4 * 6144 + 92 * 12), (92, codec != Codec::Raw));
    }
    assert!(encode(&vec![None; 5], &Vec::new(), Codec::Lz4).is_none());
    let not_finite = vec![Some([[f32::NAN, 0.0], [0.0; 2], [0.0; 2]])];
    assert!(encode(&not_finite, &Vec::new(), Codec::Lz4).is_none());
}

#[test]
fn damaged_pages_are_refused_or_sound() {
    let (uvs, normals) = sample();
    let (mut refused, mut sound) = (0, 0);
    for codec in Codec::ALL.into_iter().filter(|codec| codec.is_available()) {
        let (bytes, check) = encode(&uvs, &normals, codec).unwrap();
        for length in (0..bytes.len()).step_by(1 + bytes.len() / 700) {
            let prefix = &bytes[..length];
            assert_eq!(decode(prefix, &check).unwrap_err().reason, "its checksum is wrong");
            let check = PageCheck { checksum: checksum(prefix), ..check };
            decode(prefix, &check).unwrap_err();
        }
        for extra in [1, 7, 100] {
            let longer = [&bytes[..], &vec![0; extra]].concat();
            let check = PageCheck { checksum: checksum(&longer), ..check };
            decode(&longer, &check).unwrap_err();
        }
        for change in [
            |check: &mut PageCheck| check.uv_count += 1,
            |check: &mut PageCheck| check.normal_count -= 1,
            |check: &mut PageCheck| check.checksum ^= 1,
        ] {
            let mut other = check;
            change(&mut other);
            decode(&bytes, &other).unwrap_err();
        }
        let mut state = 12_345u64;
        for round in 0..4000 {
            let mut damaged = bytes.clone();
            for _ in 0..1 + round % 3 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let bit = (state >> 20) as usize % (8 * damaged.len());
                damaged[bit / 8] ^= 1 << (bit % 8);
            }
            let check = PageCheck { checksum: checksum(&damaged), ..check };
            match decode(&damaged, &check) {
                Err(error) => {
                    assert!(error.offset <= damaged.len() as u64);
                    refused += 1;
                }
                Ok(page) => {
                    for index in 0..PAGE_TRIANGLES {
                        let found = corner_attributes(&page, index);
                        let finite =
                            |pairs: [[f32; 2]; 3]| pairs.as_flattened().iter().all(|x| x.is_finite());
                        assert!(found.uvs.is_none_or(finite));
                    }
                    sound += 1;
                }
            }
        }
    }
    // Both ways must have been taken for the test to mean anything.
    assert!(refused > 1000 && sound > 100, "{refused} refused, {sound} sound");
    // Too little room is an error, not a panic.
    let (bytes, check) = encode(&uvs, &normals, Codec::Lz4).unwrap();
    let mut short = vec![0; page_bytes(check.uv_count, check.normal_count) - 1];
    decode_page(&bytes, &check, &mut PageDecodeScratch::default(), &mut short).unwrap_err();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_page_comes_back(
        uvs in proptest::collection::vec(
            proptest::option::of(proptest::array::uniform3(proptest::array::uniform2(-4.0f32..4.0))), 0..300),
        normals in proptest::collection::vec(
            proptest::option::of(proptest::array::uniform3(0u32..=u32::MAX)), 0..300),
    ) {
        let Some((bytes, check)) = encode(&uvs, &normals, Codec::Lz4) else {
            prop_assert!(uvs.iter().all(Option::is_none) && normals.iter().all(Option::is_none));
            return Ok(());
        };
        let page = decode(&bytes, &check).unwrap();
        for index in 0..PAGE_TRIANGLES {
            let found = corner_attributes(&page, index);
            prop_assert_eq!(found.uvs, uvs.get(index).copied().flatten());
            let expected = normals.get(index).copied().flatten().map(|bits| bits.map(normal_of_bits));
            prop_assert_eq!(found.normals, expected);
        }
    }
}
