//! The elements of an accessor, read in pieces.

use gltf::accessor::{DataType, Dimensions};
use gltf::{Accessor, Semantic};

use super::bytes::Bytes;
use super::document::Opened;
use super::placement::Placed;
use crate::error::ImportError;

/// Bytes read at a time, or one element if that is longer.
const PIECE_BYTES: u64 = 1 << 20;

/// Elements of one accessor that are still to be read.
pub(super) struct Elements {
    /// The buffer, and where the next element starts in it.
    buffer: usize,
    offset: u64,
    stride: u64,
    /// Bytes of one element.
    size: u64,
    left: u64,
    kind: DataType,
    is_normalized: bool,
    piece: Vec<u8>,
}

impl Elements {
    /// The positions of a primitive.
    pub fn positions(opened: &Opened, placed: &Placed<'_>) -> Result<Elements, ImportError> {
        match Elements::vectors(opened, placed, &Semantic::Positions)? {
            Some(elements) => Ok(elements),
            None => Err(opened.error(placed.name(), "there are no positions")),
        }
    }

    /// Vectors of a primitive, one for each position, if it has them: positions and normals of three numbers, texture coordinates of
    /// two.
    pub fn vectors(
        opened: &Opened,
        placed: &Placed<'_>,
        semantic: &Semantic,
    ) -> Result<Option<Elements>, ImportError> {
        let name = || format!("{}.attributes.{}", placed.name(), semantic.to_string());
        let Some(accessor) = placed.primitive.get(semantic) else { return Ok(None) };
        let (wanted, numbers) = match semantic {
            Semantic::TexCoords(_) => (Dimensions::Vec2, "two"),
            _ => (Dimensions::Vec3, "three"),
        };
        if accessor.dimensions() != wanted || accessor.data_type() == DataType::U32 {
            return Err(opened.error(
                name(),
                format!("it must have vectors of {numbers} numbers, and no 32-bit integers"),
            ));
        }
        if accessor.count() as u64 != placed.vertex_count {
            let reason =
                format!("it has {} elements beside {} positions", accessor.count(), placed.vertex_count);
            return Err(opened.error(name(), reason));
        }
        Elements::new(opened, &accessor, name()).map(Some)
    }

    /// The indices of a primitive, if it has some.
    pub fn indices(opened: &Opened, placed: &Placed<'_>) -> Result<Option<Elements>, ImportError> {
        let name = || format!("{}.indices", placed.name());
        let Some(accessor) = placed.primitive.indices() else { return Ok(None) };
        if accessor.dimensions() != Dimensions::Scalar
            || !matches!(accessor.data_type(), DataType::U8 | DataType::U16 | DataType::U32)
        {
            return Err(opened.error(name(), "indices must be single unsigned integers"));
        }
        Elements::new(opened, &accessor, name()).map(Some)
    }

    /// Vectors of `numbers` numbers that say where copies are: f32, or for rotations normalized signed integers.
    pub fn of_copies(
        opened: &Opened,
        accessor: &Accessor<'_>,
        name: String,
        numbers: usize,
    ) -> Result<Elements, ImportError> {
        let is_number = match accessor.data_type() {
            DataType::F32 => true,
            DataType::I8 | DataType::I16 => numbers == 4 && accessor.normalized(),
            _ => false,
        };
        if accessor.dimensions().multiplicity() != numbers
            || !matches!(accessor.dimensions(), Dimensions::Vec3 | Dimensions::Vec4)
            || !is_number
        {
            return Err(opened.error(name, "it must have three floats, or four for rotations"));
        }
        Elements::new(opened, accessor, name)
    }

