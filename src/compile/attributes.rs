//! Attributes on their way to the compiled file: values and the corners' indices in spills, pages at the end.
//!
//! Corners may name values that come later, so nothing is looked up before the last triangle has come. Then the indices are read in the
//! order of the triangles, page by page; values are looked up through a small window of pages of the spill, for meshes name
//! values that came close to each other.

use super::output::Output;
use super::spill::{Spill, SpillPlace};
use crate::block::Codec;
use crate::block::attributes::{
    NO_ATTRIBUTE, PAGE_TRIANGLES, PageEncodeScratch, PageInput, encode_page, normal_bits,
};
use crate::budget::MemoryBudget;
use crate::error::{BudgetError, CompileError};
use crate::import::CornerIndices;
use crate::units::Bytes;

/// Bytes of a triangle's indices: three to texture coordinates, three to normals.
const RECORD_BYTES: usize = 24;
/// A page of a spill in a window, and how many there are.
const WINDOW_PAGE_BYTES: usize = 4096;
const WINDOW_PAGES: usize = 128;

/// What a compiler does with the attributes that come.
pub(super) enum Attributes {
    /// Nothing: readers need not send them.
    Unwanted,
    /// They are left out; whether there were any.
    LeftOut(bool),
    /// They are kept. There is no store as long as no attribute came.
    Kept(Option<Box<AttributeStore>>),
}

/// What became of attributes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WrittenAttributes {
    pub(super) triangles: u64,
    pub(super) bytes: u64,
}

impl Attributes {
    fn store(&mut self, place: &SpillPlace) -> Result<Option<&mut AttributeStore>, CompileError> {
        let Attributes::Kept(store) = self else { return Ok(None) };
        if store.is_none() {
            *store = Some(Box::new(AttributeStore::new(place)?));
        }
        Ok(store.as_deref_mut())
    }

    pub(super) fn uvs(&mut self, batch: &[[f32; 2]], place: &SpillPlace) -> Result<(), CompileError> {
        match self.store(place)? {
            Some(store) => store.uvs.append(bytemuck::cast_slice(batch)),
            None => Ok(()),
        }
    }

    pub(super) fn normals(&mut self, batch: &[[f32; 3]], place: &SpillPlace) -> Result<(), CompileError> {
        let Some(store) = self.store(place)? else { return Ok(()) };
        for part in batch.chunks(1024) {
            store.bits.clear();
            store.bits.extend(part.iter().map(|normal| normal_bits(*normal).unwrap_or(NO_ATTRIBUTE)));
            store.normals.append(bytemuck::cast_slice(&store.bits))?;
        }
        Ok(())
    }

    pub(super) fn triangles(
        &mut self,
        first_id: u64,
        count: usize,
        corners: CornerIndices<'_>,
        place: &SpillPlace,
    ) -> Result<(), CompileError> {
        if let Attributes::LeftOut(any) = self {
            *any = true;
        }
        match self.store(place)? {
            Some(store) => store.triangles(first_id, count, corners),
            None => Ok(()),
        }
    }
}

/// See the module's text.
pub(super) struct AttributeStore {
    uvs: Values<8>,
    normals: Values<4>,
    bits: Vec<u32>,
    corners: Spill,
    record: Vec<[[u32; 3]; 2]>,
    /// The triangle of the first record, the first of a page, and the one behind the last.
    range: Option<[u64; 2]>,
}

impl AttributeStore {
    fn new(place: &SpillPlace) -> Result<AttributeStore, BudgetError> {
        // All is read once, at the end: memory is better spent on vertices.
        let headroom = place.budget.limit().0 - place.budget.limit().0 / 8;
        let spill = |suffix| Spill::new(place.clone(), suffix, headroom);
        Ok(AttributeStore {
            uvs: Values { spill: spill(".uvs")?, window: Vec::new() },
            normals: Values { spill: spill(".normals")?, window: Vec::new() },
            bits: Vec::with_capacity(1024),
            corners: spill(".corners")?,
            record: Vec::with_capacity(PAGE_TRIANGLES),
            range: None,
        })
    }

    /// Bytes that went to temporary files.
    pub(super) fn spill_bytes(&self) -> u64 {
        self.uvs.spill.file_bytes() + self.normals.spill.file_bytes() + self.corners.file_bytes()
    }

    fn triangles(
        &mut self,
        first_id: u64,
        count: usize,
        corners: CornerIndices<'_>,
    ) -> Result<(), CompileError> {
        let page_start = first_id - first_id % PAGE_TRIANGLES as u64;
        let [_, end] = *self.range.get_or_insert([page_start, page_start]);
        // Triangles without attributes came in between.
        let (mut missing, nothing) = (first_id - end, [[NO_ATTRIBUTE; 3]; 2]);
        while missing > 0 {
            let part = missing.min(PAGE_TRIANGLES as u64);
            self.record.clear();
            self.record.resize(part as usize, nothing);
            self.corners.append(bytemuck::cast_slice(&self.record))?;
            missing -= part;
        }
        let of = |list: Option<&[[u32; 3]]>, index: usize| list.map_or([NO_ATTRIBUTE; 3], |list| list[index]);
        for start in (0..count).step_by(PAGE_TRIANGLES) {
            let part = start..count.min(start + PAGE_TRIANGLES);
            self.record.clear();
            self.record.extend(part.map(|index| [of(corners.uvs, index), of(corners.normals, index)]));
            self.corners.append(bytemuck::cast_slice(&self.record))?;
        }
        // Set by `get_or_insert` above.
        if let Some(range) = &mut self.range {
            range[1] = first_id + count as u64;
        }
        Ok(())
    }

