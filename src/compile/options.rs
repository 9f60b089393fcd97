//! What the caller chooses, and what a compile tells back.

use std::path::PathBuf;
use std::sync::Arc;

use crate::block::Codec;
use crate::geom::Precision;
use crate::import::ImportReport;
use crate::model::{CompileRecord, PrecisionOrigin};
use crate::units::Bytes;

/// How a compile is to be done. The image made from the result does not depend on any of it but `precision` and
/// `skip_not_finite` (I2).
#[derive(Clone, Debug)]
pub struct CompileOptions {
    /// Most bytes of a block in its decoded form, 4 KiB to 256 KiB; 64 KiB is the paper's best.
    pub block_bytes: u32,
    /// How blocks are packed.
    pub codec: Codec,
    /// How positions are held.
    pub precision: PrecisionChoice,
    /// Which threads may be used.
    pub threads: Threads,
    /// Leave triangles with a NaN or infinite coordinate out (and count them) instead of failing.
    pub skip_not_finite: bool,
    /// Keep texture coordinates and normals if the model has them. A lazy compile leaves them out
    /// ([`LazyReport::details_left_out`](super::LazyReport::details_left_out)).
    pub attributes: bool,
    /// Where temporary data goes that does not fit the budget; `None` for the output's own directory.
    pub spill_dir: Option<PathBuf>,
    /// Most bytes of disk that spill and output may take together; `None` for no limit. Beyond it the compile
    /// fails as on a full disk.
    pub disk_limit: Option<Bytes>,
}

impl Default for CompileOptions {
    fn default() -> CompileOptions {
        CompileOptions {
            block_bytes: 64 << 10,
            codec: Codec::Lz4,
            precision: PrecisionChoice::Auto,
            threads: Threads::One,
            skip_not_finite: false,
            attributes: true,
            spill_dir: None,
            disk_limit: None,
        }
    }
}

/// How the precision of a compiled file is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PrecisionChoice {
    /// Binary f32 input is kept bit for bit. Text becomes `Float32` if that keeps every digit: if the f32 nearest to each coordinate
    /// is at most half a unit of the last written digit away, as it is in text that was written from f32. Other text and f64 input
    /// becomes `Float32` if rounding moves no vertex by more
    /// than [`AUTO_TOLERANCE`] of the shortest edge of its triangles, else the coarsest lattice that meets that
    /// bound; if none does within the range of the lattice, the finest that covers the model.
    #[default]
    Auto,
    /// Coordinates rounded to the nearest f32.
    Float32,
    /// The lattice of spacing `2^exponent`.
    Lattice {
        /// Base-two logarithm of the spacing.
        exponent: i32,
    },
}

impl PrecisionChoice {
    /// What the compiled file tells of the choice, beside the triangles that were left out.
    pub(super) fn record(self, tolerance_met: bool, skipped: u64) -> CompileRecord {
        let precision = match self {
            PrecisionChoice::Auto => PrecisionOrigin::Automatic { tolerance_met },
            PrecisionChoice::Float32 | PrecisionChoice::Lattice { .. } => PrecisionOrigin::Given,
        };
        CompileRecord { precision, skipped }
    }
}

/// How far [`PrecisionChoice::Auto`] may move a vertex, in shortest edges of its triangles. Edges of length zero do
/// not count: nothing could meet a bound of zero.
pub const AUTO_TOLERANCE: f64 = 1e-4;

/// Which threads a compile or a render may use. The result is the same, byte for byte, for any choice.
#[derive(Clone, Debug, Default)]
pub enum Threads {
    /// The calling thread only.
    #[default]
    One,
    /// This many threads, made for the job and ended with it: a compile has them beside the calling thread, a render
    /// counts the calling thread among them. 0 and 1 mean [`Threads::One`].
    Count(usize),
    /// The caller's pool. The job must not be started from one of its threads. From the last vertex to its end a compile keeps all of
    /// them: what feeds a [`Compiler`](super::Compiler) must not wait for the same pool, and compilers that one thread feeds in turns
    /// need a pool each.
    Pool(Arc<rayon::ThreadPool>),
}

/// What a compile is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The source is read; for sources that give all vertices first, triangles are scattered at once.
    Read,
    /// Triangles that had to wait for the last vertex are scattered to buckets.
    Scatter,
    /// Buckets are cut into blocks, encoded and written.
    Cut,
    /// Directory and header are written and the file is published.
    Seal,
}

/// How far a compile is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// What is being done.
    pub phase: Phase,
    /// Part of the phase that is done, 0 to 1; `None` if unknown.
    pub fraction: Option<f64>,
    /// Triangles taken from the source so far.
    pub triangles: u64,
}

/// What a progress callback answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Go on.
    Continue,
    /// Stop soon. A compile ends with [`CompileError::Cancelled`](crate::error::CompileError::Cancelled) and leaves
    /// nothing behind; a render gives the tiles that are finished.
    Cancel,
}

/// Seconds spent in a part of the work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    /// By the clock on the wall, added up over the threads that did the part: where several did, the parts add up to more
    /// than the total.
    pub wall: f64,
    /// Processor time, added up over threads. The same as `wall` on systems that do not tell.
    pub cpu: f64,
}

/// Where the time went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhaseSeconds {
    /// The reader's own work: everything between calls of the sink.
    pub parse: Seconds,
    /// Taking vertices, placing triangles in buckets, spilling.
    pub scatter: Seconds,
    /// Reading buckets back and cutting them into blocks.
    pub cut: Seconds,
    /// Deduplicating the vertices of blocks and encoding them.
    pub encode: Seconds,
    /// Writing blocks, directory and header, and publishing the file.
    pub write: Seconds,
    /// All of it.
    pub total: Seconds,
}

/// What a compile did.
#[derive(Clone, Debug)]
pub struct CompileReport {
    /// Triangles in the compiled file.
    pub triangles: u64,
    /// Blocks in it.
    pub blocks: u32,
    /// Vertices stored, counted once per block that uses them.
    pub vertices: u64,
    /// Its size.
    pub file_bytes: u64,
    /// Its size per triangle: ids, materials, directory and header included.
    pub bytes_per_triangle: f64,
    /// Triangles of exactly zero area, as stored. They are kept (and never hit).
    pub degenerate: u64,
    /// Triangles with the same three positions as another of the same block, not counting the first. Equal triangles share their
    /// centroid and so come into one block unless more of them coincide than a block holds.
    pub duplicates: u64,
    /// Triangles left out because a coordinate was not finite.
    pub skipped: u64,
    /// What the reader of the model file left out or had to guess; `None` if the geometry came from no file, or if a working file spared
    /// a lazy compile the reading.
    pub import: Option<ImportReport>,
    /// Triangles with texture coordinates or normals.
    pub triangles_with_attributes: u64,
    /// What these take in the compiled file, without their directory.
    pub attribute_bytes: u64,
    /// How positions are held.
    pub precision: Precision,
    /// Largest distance between a vertex of the source and the stored one, per axis; 0 if nothing was rounded. A number in text counts
    /// as the f64 next to it.
    pub error_bound: f64,
    /// Whether the precision keeps the promise of [`PrecisionChoice::Auto`]; true for any other choice.
    pub tolerance_met: bool,
    /// How blocks are packed.
    pub codec: Codec,
    /// Where the time went.
    pub seconds: PhaseSeconds,
    /// Bytes written to temporary files.
    pub spill_bytes: u64,
    /// Largest sum of reservations in the budget while compiling, other users of the budget included.
    pub budget_peak: Bytes,
}
