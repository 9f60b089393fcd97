//! [`LazyModel`]: cells that are cut when somebody asks for them.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use parking_lot::{Condvar, Mutex};

use super::super::blocks::BlockSettings;
use super::super::bucket::BUCKET_TRIANGLES_MAX;
use super::super::clock::{Meter, Moment};
use super::super::compiler::Compiler;
use super::super::file::read_file;
use super::super::options::{CompileOptions, Control, PhaseSeconds, PrecisionChoice, Progress, Seconds};
use super::super::temporary::DiskQuota;
use super::cutter::Cutter;
use super::keep::KeepCells;
use super::log::{Log, replay};
use super::working_file::WorkingFile;
use crate::block::checksum;
use crate::budget::{Allowance, MemoryBudget, Reservation};
use crate::error::{CompileError, ModelError};
use crate::import::{ImportOptions, ImportReport, source_record};
use crate::model::{
    BlockEntry, CellEntry, CellRecord, Model, SourceRecord, WORKING_HEADER_BYTES, WorkingHeader,
    WorkingOptions,
};
use crate::units::{BlockId, Bytes, CellId};

/// How a model is compiled lazily.
#[derive(Clone, Debug)]
pub struct LazyOptions {
    /// How blocks are to be made. `threads` are those of the first pass and of [`LazyModel::finish`].
    pub compile: CompileOptions,
    /// About how many triangles a cell has: the least that is cut. Smaller cells leave more of the model alone, larger ones give
    /// fewer blocks that are not full.
    pub cell_triangles: u32,
    /// How many cells may be cut at once, each in memory of its own; fewer if that would take more than a quarter of the budget.
    /// Threads that find no memory free wait for a cell to be done.
    pub cells_at_once: u32,
    /// Start anew even if there is a working file that fits.
    pub anew: bool,
}

impl Default for LazyOptions {
    fn default() -> LazyOptions {
        LazyOptions {
            compile: CompileOptions::default(),
            cell_triangles: 32 << 10,
            cells_at_once: 1,
            anew: false,
        }
    }
}

/// How far a lazy compile has come. What the reader of the model file has to say is in [`LazyModel::import_report`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LazyReport {
    /// Triangles of the model.
    pub triangles: u64,
    /// Triangles left out because a coordinate was not finite.
    pub skipped: u64,
    /// Its cells.
    pub cells: u32,
    /// Cells that are cut.
    pub cells_cut: u32,
    /// Of these, the cells that were cut since the model was opened.
    pub cells_cut_now: u32,
    /// Triangles in cells that are cut: no other was ever sorted or encoded.
    pub triangles_encoded: u64,
    /// Blocks that there are.
    pub blocks: u64,
    /// Length of the working file.
    pub working_bytes: u64,
    /// Whether the source has texture coordinates, normals or materials with images, which a lazy compile leaves out: the picture
    /// is not the one of the whole model.
    pub details_left_out: bool,
    /// Whether the working file was there already, so that the source was not read.
    pub was_reopened: bool,
    /// The time of the first pass, if it was made now: parse, scatter, and, as `write`, the writing of the cells.
    pub first_pass: PhaseSeconds,
    /// The time of cutting cells since the model was opened, reading and writing included.
    pub cut: Seconds,
}

/// A cell that is cut.
#[derive(Debug)]
pub(super) struct CutCell {
    pub entries: Arc<[BlockEntry]>,
    pub degenerate: u32,
    pub duplicates: u32,
    pub _memory: Reservation,
}

/// What a working file says before its log.
pub(super) struct Contents {
    pub header: WorkingHeader,
    pub records: Vec<CellRecord>,
    pub model: Arc<Model>,
}

impl Contents {
    pub fn parse(header: WorkingHeader, cells: &[u8], materials: &[u8]) -> Result<Contents, ModelError> {
        let (records, model) = header.model(cells, materials, BUCKET_TRIANGLES_MAX as u32)?;
        Ok(Contents { header, records, model: Arc::new(model) })
    }

