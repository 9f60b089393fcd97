//! What a compiled file tells about the options that it was compiled with. Its header does not hold them.

use outcrop::block::{BlockData, DecodeScratch};
use outcrop::compile::{AUTO_TOLERANCE, PrecisionChoice};
use outcrop::error::BudgetError;
use outcrop::geom::{Lattice, Precision};
use outcrop::import::GltfPart;
use outcrop::model::Model;
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};

use crate::options::Options;

/// Blocks that are looked into; of a larger file so many, spread evenly.
const LOOKS_MAX: usize = 64;

/// What some blocks show.
pub struct Held {
    /// Square of the shortest edge above zero.
    shortest_square: f64,
    /// Whether there is a triangle with a number that a source of so many triangles does not have: others were left out.
    has_gaps: bool,
}

impl Held {
    /// Looks into some blocks.
    pub fn of(source: &dyn BlockSource, budget: &MemoryBudget) -> Result<Held, BudgetError> {
        let model = source.model();
        let bytes = BlockData::bytes_needed(model.limits).0
            + DecodeScratch::bytes_needed(model.limits).0
            + source.buffer_bytes().0;
        let _room = budget.reserve(Bytes(bytes), "a look into the compiled file")?;
        let mut data = BlockData::with_limits(model.limits);
        let mut scratch = DecodeScratch::with_limits(model.limits);
        let mut stored = Vec::with_capacity(source.buffer_bytes().0 as usize);
        let mut held = Held { shortest_square: f64::INFINITY, has_gaps: false };
        for index in (0..model.blocks.len()).step_by(model.blocks.len().div_ceil(LOOKS_MAX).max(1)) {
            // A file has at most 2^32 - 1 blocks.
            let block = BlockId(index as u32);
            let is_sound = source.read_block(block, &mut stored).is_ok()
                && model.decode_block(block, &stored, &mut scratch, &mut data).is_ok();
            // Who renders it says what is wrong with it.
            if is_sound {
                held.add(&data, model.triangle_count);
            }
        }
        Ok(held)
    }

    fn add(&mut self, data: &BlockData, triangle_count: u64) {
        self.has_gaps |= data.ids.last().is_some_and(|&last| last >= triangle_count);
        for triangle in &data.triangles {
            let [a, b, c] = triangle.map(|vertex| data.position(vertex.into()));
            for (p, q) in [(a, b), (b, c), (c, a)] {
                let square: f64 = [0, 1, 2].map(|axis| (p[axis] - q[axis]).powi(2)).iter().sum();
                if square > 0.0 {
                    self.shortest_square = self.shortest_square.min(square);
                }
            }
        }
    }

    /// Why another file would be made with the options of now, if that shows. Block size and codec do not count: no picture depends
    /// on them.
    pub fn difference(&self, model: &Model, options: &Options) -> Option<&'static str> {
        let wants_auto = matches!(options.precision, None | Some(PrecisionChoice::Auto));
        if wants_auto && self.is_coarser_than_auto(model) {
            return Some("compiled again, now with --precision auto");
        }
        if self.left_out(options) && !options.skip_not_finite {
            return Some("compiled again, now without --skip-not-finite");
        }
        None
    }

    /// Whether `--precision auto` cannot have chosen the file's lattice.
    fn is_coarser_than_auto(&self, model: &Model) -> bool {
        let Precision::Lattice(lattice) = model.precision else { return false };
        if lattice.exponent == Lattice::EXPONENT_MIN {
            return false;
        }
        // A large model has the finest lattice that holds it, whatever its edges; one step more for its rounded bounds.
        let finer = Lattice { exponent: lattice.exponent - 2 };
        let mut corners = model.bounds.min.into_iter().chain(model.bounds.max);
        let has_finer = corners.all(|x| finer.quantize(x).is_some());
        // Auto moves no vertex by more than the tolerance; the edges here are already moved.
        let moved_max = 1.1 * AUTO_TOLERANCE * self.shortest_square.sqrt();
        has_finer && 3_f64.sqrt() * lattice.error_bound() > moved_max
    }

    fn left_out(&self, options: &Options) -> bool {
        // Numbers of a part may be those of the whole.
        self.has_gaps && options.part == GltfPart::Scene
    }

    /// What a reader of the story should know of the file.
    pub fn note(&self, model: &Model, options: &Options) -> String {
        let precision = match model.precision {
            Precision::Float32 => "positions as float32".to_string(),
            Precision::Lattice(lattice) => {
                format!("positions on a lattice of spacing 2^{}", lattice.exponent)
            }
        };
        let left_out = if self.left_out(options) { ", triangles that are not finite left out" } else { "" };
        format!("{precision}{left_out}")
    }
}
