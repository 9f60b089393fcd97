//! From a procedural model to a compiled file in one call.

use std::path::Path;

use super::compiler::Compiler;
use super::options::{CompileOptions, CompileReport, Control, Progress};
use crate::budget::MemoryBudget;
use crate::error::CompileError;
use crate::procedural::Shape;

/// Compiles `shape` to `output`, in memory bounded by `budget`. `progress` is called now and then.
///
/// # Errors
/// [`CompileError`]; no file is left then, and one that was at `output` before is as it was.
pub fn compile_shape(
    shape: &dyn Shape,
    output: impl AsRef<Path>,
    options: &CompileOptions,
    budget: &MemoryBudget,
    progress: &mut dyn FnMut(Progress) -> Control,
) -> Result<CompileReport, CompileError> {
    let mut compiler = Compiler::new(output, options.clone(), budget, progress)?;
    shape.emit(&mut compiler)?;
    compiler.finish()
}
