//! STL: each form and each fault.

use super::{error, stl};

/// A binary file of `facets` triangles whose header states `stated`.
fn binary(header: &str, stated: u32, facets: u32) -> Vec<u8> {
    let mut data = header.as_bytes().to_vec();
    data.resize(80, 0);
    data.extend_from_slice(&stated.to_le_bytes());
    for facet in 0..facets {
        data.extend_from_slice(&[0; 12]);
        for corner in 0..3 {
            for value in [facet as f32, corner as f32, 0.5] {
                data.extend_from_slice(&value.to_le_bytes());
            }
        }
        data.extend_from_slice(&[1, 2]);
    }
    data
}

fn facet(z: f64) -> String {
    format!(
        "  facet normal 0 0 1\n    outer loop\n      vertex 0 0 {z}\n      vertex 1 0 {z}\n      vertex 0 1 {z}\n    \
         endloop\n  endfacet\n"
    )
}

#[test]
fn binary_files() {
    for header in ["", "solid like text", "solid"] {
        let (mesh, report) = stl(binary(header, 40_000, 40_000)).unwrap();
        assert_eq!(mesh.triangles.len(), 40_000);
        assert_eq!(mesh.float32_count, 120_000);
        assert_eq!(mesh.corners(777), [[777.0, 0.0, 0.5], [777.0, 1.0, 0.5], [777.0, 2.0, 0.5]]);
        assert_eq!((report.warning_count, report.ignored.normals), (0, 40_000));
    }
    assert_eq!(stl(binary("", 0, 0)).unwrap().0.triangles.len(), 0);
}

#[test]
fn binary_files_with_wrong_counts() {
    let (mesh, report) = stl(binary("", 0, 5)).unwrap();
    assert_eq!((mesh.triangles.len(), report.warning_count), (5, 1));
    let (mesh, report) = stl(binary("", 3, 5)).unwrap();
    assert_eq!((mesh.triangles.len(), report.warning_count), (3, 1));
    assert_eq!(report.warnings[0].text, "bytes from 234 on, behind the last facet, are left out");
    assert_eq!(
        error(stl(binary("", 6, 5))),
        "folder/model.stl at byte 334: the file ends in facet 5 of the 6 that its header states"
    );
    assert_eq!(
        error(stl(b"xyz")),
        "folder/model.stl at byte 3: the file ends inside the 84 bytes that a binary STL file starts with"
    );
}

#[test]
fn text_that_is_cut_between_facets_is_told() {
    let whole = format!("solid a\n{}{}endsolid a\n", facet(1.0), facet(2.0));
    assert_eq!(stl(&whole).unwrap().1.warning_count, 0);
    assert_eq!(stl(whole.replace("endsolid", "end solid")).unwrap().1.warning_count, 0);
    // What stays of a `facet` or an `endsolid` is none.
    for end in ["", "  fac", "endso"] {
        let (mesh, report) = stl(format!("solid a\n{}{end}", facet(1.0))).unwrap();
        assert_eq!((mesh.triangles.len(), report.warning_count), (1, 1), "{end}");
        assert_eq!(report.warnings[0].text, "the file ends without `endsolid`: it may be cut short");
    }
}

#[test]
fn text_files() {
    let text =
        format!("solid a name\n{}{}endsolid\nsolid b\n{}endsolid b\n", facet(1.0), facet(2.5), facet(0.1));
    let plain = stl(&text).unwrap();
    assert_eq!(plain.0.triangles, [[0, 1, 2], [3, 4, 5], [6, 7, 8]]);
    assert_eq!(plain.0.vertices[6], [0.0, 0.0, 0.1]);
    assert_eq!(plain.0.float32_count, 0);
    for other in [
        text.replace('\n', "\r\n"),
        text.replace('\n', "\r"),
        text.to_uppercase(),
        text.trim_end().to_string(),
        text.replace(' ', "\t"),
        format!("\n  {text}"),
        // As some editors begin UTF-8.
        format!("\u{feff}{text}"),
    ] {
        assert_eq!(stl(&other).unwrap().0.vertices, plain.0.vertices, "{other:?}");
    }
    // Four corners are common enough.
    let quad = facet(0.0).replace("      vertex 0 1 0\n", "vertex 1 1 0\nvertex 0 1 0\n");
    assert_eq!(stl(format!("solid\n{quad}endsolid\n")).unwrap().0.triangles, [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn faults_name_line_and_reason() {
    let at = "folder/model.stl";
    for (text, expected) in [
        (format!("solid\n{}", facet(1.0).replace("1 0 1", "1 x 1")), format!("{at}:5: `x` is not a number")),
        (format!("solid\n{}", facet(1.0).replace("1 0 1", "1 0")), format!("{at}:5: `` is not a number")),
        (
            format!("solid\n{}", facet(1.0).replace("      vertex 1 0 1\n", "")),
            format!("{at}:6: a facet with 2 vertices; three are needed"),
        ),
        ("solid\nfacet\nvertex 1 1 1\n".into(), format!("{at}:3: `vertex` outside of a loop")),
        ("solid\nfacet\nouter loop\nvertx 1 1 1\n".into(), format!("{at}:4: `vertx` inside a facet")),
        (
            format!("solid\n{}", facet(1.0).replace("  endfacet\n", "")),
            format!("{at}:8: the file ends inside the facet of line 2"),
        ),
        // Or else the triangle would be missing, and nobody would know.
        (
            format!("solid\n{}{}", facet(1.0).replace("    endloop\n", ""), facet(2.0)),
            format!("{at}:7: `endfacet` inside a loop: its `endloop` is missing"),
        ),
        (
            "solid\nfacet\nouter loop\nfacet\n".into(),
            format!("{at}:4: `facet` inside a loop: its `endloop` is missing"),
        ),
        (
            "solid\nfacet\nouter loop\nvertex 1 1 1\nouter loop\n".into(),
            format!("{at}:5: `outer` inside a loop: its `endloop` is missing"),
        ),
    ] {
        assert_eq!(error(stl(&text)), expected, "{text:?}");
    }
}

/// Facets on the line of `solid` would be lost without a word.
#[test]
fn text_without_line_ends_is_refused() {
    let text = "solid x facet normal 0 0 1 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet endsolid x";
    assert!(error(stl(text)).contains("line"), "{}", error(stl(text)));
    assert_eq!(stl("solid the facet of a vertex\nendsolid the facet of a vertex\n").unwrap().1.triangles, 0);
}
