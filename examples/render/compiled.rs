//! Finds or makes the compiled file.

use std::error::Error;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use outcrop::compile::{
    CompileOptions, CompileReport, Compiler, Control, LazyModel, LazyOptions, Phase, Progress, Threads,
    compile_file_with, compile_shape,
};
use outcrop::error::{CompileError, ImportError, SourceError};
use outcrop::geom::Precision;
use outcrop::import::{GltfPart, ImportOptions, ImportReport, source_record_of};
use outcrop::model::{Model, PrecisionOrigin, SourceRecord};
use outcrop::procedural::{Gears, Shape};
use outcrop::source::{DiskSource, PageCache};
use outcrop::{BlockSource, MemoryBudget};

use crate::common::interrupt::Interrupt;
use crate::common::progress::Meter;
use crate::options::Options;

/// Where blocks come from.
pub enum Origin {
    /// A compiled file.
    File(PathBuf),
    /// A model that is compiled as rays reach it.
    Lazy(Arc<LazyModel>),
}

/// The compiled file, or what stands for it, and how it came to be.
pub struct Compiled {
    pub origin: Origin,
    /// What the model is called, and why it was or was not compiled.
    pub story: String,
    /// What compiling did, if it was done now.
    pub report: Option<CompileReport>,
}

/// Wheels per edge of the gears if the command line does not say.
const GEARS_N: u32 = 4;

/// Extension of compiled files.
const EXTENSION: &str = "outcrop";

/// Finds or makes the compiled file, or what stands for it; `None` if that was interrupted.
pub fn prepare(
    options: &Options,
    budget: &MemoryBudget,
    interrupt: &Interrupt,
    meter: &mut Meter,
) -> Result<Option<Compiled>, Box<dyn Error>> {
    match make(options, budget, interrupt, meter) {
        Ok(compiled) => Ok(Some(compiled)),
        Err(error) => match error.downcast::<CompileError>() {
            Ok(error) => match cause(&error) {
                CompileError::Cancelled => Ok(None),
                cause => Err(advice(options, cause).map_or(error as Box<dyn Error>, Into::into)),
            },
            Err(error) => Err(error),
        },
    }
}

/// What went wrong, behind the reader that it went through.
fn cause(error: &CompileError) -> &CompileError {
    match error {
        CompileError::Import(ImportError::Sink(error)) => cause(error),
        error => error,
    }
}

/// The message for what an option helps against, if one does.
fn advice(options: &Options, cause: &CompileError) -> Option<String> {
    match cause {
        CompileError::NotFinite { triangle } => {
            let model = options.model.as_deref().unwrap_or(Path::new("the model"));
            Some(format!(
                "{}: triangle {triangle} has a coordinate that is not finite; correct the model \
                 (--skip-not-finite leaves such triangles out)",
                model.display()
            ))
        }
        CompileError::Write { path, error }
            if matches!(error.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem) =>
        {
            let other = if options.compile_only { "-o" } else { "--compiled" };
            Some(format!(
                "cannot write {}: {error}; {other} FILE keeps the compiled file in another folder",
                path.display()
            ))
        }
        _ => None,
    }
}

