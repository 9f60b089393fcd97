//! Procedural models as compiled files in memory, for tests and benchmarks.

use outcrop::MemoryBudget;
use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::procedural::Shape;
use outcrop::units::Bytes;

/// The compiled file of a shape.
pub fn compiled(shape: &dyn Shape, options: &CompileOptions) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("model.outcrop");
    let budget = MemoryBudget::new(Bytes::mib(256));
    compile_shape(shape, &path, options, &budget, &mut |_| Control::Continue).expect("the shape compiles");
    std::fs::read(path).expect("the file was just written")
}
