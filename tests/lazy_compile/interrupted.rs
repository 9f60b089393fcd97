//! A working file as a run that was killed leaves it, and as a bad disk does.

use std::fs;
use std::path::Path;

use outcrop::compile::{Control, LazyModel};
use outcrop::error::{BlockError, CompileError, LoadError, TraceError};
use outcrop::geom::Ray;
use outcrop::units::{Bytes, CellId};
use outcrop::{LazyOctree, MemoryBudget};

use super::compiling::{Mesh, Place};
use super::support::numbers::Random;
use super::{Answers, budget, eager, gears, octree, open, rays, small, soup, trace};

/// A working file with every cell cut, and its length before and after each.
fn complete(mesh: &Mesh) -> (Vec<u8>, Vec<u64>) {
    let (place, budget) = (Place::new(), budget());
    let model = open(mesh, &place.output(), &small(), &budget).unwrap();
    let mut ends = vec![model.report().working_bytes];
    // Not in their own order.
    let count = model.model().cells.len() as u32;
    for cell in (0..count).rev() {
        model.cut_cell(CellId(cell)).unwrap();
        ends.push(model.report().working_bytes);
    }
    assert!(model.is_complete());
    drop(model);
    (fs::read(LazyModel::working_path(place.output())).unwrap(), ends)
}

/// What is expected of a mesh.
struct Expected {
    mesh: Mesh,
    octree: LazyOctree,
    rays: Vec<Ray>,
    answers: Answers,
    file: Vec<u8>,
}

impl Expected {
    fn of(mesh: Mesh) -> Expected {
        let octree = eager(&mesh, &small().compile);
        let rays = rays(&octree, 60, 7);
        let answers = trace(&octree, &rays).unwrap();
        let (place, budget) = (Place::new(), budget());
        open(&mesh, &place.output(), &small(), &budget).unwrap().finish(&mut |_| Control::Continue).unwrap();
        let file = fs::read(place.output()).unwrap();
        Expected { mesh, octree, rays, answers, file }
    }
}

fn write_working(output: &Path, bytes: &[u8]) {
    fs::write(LazyModel::working_path(output), bytes).unwrap();
}

#[test]
fn it_reopens_where_it_stood_wherever_it_was_broken_off() {
    for mesh in [gears(), soup()] {
        let expected = Expected::of(mesh);
        let (bytes, ends) = complete(&expected.mesh);
        let log = ends[0] as usize;
        let mut random = Random(11);
        let mut lengths: Vec<usize> =
            ends.iter().flat_map(|end| [*end as usize - 1, *end as usize]).collect();
        lengths.extend((0..40).map(|_| log + random.index(bytes.len() - log)));
        lengths.extend(ends.iter().map(|end| (*end as usize + 1 + random.index(100)).min(bytes.len())));
        // Before the log begins there is nothing to go on with.
        lengths.extend([0, 1, 255, 256, 257, log / 2, log - 1]);
        let place = Place::new();
        for length in lengths {
            write_working(&place.output(), &bytes[..length]);
            let budget = budget();
            let model = open(&expected.mesh, &place.output(), &small(), &budget).unwrap();
            let report = model.report();
            let whole = ends[1..].iter().filter(|end| **end as usize <= length).count();
            assert_eq!(report.was_reopened, length >= log, "broken off at {length}");
            assert_eq!(report.cells_cut as usize, whole, "broken off at {length}");
            assert_eq!(report.cells_cut_now, 0);
            let octree = octree(&model, &budget, 1);
            assert_eq!(trace(&octree, &expected.rays).unwrap(), expected.answers, "broken off at {length}");
        }
    }
}

#[test]
fn what_was_cut_after_a_break_is_kept_too() {
    let expected = Expected::of(gears());
    let (bytes, ends) = complete(&expected.mesh);
    let place = Place::new();
    // In the middle of a record.
    write_working(&place.output(), &bytes[..ends[3] as usize + 50]);
    let mut known = 3;
    for cell in [0, 5, 1] {
        let model = open(&expected.mesh, &place.output(), &small(), &budget()).unwrap();
        assert_eq!(model.report().cells_cut, known);
        model.cut_cell(CellId(cell)).unwrap();
        known += 1;
    }
    let model = open(&expected.mesh, &place.output(), &small(), &budget()).unwrap();
    assert_eq!((model.report().cells_cut, model.report().was_reopened), (known, true));
    model.finish(&mut |_| Control::Continue).unwrap();
    assert!(fs::read(place.output()).unwrap() == expected.file, "another file");
}

#[test]
fn a_hole_in_the_log_costs_what_is_behind_it() {
    let expected = Expected::of(gears());
    let (bytes, ends) = complete(&expected.mesh);
    let place = Place::new();
    for hole in [0, 2, ends.len() - 2] {
        // As if the thread that had this place in the log was killed before it wrote.
        let mut bytes = bytes.clone();
        bytes[ends[hole] as usize..ends[hole + 1] as usize].fill(0);
        write_working(&place.output(), &bytes);
        let budget = budget();
        let model = open(&expected.mesh, &place.output(), &small(), &budget).unwrap();
        assert_eq!(model.report().cells_cut as usize, hole);
        let octree = octree(&model, &budget, 1);
        assert_eq!(trace(&octree, &expected.rays).unwrap(), expected.answers);
    }
}