    /// `None` if the file is not one that was made for `made_for` and completed, or is damaged.
    fn read(
        working: &WorkingFile,
        made_for: &WorkingOptions,
        budget: &MemoryBudget,
    ) -> Result<Option<Contents>, CompileError> {
        let file_bytes = working.len()?;
        let mut header = [0; WORKING_HEADER_BYTES];
        if file_bytes < header.len() as u64 {
            return Ok(None);
        }
        working.read(0, &mut header)?;
        let Ok(header) = WorkingHeader::parse(&header, file_bytes) else { return Ok(None) };
        if header.made_for != *made_for {
            return Ok(None);
        }
        // Both lie inside the file, so this is no more than its length; but that can be more than there is memory.
        let _room = budget
            .reserve(Bytes(header.cells.bytes + header.materials.bytes), "the tables of a working file")?;
        let mut sections = [header.cells, header.materials].map(|section| vec![0; section.bytes as usize]);
        for (bytes, section) in sections.iter_mut().zip([header.cells, header.materials]) {
            working.read(section.offset, bytes)?;
        }
        Ok(Contents::parse(header, &sections[0], &sections[1]).ok())
    }
}

/// What threads that want cells cut share.
struct Cutters {
    idle: Vec<Cutter>,
    /// Cells that are being cut.
    busy: Vec<CellId>,
    time: Meter,
    cut_count: u32,
}

/// A model whose file has been read but that is not compiled yet. Cells are cut into blocks when they are asked for; what was cut stays
/// in the working file, `OUTPUT.working`, which this has locked, and is there again when the model is opened the next time.
///
/// It is a [`BlockSource`](crate::source::BlockSource): an octree opened over it cuts the cells that rays reach, and nothing else.
/// Hits and images are those of the compiled file, bit for bit (I2).
///
/// Shared by all threads. A cell is cut by one of them, the others wait or go on with other cells; no lock is held
/// meanwhile (I7). Its memory is taken from the budget when it is opened (I1).
pub struct LazyModel {
    output: PathBuf,
    working: WorkingFile,
    contents: Contents,
    options: CompileOptions,
    budget: MemoryBudget,
    cut: Vec<OnceLock<CutCell>>,
    log: Log,
    cutters: Mutex<Cutters>,
    /// Notified when a cell was cut, or could not be.
    changed: Condvar,
    allowance: Allowance,
    was_reopened: bool,
    first_pass: PhaseSeconds,
    /// What the reader of the model file reports, if the file was read now.
    import: Option<ImportReport>,
    _memory: Vec<Reservation>,
}

