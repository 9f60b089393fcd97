//! Where a reader, a generator or a caller's iterator sends geometry.

use crate::error::CompileError;
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// A run of vertices in the source's own number type, so that nothing is rounded on the way.
#[derive(Clone, Copy, Debug)]
pub enum VertexBatch<'a> {
    /// From binary f32 (or narrower) sources.
    Float32(&'a [[f32; 3]]),
    /// From f64 sources, and text that f32 cannot hold.
    Float64(&'a [[f64; 3]]),
    /// From text of which f32 keeps every digit: the f32 nearest to a coordinate is at most half a unit of the last written digit
    /// away, so that it gives the same text again. These are the numbers of the text, to be rounded to f32 if no vertex of the
    /// mesh comes as `Float64`.
    Float32Text(&'a [[f64; 3]]),
}

/// Stands for a corner without an attribute in [`CornerIndices`].
pub const NO_INDEX: u32 = u32::MAX;

/// Which attributes the corners of triangles have: for each triangle three indices into the texture coordinates and the normals of the
/// mesh, counted from 0 in the order in which they come, or [`NO_INDEX`]. They may name attributes that are yet to come.
#[derive(Clone, Copy, Debug, Default)]
pub struct CornerIndices<'a> {
    /// Of texture coordinates, if any triangle has them.
    pub uvs: Option<&'a [[u32; 3]]>,
    /// Of normals, if any triangle has them.
    pub normals: Option<&'a [[u32; 3]]>,
}

/// Receives an indexed mesh as a stream. Vertices are numbered from 0 in the order in which they come; a face
/// names vertices that have come already. Triangles get ids in the order in which they come. Batches may have
/// any length; long ones (thousands) are faster.
///
/// An error that says what is wrong with an argument (more materials than may be, a vertex that has not come yet, lists of different
/// lengths) leaves the sink as it was. After any other, part of what was sent may be lost: the sink is to be dropped. A
/// [`Compiler`](crate::compile::Compiler) refuses whatever comes after, and makes no file.
pub trait MeshSink {
    /// Adds a material and returns its id. Names need not be unique; each call adds an entry.
    ///
    /// # Errors
    /// More than 65,536 materials.
    fn material(&mut self, material: MaterialRecord) -> Result<MaterialId, CompileError>;

    /// Appends vertices.
    ///
    /// # Errors
    /// Spill cannot be written, the budget is exhausted, or the caller cancelled.
    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError>;

    /// Says that no vertex will come after this. Optional; lets the sink place triangles while they arrive.
    ///
    /// # Errors
    /// As for [`MeshSink::vertices`].
    fn vertices_complete(&mut self) -> Result<(), CompileError>;

    /// The position of a vertex that has come already, for readers that cut concave polygons.
    ///
    /// # Errors
    /// Spill cannot be read.
    fn position(&mut self, vertex: u64) -> Result<[f64; 3], CompileError>;

    /// Appends triangles of one material, each naming vertices that have come already.
    ///
    /// # Errors
    /// A vertex that has not come yet ([`CompileError::Limit`]), or as for [`MeshSink::vertices`].
    fn triangles(&mut self, triangles: &[[u32; 3]], material: MaterialId) -> Result<(), CompileError>;

    /// Whether the sink has a use for attributes: if not, readers need not send them. The four methods about attributes may be left
    /// out by sinks that have none.
    fn takes_attributes(&self) -> bool {
        false
    }

    /// Appends texture coordinates: (0, 0) is the lower left corner of an image.
    ///
    /// # Errors
    /// As for [`MeshSink::vertices`].
    fn texture_coordinates(&mut self, batch: &[[f32; 2]]) -> Result<(), CompileError> {
        let _ = batch;
        Ok(())
    }

    /// Appends normals, of any length.
    ///
    /// # Errors
    /// As for [`MeshSink::vertices`].
    fn normals(&mut self, batch: &[[f32; 3]]) -> Result<(), CompileError> {
        let _ = batch;
        Ok(())
    }

    /// [`MeshSink::triangles`] with attributes; lists of `corners` are as long as `triangles`.
    ///
    /// # Errors
    /// As for [`MeshSink::triangles`].
    fn triangles_with_attributes(
        &mut self,
        triangles: &[[u32; 3]],
        corners: CornerIndices<'_>,
        material: MaterialId,
    ) -> Result<(), CompileError> {
        let _ = corners;
        self.triangles(triangles, material)
    }

    /// Tells how far the reader is (bytes of the source consumed, and its size if known) and asks whether to go on.
    ///
    /// # Errors
    /// [`CompileError::Cancelled`].
    fn progress(&mut self, consumed_bytes: u64, total_bytes: Option<u64>) -> Result<(), CompileError> {
        let _ = (consumed_bytes, total_bytes);
        Ok(())
    }
}
