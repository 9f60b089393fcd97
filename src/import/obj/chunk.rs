//! Whole lines of a file, parsed as far as that needs nothing from before them, so that several threads can do it at once.
//!
//! What a line means may depend on all lines above it: indices that count backwards, vertices that are not there yet, materials,
//! faults that name their line. A chunk therefore leaves every line that is not plain to [`Parser`](super::parser::Parser), which
//! takes chunks in their order, checks what is left of the plain lines (that vertices have come) and reads the others itself.

use super::fast::{self, Numbering};
use super::parser::are_digits_kept;
use crate::import::attributes::Reference;
use crate::import::polygon::CORNERS_MAX;
use crate::import::window::PADDING_BYTES;

/// Bytes of text in a chunk: enough for the hand-over to cost nothing, few enough to stay in a core's cache. In tests so few that
/// every kind of line comes to stand at a border.
pub(super) const CHUNK_BYTES: usize = if cfg!(test) { 200 } else { 256 << 10 };

/// Indices that are positive and fit 32 bits; whether their vertices are there is for the parser to say.
const ANY_VERTEX: Numbering = Numbering { above: 0, known: 1 << 32 };

/// Lines of one kind that stand together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RunKind {
    /// `count` lines with a vertex each.
    Vertices,
    /// `count` lines with a triangle each.
    Triangles,
    /// One line with a face of `count` corners.
    Face,
    /// `count` lines with a triangle each whose corners have attributes.
    TrianglesWith,
    /// One line with a face of `count` corners that have attributes.
    FaceWith,
    /// `count` lines with a texture coordinate each.
    Uvs,
    /// `count` lines with a normal each.
    Normals,
    /// Anything else, whole statements.
    Other,
}

/// See [`RunKind`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub(super) kind: RunKind,
    pub(super) count: u32,
    /// The greatest vertex that a face of the run names.
    pub(super) vertex_max: u32,
    /// Where it ends in the text; it begins where the one before ends.
    pub(super) end: u32,
}

/// See the module's text. The buffers are used again and again.
#[derive(Debug, Default)]
pub(super) struct Chunk {
    /// Whole lines and [`PADDING_BYTES`] newlines.
    pub(super) text: Vec<u8>,
    /// Offset of the text in the stream.
    pub(super) offset: u64,
    pub(super) runs: Vec<Run>,
    pub(super) vertices: Vec<[f64; 3]>,
    /// Of `vertices`: how many at the front have digits that f32 keeps. Those behind are not looked at.
    pub(super) kept_count: usize,
    pub(super) triangles: Vec<[u32; 3]>,
    /// The corners of the faces that are no triangles, one face after the other.
    pub(super) corners: Vec<u32>,
    /// The attributes of the corners of triangles and faces that have any, in their order.
    pub(super) references: Vec<Reference>,
    pub(super) uvs: Vec<[f32; 2]>,
    pub(super) normals: Vec<[f32; 3]>,
    face: Vec<u32>,
    face_references: Vec<Reference>,
}

impl Chunk {
    /// Parses the text. `check_digits` is false if the file is known to have digits that f32 does not keep.
    pub(super) fn parse(&mut self, check_digits: bool, with_attributes: bool) {
        if with_attributes {
            self.parse_as::<true>(check_digits)
        } else {
            self.parse_as::<false>(check_digits)
        }
    }

