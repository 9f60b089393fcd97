//! STL: binary and text, one solid or several.
//!
//! STL has no shared vertices: every facet brings three of its own, and the sink may merge equal ones. Facet
//! normals and the attribute bytes (in which some programs keep colours) are passed over.

use std::io::Read;
use std::path::Path;

use super::decimal;
use super::feed::Feed;
use super::library::Materials;
use super::meter::Meter;
use super::number;
use super::report::{ImportOptions, ImportReport};
use super::sink::MeshSink;
use super::text::{is_blank, shown, trimmed, words};
use super::window::{WINDOW_BYTES, Window};
use crate::error::ImportError;

/// Text and a facet count stand before the facets of a binary file.
const HEADER_BYTES: usize = 84;

/// Normal, three positions, attribute.
const FACET_BYTES: usize = 50;

/// Most triangles: each has three vertices, and vertex indices have 32 bits.
const FACETS_MAX: u64 = (1 << 32) / 3;

/// Reads an STL file from `reader` into `sink`; `name` stands in messages.
///
/// A file is taken for text if it starts with `solid`, a byte order mark of UTF-8 apart, and goes on as text does, whatever its binary
/// facet count would be; many binary files start with `solid` too.
///
/// # Errors
/// [`ImportError::Byte`] for a binary file that ends before its last facet, [`ImportError::Line`] for text that cannot be
/// read, [`ImportError::Io`], [`ImportError::Sink`].
pub fn read_stl(
    reader: impl Read,
    name: &Path,
    options: &ImportOptions,
    sink: &mut dyn MeshSink,
) -> Result<ImportReport, ImportError> {
    read(Box::new(reader), Meter::default(), name, options, sink)
}

/// [`read_stl`] with progress.
pub(super) fn read(
    reader: Box<dyn Read + '_>,
    meter: Meter,
    name: &Path,
    options: &ImportOptions,
    sink: &mut dyn MeshSink,
) -> Result<ImportReport, ImportError> {
    let mut window = Window::new(reader, name, meter);
    let mut feed = Feed::new(sink);
    let materials = Materials::new(name, options, &mut feed)?;
    let material = materials.only(&mut feed);
    feed.set_material(material)?;
    window.refill()?;
    if is_text(&window) {
        if window.data().starts_with(BYTE_ORDER_MARK) {
            window.consume(BYTE_ORDER_MARK.len());
        }
        let is_closed = Text { window: &mut window, line: 1 }.read(&mut feed)?;
        if !is_closed {
            // Text states no count of facets: nothing else tells a file that was cut between two of them.
            feed.report.warn(name, None, "the file ends without `endsolid`: it may be cut short");
        }
    } else {
        read_binary(&mut window, name, &mut feed)?;
    }
    feed.vertices_complete()?;
    feed.finish(window.progress())
}

/// What some programs begin text in UTF-8 with.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// Whether the file is text: `solid` at the start, and no byte that text has not in what the window holds, or a
/// length that fits no binary file.
fn is_text(window: &Window<'_>) -> bool {
    let data = window.data();
    let text = data.strip_prefix(BYTE_ORDER_MARK).unwrap_or(data);
    if !trimmed(text).get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid")) {
        return false;
    }
    if let (true, Some(header)) = (window.ended(), data.first_chunk::<HEADER_BYTES>()) {
        let facets = u64::from(facet_count(header));
        if data.len() as u64 == HEADER_BYTES as u64 + facets * FACET_BYTES as u64 {
            return false;
        }
    }
    // The name of the solid may have any encoding, but no encoding of text has these.
    let control = |byte: &u8| *byte < b' ' && !is_blank(byte) && *byte != 0x1A;
    !data[..data.len().min(4096)].iter().any(control)
}

/// The facet count of a binary file.
fn facet_count(header: &[u8; HEADER_BYTES]) -> u32 {
    u32::from_le_bytes([header[80], header[81], header[82], header[83]])
}

/// Reads a binary file from its start. A count of 0 or 2^32 - 1, as programs leave it that write to a pipe, means as
/// many facets as there are; bytes behind the last facet are noted.
fn read_binary(window: &mut Window<'_>, name: &Path, feed: &mut Feed<'_>) -> Result<(), ImportError> {
    let Some(header) = window.data().first_chunk::<HEADER_BYTES>() else {
        let reason =
            format!("the file ends inside the {HEADER_BYTES} bytes that a binary STL file starts with");
        return Err(window.byte_error(window.data().len() as u64, reason));
    };
    let stated = facet_count(header);
    window.consume(HEADER_BYTES);
    let open_ended = matches!(stated, 0 | u32::MAX);
    let stated = if open_ended { u64::MAX } else { u64::from(stated) };
    let mut done = 0;
    while done < stated {
        if window.data().len() < FACET_BYTES {
            window.refill()?;
            feed.progress(window.progress())?;
            if window.data().len() < FACET_BYTES {
                break;
            }
        }
        let left = usize::try_from(stated - done).unwrap_or(usize::MAX);
        let take = (window.data().len() / FACET_BYTES).min(left);
        if done + take as u64 > FACETS_MAX {
            return Err(window.byte_error(window.offset(), format!("more than {FACETS_MAX} facets")));
        }
        for facet in window.data()[..take * FACET_BYTES].as_chunks::<FACET_BYTES>().0 {
            let mut numbers = facet[12..48].as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
            let mut number = || numbers.next().unwrap_or_default();
            let first = feed.vertex_count() as u32;
            for _ in 0..3 {
                feed.vertex32([number(), number(), number()])?;
            }
            feed.triangle([first, first + 1, first + 2])?;
        }
        window.consume(take * FACET_BYTES);
        done += take as u64;
    }
    feed.report.ignored.normals += done;
    let rest = window.data().len();
    if !open_ended && done < stated {
        let reason = format!("the file ends in facet {done} of the {stated} that its header states");
        return Err(window.byte_error(window.offset() + rest as u64, reason));
    }
    if open_ended && done > 0 {
        feed.report.warn(name, None, format!("the header states no facet count; {done} facets are there"));
    }
    if rest > 0 || !window.ended() {
        let offset = window.offset();
        feed.report.warn(name, None, format!("bytes from {offset} on, behind the last facet, are left out"));
    }
    Ok(())
}

