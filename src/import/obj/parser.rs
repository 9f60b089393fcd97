//! The way through the file: windows, lines, passes.

use std::path::Path;
use std::sync::Arc;

use super::ahead::Ahead;
use super::chunk::{CHUNK_BYTES, Chunk, RunKind, complete_lines};
use super::fast::{self, Numbering};
use crate::error::ImportError;
use crate::import::attributes::Reference;
use crate::import::decimal;
use crate::import::feed::Feed;
use crate::import::library::Materials;
use crate::import::polygon::CORNERS_MAX;
use crate::import::report::{ImportOptions, ImportReport};
use crate::import::sink::MeshSink;
use crate::import::text::words;
use crate::import::window::{PADDING_BYTES, WINDOW_BYTES, Window};
use crate::units::MaterialId;

/// What is taken on this way through the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pass {
    /// Everything, up to a face that names a vertex further down.
    Whole,
    /// What follows that face, without faces and materials.
    Vertices,
    /// The second reading: faces and materials from that face on.
    Faces,
}

/// Where a face names a vertex that has not come yet: the place to go on from on a second reading.
#[derive(Clone, Copy, Debug)]
pub(super) struct Postponed {
    offset: u64,
    line: u64,
    vertices_above: u64,
    attributes_above: [u64; 2],
    material: Option<MaterialId>,
}

/// Reads the lines of a file.
pub(super) struct Parser<'a> {
    pub(super) name: &'a Path,
    pub(super) feed: Feed<'a>,
    pub(super) materials: Materials<'a>,
    pub(super) pass: Pass,
    /// Whether faces that name later vertices can wait for a second reading.
    pub(super) may_postpone: bool,
    pub(super) postponed: Option<Postponed>,
    /// The line that is read, counted from 1.
    pub(super) line: u64,
    /// Vertices above that line.
    pub(super) vertices_above: u64,
    /// Texture coordinates and normals above it, if they are wanted.
    pub(super) attributes_above: [u64; 2],
    pub(super) corners: Vec<u32>,
    /// The attributes of the corners.
    pub(super) references: Vec<Reference>,
    /// A line that continues on the next, joined.
    pub(super) joined: Vec<u8>,
    /// Statements that are known, and the first that is not: to tell OBJ files from others of that extension.
    pub(super) known_count: u64,
    pub(super) first_unknown: Option<(u64, String)>,
}

