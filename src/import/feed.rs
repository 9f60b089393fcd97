//! Collects vertices and triangles into batches and sends them on in an order that the sink accepts.

use super::polygon::{Cut, Cutter};
use super::report::ImportReport;
use super::sink::{MeshSink, VertexBatch};
use crate::error::ImportError;
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// Vertices or triangles in one batch.
pub(super) const BATCH_COUNT: usize = 32 * 1024;

/// Source bytes between two calls of `MeshSink::progress`.
const PROGRESS_BYTES: u64 = 4 << 20;

/// Sends geometry to a sink in batches. A vertex is always sent before the triangles that name it.
pub(super) struct Feed<'a> {
    sink: &'a mut dyn MeshSink,
    /// Not yet sent; at most one of `singles` and `doubles` is not empty.
    singles: Vec<[f32; 3]>,
    doubles: Vec<[f64; 3]>,
    /// Whether all of `doubles` that came came as text whose digits f32 keeps.
    digits_kept: bool,
    /// The batch of doubles sent last: polygons mostly name vertices that came just before them.
    recent: Vec<[f64; 3]>,
    /// Index of the first vertex of `recent`; those of the unsent batch follow on `sent_vertices`.
    recent_start: u64,
    sent_vertices: u64,
    /// Not yet sent, all of `material`.
    triangles: Vec<[u32; 3]>,
    material: Option<MaterialId>,
    default_material: Option<MaterialId>,
    last_progress: u64,
    /// For cutting polygons: distinct neighbouring corners, their positions, and the rest.
    ring: Vec<u32>,
    positions: Vec<[f64; 3]>,
    cutter: Cutter,
    /// What is reported in the end.
    pub(super) report: ImportReport,
}

/// Wraps an error of the sink.
fn sink_error(error: crate::error::CompileError) -> ImportError {
    ImportError::Sink(Box::new(error))
}