/// Blocks are written before the head that names them: where the disk is full between the two, as where a run is killed there, no head
/// stands before blocks that are not there, and what others have appended behind does not bring it to life.
#[test]
fn blocks_without_their_head_are_nothing() {
    let expected = Expected::of(gears());
    let (bytes, ends) = complete(&expected.mesh);
    let place = Place::new();
    let (start, end) = (ends[0] as usize, ends[1] as usize);
    write_working(&place.output(), &bytes[..start]);
    let last = CellId(ends.len() as u32 - 2);
    let mut options = small();
    options.compile.disk_limit = Some(Bytes(end as u64 - 1));
    let model = open(&expected.mesh, &place.output(), &options, &budget()).unwrap();
    assert!(model.report().was_reopened);
    let error = model.cut_cell(last).unwrap_err();
    assert!(matches!(error, CompileError::Write { .. }), "{error}");
    drop(model);
    let mut left = fs::read(LazyModel::working_path(place.output())).unwrap();
    assert_eq!(left.len(), end, "the blocks are there");
    assert!(left[start..start + 64].iter().all(|byte| *byte == 0), "and no head is");
    left.extend_from_slice(&bytes[end..]);
    write_working(&place.output(), &left);
    let budget = budget();
    let model = open(&expected.mesh, &place.output(), &small(), &budget).unwrap();
    assert_eq!(model.report().cells_cut, 0);
    assert_eq!(trace(&octree(&model, &budget, 1), &expected.rays).unwrap(), expected.answers);
}

/// Opens, traces and finishes; whatever does not fail must be right. Returns how far it came.
fn right_or_refused(expected: &Expected, place: &Place, budget: &MemoryBudget) -> u32 {
    let model = open(&expected.mesh, &place.output(), &small(), budget).expect("a damaged file is made anew");
    let tree = octree(&model, budget, 1);
    let traced = match trace(&tree, &expected.rays) {
        Ok(answers) => {
            assert_eq!(answers, expected.answers);
            true
        }
        Err(TraceError::Load(LoadError::Block(BlockError { .. }))) => false,
        Err(TraceError::Load(LoadError::Cut(error))) => {
            assert!(matches!(*error, CompileError::WorkingFile { .. }), "{error}");
            assert!(error.to_string().contains("model.outcrop.working"), "{error}");
            false
        }
        Err(error) => panic!("not an error of damaged bytes: {error}"),
    };
    let finished = match model.finish(&mut |_| Control::Continue) {
        Ok(_) => {
            assert!(fs::read(place.output()).unwrap() == expected.file, "another file");
            true
        }
        Err(CompileError::WorkingFile { .. }) => false,
        Err(error) => panic!("not an error of damaged bytes: {error}"),
    };
    u32::from(traced) + u32::from(finished)
}

#[test]
fn flipped_bits_are_found_or_mended() {
    let expected = Expected::of(gears());
    let (bytes, ends) = complete(&expected.mesh);
    let log = ends[0] as usize;
    let part = log + (bytes.len() - log) / 2;
    let place = Place::new();
    let mut random = Random(5);
    let (mut right, mut refused) = (0, 0);
    for round in 0..200 {
        // The whole file, and one with a half of its cells cut, so that damaged triangles are read.
        let whole = round % 2 == 0;
        let mut bytes = bytes[..if whole { bytes.len() } else { part }].to_vec();
        let at = match round % 5 {
            0 => random.index(256),
            1 => log - 1 - random.index(2000),
            2 => log + random.index(bytes.len() - log),
            _ => random.index(bytes.len()),
        };
        bytes[at] ^= 1 << random.index(8);
        write_working(&place.output(), &bytes);
        match right_or_refused(&expected, &place, &budget()) {
            2 => right += 1,
            _ => refused += 1,
        }
        let _ = fs::remove_file(place.output());
    }
    // Both happen: damage in the log and the head is mended, damage in triangles is not.
    assert!(right > 30 && refused > 15, "{right} right, {refused} refused");
}

#[test]
fn bytes_of_any_kind_are_not_believed() {
    let expected = Expected::of(soup());
    let (bytes, ends) = complete(&expected.mesh);
    let place = Place::new();
    let mut random = Random(6);
    for round in 0..60 {
        let mut bytes = bytes.clone();
        match round % 3 {
            // A run of rubbish.
            0 => {
                let at = random.index(bytes.len() - 100);
                bytes[at..at + 100].iter_mut().for_each(|byte| *byte = random.index(256) as u8);
            }
            // A piece twice.
            1 => {
                let at = ends[0] as usize + random.index(bytes.len() - ends[0] as usize);
                let piece = bytes[at..].to_vec();
                bytes.extend_from_slice(&piece);
            }
            // A record of the log once more, whole.
            _ => {
                let which = random.index(ends.len() - 1);
                let piece = bytes[ends[which] as usize..ends[which + 1] as usize].to_vec();
                bytes.extend_from_slice(&piece);
            }
        }
        write_working(&place.output(), &bytes);
        right_or_refused(&expected, &place, &budget());
        let _ = fs::remove_file(place.output());
    }
    assert_eq!(trace(&expected.octree, &expected.rays).unwrap(), expected.answers);
    assert_eq!(budget().used(), Bytes(0));
}
