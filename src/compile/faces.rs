//! Faces that came before the last vertex: kept until the grid is complete, then replayed in order.

use super::spill::{Spill, SpillPlace};
use crate::error::{BudgetError, CompileError};

/// Most triangles in a record.
const RECORD_TRIANGLES_MAX: usize = 512;
const HEADER_BYTES: usize = 12;

/// Triangles in records of one material each: `u16 triangles - 1, u16 material, u32 base, u32 bytes per index`, then three
/// indices per triangle, 2 bytes each relative to the base where the record's vertices allow it, else 4.
#[derive(Debug)]
pub(super) struct Faces {
    spill: Spill,
    open: Vec<[u32; 3]>,
    material: u16,
    count: u64,
    bytes: Vec<u8>,
}

impl Faces {
    pub(super) fn new(place: SpillPlace, headroom: u64) -> Result<Faces, BudgetError> {
        Ok(Faces {
            spill: Spill::new(place, ".faces", headroom)?,
            open: Vec::with_capacity(RECORD_TRIANGLES_MAX),
            material: 0,
            count: 0,
            bytes: Vec::new(),
        })
    }

    /// How many triangles there are.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    pub(super) fn spill_bytes(&self) -> u64 {
        self.spill.file_bytes()
    }

    pub(super) fn push(&mut self, mut triangles: &[[u32; 3]], material: u16) -> Result<(), CompileError> {
        if material != self.material {
            self.close_record()?;
            self.material = material;
        }
        self.count += triangles.len() as u64;
        while !triangles.is_empty() {
            let count = triangles.len().min(RECORD_TRIANGLES_MAX - self.open.len());
            self.open.extend_from_slice(&triangles[..count]);
            triangles = &triangles[count..];
            if self.open.len() == RECORD_TRIANGLES_MAX {
                self.close_record()?;
            }
        }
        Ok(())
    }

    fn close_record(&mut self) -> Result<(), CompileError> {
        if self.open.is_empty() {
            return Ok(());
        }
        let (mut min, mut max) = (u32::MAX, 0);
        for &[a, b, c] in &self.open {
            min = min.min(a).min(b).min(c);
            max = max.max(a).max(b).max(c);
        }
        let narrow = max - min <= u32::from(u16::MAX);
        self.bytes.clear();
        self.bytes.extend_from_slice(&((self.open.len() - 1) as u16).to_ne_bytes());
        self.bytes.extend_from_slice(&self.material.to_ne_bytes());
        self.bytes.extend_from_slice(&min.to_ne_bytes());
        self.bytes.extend_from_slice(&if narrow { 2_u32 } else { 4 }.to_ne_bytes());
        if narrow {
            let at = self.bytes.len();
            self.bytes.resize(at + 6 * self.open.len(), 0);
            for (into, &[a, b, c]) in self.bytes[at..].as_chunks_mut::<6>().0.iter_mut().zip(&self.open) {
                *into = bytemuck::cast([(a - min) as u16, (b - min) as u16, (c - min) as u16]);
            }
        } else {
            self.bytes.extend_from_slice(bytemuck::cast_slice(&self.open));
        }
        self.spill.append(&self.bytes)?;
        self.open.clear();
        Ok(())
    }

    /// Gives every record to `take` in order: triangles, material, id of the first.
    pub(super) fn replay(
        &mut self,
        mut take: impl FnMut(&[[u32; 3]], u16, u64) -> Result<(), CompileError>,
    ) -> Result<(), CompileError> {
        self.close_record()?;
        let mut triangles = Vec::with_capacity(RECORD_TRIANGLES_MAX);
        let (mut at, mut id) = (0, 0);
        let mut window = Vec::new();
        let mut start = 0;
        while at < self.spill.len() {
            // A window always holds at least one whole record, unless the end comes first.
            let record_bytes_max = HEADER_BYTES + 12 * RECORD_TRIANGLES_MAX;
            if start + record_bytes_max > window.len()
                && at + ((window.len() - start) as u64) < self.spill.len()
            {
                let bytes = (self.spill.len() - at).min(16 * record_bytes_max as u64) as usize;
                window.resize(bytes, 0);
                self.spill.read(at, &mut window)?;
                start = 0;
            }
            let header = &window[start..start + HEADER_BYTES];
            let word = |index: usize| u32::from_ne_bytes([0, 1, 2, 3].map(|byte| header[index + byte]));
            let half = |index: usize| u16::from_ne_bytes([header[index], header[index + 1]]);
            let (count, material, base) = (usize::from(half(0)) + 1, half(2), word(4));
            let bytes = 3 * word(8) as usize * count;
            let indices = &window[start + HEADER_BYTES..start + HEADER_BYTES + bytes];
            triangles.clear();
            if word(8) == 2 {
                triangles.extend(indices.as_chunks::<6>().0.iter().map(|offsets| {
                    let [a, b, c]: [u16; 3] = bytemuck::cast(*offsets);
                    [base + u32::from(a), base + u32::from(b), base + u32::from(c)]
                }));
            } else {
                triangles.resize(count, [0; 3]);
                bytemuck::cast_slice_mut(&mut triangles).copy_from_slice(indices);
            }
            take(&triangles, material, id)?;
            id += count as u64;
            start += HEADER_BYTES + bytes;
            at += (HEADER_BYTES + bytes) as u64;
        }
        Ok(())
    }
}
