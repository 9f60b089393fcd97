//! One line of any form, with errors in words.

use super::parser::{Parser, Pass};
use crate::error::ImportError;
use crate::import::decimal;
use crate::import::number;
use crate::import::polygon::CORNERS_MAX;
use crate::import::sink::NO_INDEX;
use crate::import::text::{shown, trimmed, words};

impl Parser<'_> {
    /// Reads the line at `at`, with those that it continues on, and gives the start of the next; `None` if it
    /// continues beyond `end`, where more of the stream is to come. `offset` is that of `data` in the stream.
    pub(super) fn line(
        &mut self,
        data: &[u8],
        at: usize,
        end: usize,
        ended: bool,
        offset: u64,
    ) -> Result<Option<usize>, ImportError> {
        // Of this line alone: where many are empty, what is behind them would be looked at for each.
        let first = data[at..end].iter().find(|byte| !matches!(byte, b' ' | b'\t' | b'\x0B' | b'\x0C'));
        let comment = first == Some(&b'#');
        let mut joined = std::mem::take(&mut self.joined);
        joined.clear();
        let mut start = at;
        let mut line_count = 0;
        let (text, next) = loop {
            let stop = memchr::memchr2(b'\n', b'\r', &data[start..end]).map_or(end, |length| start + length);
            let next = match &data[stop..end] {
                [b'\r', b'\n', ..] => stop + 2,
                [] => stop,
                _ => stop + 1,
            };
            line_count += 1;
            let text = &data[start..stop];
            match text {
                [text @ .., b'\\'] if !comment => {
                    if next == end && !ended {
                        self.joined = joined;
                        return Ok(None);
                    }
                    joined.extend_from_slice(text);
                    joined.push(b' ');
                    start = next;
                }
                text if joined.is_empty() => break (text, next),
                text => {
                    joined.extend_from_slice(text);
                    break (joined.as_slice(), next);
                }
            }
        };
        if !comment {
            self.statement(text, offset + at as u64)?;
        }
        self.joined = joined;
        self.line += line_count;
        Ok(Some(next))
    }

    /// Reads a statement, which starts at `offset` in the stream.
    fn statement(&mut self, text: &[u8], offset: u64) -> Result<(), ImportError> {
        let text = trimmed(text);
        let keyword = words(text).next().unwrap_or_default();
        let rest = &text[keyword.len()..];
        let counts = self.pass != Pass::Faces;
        let wants_attributes = self.feed.takes_attributes();
        let ignored = &mut self.feed.report.ignored;
        match keyword {
            b"" => return Ok(()),
            b"v" => {
                let (position, is_kept) = self.position(rest)?;
                self.vertex(position, is_kept)?;
            }
            b"f" | b"fo" if self.pass == Pass::Vertices => {}
            b"f" | b"fo" => self.face(rest, offset)?,
            b"usemtl" if self.pass == Pass::Vertices => {}
            b"usemtl" => {
                let material = self.materials.named(rest, self.line, &mut self.feed);
                self.feed.set_material(material)?;
            }
            b"mtllib" if self.pass == Pass::Vertices => {}
            b"mtllib" => self.materials.load_named(rest, Some(self.line), &mut self.feed)?,
            b"vt" if wants_attributes => {
                // One number is enough: the other is 0 then.
                let [u, v, _] = self.numbers(rest, "vt", 1)?;
                self.uv([u, v])?;
                return Ok(());
            }
            b"vn" if wants_attributes => {
                let normal = self.numbers(rest, "vn", 3)?;
                self.normal(normal)?;
                return Ok(());
            }
            b"vn" => ignored.normals += u64::from(counts),
            b"vt" => ignored.texture_coordinates += u64::from(counts),
            b"l" | b"p" => ignored.lines_and_points += u64::from(counts),
            b"g" | b"o" | b"s" => {}
            _ => {
                ignored.unknown += u64::from(counts);
                self.first_unknown.get_or_insert_with(|| (self.line, shown(keyword)));
                return Ok(());
            }
        }
        self.known_count += 1;
        Ok(())
    }

    /// The position of a `v`: three numbers, and up to four more (weight, colour) that are checked and dropped. With
    /// it, whether f32 keeps its digits.
    fn position(&self, rest: &[u8]) -> Result<([f64; 3], bool), ImportError> {
        let mut numbers = [0.0; 7];
        let mut count = 0;
        let mut is_kept = self.feed.are_digits_kept();
        for word in arguments(rest) {
            let number = number::parse(word)
                .ok_or_else(|| self.error(self.line, format!("`{}` is not a number", shown(word))))?;
            is_kept = is_kept && (count >= 3 || decimal::is_kept_by_float32(word, number));
            match numbers.get_mut(count) {
                Some(place) => *place = number,
                None => return Err(self.error(self.line, "`v` with more than seven numbers")),
            }
            count += 1;
        }
        match numbers {
            [x, y, z, ..] if count >= 3 => Ok(([x, y, z], is_kept)),
            _ => Err(self.error(self.line, format!("`v` with {count} numbers; three are needed"))),
        }
    }

    /// The numbers of a `vt` or `vn`, at least `least`; what is beyond the third is checked and dropped.
    fn numbers(&self, rest: &[u8], keyword: &str, least: usize) -> Result<[f32; 3], ImportError> {
        let mut numbers = [0.0; 3];
        let mut count = 0;
        for word in arguments(rest) {
            let number = number::parse(word)
                .ok_or_else(|| self.error(self.line, format!("`{}` is not a number", shown(word))))?;
            if let Some(place) = numbers.get_mut(count) {
                *place = number as f32;
            }
            count += 1;
        }
        if count >= least {
            return Ok(numbers);
        }
        let reason = format!("`{keyword}` with {count} numbers; {least} are needed");
        Err(self.error(self.line, reason))
    }

    /// Takes an `f`.
    fn face(&mut self, rest: &[u8], offset: u64) -> Result<(), ImportError> {
        let numbering = self.numbering();
        self.corners.clear();
        self.references.clear();
        let mut has_references = false;
        for word in arguments(rest) {
            let (index, attributes) = corner(word).ok_or_else(|| {
                let reason = "is not a corner of a face (a, a/b, a//c or a/b/c)";
                self.error(self.line, format!("`{}` {reason}", shown(word)))
            })?;
            if index == 0 {
                return Err(self.error(self.line, "a face names vertex 0; indices start at 1"));
            }
            let Some(vertex) = numbering.vertex(index.unsigned_abs(), index < 0) else {
                if self.may_postpone && self.pass == Pass::Whole && index > 0 {
                    self.postpone(offset, self.line);
                    return Ok(());
                }
                let known = numbering.known;
                let reason = match self.pass {
                    Pass::Faces => format!("a face names vertex {index}, but the file has {known}"),
                    _ => format!("a face names vertex {index}, but only {known} have come"),
                };
                return Err(self.error(self.line, reason));
            };
            if self.corners.len() == CORNERS_MAX {
                let reason = format!("a face with more than {CORNERS_MAX} corners");
                return Err(self.error(self.line, reason));
            }
            self.corners.push(vertex);
            if self.feed.takes_attributes() {
                let above = self.attributes_above;
                let reference = [0, 1].map(|kind| attribute(attributes[kind], above[kind]));
                has_references |= reference != [NO_INDEX; 2];
                self.references.push(reference);
            }
        }
        if !has_references {
            self.references.clear();
        }
        self.feed.face_with(&self.corners, &self.references)
    }
}

