//! Texture coordinates and normals from model files to hits: each triangle gets those that its file gives it, in bounded memory, and models
//! without any are stored as if there were no such thing.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use outcrop::attributes::AttributeCache;
use outcrop::block::attributes::{CornerAttributes, PAGE_TRIANGLES};
use outcrop::block::{Codec, checksum};
use outcrop::compile::{
    CompileOptions, CompileReport, Control, LazyModel, LazyOptions, Threads, compile_file,
};
use outcrop::error::{LoadError, SourceError};
use outcrop::model::HEADER_BYTES;
use outcrop::source::{DiskSource, MemorySource, PageCache};
use outcrop::units::{Bytes, TriangleId};
use outcrop::{BlockSource, MemoryBudget};

fn compile(input: &Path, options: &CompileOptions, budget: &MemoryBudget) -> (PathBuf, CompileReport) {
    let output = input.with_extension("outcrop");
    let report = compile_file(input, &output, options, budget, &mut |_| Control::Continue).unwrap();
    assert_eq!(budget.used(), Bytes(0));
    (output, report)
}

fn compile_text(dir: &Path, name: &str, text: &str) -> (PathBuf, CompileReport) {
    let input = dir.join(name);
    fs::write(&input, text).unwrap();
    compile(&input, &CompileOptions::default(), &MemoryBudget::new(Bytes::mib(64)))
}

/// The attributes of the first `count` triangles.
fn all(source: Arc<dyn BlockSource>, count: u64) -> Vec<CornerAttributes> {
    let budget = MemoryBudget::new(Bytes::mib(16));
    let cache = AttributeCache::open(source, Bytes::mib(1), 1, &budget).unwrap();
    let mut reader = cache.reader();
    (0..count).map(|id| reader.get(TriangleId(id)).unwrap()).collect()
}

fn read(path: &Path, count: u64) -> Vec<CornerAttributes> {
    all(Arc::new(DiskSource::open(path).unwrap()), count)
}

