//! Finds or makes the compiled file.

use std::error::Error;
use std::path::{Path, PathBuf};

use outcrop::compile::{
    CompileOptions, CompileReport, Compiler, Control, Phase, Progress, Threads, compile_file,
};
use outcrop::import::source_record;
use outcrop::procedural::{Gears, Shape};
use outcrop::source::DiskSource;
use outcrop::{BlockSource, MemoryBudget};

use crate::common::interrupt::Interrupt;
use crate::common::progress::Meter;
use crate::options::Options;

/// The compiled file and how it came to be.
pub struct Compiled {
    pub path: PathBuf,
    /// What the model is called, and why it was or was not compiled.
    pub story: String,
    /// What compiling did, if it was done now.
    pub report: Option<CompileReport>,
}

/// Wheels per edge of the gears if the command line does not say.
const GEARS_N: u32 = 4;

/// Extension of compiled files.
const EXTENSION: &str = "outcrop";

pub fn prepare(
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
        let path = options.compiled.clone().unwrap_or_else(|| PathBuf::from(format!("gears{n}.{EXTENSION}")));
        let mut compiler = Compiler::new(&path, compile_options, budget, &mut progress)?;
        Gears::new(n)?.emit(&mut compiler)?;
        let report = compiler.finish()?;
        let story = format!("procedural gears, n = {n}");
        return Ok(Compiled { path, story, report: Some(report) });
    };

    if model.extension().is_some_and(|extension| extension == EXTENSION) {
        if options.compile_only {
            return Err(format!("{}: is a compiled file already", model.display()).into());
        }
        let story = format!("{}, a compiled file", model.display());
        return Ok(Compiled { path: model.clone(), story, report: None });
    }

    let path = options.compiled.clone().unwrap_or_else(|| beside(model));
    let reason = match reason_to_compile(options, model, &path)? {
        None => {
            let story = format!("{}, unchanged since it was compiled", model.display());
            return Ok(Compiled { path, story, report: None });
        }
        Some(reason) => reason,
    };
    let report = compile_file(model, &path, &compile_options, budget, &mut progress)?;
    Ok(Compiled { path, story: format!("{}, {reason}", model.display()), report: Some(report) })
}

/// `MODEL.outcrop`, with the model's own extension kept: `a.obj` and `a.ply` are two models.
fn beside(model: &Path) -> PathBuf {
    let mut name = model.as_os_str().to_os_string();
    name.push(".");
    name.push(EXTENSION);
    PathBuf::from(name)
}

/// Why the model has to be compiled, or `None` if the compiled file is there and up to date.
fn reason_to_compile(
    options: &Options,
    model: &Path,
    compiled: &Path,
) -> Result<Option<&'static str>, Box<dyn Error>> {
    let record = source_record(model)?;
    let asked = options.block_bytes.is_some() || options.codec.is_some() || options.precision.is_some();
    if options.recompile || asked {
        return Ok(Some("compiled as asked"));
    }
    if !compiled.exists() {
        return Ok(Some("compiled for the first time"));
    }
    Ok(match DiskSource::open(compiled) {
        Ok(source) if source.model().source == record => None,
        Ok(_) => Some("compiled again because it changed"),
        Err(_) => Some("compiled again because the compiled file is damaged or of another version"),
    })
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
    compile
}
