//! From a model file to a compiled file in one call.

use std::path::Path;

use super::compiler::Compiler;
use super::options::{CompileOptions, CompileReport, Control, Progress};
use crate::budget::MemoryBudget;
use crate::error::{CompileError, ImportError};
use crate::import::{ImportOptions, import_file, source_record};

/// Compiles the model file `input` to `output`, in memory bounded by `budget`. `progress` is called some hundred times.
///
/// # Errors
/// [`CompileError`]; no file is left then, and one that was at `output` before is as it was.
pub fn compile_file(
    input: &Path,
    output: &Path,
    options: &CompileOptions,
    budget: &MemoryBudget,
    progress: &mut dyn FnMut(Progress) -> Control,
) -> Result<CompileReport, CompileError> {
    let source = source_record(input)?;
    let mut compiler = Compiler::new(output, options.clone(), budget, progress)?;
    compiler.set_source(source);
    match import_file(input, &ImportOptions::default(), &mut compiler) {
        Ok(_) => compiler.finish(),
        Err(ImportError::Sink(error)) => Err(*error),
        Err(error) => Err(error.into()),
    }
}