fn make(
    options: &Options,
    budget: &MemoryBudget,
    interrupt: &Interrupt,
    meter: &mut Meter,
) -> Result<Compiled, Box<dyn Error>> {
    let compile_options = compile_options(options);
    let mut progress = |progress: Progress| {
        let phase = match progress.phase {
            Phase::Read => "reading",
            Phase::Scatter => "sorting",
            Phase::Cut => "compiling",
            Phase::Seal => "sealing",
        };
        meter.set(phase, progress.fraction.unwrap_or(0.0));
        if interrupt.is_requested() { Control::Cancel } else { Control::Continue }
    };

    let Some(model) = &options.model else {
        let n = options.gears_n.unwrap_or(GEARS_N);
        let path = file_of_gears(options);
        let story = format!("procedural gears, n = {n}");
        let gears = Gears::new(n)?;
        if options.lazy {
            // Gears of one size are always the same: what tells them apart is their number.
            let source = SourceRecord { file_bytes: 0, modified_ns: 0, fingerprint: u64::from(n) };
            let emit = |compiler: &mut Compiler<'_>| gears.emit(compiler);
            let lazy = lazy_options(options, compile_options);
            let model = LazyModel::from_mesh(source, &path, &lazy, budget, &mut progress, emit)?;
            return Ok(Compiled { origin: Origin::Lazy(Arc::new(model)), story, report: None });
        }
        let report = compile_shape(&gears, &path, &compile_options, budget, &mut progress)?;
        return Ok(Compiled { origin: Origin::File(path), story, report: Some(report) });
    };

    if is_compiled(model) {
        let story = format!("{}, a compiled file", model.display());
        return Ok(Compiled { origin: Origin::File(model.clone()), story, report: None });
    }

    let path = options.compiled.clone().unwrap_or_else(|| beside_part(model, &options.part));
    let reason = match need(options, model, &path, budget)? {
        Need::None { note } => {
            let part = of(&options.part);
            let story = format!("{}{part}, unchanged since it was compiled ({note})", model.display());
            return Ok(Compiled { origin: Origin::File(path), story, report: None });
        }
        Need::Compile(reason) => reason,
    };
    if options.is_lazy() {
        let lazy = lazy_options(options, compile_options.clone());
        let lazy = LazyModel::open(model, &path, &lazy, budget, &mut progress)?;
        // Only who asked for it by name gets a picture without what a lazy compile cannot hold.
        if lazy.report().details_left_out && !options.lazy {
            drop(lazy);
            return whole(options, model, path, budget, &mut progress, reason);
        }
        warn(lazy.import_report());
        let story = format!("{}, {reason}, as rays reach it", model.display());
        return Ok(Compiled { origin: Origin::Lazy(Arc::new(lazy)), story, report: None });
    }
    whole(options, model, path, budget, &mut progress, reason)
}

/// Compiles a model as a whole.
fn whole(
    options: &Options,
    model: &Path,
    path: PathBuf,
    budget: &MemoryBudget,
    progress: &mut dyn FnMut(Progress) -> Control,
    reason: &str,
) -> Result<Compiled, Box<dyn Error>> {
    let report = compile_file_with(
        model,
        &import_options(options),
        &path,
        &compile_options(options),
        budget,
        progress,
    )?;
    warn(report.import.as_ref());
    // What an earlier run had compiled of it as rays reached it is of no more use; there may be none.
    let _ = std::fs::remove_file(LazyModel::working_path(&path));
    let story = format!("{}{}, {reason}", model.display(), of(&options.part));
    Ok(Compiled { origin: Origin::File(path), story, report: Some(report) })
}

fn lazy_options(options: &Options, compile: CompileOptions) -> LazyOptions {
    let cells_at_once = options.threads;
    LazyOptions { compile, cells_at_once, anew: options.recompile, ..Default::default() }
}

/// `MODEL.outcrop`, with the model's own extension kept: `a.obj` and `a.ply` are two models.
fn beside(model: &Path) -> PathBuf {
    let mut name = model.as_os_str().to_os_string();
    name.push(".");
    name.push(EXTENSION);
    PathBuf::from(name)
}

/// The compiled file of `model`, which may be one itself.
pub fn file_of(model: &Path) -> PathBuf {
    if is_compiled(model) { model.to_path_buf() } else { beside(model) }
}

/// The compiled file of the gears that are made without a model.
pub fn file_of_gears(options: &Options) -> PathBuf {
    let n = options.gears_n.unwrap_or(GEARS_N);
    options.compiled.clone().unwrap_or_else(|| PathBuf::from(format!("gears{n}.{EXTENSION}")))
}

/// Where the images of `model` are kept, converted.
pub fn tiles_of(options: &Options, model: &Path) -> PathBuf {
    // The model's own folder may be read-only if the compiled file is elsewhere.
    let mut tiles = options.compiled.clone().unwrap_or_else(|| file_of(model)).into_os_string();
    tiles.push(".tiles");
    PathBuf::from(tiles)
}

/// Whether a file is a compiled one, by its name.
pub fn is_compiled(model: &Path) -> bool {
    model.extension().is_some_and(|extension| extension == EXTENSION)
}