    /// Encodes all pages and writes them.
    pub(super) fn write(
        mut self,
        codec: Codec,
        output: &mut Output,
        budget: &MemoryBudget,
    ) -> Result<WrittenAttributes, CompileError> {
        let mut written = WrittenAttributes::default();
        let Some([start, end]) = self.range else { return Ok(written) };
        let windows = 2 * (WINDOW_PAGES * WINDOW_PAGE_BYTES) as u64;
        let pages = (PAGE_TRIANGLES * (RECORD_BYTES + 28 + 16)) as u64;
        let purpose = "gathering the attributes of triangles";
        let _memory = budget.reserve(Bytes(windows + pages + PageEncodeScratch::BYTES), purpose)?;
        output.reserve_pages(end.div_ceil(PAGE_TRIANGLES as u64))?;
        let mut scratch = PageEncodeScratch::default();
        let (mut uvs, mut normals, mut stored) = (Vec::new(), Vec::new(), Vec::new());
        // Pages without attributes are written only before one that has some.
        let mut empty_pages = start / PAGE_TRIANGLES as u64;
        let mut id = start;
        while id < end {
            let count = (end - id).min(PAGE_TRIANGLES as u64) as usize;
            self.record.clear();
            self.record.resize(count, [[0; 3]; 2]);
            let offset = (id - start) * RECORD_BYTES as u64;
            self.corners.read(offset, bytemuck::cast_slice_mut(&mut self.record))?;
            uvs.clear();
            normals.clear();
            for [uv_corners, normal_corners] in &self.record {
                let uv = self.uvs.get_all(*uv_corners)?;
                let normal = self.normals.get_all(*normal_corners)?;
                let uv = uv.map(|corners| corners.map(bytemuck::cast::<[u8; 8], [f32; 2]>));
                let uv = uv.filter(|corners| corners.as_flattened().iter().all(|x| x.is_finite()));
                let normal = normal.map(|corners| corners.map(u32::from_ne_bytes));
                let normal = normal.filter(|corners| !corners.contains(&NO_ATTRIBUTE));
                written.triangles += u64::from(uv.is_some() || normal.is_some());
                uvs.push(uv);
                normals.push(normal);
            }
            let input = PageInput { uvs: &uvs, normals: &normals };
            match encode_page(&input, codec, &mut scratch, &mut stored)? {
                None => empty_pages += 1,
                Some(check) => {
                    for _ in 0..std::mem::take(&mut empty_pages) {
                        output.write_page(&[], None)?;
                    }
                    output.write_page(&stored, Some(check))?;
                    written.bytes += stored.len() as u64;
                }
            }
            id += count as u64;
        }
        Ok(written)
    }
}

/// Values of `SIZE` bytes in a spill, and a window on it for looking them up.
struct Values<const SIZE: usize> {
    spill: Spill,
    /// Pages of the spill by the low bits of their number, each with its number; empty until the first look.
    window: Vec<(u64, Vec<u8>)>,
}

impl<const SIZE: usize> Values<SIZE> {
    fn append(&mut self, bytes: &[u8]) -> Result<(), CompileError> {
        self.spill.append(bytes).map(drop)
    }

    /// The values of three corners; `None` if one has none, or names one that never came.
    fn get_all(&mut self, indices: [u32; 3]) -> Result<Option<[[u8; SIZE]; 3]>, CompileError> {
        let count = self.spill.len() / SIZE as u64;
        // `NO_ATTRIBUTE` is the greatest number, and an index only if so many came.
        if indices.iter().any(|index| *index == NO_ATTRIBUTE || u64::from(*index) >= count) {
            return Ok(None);
        }
        let mut values = [[0; SIZE]; 3];
        for (value, index) in values.iter_mut().zip(indices) {
            *value = self.get(index)?;
        }
        Ok(Some(values))
    }

    fn get(&mut self, index: u32) -> Result<[u8; SIZE], CompileError> {
        let at = u64::from(index) * SIZE as u64;
        let number = at / WINDOW_PAGE_BYTES as u64;
        if self.window.is_empty() {
            self.window = vec![(u64::MAX, Vec::new()); WINDOW_PAGES];
        }
        let (held, bytes) = &mut self.window[number as usize % WINDOW_PAGES];
        if *held != number {
            let start = number * WINDOW_PAGE_BYTES as u64;
            bytes.resize((self.spill.len() - start).min(WINDOW_PAGE_BYTES as u64) as usize, 0);
            self.spill.read(start, bytes)?;
            *held = number;
        }
        let from = (at % WINDOW_PAGE_BYTES as u64) as usize;
        let mut value = [0; SIZE];
        // `SIZE` divides the page, so no value lies across two.
        value.copy_from_slice(&bytes[from..from + SIZE]);
        Ok(value)
    }
}
