//! PLY: each form and each fault.

use super::{error, ply};

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";
const FACE: &str = "property list uchar int vertex_indices\n";

fn ascii(text: &str) -> String {
    format!("ply\nformat ascii 1.0\n{text}")
}

fn square(faces: &str, count: usize) -> String {
    ascii(&format!(
        "element vertex 4\n{XYZ}element face {count}\n{FACE}end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n{faces}"
    ))
}

#[test]
fn text() {
    let (mesh, report) = ply(square("3 0 1 2\n4 0 1 2 3\n2 0 1\n0\n", 4)).unwrap();
    assert_eq!(mesh.vertices[2], [1.0, 1.0, 0.0]);
    assert_eq!(mesh.float32_count, 0);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 1, 2], [0, 2, 3]]);
    assert_eq!((report.polygons, report.degenerate_faces), (1, 2));
    // Other line ends, no last one, numbers spread over lines, floats where whole numbers are meant.
    for text in [
        square("3 0 1 2", 1).replace('\n', "\r\n"),
        square("3 0 1 2", 1).replace('\n', "\r"),
        square("3\n0\n 1\t2 ", 1),
        square("3 0.0 1.0 2e0\n", 1),
    ] {
        assert_eq!(ply(&text).unwrap().0.triangles, [[0, 1, 2]], "{text:?}");
    }
}

#[test]
fn header_lines_of_every_kind() {
    let text = ascii(&format!(
        "comment made by \u{e9}\nobj_info x\nelement other 2\nproperty list uchar float things\nproperty double w\n\
         element vertex 3\nproperty uchar red\n{XYZ}property float nx\nelement face 1\n\
         property list uint8 float texcoord\nproperty list uint8 uint32 vertex_index\nproperty int flags\n\
         element edge 1\nproperty int v1\nproperty int v2\nend_header\n\
         2 0.5 0.5 1\n0 1\n255 0 0 0 1\n255 1 0 0 1\n255 1 1 0 1\n2 0 0 3 0 1 2 7\n0 1\n"
    ));
    let (mesh, report) = ply(text).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    assert_eq!(mesh.vertices[1], [1.0, 0.0, 0.0]);
    let ignored = report.ignored;
    assert_eq!(
        (ignored.unknown, ignored.vertex_colors, ignored.normals, ignored.lines_and_points),
        (2, 3, 3, 1)
    );
}

#[test]
fn stray_header_lines_are_warnings() {
    let text = square("3 0 1 2\n", 1).replace("element vertex", "Created by hand\nelement vertex");
    let (mesh, report) = ply(text).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    assert_eq!(
        report.warnings[0].to_string(),
        "folder/model.ply:3: `Created by hand` is not a header line; it is left out"
    );
}

#[test]
fn strips_restart_and_turn() {
    let text = ascii(&format!(
        "element vertex 6\n{XYZ}element tristrips 1\n{FACE}end_header\n{}9 0 1 2 3 -1 3 4 5 5\n",
        "0 0 0\n".repeat(6)
    ));
    assert_eq!(ply(text).unwrap().0.triangles, [[0, 1, 2], [2, 1, 3], [3, 4, 5]]);
}

