//! Any bytes behind the header of a working file that was made for the model; checksums are made right where the input asks for it.
//! What opens is traced, cut and finished: whatever comes of it must be an error or an end.
#![no_main]

use std::fs;
use std::sync::Arc;

use libfuzzer_sys::fuzz_target;
use outcrop::compile::{CompileOptions, Compiler, Control, LazyModel, LazyOptions};
use outcrop::geom::Ray;
use outcrop::model::SourceRecord;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Icosphere, Shape};
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};
use outcrop_fuzz::{HEADER_BYTES, seal, seal_part, size_at};

/// Where the header names cells and materials: offset, length, checksum.
const SECTIONS: [usize; 2] = [144, 168];

/// A few places to change: where, and the byte that is added.
fn change(file: &mut [u8], changes: &[u8]) {
    for change in changes.chunks_exact(4) {
        let at = usize::from(change[0]) << 16 | usize::from(change[1]) << 8 | usize::from(change[2]);
        let length = file.len();
        file[at % length] = file[at % length].wrapping_add(change[3]);
    }
}

/// The triangles of each cell too, so that what is changed in them is looked at.
fn seal_all(file: &mut [u8]) {
    let (offset, bytes) = (size_at(file, SECTIONS[0]), size_at(file, SECTIONS[0] + 8));
    let records = offset..offset.saturating_add(bytes).min(file.len());
    let file_bytes = file.len();
    records.step_by(96).filter(|at| at + 96 <= file_bytes).for_each(|at| seal_part(file, at));
    seal(file, HEADER_BYTES, &SECTIONS);
}

fuzz_target!(|input: &[u8]| {
    let [sealed, length, changes @ ..] = input else { return };
    let folder = tempfile::tempdir().expect("the folder for temporary files can be written");
    let output = folder.path().join("model.outcrop");
    let working = LazyModel::working_path(&output);
    let compile = CompileOptions { block_bytes: 4 << 10, ..CompileOptions::default() };
    let options = LazyOptions { compile, cell_triangles: 64, ..LazyOptions::default() };
    let open = || {
        let budget = MemoryBudget::new(Bytes::mib(64));
        let source = SourceRecord { file_bytes: 1, modified_ns: 2, fingerprint: 3 };
        let emit = |compiler: &mut Compiler<'_>| Icosphere::new(1.0, [0.0; 3], 2)?.emit(compiler);
        let go_on = &mut |_| Control::Continue;
        let model = LazyModel::from_mesh(source, &output, &options, &budget, go_on, emit);
        (model.expect("a file that is not right is made anew"), budget)
    };
    let (model, _) = open();
    for cell in 0..model.report().cells / 2 {
        model.cut_cell(outcrop::units::CellId(cell)).expect("what was just written");
    }
    drop(model);
    let mut file = fs::read(&working).expect("just written");
    file.truncate(file.len() - usize::from(*length) * 8 % file.len());
    if file.len() > HEADER_BYTES {
        change(&mut file, changes);
        if sealed % 4 != 0 {
            seal_all(&mut file);
        }
    }
    fs::write(&working, file).expect("the folder for temporary files has room");

    let (model, budget) = open();
    let model = Arc::new(model);
    let source = Arc::clone(&model) as Arc<dyn BlockSource>;
    if let Ok(octree) = LazyOctree::open(source, &budget, OctreeOptions::default()) {
        let mut tracer = octree.tracer().expect("the budget holds one");
        for i in 0..40 {
            let (x, y) = (f64::from(i % 7) / 3.0 - 1.0, f64::from(i % 5) / 2.0 - 1.0);
            let _ = tracer.closest_hit(&Ray::new([x, y, 5.0], [-0.2 * x, -0.2 * y, -1.0]));
        }
    }
    let _ = model.finish(&mut |_| Control::Continue);
});
