//! The text that every PLY file starts with: encoding, elements, properties.

use crate::error::ImportError;
use crate::import::text::{shown, trimmed, words};
use crate::import::window::Window;

/// How the records after the header are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// The types that a property can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    /// The type of that name, old style (`uchar`) or new (`uint8`).
    fn parse(name: &[u8]) -> Option<Scalar> {
        Some(match name {
            b"char" | b"int8" => Scalar::I8,
            b"uchar" | b"uint8" => Scalar::U8,
            b"short" | b"int16" => Scalar::I16,
            b"ushort" | b"uint16" => Scalar::U16,
            b"int" | b"int32" => Scalar::I32,
            b"uint" | b"uint32" => Scalar::U32,
            b"float" | b"float32" => Scalar::F32,
            b"double" | b"float64" => Scalar::F64,
            _ => return None,
        })
    }

    /// Size in a binary file.
    pub(super) fn bytes(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::F64 => 8,
        }
    }

    /// The value in exactly `self.bytes()` little-endian bytes.
    pub(super) fn little_endian(self, bytes: &[u8]) -> f64 {
        let mut filled = [0; 8];
        filled[..bytes.len()].copy_from_slice(bytes);
        let [a, b, c, d, ..] = filled;
        match self {
            Scalar::I8 => f64::from(a as i8),
            Scalar::U8 => f64::from(a),
            Scalar::I16 => f64::from(i16::from_le_bytes([a, b])),
            Scalar::U16 => f64::from(u16::from_le_bytes([a, b])),
            Scalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Scalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Scalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Scalar::F64 => f64::from_le_bytes(filled),
        }
    }

    /// Whether every value of the type is exact in f32.
    pub(super) fn fits_f32(self) -> bool {
        matches!(self, Scalar::I8 | Scalar::U8 | Scalar::I16 | Scalar::U16 | Scalar::F32)
    }
}

/// One value, or a count and that many values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

/// A named part of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

/// A table of records of one kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Size of a record in a binary file, if it has no lists.
    pub(super) fn fixed_bytes(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, property| match property.kind {
            Kind::Scalar(scalar) => Some(sum + scalar.bytes()),
            Kind::List { .. } => None,
        })
    }
}

/// The whole header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// From a line `comment mtllib NAME`.
    pub(super) material_library: Option<Vec<u8>>,
    /// Lines of the header, `end_header` included.
    pub(super) lines: u64,
    /// The first line that is none of the format's: some programs forget the word `comment`.
    pub(super) stray: Option<(u64, String)>,
}

/// Reads the header and leaves the window at the first byte after it.
pub(super) fn read(window: &mut Window<'_>) -> Result<Header, ImportError> {
    window.refill()?;
    let data = window.data();
    let line_end = match data.get(..4) {
        Some(b"ply\n") => b'\n',
        // A lone CR ends lines only where no LF follows the first one.
        Some(b"ply\r") if data.get(4) != Some(&b'\n') => b'\r',
        Some(b"ply\r" | b"ply " | b"ply\t") => b'\n',
        _ => return Err(window.byte_error(0, "not a PLY file: it does not start with a line `ply`")),
    };
    let mut parser = Parser { encoding: None, elements: Vec::new(), material_library: None, stray: None };
    let mut position = 0;
    let mut lines = 0;
    loop {
        let rest = &data[position..];
        lines += 1;
        let Some(length) = memchr::memchr(line_end, rest) else {
            // `end_header` without a line end is complete if nothing follows it.
            if window.ended() && trimmed(rest) == b"end_header" {
                position = data.len();
                break;
            }
            let reason = if window.ended() {
                "the file ends before `end_header`"
            } else {
                "no `end_header` in the first 1 MiB"
            };
            return Err(window.line_error(lines, reason));
        };
        position += length + 1;
        match parser.line(trimmed(&rest[..length]), lines) {
            Ok(true) => break,
            Ok(false) => {}
            Err(reason) => return Err(window.line_error(lines, reason)),
        }
    }
    let Some(encoding) = parser.encoding else {
        return Err(window.line_error(lines, "the header has no `format` line"));
    };
    window.consume(position);
    Ok(Header {
        encoding,
        elements: parser.elements,
        material_library: parser.material_library,
        lines,
        stray: parser.stray,
    })
}

struct Parser {
    encoding: Option<Encoding>,
    elements: Vec<Element>,
    material_library: Option<Vec<u8>>,
    stray: Option<(u64, String)>,
}

impl Parser {
    /// Takes the line of that number; true for `end_header`.
    fn line(&mut self, line: &[u8], number: u64) -> Result<bool, String> {
        let mut words = words(line);
        let keyword = words.next().unwrap_or_default();
        match keyword {
            b"" | b"ply" | b"obj_info" => {}
            b"comment" => {
                let text = trimmed(&line["comment".len()..]);
                if let Some(name) = text.strip_prefix(b"mtllib ") {
                    self.material_library.get_or_insert_with(|| trimmed(name).to_vec());
                }
            }
            b"format" => {
                self.encoding = Some(match words.next().unwrap_or_default() {
                    b"ascii" => Encoding::Ascii,
                    b"binary_little_endian" => Encoding::LittleEndian,
                    b"binary_big_endian" => Encoding::BigEndian,
                    other => return Err(format!("unknown format `{}`", shown(other))),
                });
            }
            b"element" => {
                let name = words.next().ok_or("an element without a name")?;
                let count = words.next().unwrap_or_default();
                let count = std::str::from_utf8(count)
                    .ok()
                    .and_then(|text| text.parse().ok())
                    .ok_or_else(|| format!("`{}` is not a count of records", shown(count)))?;
                self.elements.push(Element { name: shown(name), count, properties: Vec::new() });
            }
            b"property" => {
                let mut scalar = || {
                    let word = words.next().unwrap_or_default();
                    match word {
                        b"list" => Ok(None),
                        _ => Scalar::parse(word)
                            .map(Some)
                            .ok_or_else(|| format!("unknown property type `{}`", shown(word))),
                    }
                };
                let kind = match scalar()? {
                    Some(scalar) => Kind::Scalar(scalar),
                    None => match (scalar()?, scalar()?) {
                        (Some(count), Some(item)) => Kind::List { count, item },
                        _ => return Err("a list of lists".into()),
                    },
                };
                let name = words.next().ok_or("a property without a name")?;
                let element = self.elements.last_mut().ok_or("a property before the first element")?;
                element.properties.push(Property { name: shown(name), kind });
            }
            b"end_header" => return Ok(true),
            _ => {
                self.stray.get_or_insert_with(|| (number, shown(line)));
            }
        }
        Ok(false)
    }
}