/// Words of a statement up to a comment that follows it.
fn arguments(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    words(text).take_while(|word| !word.starts_with(b"#"))
}

/// The vertex index of a corner, and those of its attributes, 0 if they are missing; all must be whole numbers.
fn corner(word: &[u8]) -> Option<(i64, [i64; 2])> {
    let mut parts = word.split(|byte| *byte == b'/');
    let index = integer(parts.next()?)?;
    let mut attributes = [0; 2];
    for (place, part) in attributes.iter_mut().zip(&mut parts) {
        *place = if part.is_empty() { 0 } else { integer(part)? };
    }
    parts.next().is_none().then_some((index, attributes))
}

/// The attribute of a 1-based or negative index; none if it is 0, or counts back beyond the first of the `above`.
fn attribute(index: i64, above: u64) -> u32 {
    let found = match index {
        0 => None,
        1.. => Some(index as u64 - 1),
        _ => above.checked_sub(index.unsigned_abs()),
    };
    found.and_then(|index| u32::try_from(index).ok()).unwrap_or(NO_INDEX)
}

/// A decimal integer of at most 18 digits.
fn integer(text: &[u8]) -> Option<i64> {
    let text = std::str::from_utf8(text).ok()?;
    if text.len() > 19 { None } else { text.parse().ok() }
}
