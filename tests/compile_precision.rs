//! How positions are held: the automatic choice, its bound, and lattices.

#[path = "support/compiling.rs"]
mod compiling;

use compiling::{Mesh, Place, Vertices, assert_same, compile, compile_with, read_back};
use outcrop::MemoryBudget;
use outcrop::compile::{
    AUTO_TOLERANCE, CompileOptions, CompileReport, Control, PrecisionChoice, Threads, compile_file,
};
use outcrop::error::CompileError;
use outcrop::geom::{Lattice, Precision};
use outcrop::model::{CompileRecord, PrecisionOrigin};
use outcrop::procedural::Gears;
use outcrop::procedural::export::{write_obj, write_ply};
use outcrop::units::Bytes;

const ROOMY: Bytes = Bytes::mib(256);
const TIGHT: Bytes = Bytes::mib(18);

fn options(precision: PrecisionChoice) -> CompileOptions {
    CompileOptions { precision, ..CompileOptions::default() }
}

/// A bumpy sheet of `side`^2 quads at `origin`, in f64.
fn sheet(side: u32, origin: [f64; 3], spacing: f64) -> Mesh {
    let mut vertices = Vec::new();
    for y in 0..=side {
        for x in 0..=side {
            let (fx, fy) = (f64::from(x), f64::from(y));
            let z = 0.3 * libm::sin(0.7 * fx) * libm::cos(0.3 * fy);
            vertices.push([origin[0] + spacing * fx, origin[1] + spacing * fy, origin[2] + spacing * z]);
        }
    }
    let mut triangles = Vec::new();
    for y in 0..side {
        for x in 0..side {
            let a = y * (side + 1) + x;
            let (b, c, d) = (a + 1, a + side + 1, a + side + 2);
            triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    Mesh::new(Vertices::Float64(vertices), triangles)
}

fn rounded(mesh: &Mesh) -> Mesh {
    let Vertices::Float64(vertices) = &mesh.vertices else { panic!("in f64") };
    let vertices = vertices.iter().map(|vertex| vertex.map(|x| x as f32)).collect();
    Mesh { vertices: Vertices::Float32(vertices), ..mesh.clone() }
}

/// That every vertex is the nearest point of the lattice, equal vertices in all blocks included (I4).
fn assert_on_lattice(mesh: &Mesh, report: &CompileReport, bytes: &[u8]) -> Lattice {
    let Precision::Lattice(lattice) = report.precision else { panic!("{:?}", report.precision) };
    let (model, stored) = read_back(bytes);
    assert_eq!(model.precision, report.precision);
    assert_eq!(report.error_bound, 0.5 * lattice.step());
    assert_eq!(stored.len(), mesh.triangles.len());
    for (index, stored) in stored.iter().enumerate() {
        let stored = stored.as_ref().expect("every triangle is there");
        let expected = mesh.corners(index).map(|corner| {
            corner.map(|x| {
                let nearest = lattice.position(lattice.quantize(x).unwrap());
                assert!((x - nearest).abs() <= report.error_bound);
                nearest
            })
        });
        assert_eq!(stored.corners, expected);
    }
    lattice
}

#[test]
fn f32_input_stays_as_it_is() {
    let mesh = rounded(&sheet(20, [1e7, -1e7, 3e5], 0.01));
    let (report, bytes) = compile(&mesh, &CompileOptions::default(), ROOMY);
    assert_eq!((report.precision, report.error_bound), (Precision::Float32, 0.0));
    assert_same(&mesh, &bytes);
}

#[test]
fn text_of_f32_becomes_f32_again() {
    // Nine digits give back every f32, but not exactly in f64.
    let exact = rounded(&sheet(100, [1.0, 2.0, 3.0], 0.01));
    let Vertices::Float32(vertices) = &exact.vertices else { unreachable!() };
    let text = |x: f32| format!("{x:.9e}").parse::<f64>().unwrap();
    let mut mesh = exact.clone();
    mesh.vertices = Vertices::Float64(vertices.iter().map(|vertex| vertex.map(text)).collect());
    for complete_first in [true, false] {
        mesh.complete_first = complete_first;
        for budget in [ROOMY, TIGHT] {
            let (report, bytes) = compile(&mesh, &CompileOptions::default(), budget);
            assert_eq!(report.precision, Precision::Float32);
            assert!(report.error_bound > 0.0 && report.error_bound < 1e-8, "{}", report.error_bound);
            assert_same(&exact, &bytes);
        }
    }
}

/// Compiles a file in a budget, and checks that all of the budget is given back.
fn compile_path(
    input: &std::path::Path,
    options: &CompileOptions,
    budget: Bytes,
) -> (CompileReport, Vec<u8>) {
    let place = Place::new();
    let budget = MemoryBudget::new(budget);
    let report = compile_file(input, place.output(), options, &budget, &mut |_| Control::Continue).unwrap();
    assert_eq!(budget.used(), Bytes(0));
    assert_eq!(place.files(), ["model.outcrop"]);
    (report, std::fs::read(place.output()).unwrap())
}

/// Corners bit for bit, and material, by triangle.
fn contents(bytes: &[u8]) -> Vec<([[u64; 3]; 3], u16)> {
    let (_, stored) = read_back(bytes);
    let all = stored.into_iter().map(|stored| stored.expect("every triangle is there"));
    all.map(|stored| (stored.corners.map(|corner| corner.map(f64::to_bits)), stored.material)).collect()
}

#[test]
fn obj_and_ply_of_one_model_compile_to_the_same_positions() {
    let place = Place::new();
    let (ply, obj) = (place.path().join("gears.ply"), place.path().join("gears.obj"));
    let gears = Gears::new(1).unwrap();
    write_ply(&gears, &ply, true).unwrap();
    write_obj(&gears, &obj).unwrap();
    let options = CompileOptions::default();
    let (from_ply, ply_bytes) = compile_path(&ply, &options, ROOMY);
    let (from_obj, obj_bytes) = compile_path(&obj, &options, ROOMY);
    assert_eq!((from_ply.precision, from_ply.error_bound), (Precision::Float32, 0.0));
    assert_eq!(from_obj.precision, Precision::Float32);
    // Shortest decimals are off by less than half a unit of f32 at 2.5.
    assert!(from_obj.error_bound > 0.0 && from_obj.error_bound < 1.2e-7, "{}", from_obj.error_bound);
    assert!(contents(&ply_bytes) == contents(&obj_bytes));
    for threads in [Threads::Count(2), Threads::Count(3)] {
        for budget in [ROOMY, TIGHT] {
            let options = CompileOptions { threads: threads.clone(), ..options.clone() };
            assert!(compile_path(&obj, &options, budget).1 == obj_bytes, "{threads:?} {budget:?}");
        }
    }
}

/// A mesh as OBJ text of the shortest decimals, faces as soon as their vertices are there.
fn obj_text(mesh: &Mesh) -> String {
    let Vertices::Float64(vertices) = &mesh.vertices else { panic!("in f64") };
    let mut triangles = mesh.triangles.iter().peekable();
    let mut text = String::new();
    for (index, [x, y, z]) in vertices.iter().enumerate() {
        text += &format!("v {x} {y} {z}\n");
        while let Some([a, b, c]) =
            triangles.next_if(|triangle| triangle.iter().all(|vertex| *vertex as usize <= index))
        {
            text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
        }
    }
    text
}

#[test]
fn one_number_that_f32_does_not_keep_brings_the_rule_of_f64_back() {
    for (origin, spacing, is_lattice) in [([0.5, 1.0, 2.0], 0.25, false), ([1e4, 1e4, 1e4], 0.01, true)] {
        // More vertices than a reader sends at once.
        let mut mesh = sheet(190, origin, spacing);
        let Vertices::Float64(vertices) = &mut mesh.vertices else { unreachable!() };
        // What the shortest decimals of f32 say.
        let text_of_f32 = |x: f64| (x as f32).to_string().parse::<f64>().unwrap();
        vertices.iter_mut().for_each(|vertex| *vertex = vertex.map(text_of_f32));
        let place = Place::new();
        let input = place.path().join("sheet.obj");
        std::fs::write(&input, obj_text(&mesh)).unwrap();
        let (report, _) = compile_path(&input, &CompileOptions::default(), ROOMY);
        assert_eq!(report.precision, Precision::Float32);
        for late in [false, true] {
            let mut mesh = mesh.clone();
            let Vertices::Float64(vertices) = &mut mesh.vertices else { unreachable!() };
            let at = if late { vertices.len() - 1 } else { 7 };
            vertices[at][0] += 0.000_123_456_789;
            std::fs::write(&input, obj_text(&mesh)).unwrap();
            let (expected, expected_bytes) = compile(&mesh, &CompileOptions::default(), ROOMY);
            assert_eq!(matches!(expected.precision, Precision::Lattice(_)), is_lattice);
            for threads in [Threads::One, Threads::Count(2)] {
                let options = CompileOptions { threads, ..CompileOptions::default() };
                let (report, bytes) = compile_path(&input, &options, ROOMY);
                assert_eq!(report.precision, expected.precision);
                assert_eq!(
                    (report.error_bound, report.tolerance_met),
                    (expected.error_bound, expected.tolerance_met)
                );
                assert!(contents(&bytes) == contents(&expected_bytes), "{origin:?} {late}");
            }
        }
    }
}

#[test]
fn the_automatic_lattice_is_the_coarsest_that_keeps_the_promise() {
    for (origin, spacing) in [([0.3, 0.1, 0.2], 1e-2), ([1e7, 2e7, -1e7], 0.5), ([4e15, 0.0, 0.0], 1e3)] {
        let mesh = sheet(60, origin, spacing);
        let far = origin[0] > 1.0;
        let (report, bytes) = compile(&mesh, &CompileOptions::default(), ROOMY);
        if !far {
            // Nearby, f32 keeps the promise.
            assert_eq!(report.precision, Precision::Float32);
            continue;
        }
        let lattice = assert_on_lattice(&mesh, &report, &bytes);
        let mut shortest = f64::INFINITY;
        for index in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(index);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                let length = (0..3).map(|axis| (p[axis] - q[axis]).powi(2)).sum::<f64>().sqrt();
                shortest = shortest.min(length);
            }
        }
        let moved = |step: f64| 0.5 * 3_f64.sqrt() * step;
        if report.tolerance_met {
            assert!(moved(lattice.step()) <= AUTO_TOLERANCE * shortest);
            assert!(moved(2.0 * lattice.step()) > AUTO_TOLERANCE * shortest, "a coarser one would do");
        } else {
            assert_eq!(origin[0], 4e15);
            // The next finer one would not reach the coordinates.
            assert!(4.1e15 / (0.5 * lattice.step()) > Lattice::COORDINATE_MAX as f64);
        }
        assert_eq!(report.tolerance_met, origin[0] < 4e15);
        // The same from a budget that keeps little in memory.
        assert!(compile(&mesh, &CompileOptions::default(), TIGHT).1 == bytes);
    }
}