/// [`beside`] for a part of a model.
pub fn beside_part(model: &Path, part: &GltfPart) -> PathBuf {
    let mut name = model.as_os_str().to_os_string();
    match part {
        GltfPart::Scene => {}
        GltfPart::Mesh(number) => name.push(format!(".mesh{number}")),
        GltfPart::Without(_) => name.push(".rest"),
    }
    beside(Path::new(&name))
}

/// What is said of a part behind the model's name.
fn of(part: &GltfPart) -> String {
    match part {
        GltfPart::Scene => String::new(),
        GltfPart::Mesh(number) => format!(" (mesh {number})"),
        GltfPart::Without(_) => " (what is not shared)".to_string(),
    }
}

fn import_options(options: &Options) -> ImportOptions {
    ImportOptions::default().with_gltf_part(options.part.clone())
}

/// Whether the model has to be compiled.
enum Need {
    Compile(&'static str),
    /// The compiled file is there and up to date; `note` says what in it is a matter of options.
    None {
        note: String,
    },
}

fn need(
    options: &Options,
    model: &Path,
    compiled: &Path,
    budget: &MemoryBudget,
) -> Result<Need, Box<dyn Error>> {
    let record = source_record_of(model, &import_options(options))?;
    if options.asks_to_compile() {
        return Ok(Need::Compile("compiled as asked"));
    }
    let is_empty = std::fs::metadata(compiled).map_or(true, |metadata| metadata.len() == 0);
    if is_empty {
        return Ok(Need::Compile("compiled for the first time"));
    }
    Ok(match DiskSource::open_in(compiled, PageCache::Use, budget) {
        Ok(source) if source.model().source == record => {
            let model = source.model();
            match other_options(model, options) {
                Some(reason) => Need::Compile(reason),
                None => Need::None { note: note(model) },
            }
        }
        Ok(_) => Need::Compile("compiled again because it changed"),
        // The file may be as sound as can be.
        Err(error @ (SourceError::Budget(_) | SourceError::Io { .. })) => return Err(error.into()),
        // That it is a compiled file is known: see `files::refuse_foreign`.
        Err(_) => Need::Compile("compiled again because the compiled file is damaged or of another version"),
    })
}

/// Why the options of now would make another file than those that it was compiled with, if they would. Block size and codec do not
/// count: no picture depends on them.
fn other_options(model: &Model, options: &Options) -> Option<&'static str> {
    let record = model.compiled?;
    // Who names a precision has asked for a compile.
    if record.precision == PrecisionOrigin::Given {
        return Some("compiled again, now with --precision auto");
    }
    if record.skipped > 0 && !options.skip_not_finite {
        return Some("compiled again, now without --skip-not-finite");
    }
    None
}

/// What in the compiled file is a matter of options.
fn note(model: &Model) -> String {
    let precision = match model.precision {
        Precision::Float32 => "positions as float32".to_string(),
        Precision::Lattice(lattice) => format!("positions on a lattice of spacing 2^{}", lattice.exponent),
    };
    match model.compiled.map_or(0, |record| record.skipped) {
        0 => precision,
        1 => format!("{precision}, 1 triangle that is not finite left out"),
        count => format!("{precision}, {count} triangles that are not finite left out"),
    }
}

fn compile_options(options: &Options) -> CompileOptions {
    let mut compile =
        CompileOptions { threads: Threads::Count(options.threads as usize), ..Default::default() };
    if let Some(block_bytes) = options.block_bytes {
        compile.block_bytes = block_bytes;
    }
    if let Some(codec) = options.codec {
        compile.codec = codec;
    }
    if let Some(precision) = options.precision {
        compile.precision = precision;
    }
    compile.skip_not_finite = options.skip_not_finite;
    compile
}

/// Tells what the reader of a model file did not use as the file may have meant it.
fn warn(import: Option<&ImportReport>) {
    let Some(import) = import else { return };
    for warning in &import.warnings {
        eprintln!("warning: {warning}");
    }
    let more = import.warning_count.saturating_sub(import.warnings.len() as u64);
    if more > 0 {
        eprintln!("warning: and {more} more");
    }
}