impl<'a> Feed<'a> {
    /// An empty feed in front of `sink`, with all its buffers.
    pub(super) fn new(sink: &'a mut dyn MeshSink) -> Feed<'a> {
        Feed {
            sink,
            singles: Vec::new(),
            doubles: Vec::new(),
            digits_kept: true,
            recent: Vec::new(),
            recent_start: 0,
            sent_vertices: 0,
            triangles: Vec::with_capacity(BATCH_COUNT),
            material: None,
            default_material: None,
            last_progress: 0,
            ring: Vec::new(),
            positions: Vec::new(),
            cutter: Cutter::default(),
            report: ImportReport::default(),
        }
    }

    /// Whether f32 keeps all digits of the vertices so far. Once it does not, it matters no more for the others.
    #[inline]
    pub(super) fn are_digits_kept(&self) -> bool {
        self.digits_kept
    }

    /// Vertices that have come so far, sent or not.
    pub(super) fn vertex_count(&self) -> u64 {
        self.sent_vertices + (self.singles.len() + self.doubles.len()) as u64
    }

    /// Appends a vertex.
    #[inline]
    pub(super) fn vertex64(&mut self, position: [f64; 3]) -> Result<(), ImportError> {
        self.vertex_text(position, false)
    }

    /// Appends a vertex from text, of which `is_kept` says whether f32 keeps all its digits.
    #[inline]
    pub(super) fn vertex_text(&mut self, position: [f64; 3], is_kept: bool) -> Result<(), ImportError> {
        if self.doubles.len() == self.doubles.capacity() || !self.singles.is_empty() {
            self.make_room64()?;
        }
        self.digits_kept &= is_kept;
        self.doubles.push(position);
        Ok(())
    }

    /// [`Feed::vertex_text`] for many.
    pub(super) fn vertices_text(
        &mut self,
        mut positions: &[[f64; 3]],
        is_kept: bool,
    ) -> Result<(), ImportError> {
        while !positions.is_empty() {
            if self.doubles.len() == self.doubles.capacity() || !self.singles.is_empty() {
                self.make_room64()?;
            }
            self.digits_kept &= is_kept;
            let (here, rest) =
                positions.split_at(positions.len().min(self.doubles.capacity() - self.doubles.len()));
            self.doubles.extend_from_slice(here);
            positions = rest;
        }
        Ok(())
    }

    /// Appends a vertex.
    #[inline]
    pub(super) fn vertex32(&mut self, position: [f32; 3]) -> Result<(), ImportError> {
        if self.singles.len() == self.singles.capacity() || !self.doubles.is_empty() {
            self.make_room32()?;
        }
        self.singles.push(position);
        Ok(())
    }

    #[cold]
    fn make_room64(&mut self) -> Result<(), ImportError> {
        self.send_vertices()?;
        self.check_vertex_count()?;
        if self.doubles.capacity() == 0 {
            self.doubles.reserve_exact(BATCH_COUNT);
            self.recent.reserve_exact(BATCH_COUNT);
        }
        Ok(())
    }

    #[cold]
    fn make_room32(&mut self) -> Result<(), ImportError> {
        self.send_vertices()?;
        self.check_vertex_count()?;
        self.singles.reserve_exact(BATCH_COUNT);
        Ok(())
    }

    /// Indices have 32 bits. Checked per batch, which divides 2^32.
    fn check_vertex_count(&self) -> Result<(), ImportError> {
        if self.sent_vertices >> 32 == 0 {
            return Ok(());
        }
        let reason = "more than 2^32 vertices; split the model".into();
        Err(sink_error(crate::error::CompileError::Limit { reason }))
    }

    /// The batch of f32 vertices, with room for at least one more, for readers that fill it in bulk up to its
    /// capacity.
    pub(super) fn singles_with_room(&mut self) -> Result<&mut Vec<[f32; 3]>, ImportError> {
        if self.singles.len() == self.singles.capacity() || !self.doubles.is_empty() {
            self.make_room32()?;
        }
        Ok(&mut self.singles)
    }

    /// Appends a triangle of the current material. Its vertices have come already.
    #[inline]
    pub(super) fn triangle(&mut self, triangle: [u32; 3]) -> Result<(), ImportError> {
        if self.triangles.len() == BATCH_COUNT {
            self.send_triangles()?;
        }
        self.triangles.push(triangle);
        Ok(())
    }

    /// [`Feed::triangle`] for many.
    pub(super) fn triangles(&mut self, mut triangles: &[[u32; 3]]) -> Result<(), ImportError> {
        while !triangles.is_empty() {
            let batch = self.triangles_with_room()?;
            let (here, rest) = triangles.split_at(triangles.len().min(BATCH_COUNT - batch.len()));
            batch.extend_from_slice(here);
            triangles = rest;
        }
        Ok(())
    }

    /// Appends a face of any number of corners up to `CORNERS_MAX`, cut into triangles. Its vertices have come
    /// already.
    pub(super) fn face(&mut self, corners: &[u32]) -> Result<(), ImportError> {
        if let [a, b, c] = *corners {
            return self.triangle([a, b, c]);
        }
        // Cutting needs a ring without repeated neighbours.
        let mut ring = std::mem::take(&mut self.ring);
        ring.clear();
        for corner in corners {
            if ring.last() != Some(corner) {
                ring.push(*corner);
            }
        }
        while ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        }
        let result = match ring[..] {
            [] | [_] | [_, _] => {
                self.report.degenerate_faces += 1;
                Ok(())
            }
            [a, b, c] => self.triangle([a, b, c]),
            _ => self.polygon(&ring),
        };
        self.ring = ring;
        result
    }

    /// Cuts a polygon and appends the triangles.
    fn polygon(&mut self, ring: &[u32]) -> Result<(), ImportError> {
        let mut positions = std::mem::take(&mut self.positions);
        positions.clear();
        for vertex in ring {
            positions.push(self.position(*vertex)?);
        }
        let mut cutter = std::mem::take(&mut self.cutter);
        let (cut, triangles) = cutter.cut(&positions);
        self.report.polygons += 1;
        self.report.fans += u64::from(cut == Cut::Fan);
        for triangle in triangles {
            self.triangle(triangle.map(|corner| ring[corner as usize]))?;
        }
        self.positions = positions;
        self.cutter = cutter;
        Ok(())
    }

