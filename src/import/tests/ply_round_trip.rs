//! PLY files of every kind, written here and read back.

use proptest::prelude::*;

use super::ply;

/// Types by their two names and sizes.
const TYPES: [(&str, &str, usize); 8] = [
    ("char", "int8", 1),
    ("uchar", "uint8", 1),
    ("short", "int16", 2),
    ("ushort", "uint16", 2),
    ("int", "int32", 4),
    ("uint", "uint32", 4),
    ("float", "float32", 4),
    ("double", "float64", 8),
];

#[derive(Clone, Copy, Debug)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Debug)]
struct Model {
    encoding: Encoding,
    new_names: bool,
    line_end: &'static str,
    /// Types of x, y, z, and of extra properties before, between and after them.
    axes: [usize; 3],
    extras: Vec<usize>,
    shuffle: u32,
    /// A list property among those of the vertices.
    vertex_list: bool,
    count_type: usize,
    index_type: usize,
    /// Small whole numbers, exact in every type.
    vertices: Vec<[i8; 3]>,
    faces: Vec<Vec<u8>>,
}

impl Model {
    fn name(&self, kind: usize) -> &'static str {
        if self.new_names { TYPES[kind].1 } else { TYPES[kind].0 }
    }

    fn value(&self, out: &mut Vec<u8>, kind: usize, value: i8) {
        let mut bytes = match kind {
            0..=5 => i64::from(value).to_le_bytes()[..TYPES[kind].2].to_vec(),
            6 => f32::from(value).to_le_bytes().to_vec(),
            _ => f64::from(value).to_le_bytes().to_vec(),
        };
        match self.encoding {
            Encoding::Ascii => bytes = format!("{value} ").into_bytes(),
            Encoding::Little => {}
            Encoding::Big => bytes.reverse(),
        }
        out.extend(bytes);
    }

    fn record_end(&self, out: &mut Vec<u8>) {
        if let Encoding::Ascii = self.encoding {
            out.extend(self.line_end.as_bytes());
        }
    }

    fn write(&self) -> Vec<u8> {
        let format = match self.encoding {
            Encoding::Ascii => "ascii",
            Encoding::Little => "binary_little_endian",
            Encoding::Big => "binary_big_endian",
        };
        // Properties of a vertex: an axis or an extra one, in some order.
        let mut order: Vec<Result<usize, usize>> =
            (0..3).map(Ok).chain(self.extras.iter().copied().map(Err)).collect();
        let by = self.shuffle as usize % order.len();
        order.rotate_left(by);
        if self.shuffle.is_multiple_of(3) {
            order.reverse();
        }
        let mut text =
            format!("ply\nformat {format} 1.0\ncomment x\nelement vertex {}\n", self.vertices.len());
        for property in &order {
            text += &match property {
                Ok(axis) => format!("property {} {}\n", self.name(self.axes[*axis]), ["x", "y", "z"][*axis]),
                Err(kind) => format!("property {} extra\n", self.name(*kind)),
            };
        }
        if self.vertex_list {
            text += "property list uchar short things\n";
        }
        text += &format!(
            "element face {}\nproperty {} before\nproperty list {} {} vertex_indices\nproperty uchar after\nend_header\n",
            self.faces.len(),
            self.name(3),
            self.name(self.count_type),
            self.name(self.index_type),
        );
        let mut out = text.replace('\n', self.line_end).into_bytes();
        for (index, vertex) in self.vertices.iter().enumerate() {
            for property in &order {
                match property {
                    Ok(axis) => self.value(&mut out, self.axes[*axis], vertex[*axis]),
                    Err(kind) => self.value(&mut out, *kind, 77),
                }
            }
            if self.vertex_list {
                let count = (index % 3) as i8;
                self.value(&mut out, 1, count);
                (0..count).for_each(|item| self.value(&mut out, 2, item));
            }
            self.record_end(&mut out);
        }
        for face in &self.faces {
            self.value(&mut out, 3, 9);
            self.value(&mut out, self.count_type, face.len() as i8);
            for corner in face {
                self.value(&mut out, self.index_type, *corner as i8);
            }
            self.value(&mut out, 1, 9);
            self.record_end(&mut out);
        }
        out
    }
}

fn models() -> impl Strategy<Value = Model> {
    let encoding = prop_oneof![Just(Encoding::Ascii), Just(Encoding::Little), Just(Encoding::Big)];
    let line_end = prop_oneof![Just("\n"), Just("\r\n"), Just("\r")];
    let axes = prop_oneof![Just([6, 6, 6]), Just([7, 7, 7]), prop::array::uniform3(0..8_usize)];
    // Values up to 127 fit every type if unsigned ones get no sign.
    let vertices = prop::collection::vec(prop::array::uniform3(0..=127_i8), 5..40);
    let face = prop_oneof![4 => prop::collection::vec(0..5_u8, 3), 1 => prop::collection::vec(0..5_u8, 0..7)];
    let faces = prop::collection::vec(face, 0..40);
    let head =
        (encoding, any::<bool>(), line_end, axes, prop::collection::vec(0..8_usize, 0..4), any::<u32>());
    (head, any::<bool>(), 0..8_usize, 0..8_usize, vertices, faces).prop_map(
        |(
            (encoding, new_names, line_end, axes, extras, shuffle),
            vertex_list,
            count_type,
            index_type,
            vertices,
            faces,
        )| {
            Model {
                encoding,
                new_names,
                line_end,
                axes,
                extras,
                shuffle,
                // A record of one size takes the bulk path; leave that most of the cases.
                vertex_list: vertex_list && shuffle.is_multiple_of(2),
                count_type: if shuffle % 4 < 2 { 1 } else { count_type },
                index_type: if shuffle % 8 < 4 { 4 + index_type % 2 } else { index_type },
                vertices,
                faces,
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn what_was_written_is_read(model in models()) {
        let (mesh, report) = ply(model.write()).unwrap();
        let vertices: Vec<[f64; 3]> = model.vertices.iter().map(|vertex| vertex.map(f64::from)).collect();
        prop_assert_eq!(&mesh.vertices, &vertices);
        let narrow = !matches!(model.encoding, Encoding::Ascii) && model.axes.iter().all(|kind| ![4, 5, 7].contains(kind));
        prop_assert_eq!(mesh.float32_count, if narrow { vertices.len() } else { 0 });
        let mut found = mesh.triangles.iter();
        for face in &model.faces {
            if let [a, b, c] = face[..] {
                prop_assert_eq!(found.next(), Some(&[a, b, c].map(u32::from)));
                continue;
            }
            let mut ring = face.clone();
            ring.dedup();
            while ring.len() > 1 && ring.first() == ring.last() {
                ring.pop();
            }
            for _ in 2..ring.len() {
                let triangle = found.next().expect("a polygon gives triangles");
                prop_assert!(triangle.iter().all(|corner| face.contains(&(*corner as u8))));
            }
        }
        prop_assert!(found.next().is_none());
        prop_assert_eq!(report.warning_count, 0);
    }
}
