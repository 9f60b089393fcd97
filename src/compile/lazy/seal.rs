//! From a working file to a compiled file.

use std::sync::OnceLock;

use super::super::blocks::{EncodedBlock, EncodedBucket};
use super::super::clock::Meter;
use super::super::clock::Moment;
use super::super::options::{CompileReport, Control, Phase, Progress, Seconds};
use super::super::output::Output;
use super::super::precision::Decision;
use super::cutter::Cutter;
use super::lazy_model::{CutCell, LazyModel};
use crate::block::checksum;
use crate::error::CompileError;
use crate::geom::Precision;
use crate::model::SubBoxes;
use crate::units::CellId;

impl LazyModel {
    /// Cuts the cells that no ray has reached, publishes the compiled file at [`LazyModel::output`], replacing what is there in one
    /// step, and removes the working file. The compiled file is that of a compile in one go with cells of the same size, byte for byte.
    ///
    /// Octrees over this model can be used before, meanwhile and after it. If it fails, the working file is as it was.
    ///
    /// # Errors
    /// [`CompileError`]; [`CompileError::Limit`] if attributes or images of the source were left out: then the whole model must be
    /// compiled, or [`CompileOptions::attributes`](crate::compile::CompileOptions) say that they are not wanted.
    pub fn finish(
        &self,
        progress: &mut dyn FnMut(Progress) -> Control,
    ) -> Result<CompileReport, CompileError> {
        let header = &self.contents().header;
        if header.details_left_out {
            let reason = "a lazy compile leaves normals, texture coordinates and images out; compile the model as a whole \
                          (`compile_file`), or set `CompileOptions::attributes` to false";
            return Err(CompileError::Limit { reason: reason.into() });
        }
        let start = Moment::now();
        let cut_before = self.cut_time();
        let quota = self.working().quota().clone();
        let mut output =
            Output::create(self.output(), quota, header.precision, header.limits, self.budget())?;
        let count = self.cells().len();
        for (index, place) in self.cells().iter().enumerate() {
            let cell = CellId(index as u32);
            // One borrowed for each cell, so that rays that wait for another get their turn.
            let mut borrowed = self.borrow_any(cell);
            let cutter = borrowed.cutter();
            if !place.get().is_some_and(|done| self.read_back(done, cutter)) {
                self.cut_with(cutter, cell)?;
            }
            output.write_bucket(&cutter.bucket)?;
            drop(borrowed);
            let fraction = Some((index + 1) as f64 / count as f64);
            match progress(Progress { phase: Phase::Cut, fraction, triangles: header.triangle_count }) {
                Control::Continue => {}
                Control::Cancel => return Err(CompileError::Cancelled),
            }
        }
        let spill_bytes = header.log_offset();
        let model = self.model();
        progress(Progress { phase: Phase::Seal, fraction: None, triangles: output.triangles() });
        let compiled = self.options().precision.record(header.tolerance_met, header.skipped);
        let written = output.seal(&model.materials, model.source, compiled)?;
        self.working().remove();
        let mut spent = Meter::default();
        spent.add_since(start);
        let mut seconds = self.first_pass();
        let cut = self.cut_time();
        seconds.cut = Seconds { wall: cut.wall - cut_before.wall, cpu: cut.cpu - cut_before.cpu };
        let spent = spent.seconds();
        seconds.write = Seconds {
            wall: seconds.write.wall + (spent.wall - seconds.cut.wall).max(0.0),
            cpu: seconds.write.cpu + (spent.cpu - seconds.cut.cpu).max(0.0),
        };
        seconds.total = Seconds { wall: seconds.total.wall + spent.wall, cpu: seconds.total.cpu + spent.cpu };
        let precision = header.precision;
        let decision = Decision { precision, tolerance_met: header.tolerance_met };
        let error_bound = match precision {
            Precision::Float32 => header.error_bound,
            Precision::Lattice(lattice) => lattice.error_bound(),
        };
        Ok(CompileReport {
            skipped: header.skipped,
            import: self.import_report().cloned(),
            seconds,
            spill_bytes,
            budget_peak: self.budget().peak(),
            ..written.report(decision, error_bound, self.options().codec)
        })
    }

    /// Reads the blocks of a cell from the log into the cutter; false if they are not those that were written: then the cell is to
    /// be cut again.
    fn read_back(&self, done: &CutCell, cutter: &mut Cutter) -> bool {
        let EncodedBucket { bytes, blocks, degenerate, duplicates } = &mut cutter.bucket;
        (*degenerate, *duplicates) = (u64::from(done.degenerate), u64::from(done.duplicates));
        blocks.clear();
        let mut end = 0;
        for entry in done.entries.iter() {
            end += entry.stored_bytes as usize;
            blocks.push(EncodedBlock {
                end,
                triangle_count: entry.triangle_count,
                vertex_count: entry.vertex_count,
                bounds: entry.bounds,
                sub_boxes: SubBoxes(entry.sub_boxes),
                material_range: entry.material_range,
            });
        }
        bytes.clear();
        bytes.resize(end, 0);
        let start = done.entries.first().map_or(0, |entry| entry.offset);
        if self.working().read_raw(start, bytes).is_err() {
            return false;
        }
        let mut rest = &bytes[..];
        done.entries.iter().all(|entry| {
            let (stored, behind) = rest.split_at(entry.stored_bytes as usize);
            rest = behind;
            checksum(stored) == entry.checksum
        })
    }

    /// A cutter while nobody else is at `cell`, whether it is cut or not.
    fn borrow_any(&self, cell: CellId) -> super::lazy_model::Borrowed<'_> {
        let never = OnceLock::new();
        // A place that stays empty, so that there always comes one.
        self.borrow_cutter(cell, &never).expect("an empty place is not cut by others")
    }
}
