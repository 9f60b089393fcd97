//! Geometry that never was a file: triangles one by one, from a caller's loop or iterator.

use super::feed::Feed;
use super::sink::MeshSink;
use crate::error::{CompileError, ImportError};
use crate::units::MaterialId;

/// Takes triangles one at a time, each with three vertices of its own, and sends them to a [`MeshSink`] in batches.
/// Equal vertices are left for the sink to merge. Memory: about 2 MiB.
///
/// ```
/// use outcrop::import::{MeshBuffer, TriangleSink};
///
/// let mut mesh = MeshBuffer::new();
/// let mut triangles = TriangleSink::new(&mut mesh);
/// triangles.push([[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], None)?;
/// triangles.finish()?;
/// assert_eq!(mesh.triangles, [[0, 1, 2]]);
/// # Ok::<(), outcrop::error::CompileError>(())
/// ```
pub struct TriangleSink<'a> {
    feed: Feed<'a>,
}

/// Positions of a triangle's corners, in the number type that they have, so that nothing is rounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Corners {
    /// In f32.
    Float32([[f32; 3]; 3]),
    /// In f64.
    Float64([[f64; 3]; 3]),
}

impl From<[[f32; 3]; 3]> for Corners {
    fn from(corners: [[f32; 3]; 3]) -> Corners {
        Corners::Float32(corners)
    }
}

impl From<[[f64; 3]; 3]> for Corners {
    fn from(corners: [[f64; 3]; 3]) -> Corners {
        Corners::Float64(corners)
    }
}

impl<'a> TriangleSink<'a> {
    /// A triangle sink in front of `sink`, which has had no vertices yet.
    pub fn new(sink: &'a mut dyn MeshSink) -> TriangleSink<'a> {
        TriangleSink { feed: Feed::new(sink) }
    }

    /// Appends a triangle: `[[f32; 3]; 3]` or `[[f64; 3]; 3]`. `material` is an id that the mesh sink gave before; `None` stands
    /// for the default material, which is added when it is first used.
    ///
    /// # Errors
    /// More than 1,431,655,765 triangles ([`CompileError::Limit`]: vertex indices have 32 bits), or an error of the
    /// mesh sink. After an error the sink takes no more.
    pub fn push(
        &mut self,
        triangle: impl Into<Corners>,
        material: Option<MaterialId>,
    ) -> Result<(), CompileError> {
        self.try_push(triangle.into(), material).map_err(sink_error)
    }

    fn try_push(&mut self, triangle: Corners, material: Option<MaterialId>) -> Result<(), ImportError> {
        self.feed.set_material(material)?;
        let first = self.feed.vertex_count();
        if first + 3 > 1 << 32 {
            let reason = "more than 1,431,655,765 triangles without shared vertices; send an indexed mesh";
            return Err(ImportError::Sink(Box::new(CompileError::Limit { reason: reason.into() })));
        }
        match triangle {
            Corners::Float32(corners) => {
                corners.into_iter().try_for_each(|position| self.feed.vertex32(position))?;
            }
            Corners::Float64(corners) => {
                corners.into_iter().try_for_each(|position| self.feed.vertex64(position))?;
            }
        }
        let first = first as u32;
        self.feed.triangle([first, first + 1, first + 2])
    }

    /// Sends what is left and gives the number of triangles. Without this call the last ones are lost.
    ///
    /// # Errors
    /// An error of the mesh sink.
    pub fn finish(mut self) -> Result<u64, CompileError> {
        self.feed.vertices_complete().map_err(sink_error)?;
        let report = self.feed.finish((0, None)).map_err(sink_error)?;
        Ok(report.triangles)
    }
}

/// Sends every triangle of an iterator to `sink`; see [`TriangleSink`]. Gives their number.
///
/// # Errors
/// As for [`TriangleSink::push`].
pub fn import_triangles<T: Into<Corners>>(
    triangles: impl IntoIterator<Item = T>,
    material: Option<MaterialId>,
    sink: &mut dyn MeshSink,
) -> Result<u64, CompileError> {
    let mut triangle_sink = TriangleSink::new(sink);
    for triangle in triangles {
        triangle_sink.push(triangle, material)?;
    }
    triangle_sink.finish()
}

/// The mesh sink's own error: a feed without a file has no others.
fn sink_error(error: ImportError) -> CompileError {
    match error {
        ImportError::Sink(error) => *error,
        other => CompileError::Import(other),
    }
}

impl std::fmt::Debug for TriangleSink<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TriangleSink").finish_non_exhaustive()
    }
}
