//! OBJ: each form, each fault, and `tobj` as oracle.

use proptest::prelude::*;

use super::{Dribble, error, obj};
use crate::import::{ImportOptions, MeshBuffer, read_obj};

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

/// The triangles of faces over the unit square.
fn faces(text: &str) -> Vec<[u32; 3]> {
    obj(format!("{SQUARE}{text}")).unwrap().0.triangles
}

#[test]
fn vertices_of_every_form() {
    let text = "v 1 2 3\nv\t-1.5\t.5\t1.\nv  1e-3   +2  3.25e2 \nv 1 2 3 0.5\nv 1 2 3 0.1 0.2 0.3\nv 1 2 3 1 0.1 0.2 0.3\n \
                v 7 8 9\nv 1 2 3 # remark\nv 1 2 \\\n 4\nv 0.1 123456789012345678901234567890 1e400";
    let (mesh, _) = obj(text).unwrap();
    assert_eq!(mesh.vertices[..3], [[1.0, 2.0, 3.0], [-1.5, 0.5, 1.0], [1e-3, 2.0, 325.0]]);
    assert_eq!(
        mesh.vertices[3..8],
        [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [7.0, 8.0, 9.0], [1.0, 2.0, 3.0]]
    );
    assert_eq!(mesh.vertices[8..], [[1.0, 2.0, 4.0], [0.1, 123456789012345678901234567890.0, f64::INFINITY]]);
    assert_eq!(mesh.float32_count, 0);
}

