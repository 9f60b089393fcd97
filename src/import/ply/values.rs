//! Values of records, one at a time, from binary or text: the path for every file that the fast loops do not take.

use super::header::{Encoding, Kind, Scalar};
use crate::error::ImportError;
use crate::import::decimal;
use crate::import::number;
use crate::import::text::is_blank;
use crate::import::window::Window;

/// Longest number in a text file.
const TOKEN_BYTES_MAX: usize = 4096;

/// Gives the values of a PLY body in their order.
pub(super) struct Values<'w, 'a> {
    pub(super) window: &'w mut Window<'a>,
    encoding: Encoding,
    /// The line that text reading is at.
    line: u64,
}

/// A value in its own type.
#[derive(Clone, Copy, Debug)]
pub(super) enum Value {
    Integer(i64),
    Single(f32),
    Double(f64),
}

impl<'w, 'a> Values<'w, 'a> {
    pub(super) fn new(window: &'w mut Window<'a>, encoding: Encoding, line: u64) -> Values<'w, 'a> {
        Values { window, encoding, line }
    }

    pub(super) fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// An error at the value that would come next.
    pub(super) fn error(&self, reason: impl Into<String>) -> ImportError {
        match self.encoding {
            Encoding::Ascii => self.window.line_error(self.line, reason),
            _ => self.window.byte_error(self.window.offset(), reason),
        }
    }

    fn truncated(&self) -> ImportError {
        self.error("the file ends here, but its header promises more records")
    }

    /// The next value as a coordinate.
    #[inline]
    pub(super) fn float(&mut self, scalar: Scalar) -> Result<f64, ImportError> {
        Ok(match self.value(scalar)? {
            Value::Integer(value) => value as f64,
            Value::Single(value) => f64::from(value),
            Value::Double(value) => value,
        })
    }

    /// The next value of a text file as a coordinate. `is_kept` becomes false if f32 does not keep its digits; once it is false
    /// they are not looked at.
    pub(super) fn text_float(&mut self, is_kept: &mut bool) -> Result<f64, ImportError> {
        let length = self.token()?;
        let token = &self.window.data()[..length];
        let Some(value) = number::parse(token) else { return Err(self.not_a_number(length)) };
        *is_kept = *is_kept && decimal::is_kept_by_float32(token, value);
        self.window.consume(length);
        Ok(value)
    }

    /// The next value as a count or an index.
    #[inline]
    pub(super) fn integer(&mut self, scalar: Scalar) -> Result<i64, ImportError> {
        let float = match self.value(scalar)? {
            Value::Integer(value) => return Ok(value),
            Value::Single(value) => f64::from(value),
            Value::Double(value) => value,
        };
        if float.fract() == 0.0 && float.abs() < 9e15 {
            return Ok(float as i64);
        }
        Err(self.error(format!("{float} where a whole number must stand")))
    }

    /// The count of a list.
    pub(super) fn count(&mut self, scalar: Scalar) -> Result<u64, ImportError> {
        let count = self.integer(scalar)?;
        u64::try_from(count).map_err(|_| self.error(format!("a list with {count} items")))
    }

    /// The next value.
    #[inline]
    fn value(&mut self, scalar: Scalar) -> Result<Value, ImportError> {
        match self.encoding {
            Encoding::Ascii => self.text_value(scalar),
            Encoding::LittleEndian => self.binary_value::<false>(scalar),
            Encoding::BigEndian => self.binary_value::<true>(scalar),
        }
    }

    #[inline]
    fn binary_value<const BIG: bool>(&mut self, scalar: Scalar) -> Result<Value, ImportError> {
        fn order<const BIG: bool, const N: usize>(mut bytes: [u8; N]) -> [u8; N] {
            if BIG {
                bytes.reverse();
            }
            bytes
        }
        Ok(match scalar {
            Scalar::I8 => Value::Integer(i8::from_le_bytes(self.bytes()?).into()),
            Scalar::U8 => Value::Integer(u8::from_le_bytes(self.bytes()?).into()),
            Scalar::I16 => Value::Integer(i16::from_le_bytes(order::<BIG, 2>(self.bytes()?)).into()),
            Scalar::U16 => Value::Integer(u16::from_le_bytes(order::<BIG, 2>(self.bytes()?)).into()),
            Scalar::I32 => Value::Integer(i32::from_le_bytes(order::<BIG, 4>(self.bytes()?)).into()),
            Scalar::U32 => Value::Integer(u32::from_le_bytes(order::<BIG, 4>(self.bytes()?)).into()),
            Scalar::F32 => Value::Single(f32::from_le_bytes(order::<BIG, 4>(self.bytes()?))),
            Scalar::F64 => Value::Double(f64::from_le_bytes(order::<BIG, 8>(self.bytes()?))),
        })
    }