impl LazyModel {
    /// Opens the model file `input`: with the working file beside `output` if that was made from `input` as it is now and with the
    /// same options, else by reading `input` once, from its begin to its end. `output` is where [`LazyModel::finish`] will
    /// leave the compiled file. `progress` is called while the file is read.
    ///
    /// # Errors
    /// [`CompileError`]; [`CompileError::Locked`] if the working file is in use. A pass that fails leaves no file, and one that was killed
    /// a file that the next one starts anew.
    pub fn open(
        input: impl AsRef<Path>,
        output: impl AsRef<Path>,
        options: &LazyOptions,
        budget: &MemoryBudget,
        progress: &mut dyn FnMut(Progress) -> Control,
    ) -> Result<LazyModel, CompileError> {
        let (input, output) = (input.as_ref(), output.as_ref());
        let source = source_record(input)?;
        let working = match LazyModel::reopen(output, source, options, budget)? {
            Ok(model) => return Ok(model),
            Err(working) => working,
        };
        let mut prepare = |compiler: &mut Compiler<'_>| {
            compiler.set_bucket_triangles(u64::from(options.cell_triangles));
            compiler.leave_attributes_out();
        };
        let ending = KeepCells::of(working, options);
        let end = |compiler: Compiler<'_>, import| {
            let mut model = compiler.end(ending)?;
            model.import = Some(import);
            Ok(model)
        };
        let import = ImportOptions::default();
        read_file(input, &import, output, source, &options.compile, budget, progress, &mut prepare, end)
    }

    /// The same for geometry that is no file: `emit` sends it to the compiler, unless there is a working file. `source` is to
    /// tell one geometry from another; for one of zeros the pass is always made.
    ///
    /// # Errors
    /// As for [`LazyModel::open`].
    pub fn from_mesh(
        source: SourceRecord,
        output: impl AsRef<Path>,
        options: &LazyOptions,
        budget: &MemoryBudget,
        progress: &mut dyn FnMut(Progress) -> Control,
        emit: impl FnOnce(&mut Compiler<'_>) -> Result<(), CompileError>,
    ) -> Result<LazyModel, CompileError> {
        let output = output.as_ref();
        let working = match LazyModel::reopen(output, source, options, budget)? {
            Ok(model) => return Ok(model),
            Err(working) => working,
        };
        let mut compiler = Compiler::new(output, options.compile.clone(), budget, progress)?;
        compiler.set_source(source);
        compiler.set_bucket_triangles(u64::from(options.cell_triangles));
        compiler.leave_attributes_out();
        emit(&mut compiler)?;
        compiler.end(KeepCells::of(working, options))
    }

    /// Where the working file of a lazy compile to `output` is.
    pub fn working_path(output: impl AsRef<Path>) -> PathBuf {
        WorkingFile::path_for(output.as_ref())
    }

    /// Locks the working file and opens the model from it, or gives back the file, empty.
    fn reopen(
        output: &Path,
        source: SourceRecord,
        options: &LazyOptions,
        budget: &MemoryBudget,
    ) -> Result<Result<LazyModel, WorkingFile>, CompileError> {
        let quota = DiskQuota::new(options.compile.disk_limit.map(|limit| limit.0));
        let mut working = WorkingFile::lock(output, quota)?;
        let made_for =
            WorkingOptions { source, options: options_hash(&options.compile, options.cell_triangles) };
        let contents = match options.anew || source == SourceRecord::default() {
            true => None,
            false => Contents::read(&working, &made_for, budget)?,
        };
        let Some(contents) = contents else {
            working.empty()?;
            return Ok(Err(working));
        };
        working.count_existing(working.len()?)?;
        let seconds = PhaseSeconds::default();
        let mut model = LazyModel::assemble(
            working,
            contents,
            budget,
            options.compile.clone(),
            options.cells_at_once,
            seconds,
        )?;
        model.was_reopened = true;
        let LazyModel { working, contents, allowance, cut, .. } = &model;
        let end = replay(working, contents, allowance, |cell, cut_cell| {
            cut[cell.0 as usize].set(cut_cell).is_ok()
        })?;
        // What is behind it is no record, or one of a run that was killed while it wrote.
        working.truncate(end)?;
        model.log = Log::new(end);
        Ok(Ok(model))
    }

    /// A model of which no cell is cut.
    pub(super) fn assemble(
        working: WorkingFile,
        contents: Contents,
        budget: &MemoryBudget,
        options: CompileOptions,
        cells_at_once: u32,
        first_pass: PhaseSeconds,
    ) -> Result<LazyModel, CompileError> {
        let Contents { header, records, model } = &contents;
        let settings =
            BlockSettings { precision: header.precision, limits: header.limits, codec: header.codec };
        let table_bytes = model.resident_bytes().0
            + (records.len() * (size_of::<CellRecord>() + size_of::<OnceLock<CutCell>>())) as u64;
        let mut memory = vec![budget.reserve(Bytes(table_bytes), "the cells of a lazy compile")?];
        // Cells are not all of one size, so the blocks may be more than expected; the budget has the rest.
        let blocks = model.expected_block_count() as usize;
        let directory = Bytes(CellEntry::directory_bytes(blocks + blocks / 2));
        let allowance = Allowance::new(budget, directory, "the directory of a lazy compile")?;
        let cutter_bytes = Bytes(Cutter::bytes_needed(settings, records));
        let mut idle = Vec::new();
        // Most of the budget is for the cache, whoever asks for how many.
        let fitting = (budget.limit().0 / 4 / cutter_bytes.0.max(1)).max(1);
        while (idle.len() as u64) < u64::from(cells_at_once.max(1)).min(fitting) {
            match budget.reserve(cutter_bytes, "cutting a cell") {
                Ok(reservation) => memory.push(reservation),
                Err(error) if idle.is_empty() => return Err(error.into()),
                Err(_) => break,
            }
            idle.push(Cutter::new(settings));
        }
        let cutters = Cutters { idle, busy: Vec::new(), time: Meter::default(), cut_count: 0 };
        Ok(LazyModel {
            // The working file's own name without what it adds.
            output: working.path().with_extension(""),
            log: Log::new(header.log_offset()),
            cut: records.iter().map(|_| OnceLock::new()).collect(),
            working,
            contents,
            options,
            budget: budget.clone(),
            cutters: Mutex::new(cutters),
            changed: Condvar::new(),
            allowance,
            was_reopened: false,
            first_pass,
            import: None,
            _memory: memory,
        })
    }

    /// Everything about the model but its blocks, which are not known: [`Model::cells`] stands for them.
    pub fn model(&self) -> &Arc<Model> {
        &self.contents.model
    }

    /// Where the compiled file will be.
    pub fn output(&self) -> &Path {
        &self.output
    }

    /// How far it has come.
    pub fn report(&self) -> LazyReport {
        let (cut, cut_count) = {
            let cutters = self.cutters.lock();
            (cutters.time.seconds(), cutters.cut_count)
        };
        let done = || self.cut.iter().filter_map(OnceLock::get);
        let triangles =
            done().flat_map(|cell| cell.entries.iter()).map(|entry| u64::from(entry.triangle_count));
        LazyReport {
            triangles: self.contents.header.triangle_count,
            skipped: self.contents.header.skipped,
            cells: self.cut.len() as u32,
            cells_cut: done().count() as u32,
            cells_cut_now: cut_count,
            triangles_encoded: triangles.sum(),
            blocks: done().map(|cell| cell.entries.len() as u64).sum(),
            working_bytes: self.log.end(),
            details_left_out: self.contents.header.details_left_out,
            was_reopened: self.was_reopened,
            first_pass: self.first_pass,
            cut,
        }
    }

    /// What the reader of the model file left out or had to guess; `None` if the file was not read now
    /// ([`LazyReport::was_reopened`]), or if the geometry came from no file. It stops nothing, so show its warnings to whoever opened the
    /// model.
    pub fn import_report(&self) -> Option<&ImportReport> {
        self.import.as_ref()
    }

    /// Whether a cell is cut.
    pub fn is_cut(&self, cell: CellId) -> bool {
        self.cut.get(cell.0 as usize).is_some_and(|place| place.get().is_some())
    }

    /// Whether every cell is cut, so that [`LazyModel::finish`] has nothing to do but to copy.
    pub fn is_complete(&self) -> bool {
        self.cut.iter().all(|cell| cell.get().is_some())
    }

    /// The blocks of a cell, in the order of their numbers, which begin with [`CellEntry::first_block`]; cuts the cell if nobody has
    /// yet. If another thread is at it, waits for that.
    ///
    /// # Errors
    /// [`CompileError::Write`] if the blocks cannot be kept (a full disk), [`CompileError::WorkingFile`] if the triangles cannot be
    /// read back. The cell stays uncut, and can be asked for again.
    pub fn cut_cell(&self, cell: CellId) -> Result<Arc<[BlockEntry]>, CompileError> {
        let place = self.cut.get(cell.0 as usize);
        let Some(place) = place else {
            return Err(CompileError::Limit { reason: format!("the model has no cell {}", cell.0) });
        };
        if let Some(done) = place.get() {
            return Ok(Arc::clone(&done.entries));
        }
        let Some(mut borrowed) = self.borrow_cutter(cell, place) else {
            return Ok(place.get().map(|done| Arc::clone(&done.entries)).unwrap_or_default());
        };
        let cutter = borrowed.cutter();
        self.cut_with(cutter, cell)?;
        let made_for = &self.contents.header.made_for;
        let done = self.log.append(&self.working, made_for, cell, cutter, &self.allowance)?;
        borrowed.is_cut = true;
        // Whoever has the cutter for a cell is the only one at that cell.
        Ok(Arc::clone(&place.get_or_init(|| done).entries))
    }

    /// Reads a block that is known.
    ///
    /// # Errors
    /// What the system says; `None` if there is no such block, or its cell is not cut.
    pub(crate) fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Option<std::io::Result<()>> {
        let (cell, index) = self.contents.model.cells.cell_of(block)?;
        let entry = self.cut[cell.0 as usize].get()?.entries.get(index)?;
        into.clear();
        into.resize(entry.stored_bytes as usize, 0);
        Some(self.working.read_raw(entry.offset, into))
    }

    /// The working file.
    pub(crate) fn path(&self) -> &Path {
        self.working.path()
    }

    /// Makes the blocks of a cell.
    pub(super) fn cut_with(&self, cutter: &mut Cutter, cell: CellId) -> Result<(), CompileError> {
        let Contents { records, model, .. } = &self.contents;
        let index = cell.0 as usize;
        cutter.cut(&self.working, &records[index], &model.cells.entries()[index])
    }

    /// A cutter, for `cell` alone; `None` if another thread has cut it in the meantime.
    pub(super) fn borrow_cutter(&self, cell: CellId, place: &OnceLock<CutCell>) -> Option<Borrowed<'_>> {
        let mut cutters = self.cutters.lock();
        loop {
            if place.get().is_some() {
                return None;
            }
            if !cutters.busy.contains(&cell)
                && let Some(cutter) = cutters.idle.pop()
            {
                cutters.busy.push(cell);
                let start = Moment::now();
                return Some(Borrowed { model: self, cell, cutter: Some(cutter), start, is_cut: false });
            }
            self.changed.wait(&mut cutters);
        }
    }

    pub(super) fn working(&self) -> &WorkingFile {
        &self.working
    }

    pub(super) fn contents(&self) -> &Contents {
        &self.contents
    }

    pub(super) fn options(&self) -> &CompileOptions {
        &self.options
    }

    pub(super) fn budget(&self) -> &MemoryBudget {
        &self.budget
    }

    /// The cells, those that are cut and those that are not.
    pub(super) fn cells(&self) -> &[OnceLock<CutCell>] {
        &self.cut
    }

    pub(super) fn cut_time(&self) -> Seconds {
        self.cutters.lock().time.seconds()
    }

    pub(super) fn first_pass(&self) -> PhaseSeconds {
        self.first_pass
    }
}