#[test]
fn narrow_integers_stay_exact_in_f32_and_wide_ones_do_not_go_there() {
    for (scalar, bytes, float32) in [("short", 2, 3), ("int", 4, 0)] {
        let header = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty {scalar} x\nproperty {scalar} y\n\
             property {scalar} z\nelement face 1\n{FACE}end_header\n"
        );
        let mut data = header.into_bytes();
        for value in 0..9_i32 {
            data.extend_from_slice(&(value * 1000).to_le_bytes()[..bytes]);
        }
        data.extend_from_slice(&[3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
        let (mesh, _) = ply(data).unwrap();
        assert_eq!(mesh.vertices[2], [6000.0, 7000.0, 8000.0]);
        assert_eq!(mesh.float32_count, float32, "{scalar}");
    }
}

#[test]
fn face_colors_become_materials() {
    let text = ascii(&format!(
        "element vertex 3\n{XYZ}element face 3\n{FACE}property uchar red\nproperty uchar green\nproperty uchar blue\n\
         end_header\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2 255 0 0\n3 0 1 2 0 0 255\n3 0 1 2 255 0 0\n"
    ));
    let (mesh, report) = ply(text).unwrap();
    assert_eq!(report.materials, 2);
    assert_eq!(mesh.materials[0].diffuse, [1.0, 0.0, 0.0]);
    assert_eq!(mesh.materials[1].name, "color #0000ff");
    assert_eq!(mesh.triangle_materials.iter().map(|id| id.0).collect::<Vec<_>>(), [0, 1, 0]);
}

#[test]
fn many_face_colors_take_the_nearest() {
    let mut data = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\n{XYZ}element face 2000\n{FACE}property uchar red\n\
         property uchar green\nproperty uchar blue\nend_header\n"
    )
    .into_bytes();
    data.extend_from_slice(&[0; 36]);
    for i in 0..2000_u32 {
        data.extend_from_slice(&[3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
        data.extend_from_slice(&[(i / 256) as u8, (i % 256) as u8, 0]);
    }
    let (mesh, report) = ply(data).unwrap();
    assert_eq!((report.materials, report.warning_count), (1024, 1));
    // Colour (4, 7, 0) is not among the first 1024; (3, 7, 0) is the nearest.
    assert_eq!(mesh.triangle_materials[4 * 256 + 7].0, 3 * 256 + 7);
}

#[test]
fn faults_name_place_and_reason() {
    let at = "folder/model.ply";
    for (text, expected) in [
        ("".to_string(), format!("{at} at byte 0: not a PLY file: it does not start with a line `ply`")),
        ("ply\nformat ascii 1.0\n".into(), format!("{at}:3: the file ends before `end_header`")),
        ("ply\nformat best 1.0\n".into(), format!("{at}:2: unknown format `best`")),
        ("ply\nproperty float x\n".into(), format!("{at}:2: a property before the first element")),
        (ascii("element vertex -1\n"), format!("{at}:3: `-1` is not a count of records")),
        (ascii("element v 1\nproperty half x\n"), format!("{at}:4: unknown property type `half`")),
        (ascii("end_header\n"), format!("{at}:3: the header has no element `vertex`")),
        (
            ascii("element vertex 1\nproperty float x\nend_header\n"),
            format!("{at}:6: the element `vertex` has no property `y`"),
        ),
        (square("3 0 1\n", 1), format!("{at}:15: the file ends here, but its header promises more records")),
        (
            square("3 0 1 4\n", 1),
            format!("{at}:14: a face names vertex 4 of 4 (just before this place; counted from 0)"),
        ),
        (square("3 0 1 x\n", 1), format!("{at}:14: `x` is not a number")),
        (square("3 0 1 1.5\n", 1), format!("{at}:14: 1.5 where a whole number must stand")),
        (square("-3 0 1 1\n", 1), format!("{at}:14: a list with -3 items")),
        (
            ascii(&format!("element face 1\n{FACE}element vertex 3\n{XYZ}end_header\n3 0 1 2\n")),
            format!(
                "{at}:9: faces come before vertices; import it as a file (not from a stream), so that it can be read \
                 twice"
            ),
        ),
    ] {
        assert_eq!(error(ply(&text)), expected, "{text:?}");
    }
    let mut data = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\n{XYZ}element face 2\n{FACE}end_header\n"
    )
    .into_bytes();
    let body = data.len();
    data.extend_from_slice(&[0; 36]);
    data.extend_from_slice(&[3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0]);
    assert_eq!(
        error(ply(&data)),
        format!("{at} at byte {}: the file ends here, but its header promises more records", body + 36 + 14)
    );
    // A count that nothing could hold is met by the end of the file, not by an allocation.
    let huge =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex 4294967295\n{XYZ}end_header\nxxxx");
    assert!(error(ply(huge)).contains("the file ends here"));
    let endless = ascii(&format!("element x 18446744073709551615\nelement vertex 0\n{XYZ}end_header\n"));
    assert_eq!(ply(endless).unwrap().0.vertices.len(), 0);
}

/// Records of no properties take no bytes, so any number of them can be promised.
#[test]
fn counts_of_what_is_left_out_do_not_overflow() {
    let text = "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\n\
        element a 18446744073709551615\nelement b 18446744073709551615\nelement edge 18446744073709551615\n\
        element edge 1\nend_header\n";
    let (_, report) = ply(text).unwrap();
    assert_eq!((report.ignored.unknown, report.ignored.lines_and_points), (u64::MAX, u64::MAX));
}

/// As MeshLab writes them: texture coordinates for each corner of a face.
#[test]
fn texture_coordinates_of_faces_are_counted() {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n\
        0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0 0 1 0 0 1\n";
    let (mesh, report) = ply(text).unwrap();
    assert_eq!((mesh.triangles.len(), report.ignored.texture_coordinates), (1, 1));
}
