//! Damaged files: every truncation and many random changes give a typed error or part of the mesh, never a panic,
//! and never an allocation that the file chose (I5).

use super::{obj, ply, stl};
use crate::procedural::random::Random;

fn ply_bytes(format: &str) -> Vec<u8> {
    let mut data = format!(
        "ply\nformat {format} 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nelement face 3\nproperty list uchar int vertex_indices\nproperty uchar red\n\
         property uchar green\nproperty uchar blue\nelement tristrips 1\nproperty list int int vertex_indices\n\
         end_header\n"
    )
    .into_bytes();
    if format == "ascii" {
        data.extend_from_slice(
            b"0 0 0 1\n1 0 0 2\n1 1 0 3\n0 1 0 4\n3 0 1 2 1 2 3\n4 0 1 2 3 1 2 3\n3 0 1 2 9 9 9\n5 0 1 2 -1 3\n",
        );
        return data;
    }
    let big = format.contains("big");
    let mut rest = Vec::new();
    for [x, y] in [[0.0_f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
        for value in [x, y, 0.0] {
            rest.extend(if big { value.to_be_bytes() } else { value.to_le_bytes() });
        }
        rest.push(7);
    }
    for face in [[0_u32, 1, 2].as_slice(), &[0, 1, 2, 3], &[2, 1, 0]] {
        rest.push(face.len() as u8);
        for corner in face {
            rest.extend(if big { corner.to_be_bytes() } else { corner.to_le_bytes() });
        }
        rest.extend([1, 2, 3]);
    }
    for value in [5, 0, 1, 2, u32::MAX, 3] {
        rest.extend(if big { u32::to_be_bytes(value) } else { u32::to_le_bytes(value) });
    }
    data.extend(rest);
    data
}

fn obj_bytes() -> Vec<u8> {
    b"# remark\r\nmtllib x.mtl\nv 0 0 0\nv 1.5 -2.25e1 0 1\nv 1 1 0.123456789012345678\nv 0 1 0\nvn 0 0 1\nvt 0 0\n\
      usemtl a\nf 1 2 3\nf 1//1 2//1 3//1\nf -1 -2 \\\n -3 -4\nf 1/1/1 2/1/1 3/1/1 4/1/1\ng x\nl 1 2\n"
        .to_vec()
}

fn stl_bytes() -> [Vec<u8>; 2] {
    let text =
        b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1.5e0 0\nendloop\n\
        endfacet\nendsolid x\n";
    let mut binary = vec![b's'; 80];
    binary.extend([2, 0, 0, 0]);
    binary.extend([63; 100]);
    [text.to_vec(), binary]
}

type Sample = (Vec<u8>, fn(&[u8]) -> bool);

/// Every sample with its reader; `true` if it was read to the end.
fn samples() -> Vec<Sample> {
    let mut samples: Vec<Sample> = vec![(obj_bytes(), |bytes| obj(bytes).is_ok())];
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        samples.push((ply_bytes(format), |bytes| ply(bytes).is_ok()));
    }
    for bytes in stl_bytes() {
        samples.push((bytes, |bytes| stl(bytes).is_ok()));
    }
    samples
}

#[test]
fn every_truncation() {
    for (bytes, read) in samples() {
        assert!(read(&bytes), "{}", String::from_utf8_lossy(&bytes));
        for length in 0..bytes.len() {
            read(&bytes[..length]);
        }
    }
}

#[test]
fn truncated_binary_files_never_pass_for_whole() {
    for (bytes, read) in samples() {
        let binary = bytes.starts_with(b"ssss") || bytes.starts_with(b"ply\nformat binary");
        for length in 0..bytes.len() {
            assert!(!(binary && read(&bytes[..length])), "{length} of {}", bytes.len());
        }
    }
}

#[test]
fn random_changes() {
    let mut generator = Random::new(1);
    let mut random = |below: usize| generator.below(below);
    for (bytes, read) in samples() {
        for _ in 0..1500 {
            let mut changed = bytes.clone();
            for _ in 0..=random(4) {
                let place = random(changed.len());
                match random(4) {
                    0 => changed[place] = random(256) as u8,
                    1 => changed[place] ^= 1 << random(8),
                    2 => drop(changed.remove(place)),
                    _ => changed.insert(place, b" \n\r\\/-.e9#\0\xFF"[random(12)]),
                }
            }
            read(&changed);
        }
    }
}

/// A line costs what it is long, not what is behind it: that would take minutes.
#[test]
fn many_empty_lines() {
    let text =
        ["v 0 0 0\n", &"\n".repeat(1 << 20), "v 1 0 0\n", &" \r\n".repeat(1 << 18), "v 0 1 0\nf 1 2 3\n"];
    assert_eq!(obj(text.concat()).unwrap().0.triangles, [[0, 1, 2]]);
}
