//! Collects vertices and triangles into batches and sends them on in an order that the sink accepts.

use super::attributes::{AttributeFeed, Reference};
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
    /// Which corners of the face each of `ring` is.
    places: Vec<u32>,
    cutter: Cutter,
    attributes: AttributeFeed,
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
        let attributes = AttributeFeed::new(sink.takes_attributes());
        Feed {
            sink,
            attributes,
            places: Vec::new(),
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

    /// Whether the sink takes attributes.
    pub(super) fn takes_attributes(&self) -> bool {
        self.attributes.is_wanted
    }

    /// The attributes that came so far: texture coordinates, normals.
    pub(super) fn attribute_counts(&self) -> [u64; 2] {
        [self.attributes.uv_count, self.attributes.normal_count]
    }

    /// How many attributes the corners so far need: more than come if a file names some that it does not have.
    pub(super) fn attributes_named(&self) -> [u64; 2] {
        self.attributes.named
    }

    /// From now on corners have the attributes of their vertices: vertex `i` those numbered `i`.
    pub(super) fn name_attributes_by_vertex(&mut self, uvs: bool, normals: bool) {
        self.attributes.name_by_vertex(uvs, normals);
    }

    /// Appends a texture coordinate.
    pub(super) fn uv(&mut self, uv: [f32; 2]) -> Result<(), ImportError> {
        self.attributes.uv(uv, self.sink).map_err(sink_error)
    }

    /// Appends a normal.
    pub(super) fn normal(&mut self, normal: [f32; 3]) -> Result<(), ImportError> {
        self.attributes.normal(normal, self.sink).map_err(sink_error)
    }

    /// [`Feed::triangle`] with the attributes of its corners.
    #[inline]
    pub(super) fn triangle_with(
        &mut self,
        triangle: [u32; 3],
        references: [Reference; 3],
    ) -> Result<(), ImportError> {
        self.triangle(triangle)?;
        self.attributes.triangle(self.triangles.len() - 1, references);
        Ok(())
    }

    /// Appends a face of any number of corners up to `CORNERS_MAX`, cut into triangles. Its vertices have come
    /// already.
    pub(super) fn face(&mut self, corners: &[u32]) -> Result<(), ImportError> {
        self.face_with(corners, &[])
    }

    /// [`Feed::face`] with the attributes of its corners, or none.
    pub(super) fn face_with(&mut self, corners: &[u32], references: &[Reference]) -> Result<(), ImportError> {
        if let [a, b, c] = *corners {
            return match *references {
                [d, e, f] => self.triangle_with([a, b, c], [d, e, f]),
                _ => self.triangle([a, b, c]),
            };
        }
        // Cutting needs a ring without repeated neighbours.
        let mut ring = std::mem::take(&mut self.ring);
        let mut places = std::mem::take(&mut self.places);
        ring.clear();
        places.clear();
        for (corner, place) in corners.iter().zip(0..) {
            if ring.last() != Some(corner) {
                ring.push(*corner);
                places.push(place);
            }
        }
        while ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
            places.pop();
        }
        // Nothing to say if there are no references.
        let reference = |corner: usize| references.get(places[corner] as usize).copied();
        let result = match ring[..] {
            [] | [_] | [_, _] => {
                self.report.degenerate_faces += 1;
                Ok(())
            }
            [a, b, c] => match [reference(0), reference(1), reference(2)] {
                [Some(d), Some(e), Some(f)] => self.triangle_with([a, b, c], [d, e, f]),
                _ => self.triangle([a, b, c]),
            },
            _ => self.polygon(&ring, &reference),
        };
        self.ring = ring;
        self.places = places;
        result
    }

    /// Cuts a polygon and appends the triangles.
    fn polygon(
        &mut self,
        ring: &[u32],
        reference: &dyn Fn(usize) -> Option<Reference>,
    ) -> Result<(), ImportError> {
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
            let corners = triangle.map(|corner| ring[corner as usize]);
            match triangle.map(|corner| reference(corner as usize)) {
                [Some(a), Some(b), Some(c)] => self.triangle_with(corners, [a, b, c])?,
                _ => self.triangle(corners)?,
            }
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
        let Feed { sink, attributes, triangles, .. } = self;
        match attributes.corners(triangles) {
            Some(corners) => sink.triangles_with_attributes(triangles, corners, material),
            None => sink.triangles(triangles, material),
        }
        .map_err(sink_error)?;
        self.attributes.clear_corners();
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
        self.attributes.send_values(self.sink).map_err(sink_error)?;
        [self.report.texture_coordinates, self.report.normals] = self.attribute_counts();
        self.sink.progress(consumed, total).map_err(sink_error)?;
        self.report.vertices = self.sent_vertices;
        Ok(self.report)
    }
}
