//! From a model file to a compiled file in one call.

use std::path::Path;

use super::compiler::Compiler;
use super::options::{CompileOptions, CompileReport, Control, Progress};
use super::vertices::Keep;
use crate::budget::MemoryBudget;
use crate::error::{CompileError, ImportError};
use crate::import::{ImportOptions, ImportReport, import_file, source_record_of};
use crate::model::SourceRecord;

/// Compiles the model file `input` to `output`, in memory bounded by `budget`. `progress` is called some hundred times.
/// What the import left out or had to guess, a missing material library for one, is in [`CompileReport::import`]: it stops nothing, so
/// show its warnings to whoever started the compile.
///
/// # Errors
/// [`CompileError`]; no file is left then, and one that was at `output` before is as it was.
pub fn compile_file(
    input: impl AsRef<Path>,
    output: impl AsRef<Path>,
    options: &CompileOptions,
    budget: &MemoryBudget,
    progress: &mut dyn FnMut(Progress) -> Control,
) -> Result<CompileReport, CompileError> {
    compile_file_with(input, &ImportOptions::default(), output, options, budget, progress)
}

/// [`compile_file`] of what `import` has read: with other materials, or a part of a glTF file. Threads are those of `options`.
///
/// # Errors
/// As for [`compile_file`].
pub fn compile_file_with(
    input: impl AsRef<Path>,
    import: &ImportOptions,
    output: impl AsRef<Path>,
    options: &CompileOptions,
    budget: &MemoryBudget,
    progress: &mut dyn FnMut(Progress) -> Control,
) -> Result<CompileReport, CompileError> {
    let (input, output) = (input.as_ref(), output.as_ref());
    let source = source_record_of(input, import)?;
    let mut prepare = |_: &mut Compiler<'_>| ();
    let end = |compiler: Compiler<'_>, import| {
        let mut report = compiler.finish()?;
        report.import = Some(import);
        Ok(report)
    };
    read_file(input, import, output, source, options, budget, progress, &mut prepare, end)
}

/// Reads the model file `input` into a compiler, as often as it takes, and ends the one that has all that it needs; `end` gets what the
/// last reading reports.
#[expect(clippy::too_many_arguments, reason = "what a compile takes, and two steps of it")]
pub(super) fn read_file<T>(
    input: &Path,
    import: &ImportOptions,
    output: &Path,
    source: SourceRecord,
    options: &CompileOptions,
    budget: &MemoryBudget,
    progress: &mut dyn FnMut(Progress) -> Control,
    prepare: &mut dyn FnMut(&mut Compiler<'_>),
    end: impl FnOnce(Compiler<'_>, ImportReport) -> Result<T, CompileError>,
) -> Result<T, CompileError> {
    // A file can be read again, so the rare need for more of the vertices costs another reading and not the space to keep it
    // every time.
    let (mut keep, mut spent) = (Keep::Narrow, None);
    loop {
        let mut compiler = Compiler::new(output, options.clone(), budget, &mut *progress)?;
        compiler.set_source(source);
        compiler.set_keep(keep);
        prepare(&mut compiler);
        if let Some(spent) = &spent {
            compiler.add_spent(spent);
        }
        let import_options = ImportOptions { pool: compiler.pool().cloned(), ..import.clone() };
        let imported = import_file(input, &import_options, &mut compiler);
        let imported = imported.map_err(sink_error).and_then(|report| compiler.drain().map(|()| report));
        match (imported, compiler.needs()) {
            // Asks for more each time, so at most twice.
            (Err(_), Some(needed)) => (keep, spent) = (needed, Some(compiler.into_spent())),
            (Err(error), None) => return Err(error),
            (Ok(report), _) => return end(compiler, report),
        }
    }
}

/// The error of an import, without the wrapping that it got on its way through the reader.
fn sink_error(error: ImportError) -> CompileError {
    match error {
        ImportError::Sink(error) => *error,
        other => CompileError::Import(other),
    }
}