/// Whether two words are those that a facet starts with.
fn is_facet_start((first, second): (&[u8], &[u8])) -> bool {
    first.eq_ignore_ascii_case(b"facet") && second.eq_ignore_ascii_case(b"normal")
}

/// Reads a text file.
struct Text<'w, 'a> {
    window: &'w mut Window<'a>,
    line: u64,
}

/// How far the current facet is.
#[derive(Default)]
struct Facet {
    /// The line on which it starts.
    open: Option<u64>,
    /// Whether a `solid` has begun and not ended.
    in_solid: bool,
    in_loop: bool,
    corners: Vec<u32>,
}

impl Text<'_, '_> {
    /// Whether the last solid is closed, as the format wants it.
    fn read(&mut self, feed: &mut Feed<'_>) -> Result<bool, ImportError> {
        let mut state = Facet::default();
        while let Some((length, end_bytes)) = self.next_line()? {
            self.statement(trimmed(&self.window.data()[..length]), &mut state, feed)?;
            self.window.consume(length + end_bytes);
            self.line += 1;
            feed.progress(self.window.progress())?;
        }
        match state.open {
            Some(line) => Err(self.error(format!("the file ends inside the facet of line {line}"))),
            None => Ok(!state.in_solid),
        }
    }

    fn statement(&self, text: &[u8], facet: &mut Facet, feed: &mut Feed<'_>) -> Result<(), ImportError> {
        let mut words = words(text);
        let keyword = words.next().unwrap_or_default().to_ascii_lowercase();
        match keyword.as_slice() {
            b"vertex" if facet.in_loop => {
                let mut position = [0.0; 3];
                let mut is_kept = feed.are_digits_kept();
                for coordinate in &mut position {
                    let word = words.next().unwrap_or_default();
                    *coordinate = number::parse(word)
                        .ok_or_else(|| self.error(format!("`{}` is not a number", shown(word))))?;
                    is_kept = is_kept && decimal::is_kept_by_float32(word, *coordinate);
                }
                if facet.corners.len() == super::polygon::CORNERS_MAX {
                    return Err(self.error("a facet with too many vertices"));
                }
                facet.corners.push(self.vertex(position, is_kept, feed)?);
            }
            b"vertex" => return Err(self.error("`vertex` outside of a loop")),
            b"outer" | b"facet" | b"endfacet" if facet.in_loop => {
                let reason = format!("`{}` inside a loop: its `endloop` is missing", shown(&keyword));
                return Err(self.error(reason));
            }
            b"outer" => {
                facet.in_loop = true;
                facet.corners.clear();
            }
            b"endloop" if facet.in_loop => {
                facet.in_loop = false;
                if facet.corners.len() < 3 {
                    let reason = format!("a facet with {} vertices; three are needed", facet.corners.len());
                    return Err(self.error(reason));
                }
                feed.face(&facet.corners)?;
            }
            b"facet" => {
                facet.open = Some(self.line);
                feed.report.ignored.normals += 1;
            }
            b"endfacet" => facet.open = None,
            // Else a file without line ends would be one with a long name and no facets.
            b"solid" if words.clone().zip(words.skip(1)).any(is_facet_start) => {
                return Err(
                    self.error("a facet on the line of `solid`; each statement needs a line of its own")
                );
            }
            b"" => {}
            // The name behind these may be anything, and `end solid` is common.
            b"solid" => facet.in_solid = true,
            b"endsolid" | b"end" => facet.in_solid = false,
            _ if facet.in_loop || facet.open.is_some() => {
                return Err(self.error(format!("`{}` inside a facet", shown(&keyword))));
            }
            _ => feed.report.ignored.unknown += 1,
        }
        Ok(())
    }

    /// Appends a vertex and gives its index. `is_kept`: whether f32 keeps its digits.
    fn vertex(&self, position: [f64; 3], is_kept: bool, feed: &mut Feed<'_>) -> Result<u32, ImportError> {
        let index = u32::try_from(feed.vertex_count()).map_err(|_| self.error("more than 2^32 vertices"))?;
        feed.vertex_text(position, is_kept)?;
        Ok(index)
    }

    /// Length of the next line, and of the line end behind it; nothing at the end of the file.
    fn next_line(&mut self) -> Result<Option<(usize, usize)>, ImportError> {
        loop {
            let data = self.window.data();
            let line_end = memchr::memchr2(b'\n', b'\r', data);
            let rest = &data[line_end.unwrap_or(data.len())..];
            let end_bytes = match rest {
                [b'\r', b'\n', ..] => 2,
                // An LF may follow.
                [b'\r'] if !self.window.ended() => 0,
                [_, ..] => 1,
                [] => 0,
            };
            if end_bytes > 0 || self.window.ended() {
                let length = data.len() - rest.len();
                return Ok((length + end_bytes > 0).then_some((length, end_bytes)));
            }
            if data.len() == WINDOW_BYTES {
                return Err(self.error("a line of more than 1 MiB"));
            }
            self.window.refill()?;
        }
    }

    fn error(&self, reason: impl Into<String>) -> ImportError {
        self.window.line_error(self.line, reason)
    }
}