#[test]
fn an_edge_that_f32_would_collapse_is_noticed() {
    let x = 1.0 + 1e-12;
    let vertices = vec![[1.0, 0.0, 0.0], [x, 0.0, 0.0], [1.0, 1e-3, 0.0], [1.0, 0.0, 0.0]];
    let mut mesh = Mesh::new(Vertices::Float64(vertices), vec![[0, 1, 2]]);
    assert!(matches!(
        compile(&mesh, &CompileOptions::default(), ROOMY).0.precision,
        Precision::Lattice(lattice) if lattice.step() < 1e-12
    ));
    // An edge that is zero in the source binds nothing.
    mesh.triangles = vec![[0, 3, 2]];
    assert_eq!(compile(&mesh, &CompileOptions::default(), ROOMY).0.precision, Precision::Float32);
}

#[test]
fn a_chosen_lattice_is_used_for_any_input() {
    let exact = sheet(120, [100.0, 200.0, -50.0], 0.25);
    for mesh in [rounded(&exact), exact] {
        for exponent in [-4, -12, -40] {
            let options = options(PrecisionChoice::Lattice { exponent });
            let (report, bytes) = compile(&mesh, &options, ROOMY);
            assert_eq!(assert_on_lattice(&mesh, &report, &bytes).exponent, exponent);
            assert!(compile(&mesh, &options, TIGHT).1 == bytes);
        }
    }
}