impl<'a> Parser<'a> {
    pub(super) fn new(
        name: &'a Path,
        options: &'a ImportOptions,
        sink: &'a mut dyn MeshSink,
    ) -> Result<Parser<'a>, ImportError> {
        let mut feed = Feed::new(sink);
        let materials = Materials::new(name, options, &mut feed)?;
        Ok(Parser {
            name,
            feed,
            materials,
            pass: Pass::Whole,
            may_postpone: false,
            postponed: None,
            line: 1,
            vertices_above: 0,
            attributes_above: [0; 2],
            corners: Vec::new(),
            references: Vec::new(),
            joined: Vec::new(),
            known_count: 0,
            first_unknown: None,
        })
    }

    /// Reads the stream from its start, with the help of a pool's threads if there is one. Gives a place to go on from if a face
    /// names a later vertex.
    pub(super) fn run(
        &mut self,
        window: &mut Window<'_>,
        may_postpone: bool,
        pool: Option<&Arc<rayon::ThreadPool>>,
    ) -> Result<Option<Postponed>, ImportError> {
        self.may_postpone = may_postpone;
        window.refill()?;
        if window.data().starts_with(b"\xEF\xBB\xBF") {
            window.consume(3);
        }
        if let Some(pool) = pool {
            self.chunks(window, Ahead::new(Arc::clone(pool)))?;
        }
        self.windows(window)?;
        self.feed.vertices_complete()?;
        Ok(self.postponed)
    }

    /// Reads the faces from the postponed one on, out of the same bytes opened again.
    pub(super) fn run_postponed(
        &mut self,
        window: &mut Window<'_>,
        postponed: Postponed,
    ) -> Result<(), ImportError> {
        let Postponed { offset, line, vertices_above, attributes_above, material } = postponed;
        self.attributes_above = attributes_above;
        self.pass = Pass::Faces;
        self.line = line;
        self.vertices_above = vertices_above;
        self.feed.set_material(material)?;
        self.feed.restart_progress();
        if !window.skip(offset)? {
            return Err(self.error(line, "the file has become shorter while it was read"));
        }
        self.windows(window)
    }

    /// Sends what is left and gives the report.
    pub(super) fn finish(mut self, window: &Window<'_>) -> Result<ImportReport, ImportError> {
        if let (0, Some((line, keyword))) = (self.known_count, &self.first_unknown) {
            let reason = format!("`{keyword}` is not an OBJ statement, and there is none in the whole file");
            return Err(self.error(*line, reason));
        }
        let (named, there) = (self.feed.attributes_named(), self.feed.attribute_counts());
        for (kind, what) in ["texture coordinates", "normals"].into_iter().enumerate() {
            if named[kind] > there[kind] {
                let text = format!(
                    "faces name {what} up to {}, but there are {}; corners without are as if they named none",
                    named[kind], there[kind]
                );
                self.feed.report.warn(self.name, None, text);
            }
        }
        self.feed.finish(window.progress())
    }

    /// An error about a line.
    pub(super) fn error(&self, line: u64, reason: impl Into<String>) -> ImportError {
        ImportError::Line { path: self.name.to_path_buf(), line, reason: reason.into() }
    }

    /// Reads chunks of whole lines as long as there are such, parsed by other threads, and leaves the rest of the stream, if any.
    fn chunks(&mut self, window: &mut Window<'_>, mut ahead: Ahead) -> Result<(), ImportError> {
        // What is wrong with the stream comes after what is wrong with the lines before.
        let mut fault = None;
        let mut ended = false;
        loop {
            while !ended && ahead.has_room() {
                let mut chunk = ahead.spare();
                match next_chunk(window, &mut chunk) {
                    Ok(true) => {
                        let (check, with) = (self.feed.are_digits_kept(), self.feed.takes_attributes());
                        ahead.give(chunk, check, with);
                    }
                    Ok(false) => ended = true,
                    Err(error) => (ended, fault) = (true, Some(error)),
                }
            }
            let Some(chunk) = ahead.take() else { break };
            self.chunk(&chunk)?;
            ahead.give_back(chunk);
            self.feed.progress(window.progress())?;
        }
        fault.map_or(Ok(()), Err)
    }

    /// Takes the lines of a chunk.
    fn chunk(&mut self, chunk: &Chunk) -> Result<(), ImportError> {
        let (mut start, mut vertex, mut triangle, mut corner) = (0, 0, 0, 0);
        let (mut reference, mut uv, mut normal) = (0, 0, 0);
        for run in &chunk.runs {
            let (end, count) = (run.end as usize, run.count as usize);
            // All vertices that a face of the run names have come, and faces are wanted.
            let is_known = u64::from(run.vertex_max) < self.feed.vertex_count() && self.pass == Pass::Whole;
            match run.kind {
                RunKind::Vertices => {
                    let kept = chunk.kept_count.clamp(vertex, vertex + count);
                    self.feed.vertices_text(&chunk.vertices[vertex..kept], true)?;
                    self.feed.vertices_text(&chunk.vertices[kept..vertex + count], false)?;
                    self.vertices_above += u64::from(run.count);
                    self.known_count += u64::from(run.count);
                    self.line += u64::from(run.count);
                }
                RunKind::Triangles if is_known => {
                    self.feed.triangles(&chunk.triangles[triangle..triangle + count])?;
                    self.line += u64::from(run.count);
                }
                RunKind::Face if is_known => {
                    self.feed.face(&chunk.corners[corner..corner + count])?;
                    self.line += 1;
                }
                RunKind::TrianglesWith if is_known => {
                    let triangles = &chunk.triangles[triangle..triangle + count];
                    let references = chunk.references[reference..].as_chunks::<3>().0;
                    for (three, references) in triangles.iter().zip(references) {
                        self.feed.triangle_with(*three, *references)?;
                    }
                    self.line += u64::from(run.count);
                }
                RunKind::FaceWith if is_known => {
                    let corners = &chunk.corners[corner..corner + count];
                    self.feed.face_with(corners, &chunk.references[reference..reference + count])?;
                    self.line += 1;
                }
                RunKind::Uvs => {
                    chunk.uvs[uv..uv + count].iter().try_for_each(|pair| self.uv(*pair))?;
                    self.line += u64::from(run.count);
                }
                RunKind::Normals => {
                    chunk.normals[normal..normal + count].iter().try_for_each(|one| self.normal(*one))?;
                    self.line += u64::from(run.count);
                }
                // Whole statements: none goes on behind the end.
                RunKind::Triangles
                | RunKind::TrianglesWith
                | RunKind::Face
                | RunKind::FaceWith
                | RunKind::Other => {
                    self.lines(&chunk.text, start, end, true, chunk.offset)?;
                }
            }
            match run.kind {
                RunKind::Vertices => vertex += count,
                RunKind::Triangles => triangle += count,
                RunKind::Face => corner += count,
                RunKind::TrianglesWith => (triangle, reference) = (triangle + count, reference + 3 * count),
                RunKind::FaceWith => (corner, reference) = (corner + count, reference + count),
                RunKind::Uvs => uv += count,
                RunKind::Normals => normal += count,
                RunKind::Other => {}
            }
            start = end;
        }
        Ok(())
    }

    fn windows(&mut self, window: &mut Window<'_>) -> Result<(), ImportError> {
        loop {
            window.refill()?;
            self.feed.progress(window.progress())?;
            let data = window.data();
            let end = if window.ended() { data.len() } else { whole_lines(data) };
            let done = self.lines(window.padded(), 0, end, window.ended(), window.offset())?;
            let full = data.len() == WINDOW_BYTES;
            window.consume(done);
            if window.ended() && window.data().is_empty() {
                return Ok(());
            }
            if done == 0 && full {
                self.long_line(window)?;
            }
        }
    }

    /// Reads the lines of `data[at..end]`, which has whole lines only, and gives the place after the last; a line that
    /// continues beyond `end` is left for the next window, unless the stream has `ended`. `offset` is that of `data` in the stream.
    fn lines(
        &mut self,
        data: &[u8],
        mut at: usize,
        end: usize,
        ended: bool,
        offset: u64,
    ) -> Result<usize, ImportError> {
        while at < end {
            match (data[at], data[at + 1]) {
                (b'v', b' ') if self.pass != Pass::Faces => {
                    if let Some((position, is_kept, next)) = fast::vertex(data, at + 2) {
                        let is_kept = is_kept
                            || self.feed.are_digits_kept() && are_digits_kept(position, &data[at + 2..next]);
                        self.vertex(position, is_kept)?;
                        self.line += 1;
                        at = next;
                        continue;
                    }
                }
                (b'f', b' ') if self.pass != Pass::Vertices => {
                    if let Some((three, next)) = fast::triangle(data, at, self.feed.vertex_count()) {
                        self.feed.triangle(three)?;
                        self.line += 1;
                        at = next;
                        continue;
                    }
                    let (numbering, corners) = (self.numbering(), &mut self.corners);
                    let references = &mut self.references;
                    let parsed = if self.feed.takes_attributes() {
                        fast::face::<true>(data, at + 2, numbering, corners, references, CORNERS_MAX)
                    } else {
                        fast::face::<false>(data, at + 2, numbering, corners, references, CORNERS_MAX)
                    };
                    if let Some((three, next)) = parsed {
                        match (self.corners.is_empty(), self.references.as_slice()) {
                            (true, &[a, b, c]) => self.feed.triangle_with(three, [a, b, c])?,
                            (true, _) => self.feed.triangle(three)?,
                            (false, _) => self.feed.face_with(&self.corners, &self.references)?,
                        }
                        self.line += 1;
                        at = next;
                        continue;
                    }
                }
                _ => {}
            }
            match self.line(data, at, end, ended, offset)? {
                Some(next) => at = next,
                None => break,
            }
        }
        // A last line without a line end stops in the padding.
        Ok(at.min(end))
    }

    /// Takes a vertex, and whether f32 keeps its digits.
    #[inline(always)]
    pub(super) fn vertex(&mut self, position: [f64; 3], is_kept: bool) -> Result<(), ImportError> {
        self.vertices_above += 1;
        self.known_count += 1;
        if self.pass == Pass::Faces { Ok(()) } else { self.feed.vertex_text(position, is_kept) }
    }

    /// Takes a texture coordinate.
    pub(super) fn uv(&mut self, uv: [f32; 2]) -> Result<(), ImportError> {
        self.attributes_above[0] += 1;
        self.known_count += 1;
        if self.pass == Pass::Faces { Ok(()) } else { self.feed.uv(uv) }
    }

    /// Takes a normal.
    pub(super) fn normal(&mut self, normal: [f32; 3]) -> Result<(), ImportError> {
        self.attributes_above[1] += 1;
        self.known_count += 1;
        if self.pass == Pass::Faces { Ok(()) } else { self.feed.normal(normal) }
    }

    /// What face indices count from on the current line.
    #[inline(always)]
    pub(super) fn numbering(&self) -> Numbering {
        Numbering { above: self.vertices_above, known: self.feed.vertex_count() }
    }

    /// Remembers a face for the second reading. From here on only vertices are taken.
    pub(super) fn postpone(&mut self, offset: u64, line: u64) {
        self.postponed = Some(Postponed {
            offset,
            line,
            vertices_above: self.vertices_above,
            attributes_above: self.attributes_above,
            material: self.feed.material(),
        });
        self.pass = Pass::Vertices;
    }

    /// A line that does not fit the window: an error, unless it is a comment.
    fn long_line(&mut self, window: &mut Window<'_>) -> Result<(), ImportError> {
        if !window.data().trim_ascii_start().starts_with(b"#") {
            return Err(self.error(self.line, "a line of more than 1 MiB"));
        }
        loop {
            let data = window.data();
            let here = memchr::memchr2(b'\n', b'\r', data).unwrap_or(data.len());
            let all = data.len();
            window.consume(here);
            if here < all || window.ended() {
                // The line end itself is read as an empty line, and counts for this one.
                return Ok(());
            }
            window.refill()?;
        }
    }
}