#[test]
fn faces_of_every_form() {
    for form in [
        "f 1 2 3",
        "f 1/1 2/2 3/3",
        "f 1//1 2//2 3//3",
        "f 1/1/1 2/2/2 3/3/3",
        "f -4 -3 -2",
        "f -4//-1 -3//-1 -2//-1",
        "f 1/ 2/ 3/",
        "f\t1\t2  3\t",
        "  f 1 2 3",
        "f 1 2 \\\n3",
        "f 1 2 3 # remark",
        "f 00001 2 3",
        "fo 1 2 3",
        "f +1 2 3",
    ] {
        for end in ["", "\n", "\r\n", "\r", " \n", " \r\n"] {
            assert_eq!(faces(&format!("{form}{end}")), [[0, 1, 2]], "{form:?} {end:?}");
        }
    }
    assert_eq!(faces("f 1 2 3 4\n"), [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(faces("f 1 1 2 2 3 1\n"), [[0, 1, 2]]);
    assert_eq!(faces("f 1 2\nf 1\nf\nf 1 1 2 2\n"), [[0; 3]; 0]);
    let (_, report) = obj(format!("{SQUARE}f 1 2\nf 1 1 2 2\nf 1 2 3 4\n")).unwrap();
    assert_eq!((report.degenerate_faces, report.polygons, report.fans), (2, 1, 0));
}

#[test]
fn concave_faces_are_cut_inside() {
    let (mesh, report) = obj("v 0 0 0\nv 4 -4 0\nv 0 8 0\nv -4 -4 0\nf 2 3 4 1\n").unwrap();
    assert_eq!((report.polygons, report.fans), (1, 0));
    // The diagonal starts at the notch.
    assert!(mesh.triangles.iter().all(|triangle| triangle.contains(&0) && triangle.contains(&2)));
}

#[test]
fn line_ends_of_every_kind() {
    let text = "# remark\nv 0 0 0\nv 1 0 0\n\nv 1 1 0\nf 1 2 \\\n 3\n";
    let plain = obj(text).unwrap();
    for end in ["\r\n", "\r"] {
        assert_eq!(obj(text.replace('\n', end)).unwrap(), plain, "{end:?}");
    }
    // Wherever the reads fall, and with a byte order mark.
    for step in 1..30 {
        let mut mesh = MeshBuffer::new();
        let text = text.replace('\n', "\r\n");
        read_obj(Dribble(text.as_bytes(), step), "x.obj".as_ref(), &ImportOptions::default(), &mut mesh)
            .unwrap();
        assert_eq!(mesh, plain.0);
    }
    assert_eq!(obj(format!("\u{FEFF}{text}")).unwrap().0, plain.0);
    // Vertical tabs, before words too, and in a remark, which does not go on in the next line.
    let tabs = text.replace(' ', "\u{B}").replace("v", "\u{B}v");
    assert_eq!(obj(tabs).unwrap().0, plain.0);
    assert_eq!(obj(format!("\u{B}# remark \\\n{text}")).unwrap().0, plain.0);
}

#[test]
fn lines_across_windows() {
    // Long enough that windows end at every kind of place: inside numbers, line ends and continuations.
    let mut text = String::new();
    for i in 0..60_000 {
        text += &format!("v {i} 0.5 -1.25\r\nv {i} \\\r\n 1 2\r\nv {i}.125 7 8\n");
        text += &format!("f {} -2 \\\n -1\n", 3 * i + 1);
    }
    let (mesh, _) = obj(&text).unwrap();
    assert!(text.len() > 3 << 20);
    for i in 0..60_000 {
        let x = i as f64;
        assert_eq!(mesh.vertices[3 * i..3 * i + 3], [[x, 0.5, -1.25], [x, 1.0, 2.0], [x + 0.125, 7.0, 8.0]]);
        assert_eq!(mesh.triangles[i], [3 * i as u32, 3 * i as u32 + 1, 3 * i as u32 + 2]);
    }
}

#[test]
fn everything_else_is_counted() {
    let text = "g a b\no c\ns 1\nvn 0 0 1\nvn 0 0 1\nvt 0 0\nl 1 2\np 1\ncurv 0 1 2\nxyzzy\n";
    let (_, report) = obj(format!("{SQUARE}{text}f 1 2 3\n")).unwrap();
    let ignored = report.ignored;
    assert_eq!(
        (ignored.normals, ignored.texture_coordinates, ignored.lines_and_points, ignored.unknown),
        (2, 1, 2, 2)
    );
    assert_eq!(report.warning_count, 0);
}

#[test]
fn any_encoding() {
    let (mesh, report) =
        obj(b"# \xE9\xFF\x80 \\\ng \xC3\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl \xE9\nf 1 2 3\n").unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    assert_eq!(report.warnings.len(), 1);
    assert_eq!(report.warnings[0].line, Some(6));
}

#[test]
fn missing_libraries_and_materials_are_warnings() {
    let text = format!("mtllib absent.mtl\n{SQUARE}usemtl red\nf 1 2 3\nusemtl red\nf 1 3 4\n");
    let (mesh, report) = obj(text).unwrap();
    assert_eq!(mesh.triangles.len(), 2);
    assert_eq!(mesh.materials.len(), 1);
    let warnings: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    assert_eq!(
        warnings,
        [
            "folder/model.obj:1: the material library `absent.mtl` is not there",
            "folder/model.obj:6: the material `red` is not defined; the default one is used"
        ]
    );
}

#[test]
fn faults_name_line_and_reason() {
    for (text, expected) in [
        ("v 1 2\n", "folder/model.obj:1: `v` with 2 numbers; three are needed"),
        ("\nv 1 2 x\n", "folder/model.obj:2: `x` is not a number"),
        ("v 1 2 3 4 5 6 7 8\n", "folder/model.obj:1: `v` with more than seven numbers"),
        ("v 1 2 3\nf 1 0 1\n", "folder/model.obj:2: a face names vertex 0; indices start at 1"),
        ("v 1 2 3\nf 1 1 2\n", "folder/model.obj:2: a face names vertex 2, but only 1 have come"),
        ("v 1 2 3\nf 1 1 -2\n", "folder/model.obj:2: a face names vertex -2, but only 1 have come"),
        (
            "v 1 2 3\n#\\\nf 1 \\\n1 1.5\n",
            "folder/model.obj:3: `1.5` is not a corner of a face (a, a/b, a//c or a/b/c)",
        ),
        (
            "v 1 2 3\nf 1/1/1/1 1 1\n",
            "folder/model.obj:2: `1/1/1/1` is not a corner of a face (a, a/b, a//c or a/b/c)",
        ),
        (
            "v 1 2 3\nf 1 1 1/-\n",
            "folder/model.obj:2: `1/-` is not a corner of a face (a, a/b, a//c or a/b/c)",
        ),
        (
            "v 1 2 3\nf 1 1 99999999999999999999\n",
            "folder/model.obj:2: `99999999999999999999` is not a corner of a face (a, a/b, a//c or a/b/c)",
        ),
        (
            "v 1 2 3\nf 1 1 4294967297\n",
            "folder/model.obj:2: a face names vertex 4294967297, but only 1 have come",
        ),
        (
            "PK\u{3}\u{4} zip\n",
            "folder/model.obj:1: `PK\u{3}\u{4}` is not an OBJ statement, and there is none in the whole file",
        ),
    ] {
        assert_eq!(error(obj(text)), expected, "{text:?}");
    }
}

#[test]
fn long_lines_are_bounded() {
    let comment = format!("#{}\n{SQUARE}#{}\nf 1 2 3\nf 1 2 9\n", "x".repeat(3 << 20), "y".repeat(2 << 20));
    assert_eq!(error(obj(comment)), "folder/model.obj:8: a face names vertex 9, but only 4 have come");
    let long = format!("{SQUARE}f {}\n", "1 ".repeat(1 << 20));
    assert_eq!(error(obj(long)), "folder/model.obj:5: a line of more than 1 MiB");
    let many = format!("{SQUARE}f {}\n", "1 2 ".repeat(1 << 16));
    assert_eq!(error(obj(many)), "folder/model.obj:5: a face with more than 65536 corners");
    let endless = format!("{SQUARE}f 1 2 {}\n", "\\\n".repeat(1 << 20));
    assert_eq!(error(obj(endless)), "folder/model.obj:5: a line of more than 1 MiB");
}

/// Text of an OBJ file of triangles in mixed forms, where `tobj` and this reader must agree.
fn model() -> impl Strategy<Value = String> {
    let vertex = prop::array::uniform3(-1e4_f32..1e4).prop_map(|[x, y, z]| format!("v {x} {y} {z}"));
    let face = (prop::array::uniform3(0_u32..4), 0..4_u8).prop_map(|(corners, form)| {
        let corner = |c: u32| match form {
            0 => format!("{}", c + 1),
            1 => format!("-{}", c + 1),
            2 => format!("{}/1", c + 1),
            _ => format!("{}//1", c + 1),
        };
        format!("f {}", corners.map(corner).join(" "))
    });
    let rest = prop_oneof![vertex.clone(), face, Just("# remark".to_string()), Just("s off".to_string())];
    let end = prop_oneof![Just("\n"), Just("\r\n")];
    (prop::collection::vec(vertex, 4), prop::collection::vec(rest, 1..60), end).prop_map(
        |(first, rest, end)| {
            let front = ["vt 0 0".to_string(), "vn 0 0 1".to_string()];
            [front.to_vec(), first, rest].concat().join(end) + end
        },
    )
}

proptest! {
    #[test]
    fn agrees_with_tobj(text in model()) {
        let (mesh, _) = obj(&text).unwrap();
        let options = tobj::LoadOptions::default();
        let (models, _) = tobj::load_obj_buf(&mut text.as_bytes(), &options, |_| unreachable!()).unwrap();
        // tobj renumbers vertices per object and keeps f32, so compare corners in f32.
        let mut expected = Vec::new();
        for model in &models {
            for index in &model.mesh.indices {
                let at = *index as usize * 3;
                expected.push([0, 1, 2].map(|axis| model.mesh.positions[at + axis]));
            }
        }
        let found: Vec<[f32; 3]> =
            mesh.triangles.as_flattened().iter().map(|v| mesh.vertices[*v as usize].map(|x| x as f32)).collect();
        prop_assert_eq!(found, expected);
    }
}

/// Lines of every kind, good and bad, whole files of which must not depend on threads.
fn line() -> impl Strategy<Value = String> {
    let number = prop_oneof![
        4 => "-?[0-9]{1,3}\\.[0-9]{1,4}",
        1 => "-?[0-9]{1,3}\\.[0-9]{7,12}",
        1 => Just("1e-3".to_string()),
    ];
    let vertex = prop::array::uniform3(number).prop_map(|[x, y, z]| format!("v {x} {y} {z}"));
    let corner = prop_oneof![8 => "[1-4]", 2 => "-[1-3]", 1 => "[1-9]", 1 => "[1-3]/1", 1 => "[1-3]//"];
    let face = prop::collection::vec(corner, 3..6).prop_map(|corners| format!("f {}", corners.join(" ")));
    let other = prop::sample::select(vec![
        "",
        "# remark",
        "# goes on? \\",
        "g a \\",
        "s 1",
        "v 1 2 \\\n3",
        "v 1 2 \\\n\\\n3",
        "f 1 \\\n2 3",
        "usemtl red",
        " v 1 2 3 ",
        "v\t1 2 3 0.5",
        "vn 0 0 1",
        "xyzzy",
        "f 1 2",
        "g a\rv 4 5 6",
        "l 1 2",
    ]);
    let bad = prop::sample::select(vec!["v 1 2", "f 0 1 2", "f 1 2 900", "v 1 x 2", "f 1 2 x"]);
    prop_oneof![200 => vertex, 200 => face, 60 => other.prop_map(str::to_string), 1 => bad.prop_map(str::to_string)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn threads_change_nothing(
        lines in prop::collection::vec(line(), 1..120), end in prop_oneof![Just("\n"), Just("\r\n"), Just("\r")], last in any::<bool>(),
    ) {
        // `obj` reads both ways and compares.
        let mut text = SQUARE.replace('\n', end) + &lines.join(end);
        if last {
            text += end;
        }
        let _ = obj(text);
    }
}