fn near(found: Option<[[f64; 3]; 3]>, expected: [[f64; 3]; 3]) {
    let found = found.expect("normals");
    for (found, expected) in found.as_flattened().iter().zip(expected.as_flattened()) {
        assert!((found - expected).abs() < 1e-4, "{found} {expected}");
    }
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

#[test]
fn every_form_of_index_in_an_obj_file() {
    let place = tempfile::tempdir().unwrap();
    let values = "vt 0 0\nvt 1 0 0.5\nvt 1 1\nvt 0.25\nvn 0 0 2\nvn 0 3 0\nvn 1 0 0\nvn 0 0 -1\n";
    let faces = "f 1/1/1 2/2/2 3/3/3\n\
        f 1/1 3/3 4/4\n\
        f 1//4 2//3 3//2\n\
        f 1 2 3\n\
        f -4/-4/-4 -3/-3/-3 -2/-2/-2\n\
        f 1/1/1 2/2/2 3/3/3 4/4/4\n\
        f 1/1 2 3/3\n\
        f 1/9/9 2/2/2 3/3/3\n\
        f 1/0 2/2 3/3\n\
        f 1/1/1 1/1/1 2/2/2 3/3/3\n";
    // Attributes before, behind and between the faces; and faces that make the file be read twice.
    let texts = [
        format!("{SQUARE}{values}{faces}"),
        format!("{values}{SQUARE}{faces}").replace("-4/-4/-4 -3/-3/-3 -2/-2/-2", "1/1/1 2/2/2 3/3/3"),
        format!("{values}{faces}{SQUARE}").replace("-4/-4/-4 -3/-3/-3 -2/-2/-2", "1/-4/-4 2/-3/-3 3/-2/-2"),
        format!("{SQUARE}{values}{faces}").replace('\n', "\r\n").replace("vt 0.25", "vt 0.25 # only one"),
        format!("{SQUARE}{}{values}", faces.replace("-4/-4/-4 -3/-3/-3 -2/-2/-2", "1/1/1 2/2/2 3/3/3")),
    ];
    for (number, text) in texts.iter().enumerate() {
        let (path, report) = compile_text(place.path(), &format!("{number}.obj"), text);
        let found = read(&path, 12);
        let (uv, normal) =
            ([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
        // A full one, by positive and by negative indices; as part of a square; with a corner twice.
        for index in [0, 4, 10] {
            assert_eq!(found[index].uvs, Some(uv), "{number} {index}");
            near(found[index].normals, normal);
        }
        assert_eq!(found[1], CornerAttributes { uvs: Some([uv[0], uv[2], [0.25, 0.0]]), normals: None });
        assert_eq!(found[2].uvs, None);
        near(found[2].normals, [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        // Two triangles of a square between them have all four corners.
        let corners: Vec<_> = found[5..7].iter().flat_map(|triangle| triangle.uvs.unwrap()).collect();
        for corner in [uv[0], uv[1], uv[2], [0.25, 0.0]] {
            assert!(corners.contains(&corner), "{number}");
        }
        // None; partly; names some that are not there; index 0.
        for index in [3, 7, 8, 9] {
            assert_eq!(found[index], CornerAttributes::default(), "{number} {index}");
        }
        assert_eq!((report.triangles, report.triangles_with_attributes), (11, 7));
        assert_eq!(found[11], CornerAttributes::default());
    }
}

#[test]
fn ply_vertices_have_attributes() {
    let place = tempfile::tempdir().unwrap();
    for (u, v) in [("u", "v"), ("s", "t"), ("texture_u", "texture_v")] {
        let header = format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float nx\nproperty float y\nproperty float z\n\
             property float ny\nproperty float nz\nproperty uchar red\nproperty float {v}\nproperty float {u}\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        );
        let text =
            format!("{header}0 0 0 0 0 5 9 0.5 0.25\n1 0 0 0 1 0 9 2 1\n1 1 1 0 0 0 9 -1 -2\n3 0 1 2\n");
        let (path, _) = compile_text(place.path(), "a.ply", &text);
        let found = read(&path, 1)[0];
        assert_eq!(found.uvs, Some([[0.25, 0.5], [1.0, 2.0], [-2.0, -1.0]]));
        near(found.normals, [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
    }
}

#[test]
fn binary_ply_vertices_have_attributes_read_in_bulk_or_one_by_one() {
    let place = tempfile::tempdir().unwrap();
    let count = 40_000u32;
    let value = |vertex: u32, place: u32| ((vertex * 7 + place * 13) % 1000) as f32 * 0.25 - 100.0;
    let mut found = Vec::new();
    // All in f32; with a texture coordinate in f64, which is not read in bulk; big-endian.
    for (name, u_type, is_big) in
        [("a.ply", "float", false), ("b.ply", "double", false), ("c.ply", "float", true)]
    {
        let order = if is_big { "big" } else { "little" };
        let mut bytes = format!(
            "ply\nformat binary_{order}_endian 1.0\nelement vertex {count}\nproperty float nx\nproperty float x\nproperty float y\n\
             property float z\nproperty uchar red\nproperty float ny\nproperty float nz\nproperty {u_type} u\nproperty float v\n\
             element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            count / 3
        )
        .into_bytes();
        let put = |bytes: &mut Vec<u8>, mut number: Vec<u8>| {
            if is_big {
                number.reverse();
            }
            bytes.extend(number);
        };
        for vertex in 0..count {
            for place in 0..8 {
                let number = value(vertex, place);
                match (place, u_type) {
                    (6, "double") => put(&mut bytes, f64::from(number).to_le_bytes().to_vec()),
                    _ => put(&mut bytes, number.to_le_bytes().to_vec()),
                }
                if place == 3 {
                    bytes.push(9);
                }
            }
        }
        for face in 0..count / 3 {
            bytes.push(3);
            (0..3).for_each(|corner| put(&mut bytes, (3 * face + corner).to_le_bytes().to_vec()));
        }
        let input = place.path().join(name);
        fs::write(&input, bytes).unwrap();
        let (path, _) = compile(&input, &CompileOptions::default(), &MemoryBudget::new(Bytes::mib(64)));
        found.push(read(&path, u64::from(count / 3)));
    }
    for (face, attributes) in (0..).zip(&found[0]) {
        let corners = [0, 1, 2].map(|corner| 3 * face + corner);
        assert_eq!(attributes.uvs, Some(corners.map(|vertex| [value(vertex, 6), value(vertex, 7)])));
        let normals = corners.map(|vertex| [0, 4, 5].map(|place| f64::from(value(vertex, place))));
        let unit = normals.map(|normal| {
            let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
            normal.map(|x| x / length)
        });
        near(attributes.normals, unit);
    }
    assert_eq!(found[0], found[1]);
    assert_eq!(found[0], found[2]);
}

/// A grid of `side` squares each way with its plane coordinates as texture coordinates, rows in a scrambled order.
fn grid(side: usize, with: bool) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    for i in 0..(side + 1) * (side + 1) {
        let (x, y) = (i % (side + 1), i / (side + 1));
        writeln!(text, "v {x} {y} {}", (x * 7 + y * 3) % 5).unwrap();
        if with {
            writeln!(text, "vt {x}.5 {y}\nvn {x} 1 {y}").unwrap();
        }
    }
    for row in 0..side {
        let y = row * 37 % side;
        for x in 0..side {
            let corner = |dx: usize, dy: usize| (y + dy) * (side + 1) + x + dx + 1;
            let name = |i: usize| if with { format!("{i}/{i}/{i}") } else { i.to_string() };
            let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)].map(name);
            writeln!(text, "f {a} {b} {c}\nf {a} {c} {d}").unwrap();
        }
    }
    text
}

#[test]
fn a_model_without_attributes_is_stored_as_before_and_blocks_never_change() {
    let place = tempfile::tempdir().unwrap();
    let write = |name: &str, text: String| {
        let path = place.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let budget = MemoryBudget::new(Bytes::mib(64));
    let file = |path: &Path, options: &CompileOptions| fs::read(compile(path, options, &budget).0).unwrap();
    let defaults = CompileOptions::default();
    let plain = file(&write("plain.obj", grid(30, false)), &defaults);
    // It tells how it was compiled, and nothing else beyond the oldest files.
    assert_eq!(plain[16..24], [8, 0, 0, 0, 0, 0, 0, 0]);
    assert!(plain[180..232].iter().chain(&plain[233..248]).all(|byte| *byte == 0) && plain[232] == 1);
    let with = write("with.obj", grid(30, true));
    let kept = file(&with, &defaults);
    let left_out = file(&with, &CompileOptions { attributes: false, ..defaults.clone() });
    assert_eq!(kept[16], 2 | 8);
    // The source's size and fingerprint stand in the header; all else is the same.
    assert_eq!(left_out[HEADER_BYTES..], plain[HEADER_BYTES..]);
    // Values that no face names are not attributes of anything.
    let unused = file(&write("unused.obj", grid(30, false) + "vt 1 2\nvn 1 2 3\n"), &defaults);
    assert_eq!(unused[HEADER_BYTES..], plain[HEADER_BYTES..]);
    let models = [plain, kept].map(|file| Arc::clone(MemorySource::new(file).unwrap().model()));
    assert_eq!(models[0].blocks, models[1].blocks);
}

#[test]
fn many_triangles_in_a_small_budget_on_any_threads() {
    let place = tempfile::tempdir().unwrap();
    let side = 120;
    let input = place.path().join("grid.obj");
    fs::write(&input, grid(side, true)).unwrap();
    let count = 2 * (side * side) as u64;
    let expected = |id: u64| {
        let (row, x) = (id as usize / 2 / side, id as usize / 2 % side);
        let y = row * 37 % side;
        let corner = |dx: usize, dy: usize| [(x + dx) as f32 + 0.5, (y + dy) as f32];
        if id.is_multiple_of(2) {
            [corner(0, 0), corner(1, 0), corner(1, 1)]
        } else {
            [corner(0, 0), corner(1, 1), corner(0, 1)]
        }
    };
    let mut files = Vec::new();
    for (threads, mib, codec) in [
        (Threads::One, 256, Codec::Lz4),
        (Threads::Count(3), 256, Codec::Lz4),
        (Threads::One, 40, Codec::Lz4),
    ] {
        let options = CompileOptions { threads, codec, ..CompileOptions::default() };
        let (path, report) = compile(&input, &options, &MemoryBudget::new(Bytes::mib(mib)));
        assert_eq!(report.triangles_with_attributes, count);
        let entries = DiskSource::open(&path).unwrap().model().attributes.clone();
        assert_eq!(entries.entries().len() as u64, count.div_ceil(PAGE_TRIANGLES as u64));
        files.push(fs::read(&path).unwrap());
    }
    assert!(files.iter().all(|file| *file == files[0]));
    let path = place.path().join("grid.outcrop");
    for (id, found) in (0..).zip(read(&path, count)) {
        assert_eq!(found.uvs, Some(expected(id)));
        assert!(found.normals.is_some());
    }
    // One slot, past the page cache, in an order that never finds a page again: as right, and slower.
    let source = Arc::new(DiskSource::open_with(&path, PageCache::Bypass).unwrap());
    let budget = MemoryBudget::new(Bytes::mib(2));
    let cache = AttributeCache::open(source, Bytes(0), 1, &budget).unwrap();
    assert_eq!(budget.used(), AttributeCache::bytes_needed(cache.model(), Bytes(0), 1));
    let mut reader = cache.reader();
    for round in 0..200 {
        let id = round * 10_007 % count;
        assert_eq!(reader.get(TriangleId(id)).unwrap().uvs, Some(expected(id)));
    }
    assert!(cache.stats().misses > 150, "{:?}", cache.stats());
    let small = MemoryBudget::new(Bytes::kib(64));
    let source = Arc::new(DiskSource::open(&path).unwrap());
    assert!(matches!(AttributeCache::open(source, Bytes(0), 1, &small), Err(LoadError::Budget(_))));
}

#[test]
fn damaged_and_shortened_files_are_refused() {
    let place = tempfile::tempdir().unwrap();
    let (path, _) = compile_text(place.path(), "grid.obj", &grid(40, true));
    let file = fs::read(&path).unwrap();
    let sound = all(Arc::new(MemorySource::new(file.clone()).unwrap()), 3200);
    let step = 1 + file.len() / 3000;
    for length in (0..file.len()).step_by(step).chain(file.len() - 30..file.len()) {
        assert!(
            matches!(MemorySource::new(file[..length].to_vec()), Err(SourceError::Model { .. })),
            "{length}"
        );
    }
    assert!(MemorySource::new([&file[..], &[0]].concat()).is_err());
    let model = Arc::clone(MemorySource::new(file.clone()).unwrap().model());
    let pages = &model.attributes.entries();
    let pages_end = pages.last().map(|page| page.offset + u64::from(page.stored_bytes)).unwrap() as usize;
    let pages_start = pages[0].offset as usize;
    // A flipped bit anywhere: an error when the file is opened, or when the page is read.
    let mut in_pages = 0;
    for at in (0..HEADER_BYTES).chain((pages_start..file.len()).step_by(7)) {
        let mut damaged = file.clone();
        damaged[at] ^= 1 << (at % 8);
        match MemorySource::new(damaged) {
            Err(_) => assert!(!(pages_start..pages_end).contains(&at), "{at}"),
            Ok(source) => {
                assert!((pages_start..pages_end).contains(&at), "{at}");
                let budget = MemoryBudget::new(Bytes::mib(16));
                let cache = AttributeCache::open(Arc::new(source), Bytes::mib(1), 1, &budget).unwrap();
                let mut reader = cache.reader();
                let mut wrong = 0;
                for (id, sound) in (0..3200).zip(&sound) {
                    match reader.get(TriangleId(id)) {
                        Ok(found) => assert_eq!(found, *sound),
                        Err(LoadError::Attributes(error)) => {
                            assert_eq!(error.page, (id / PAGE_TRIANGLES as u64) as u32);
                            wrong += 1;
                        }
                        Err(other) => panic!("{other}"),
                    }
                }
                assert!(wrong > 0);
                in_pages += 1;
            }
        }
    }
    assert!(in_pages > 100);
    // A directory of pages that lies, under good checksums.
    let directory = u64::from_le_bytes(file[180..188].try_into().unwrap()) as usize;
    for (at, value) in [
        (directory, 1u8),
        (directory + 16, 200),
        (directory + 20, 255),
        (directory + 23, 255),
        (204, 3),
        (188, 9),
    ] {
        let mut damaged = file.clone();
        damaged[at] ^= value;
        if let Some(part) = damaged.get(directory..directory + 24 * pages.len()) {
            let sum = checksum(part);
            damaged[196..204].copy_from_slice(&sum.to_le_bytes());
        }
        let sum = checksum(&damaged[..HEADER_BYTES - 8]);
        damaged[HEADER_BYTES - 8..HEADER_BYTES].copy_from_slice(&sum.to_le_bytes());
        match MemorySource::new(damaged) {
            // A count that is possible, but not that of the page: told when it is read.
            Ok(source) => {
                let budget = MemoryBudget::new(Bytes::mib(16));
                let cache = AttributeCache::open(Arc::new(source), Bytes::mib(1), 1, &budget).unwrap();
                assert!(cache.reader().get(TriangleId(0)).is_err(), "{at}");
            }
            Err(error) => assert!(error.to_string().contains("damaged"), "{error}"),
        }
    }
}

#[test]
fn a_lazy_compile_says_that_it_leaves_them_out() {
    let place = tempfile::tempdir().unwrap();
    let input = place.path().join("grid.obj");
    fs::write(&input, grid(20, true)).unwrap();
    let budget = MemoryBudget::new(Bytes::mib(64));
    let open = |options: &LazyOptions| {
        let output = place.path().join("grid.outcrop");
        LazyModel::open(&input, &output, options, &budget, &mut |_| Control::Continue).unwrap()
    };
    let model = open(&LazyOptions::default());
    assert!(model.report().details_left_out);
    assert!(model.finish(&mut |_| Control::Continue).unwrap_err().to_string().contains("as a whole"));
    assert!(model.model().attributes.is_empty() && !model.gives_attributes());
    let mut page = Vec::new();
    assert!(matches!(model.read_attributes(0, &mut page), Err(SourceError::NoAttributes { .. })));
    drop(model);
    // It is still known when the source is not read again.
    let again = open(&LazyOptions::default());
    assert!(again.report().was_reopened && again.report().details_left_out);
    drop(again);
    let mut options = LazyOptions { anew: true, ..LazyOptions::default() };
    options.compile.attributes = false;
    let model = open(&options);
    assert!(!model.report().details_left_out);
    model.finish(&mut |_| Control::Continue).unwrap();
}