impl std::fmt::Debug for LazyModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LazyModel")
            .field("working", &self.working.path())
            .field("report", &self.report())
            .finish()
    }
}

/// A cutter that goes back when this is dropped, by whatever way.
pub(super) struct Borrowed<'m> {
    model: &'m LazyModel,
    cell: CellId,
    cutter: Option<Cutter>,
    start: Moment,
    /// Whether the cell is in the log now.
    is_cut: bool,
}

impl Borrowed<'_> {
    pub fn cutter(&mut self) -> &mut Cutter {
        // Only `drop` takes it.
        self.cutter.as_mut().expect("there until dropped")
    }
}

impl Drop for Borrowed<'_> {
    fn drop(&mut self) {
        let mut cutters = self.model.cutters.lock();
        cutters.time.add_since(self.start);
        cutters.cut_count += u32::from(self.is_cut);
        cutters.busy.retain(|cell| *cell != self.cell);
        cutters.idle.extend(self.cutter.take());
        drop(cutters);
        self.model.changed.notify_all();
    }
}

/// A hash over all that changes what a working file holds, and how.
pub(super) fn options_hash(options: &CompileOptions, cell_triangles: u32) -> u64 {
    let (kind, exponent) = match options.precision {
        PrecisionChoice::Auto => (0, 0),
        PrecisionChoice::Float32 => (1, 0),
        PrecisionChoice::Lattice { exponent } => (2, exponent),
    };
    let mut bytes =
        vec![options.codec.id(), kind, u8::from(options.skip_not_finite), u8::from(options.attributes)];
    bytes.extend_from_slice(&exponent.to_le_bytes());
    bytes.extend_from_slice(&options.block_bytes.to_le_bytes());
    bytes.extend_from_slice(&cell_triangles.to_le_bytes());
    checksum(&bytes)
}