    fn new(opened: &Opened, accessor: &Accessor<'_>, name: String) -> Result<Elements, ImportError> {
        if accessor.sparse().is_some() {
            return Err(opened.error(name, "sparse accessors are not supported; write the file without them"));
        }
        let Some(view) = accessor.view() else {
            return Err(opened.error(
                name,
                "the accessor has no buffer view, which makes it all zeros; write the file without it",
            ));
        };
        let (size, left) = (accessor.size() as u64, accessor.count() as u64);
        let stride = view.stride().map_or(size, |stride| stride as u64);
        let start = accessor.offset() as u64;
        // From the first byte of the first element to the last one of the last.
        let end = left.saturating_sub(1).checked_mul(stride).and_then(|last| last.checked_add(size + start));
        if stride < size || end.is_none_or(|end| left > 0 && end > view.length() as u64) {
            return Err(opened.error(name, "the accessor reaches past the end of its buffer view"));
        }
        let Some(offset) = start.checked_add(view.offset() as u64) else {
            return Err(opened.error(name, "the accessor starts past the end of its buffer view"));
        };
        Ok(Elements {
            buffer: view.buffer().index(),
            offset,
            stride,
            size,
            left,
            kind: accessor.data_type(),
            is_normalized: accessor.normalized(),
            piece: Vec::new(),
        })
    }

    /// Reads the next piece. Gives how many elements it holds; 0 at the end.
    fn refill(&mut self, bytes: &mut Bytes<'_>) -> Result<u64, ImportError> {
        let count = self.left.min((PIECE_BYTES / self.stride).max(1));
        if count == 0 {
            return Ok(0);
        }
        // The last element need not be followed by the rest of a stride.
        self.piece.resize(((count - 1) * self.stride + self.size) as usize, 0);
        bytes.read(self.buffer, self.offset, &mut self.piece)?;
        self.offset += count * self.stride;
        self.left -= count;
        Ok(count)
    }

    /// Puts the next vectors into `into` and gives the bytes of the buffer that they took; `None` at the end.
    pub fn next_vectors<const N: usize>(
        &mut self,
        bytes: &mut Bytes<'_>,
        into: &mut Vec<[f32; N]>,
    ) -> Result<Option<u64>, ImportError> {
        let count = self.refill(bytes)?;
        into.clear();
        let part = self.size as usize / N;
        for element in self.piece.chunks(self.stride as usize).take(count as usize) {
            let mut vector = [0.0; N];
            for (axis, number) in vector.iter_mut().enumerate() {
                *number = coordinate(self.kind, self.is_normalized, &element[axis * part..]);
            }
            into.push(vector);
        }
        Ok((count > 0).then_some(count * self.size))
    }

    /// As [`Elements::next_vectors`], for indices.
    pub fn next_indices(
        &mut self,
        bytes: &mut Bytes<'_>,
        into: &mut Vec<u32>,
    ) -> Result<Option<u64>, ImportError> {
        let count = self.refill(bytes)?;
        into.clear();
        for element in self.piece.chunks(self.stride as usize).take(count as usize) {
            into.push(match self.kind {
                DataType::U8 => u32::from(element[0]),
                DataType::U16 => u32::from(u16::from_le_bytes(first(element))),
                _ => u32::from_le_bytes(first(element)),
            });
        }
        Ok((count > 0).then_some(count * self.size))
    }
}

/// The first bytes of an element, which has as many.
fn first<const N: usize>(element: &[u8]) -> [u8; N] {
    element.first_chunk().copied().unwrap_or([0; N])
}

/// One coordinate; integers as `KHR_mesh_quantization` has them.
fn coordinate(kind: DataType, is_normalized: bool, bytes: &[u8]) -> f32 {
    let (number, most) = match kind {
        DataType::I8 => (f32::from(bytes[0] as i8), 127.0),
        DataType::U8 => (f32::from(bytes[0]), 255.0),
        DataType::I16 => (f32::from(i16::from_le_bytes(first(bytes))), 32_767.0),
        DataType::U16 => (f32::from(u16::from_le_bytes(first(bytes))), 65_535.0),
        _ => return f32::from_le_bytes(first(bytes)),
    };
    if is_normalized { (number / most).max(-1.0) } else { number }
}