    #[inline]
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], ImportError> {
        if let Some(bytes) = self.window.data().first_chunk::<N>() {
            let bytes = *bytes;
            self.window.consume(N);
            return Ok(bytes);
        }
        self.window.refill()?;
        match self.window.data().first_chunk::<N>() {
            Some(bytes) => {
                let bytes = *bytes;
                self.window.consume(N);
                Ok(bytes)
            }
            None => Err(self.truncated()),
        }
    }

    /// Text integers that look like floats (`3.0`) are accepted where they are whole.
    fn text_value(&mut self, scalar: Scalar) -> Result<Value, ImportError> {
        let length = self.token()?;
        let token = &self.window.data()[..length];
        let value = match (scalar, integer(token)) {
            (Scalar::F32 | Scalar::F64, _) | (_, None) => number::parse(token).map(Value::Double),
            (_, Some(value)) => Some(Value::Integer(value)),
        };
        match value {
            Some(value) => {
                self.window.consume(length);
                Ok(value)
            }
            None => Err(self.not_a_number(length)),
        }
    }

    fn not_a_number(&self, length: usize) -> ImportError {
        let token = String::from_utf8_lossy(&self.window.data()[..length.min(40)]);
        self.error(format!("`{token}` is not a number"))
    }

    /// Moves to the next token and gives its length.
    fn token(&mut self) -> Result<usize, ImportError> {
        loop {
            let data = self.window.data();
            let blank = data.iter().position(|byte| !is_blank(byte)).unwrap_or(data.len());
            let newlines = memchr::memchr_iter(b'\n', &data[..blank]).count() as u64;
            let length = data[blank..].iter().take(TOKEN_BYTES_MAX + 1).position(is_blank);
            let rest = data.len() - blank;
            self.line += newlines;
            self.window.consume(blank);
            if let Some(length) = length {
                return Ok(length);
            }
            if rest > TOKEN_BYTES_MAX {
                return Err(self.error("a number of more than 4096 characters"));
            }
            if self.window.ended() {
                return if rest == 0 { Err(self.truncated()) } else { Ok(rest) };
            }
            self.window.refill()?;
        }
    }

    /// Passes over a property of a record.
    pub(super) fn skip_property(&mut self, kind: Kind) -> Result<(), ImportError> {
        match kind {
            Kind::Scalar(scalar) => self.skip(scalar, 1),
            Kind::List { count, item } => {
                let count = self.count(count)?;
                self.skip(item, count)
            }
        }
    }

    /// Passes over values of one type.
    fn skip(&mut self, scalar: Scalar, count: u64) -> Result<(), ImportError> {
        if self.encoding == Encoding::Ascii {
            for _ in 0..count {
                let length = self.token()?;
                self.window.consume(length);
            }
            return Ok(());
        }
        let bytes = count.checked_mul(scalar.bytes() as u64);
        match bytes {
            Some(bytes) if self.window.skip(bytes)? => Ok(()),
            _ => Err(self.truncated()),
        }
    }
}

/// A decimal integer, or nothing.
fn integer(token: &[u8]) -> Option<i64> {
    let (negative, digits) = match token {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] => (false, digits),
        digits => (false, digits),
    };
    if digits.is_empty() || digits.len() > 18 {
        return None;
    }
    let mut value = 0;
    for digit in digits {
        let digit = digit.wrapping_sub(b'0');
        if digit > 9 {
            return None;
        }
        value = value * 10 + i64::from(digit);
    }
    Some(if negative { -value } else { value })
}
