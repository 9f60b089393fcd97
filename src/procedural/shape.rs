//! What all procedural models have in common.

use crate::error::CompileError;
use crate::import::MeshSink;
use crate::model::MaterialRecord;

/// A model that is computed instead of read.
///
/// `emit` is a pure function of the shape: it sends the same materials, vertices and triangles in the same order
/// each time. It sends all materials first, so material ids of a fresh sink start at 0 in the order of the
/// shape's documentation.
pub trait Shape {
    /// How many vertices [`Shape::emit`] sends.
    fn vertex_count(&self) -> u64;

    /// How many triangles [`Shape::emit`] sends.
    fn triangle_count(&self) -> u64;

    /// Whether the vertices are f64; otherwise they are f32.
    fn is_double(&self) -> bool {
        false
    }

    /// Sends the model to `sink`. Vertices are numbered from `sink`'s first one, so the sink must be fresh.
    ///
    /// # Errors
    /// Those of the sink.
    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError>;
}

/// The default material, named, since nameless ones cannot be written to a file.
pub(super) fn plain_material() -> MaterialRecord {
    MaterialRecord { name: "plain".to_string(), ..MaterialRecord::default() }
}