    /// The batch of triangles, with room for at least one more, for readers that fill it in bulk up to
    /// [`BATCH_COUNT`].
    pub(super) fn triangles_with_room(&mut self) -> Result<&mut Vec<[u32; 3]>, ImportError> {
        if self.triangles.len() == BATCH_COUNT {
            self.send_triangles()?;
        }
        Ok(&mut self.triangles)
    }

    /// Adds a material to the sink.
    pub(super) fn add_material(&mut self, material: MaterialRecord) -> Result<MaterialId, ImportError> {
        let id = self.sink.material(material).map_err(sink_error)?;
        self.report.materials += 1;
        Ok(id)
    }

    /// The material of the triangles that come from here on; `None` for the default one.
    pub(super) fn set_material(&mut self, material: Option<MaterialId>) -> Result<(), ImportError> {
        if material != self.material {
            self.send_triangles()?;
            self.material = material;
        }
        Ok(())
    }

    /// The material of the triangles that come now.
    pub(super) fn material(&self) -> Option<MaterialId> {
        self.material
    }

    /// Position of a vertex that has come already.
    pub(super) fn position(&mut self, vertex: u32) -> Result<[f64; 3], ImportError> {
        let vertex = u64::from(vertex);
        if let Some(unsent) = vertex.checked_sub(self.sent_vertices) {
            let unsent = unsent as usize;
            return Ok(match self.doubles.get(unsent) {
                Some(position) => *position,
                None => self.singles[unsent].map(f64::from),
            });
        }
        if let Some(recent) = vertex.checked_sub(self.recent_start)
            && let Some(position) = self.recent.get(recent as usize)
        {
            return Ok(*position);
        }
        self.sink.position(vertex).map_err(sink_error)
    }

    /// Sends the unsent vertices. Safe at any time: triangles wait longer than vertices, never shorter.
    fn send_vertices(&mut self) -> Result<(), ImportError> {
        if !self.singles.is_empty() {
            self.sink.vertices(VertexBatch::Float32(&self.singles)).map_err(sink_error)?;
            self.sent_vertices += self.singles.len() as u64;
            self.singles.clear();
        }
        if !self.doubles.is_empty() {
            let batch = match self.digits_kept {
                true => VertexBatch::Float32Text(&self.doubles),
                false => VertexBatch::Float64(&self.doubles),
            };
            self.sink.vertices(batch).map_err(sink_error)?;
            self.recent_start = self.sent_vertices;
            self.sent_vertices += self.doubles.len() as u64;
            std::mem::swap(&mut self.recent, &mut self.doubles);
            self.doubles.clear();
        }
        Ok(())
    }

    #[cold]
    fn send_triangles(&mut self) -> Result<(), ImportError> {
        if self.triangles.is_empty() {
            return Ok(());
        }
        self.send_vertices()?;
        let material = match (self.material, self.default_material) {
            (Some(material), _) | (None, Some(material)) => material,
            (None, None) => {
                let material = self.add_material(MaterialRecord::default())?;
                self.default_material = Some(material);
                material
            }
        };
        self.sink.triangles(&self.triangles, material).map_err(sink_error)?;
        self.report.triangles += self.triangles.len() as u64;
        self.triangles.clear();
        Ok(())
    }

    /// Says that no vertex will come after this.
    pub(super) fn vertices_complete(&mut self) -> Result<(), ImportError> {
        self.send_vertices()?;
        self.sink.vertices_complete().map_err(sink_error)
    }

    /// Tells the sink how far the reader is, if that has moved enough to matter.
    pub(super) fn progress(&mut self, (consumed, total): (u64, Option<u64>)) -> Result<(), ImportError> {
        if consumed >= self.last_progress + PROGRESS_BYTES {
            self.last_progress = consumed;
            self.sink.progress(consumed, total).map_err(sink_error)?;
        }
        Ok(())
    }

    /// Says that the reader starts again from the front of the file.
    pub(super) fn restart_progress(&mut self) {
        self.last_progress = 0;
    }

    /// Sends what is left and gives the report.
    pub(super) fn finish(
        mut self,
        (consumed, total): (u64, Option<u64>),
    ) -> Result<ImportReport, ImportError> {
        self.send_vertices()?;
        self.send_triangles()?;
        self.sink.progress(consumed, total).map_err(sink_error)?;
        self.report.vertices = self.sent_vertices;
        Ok(self.report)
    }
}