/// Whether f32 keeps the digits of `position`, which stands at the start of `text`.
#[cold]
pub(super) fn are_digits_kept(position: [f64; 3], text: &[u8]) -> bool {
    position.iter().zip(words(text)).all(|(value, word)| decimal::is_kept_by_float32(word, *value))
}

/// Fills a chunk with the next lines of the stream; false if there are none that can be read without what follows.
fn next_chunk(window: &mut Window<'_>, chunk: &mut Chunk) -> Result<bool, ImportError> {
    if window.data().len() < CHUNK_BYTES {
        window.refill()?;
    }
    let data = window.data();
    let end = if data.len() <= CHUNK_BYTES && window.ended() {
        data.len()
    } else {
        complete_lines(&data[..data.len().min(CHUNK_BYTES)])
    };
    chunk.offset = window.offset();
    chunk.text.clear();
    chunk.text.extend_from_slice(&data[..end]);
    chunk.text.extend_from_slice(&[b'\n'; PADDING_BYTES]);
    window.consume(end);
    Ok(end > 0)
}

/// Length of the whole lines in `data`, in a stream that goes on: a CR at the very end may be followed by an LF.
fn whole_lines(data: &[u8]) -> usize {
    let certain = match data {
        [rest @ .., b'\r'] => rest,
        data => data,
    };
    memchr::memrchr2(b'\n', b'\r', certain).map_or(0, |last| last + 1)
}