    fn parse_as<const ATTRIBUTES: bool>(&mut self, check_digits: bool) {
        let Chunk {
            text: data,
            runs,
            vertices,
            kept_count,
            triangles,
            corners,
            references,
            uvs,
            normals,
            face,
            face_references,
            ..
        } = self;
        references.clear();
        uvs.clear();
        normals.clear();
        runs.clear();
        vertices.clear();
        triangles.clear();
        corners.clear();
        let mut is_kept = check_digits;
        *kept_count = 0;
        let end = data.len() - PADDING_BYTES;
        let mut at = 0;
        while at < end {
            match (data[at], data[at + 1]) {
                (b'v', b' ') => {
                    if let Some((position, is_certain, next)) = fast::vertex(data, at + 2) {
                        is_kept = is_kept && (is_certain || are_digits_kept(position, &data[at + 2..next]));
                        *kept_count += usize::from(is_kept);
                        vertices.push(position);
                        at = next;
                        extend(runs, RunKind::Vertices, 0, at);
                        continue;
                    }
                }
                (b'f', b' ') => {
                    if let Some((three, next)) = fast::triangle(data, at, ANY_VERTEX.known) {
                        triangles.push(three);
                        let [a, b, c] = three;
                        at = next;
                        extend(runs, RunKind::Triangles, a.max(b).max(c), at);
                        continue;
                    }
                    let parsed = fast::face::<ATTRIBUTES>(
                        data,
                        at + 2,
                        ANY_VERTEX,
                        face,
                        face_references,
                        CORNERS_MAX,
                    );
                    if let Some((three, next)) = parsed {
                        at = next;
                        let is_plain = !ATTRIBUTES || face_references.is_empty();
                        if !is_plain {
                            references.extend_from_slice(face_references);
                        }
                        if face.is_empty() {
                            triangles.push(three);
                            let [a, b, c] = three;
                            let kind = if is_plain { RunKind::Triangles } else { RunKind::TrianglesWith };
                            extend(runs, kind, a.max(b).max(c), at);
                        } else {
                            corners.extend_from_slice(face);
                            let vertex_max = face.iter().copied().max().unwrap_or(0);
                            let kind = if is_plain { RunKind::Face } else { RunKind::FaceWith };
                            let count = face.len() as u32;
                            runs.push(Run { kind, count, vertex_max, end: at as u32 });
                        }
                        continue;
                    }
                }
                (b'v', b't') if ATTRIBUTES && data[at + 2] == b' ' => {
                    if let Some(([u, v, _], next)) = fast::numbers::<1>(data, at + 3) {
                        uvs.push([u, v]);
                        at = next;
                        extend(runs, RunKind::Uvs, 0, at);
                        continue;
                    }
                }
                (b'v', b'n') if ATTRIBUTES && data[at + 2] == b' ' => {
                    if let Some((normal, next)) = fast::numbers::<3>(data, at + 3) {
                        normals.push(normal);
                        at = next;
                        extend(runs, RunKind::Normals, 0, at);
                        continue;
                    }
                }
                _ => {}
            }
            at = statement_end(data, at, end);
            extend(runs, RunKind::Other, 0, at);
        }
        // A last line without a line end stops in the padding.
        if let Some(last) = runs.last_mut() {
            last.end = last.end.min(end as u32);
        }
    }
}

/// Counts a line for the last run if that is of its kind, else for a new one.
#[inline(always)]
fn extend(runs: &mut Vec<Run>, kind: RunKind, vertex_max: u32, end: usize) {
    let end = end as u32;
    match runs.last_mut() {
        Some(run) if run.kind == kind => {
            run.count += 1;
            run.vertex_max = run.vertex_max.max(vertex_max);
            run.end = end;
        }
        _ => runs.push(Run { kind, count: 1, vertex_max, end }),
    }
}

/// Where the statement that starts at `at` ends: behind the first line that does not go on with `\`. (Comments do not go on, but a
/// run may well hold the line behind one.)
fn statement_end(data: &[u8], mut at: usize, end: usize) -> usize {
    while at < end {
        let stop = memchr::memchr2(b'\n', b'\r', &data[at..end]).map_or(end, |length| at + length);
        let goes_on = stop > at && data[stop - 1] == b'\\';
        at = match &data[stop..end] {
            [b'\r', b'\n', ..] => stop + 2,
            [] => stop,
            _ => stop + 1,
        };
        if !goes_on {
            break;
        }
    }
    at
}

/// Length of the lines at the front of `data` that can be read without what follows: up to the last LF of a line that does not go on
/// with `\`. 0 if there is none.
pub(super) fn complete_lines(data: &[u8]) -> usize {
    let ends = memchr::memrchr_iter(b'\n', data);
    let complete = |end: &usize| {
        let line = &data[..*end];
        !line.strip_suffix(b"\r").unwrap_or(line).ends_with(b"\\")
    };
    ends.into_iter().find(complete).map_or(0, |end| end + 1)
}