#[test]
fn the_file_tells_who_chose_its_precision_and_what_was_left_out() {
    let automatic = |tolerance_met| PrecisionOrigin::Automatic { tolerance_met };
    let mut with_a_hole = sheet(3, [0.0; 3], 1.0);
    let Vertices::Float64(vertices) = &mut with_a_hole.vertices else { unreachable!() };
    vertices[0][1] = f64::NAN;
    let users = with_a_hole.triangles.iter().filter(|triangle| triangle.contains(&0)).count() as u64;
    // A far vertex that no triangle uses can force a lattice that is coarser than the edges call for.
    let mut with_a_far_vertex = sheet(3, [1e7, 0.0, 0.0], 1e-9);
    let Vertices::Float64(vertices) = &mut with_a_far_vertex.vertices else { unreachable!() };
    vertices.push([1e30, 0.0, 0.0]);
    let plain = sheet(3, [0.0; 3], 1.0);
    for (mesh, precision, origin, skipped) in [
        (&plain, PrecisionChoice::Auto, automatic(true), 0),
        (&plain, PrecisionChoice::Float32, PrecisionOrigin::Given, 0),
        (&plain, PrecisionChoice::Lattice { exponent: -20 }, PrecisionOrigin::Given, 0),
        (&with_a_hole, PrecisionChoice::Auto, automatic(true), users),
        (&with_a_far_vertex, PrecisionChoice::Auto, automatic(false), 0),
    ] {
        let place = Place::new();
        let options = CompileOptions { skip_not_finite: true, ..options(precision) };
        let report =
            compile_with(mesh, &options, ROOMY, &place.output(), &mut |_| Control::Continue).unwrap();
        let (model, _) = read_back(&std::fs::read(place.output()).unwrap());
        assert_eq!(model.compiled, Some(CompileRecord { precision: origin, skipped }));
        let met = origin != automatic(false);
        assert_eq!((report.tolerance_met, report.skipped), (met, skipped));
    }
}

