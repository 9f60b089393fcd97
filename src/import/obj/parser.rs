//! The way through the file: windows, lines, passes.

use std::path::Path;

use super::fast::{self, Numbering};
use crate::error::ImportError;
use crate::import::feed::Feed;
use crate::import::library::Materials;
use crate::import::polygon::CORNERS_MAX;
use crate::import::report::{ImportOptions, ImportReport};
use crate::import::sink::MeshSink;
use crate::import::window::{WINDOW_BYTES, Window};
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
    pub(super) corners: Vec<u32>,
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
            corners: Vec::new(),
            joined: Vec::new(),
            known_count: 0,
            first_unknown: None,
        })
    }

    /// Reads the stream from its start. Gives a place to go on from if a face names a later vertex.
    pub(super) fn run(
        &mut self,
        window: &mut Window<'_>,
        may_postpone: bool,
    ) -> Result<Option<Postponed>, ImportError> {
        self.may_postpone = may_postpone;
        window.refill()?;
        if window.data().starts_with(b"\xEF\xBB\xBF") {
            window.consume(3);
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
        let Postponed { offset, line, vertices_above, material } = postponed;
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
    pub(super) fn finish(self, window: &Window<'_>) -> Result<ImportReport, ImportError> {
        if let (0, Some((line, keyword))) = (self.known_count, &self.first_unknown) {
            let reason = format!("`{keyword}` is not an OBJ statement, and there is none in the whole file");
            return Err(self.error(*line, reason));
        }
        self.feed.finish(window.progress())
    }

    /// An error about a line.
    pub(super) fn error(&self, line: u64, reason: impl Into<String>) -> ImportError {
        ImportError::Line { path: self.name.to_path_buf(), line, reason: reason.into() }
    }

    fn windows(&mut self, window: &mut Window<'_>) -> Result<(), ImportError> {
        loop {
            window.refill()?;
            self.feed.progress(window.progress())?;
            let data = window.data();
            let end = if window.ended() { data.len() } else { whole_lines(data) };
            let done = self.lines(window.padded(), end, window.ended(), window.offset())?;
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

    /// Reads the lines of `data[..end]`, which has whole lines only, and gives the place after the last; a line that
    /// continues beyond `end` is left for the next window. `offset` is that of `data` in the stream.
    fn lines(&mut self, data: &[u8], end: usize, ended: bool, offset: u64) -> Result<usize, ImportError> {
        let mut at = 0;
        while at < end {
            match (data[at], data[at + 1]) {
                (b'v', b' ') if self.pass != Pass::Faces => {
                    if let Some((position, next)) = fast::vertex(data, at + 2) {
                        self.vertex(position)?;
                        self.line += 1;
                        at = next;
                        continue;
                    }
                }
                (b'f', b' ') if self.pass != Pass::Vertices => {
                    let numbering = self.numbering();
                    if let Some((three, next)) =
                        fast::face(data, at + 2, numbering, &mut self.corners, CORNERS_MAX)
                    {
                        if self.corners.is_empty() {
                            self.feed.triangle(three)?;
                        } else {
                            self.feed.face(&self.corners)?;
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

    /// Takes a vertex.
    #[inline(always)]
    pub(super) fn vertex(&mut self, position: [f64; 3]) -> Result<(), ImportError> {
        self.vertices_above += 1;
        self.known_count += 1;
        if self.pass == Pass::Faces { Ok(()) } else { self.feed.vertex64(position) }
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

/// Length of the whole lines in `data`, in a stream that goes on: a CR at the very end may be followed by an LF.
fn whole_lines(data: &[u8]) -> usize {
    let certain = match data {
        [rest @ .., b'\r'] => rest,
        data => data,
    };
    memchr::memrchr2(b'\n', b'\r', certain).map_or(0, |last| last + 1)
}