#[test]
fn wide_lattice_blocks_keep_the_size_limit() {
    // Offsets of more than 2^24 steps take 24 bytes a vertex; `read_back` checks the limits of every block.
    let mesh = sheet(150, [0.0; 3], 1.0);
    for block_bytes in [4 << 10, 64 << 10] {
        let precision = PrecisionChoice::Lattice { exponent: -30 };
        let options = CompileOptions { block_bytes, precision, ..CompileOptions::default() };
        let (report, bytes) = compile(&mesh, &options, ROOMY);
        assert_on_lattice(&mesh, &report, &bytes);
    }
}

#[test]
fn coordinates_that_do_not_fit_are_errors() {
    let far =
        Mesh::new(Vertices::Float64(vec![[1e300, 0.0, 0.0], [0.0; 3], [0.0, 1.0, 0.0]]), vec![[0, 1, 2]]);
    let place = Place::new();
    let run = |mesh: &Mesh, precision, skip_not_finite| {
        let options = CompileOptions { precision, skip_not_finite, ..CompileOptions::default() };
        compile_with(mesh, &options, ROOMY, &place.output(), &mut |_| Control::Continue)
    };
    for precision in
        [PrecisionChoice::Float32, PrecisionChoice::Lattice { exponent: 0 }, PrecisionChoice::Auto]
    {
        let result = run(&far, precision, true);
        assert!(matches!(result, Err(CompileError::Limit { .. })), "{precision:?}: {result:?}");
    }
    for (bad, not_finite) in [(f64::NAN, true), (f64::INFINITY, true), (1e300, false)] {
        let mut mesh = sheet(3, [0.0; 3], 1.0);
        let Vertices::Float64(vertices) = &mut mesh.vertices else { unreachable!() };
        vertices[5][1] = bad;
        let users = mesh.triangles.iter().filter(|triangle| triangle.contains(&5)).count() as u64;
        let first = mesh.triangles.iter().position(|triangle| triangle.contains(&5)).unwrap() as u64;
        for precision in [PrecisionChoice::Float32, PrecisionChoice::Lattice { exponent: -20 }] {
            let error = run(&mesh, precision, false).unwrap_err();
            match error {
                CompileError::NotFinite { triangle } => assert!(not_finite && triangle == first),
                CompileError::Limit { .. } => assert!(!not_finite),
                other => panic!("{other}"),
            }
        }
        if not_finite {
            for precision in [PrecisionChoice::Auto, PrecisionChoice::Float32] {
                let report = run(&mesh, precision, true).unwrap();
                assert_eq!((report.skipped, report.triangles), (users, mesh.triangles.len() as u64 - users));
            }
        }
    }
    assert_eq!(place.files(), ["model.outcrop"]);
}

#[test]
fn what_lies_beyond_f32_on_all_sides_goes_to_a_lattice() {
    // Rounded to f32 no two of the vertices are at a finite distance from each other.
    let corners = vec![[1e50, 0.0, 0.0], [-1e50, 0.0, 0.0], [0.0, 1e50, 0.0], [3e50, 3e50, 0.0]];
    let mut mesh = Mesh::new(Vertices::Float64(corners), vec![[0, 1, 2], [0, 3, 2]]);
    for complete_first in [true, false] {
        mesh.complete_first = complete_first;
        let (report, bytes) = compile(&mesh, &CompileOptions::default(), ROOMY);
        assert!(report.tolerance_met);
        assert_on_lattice(&mesh, &report, &bytes);
    }
}
