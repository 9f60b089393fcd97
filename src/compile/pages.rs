//! A long array in pages, of which only as many are in memory as the budget allows.

use bytemuck::Pod;

use super::spill::{Spill, SpillPlace};
use crate::budget::Reservation;
use crate::error::CompileError;
use crate::units::Bytes;

/// Base-two logarithm of the items in a page: pages of 48 to 96 KiB, small enough to fetch one for a few items
/// and large enough that a fetch is not all overhead.
const PAGE_SHIFT: u32 = 12;
const PAGE_ITEMS: usize = 1 << PAGE_SHIFT;
/// Fewest frames that work at all: the pages that a triangle touches, with some to spare.
const FRAMES_MIN: usize = 16;
const ABSENT: u32 = u32::MAX;

/// Items are appended and read in any order. While all fit, reading is two loads; beyond that, pages are fetched from
/// a spill file into a fixed number of frames, first in first out, so memory never exceeds its share.
#[derive(Debug)]
pub(super) struct Pages<T> {
    place: SpillPlace,
    /// Page to frame, or `ABSENT`.
    frame_of: Vec<u32>,
    frames: Vec<Vec<T>>,
    /// Frame to page.
    page_in: Vec<u32>,
    reservations: Vec<Reservation>,
    /// Next frame to reuse.
    hand: usize,
    /// Pages read back so far.
    fetches: u64,
    /// Once it exists it holds every full page, in order.
    spill: Option<Spill>,
    len: usize,
    headroom: u64,
}

impl<T: Pod> Pages<T> {
    /// No items yet. Takes frames while `headroom` bytes of the budget stay free for others.
    pub(super) fn new(place: SpillPlace, headroom: u64) -> Pages<T> {
        Pages {
            place,
            frame_of: Vec::new(),
            frames: Vec::new(),
            page_in: Vec::new(),
            reservations: Vec::new(),
            hand: 0,
            fetches: 0,
            spill: None,
            len: 0,
            headroom,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Whether every item is in memory, so that reading needs no exclusive access.
    pub(super) fn is_resident(&self) -> bool {
        self.spill.is_none()
    }

    /// How many pages were read back so far.
    pub(super) fn fetches(&self) -> u64 {
        self.fetches
    }

    /// Gives back all but the least memory. Only once there is a spill; the page that is being filled stays.
    pub(super) fn shrink(&mut self) {
        if self.spill.is_none() || self.frames.len() <= FRAMES_MIN {
            return;
        }
        let full_pages = self.len >> PAGE_SHIFT;
        // The page that is in no other place comes first and stays.
        if let Some(last) = self.page_in.iter().position(|page| *page as usize >= full_pages) {
            self.frames.swap(0, last);
            self.page_in.swap(0, last);
        }
        self.frames.truncate(FRAMES_MIN);
        self.page_in.truncate(FRAMES_MIN);
        self.reservations.truncate(FRAMES_MIN);
        self.hand = 0;
        self.frame_of.fill(ABSENT);
        for (frame, page) in (0..).zip(&self.page_in) {
            self.frame_of[*page as usize] = frame;
        }
    }

    /// What the frames hold of the budget.
    pub(super) fn memory_bytes(&self) -> u64 {
        (self.frames.len() * PAGE_ITEMS * size_of::<T>()) as u64
    }

    pub(super) fn spill_bytes(&self) -> u64 {
        self.spill.as_ref().map_or(0, Spill::file_bytes)
    }

    /// Appends what `convert` makes of `items`.
    pub(super) fn extend<S: Copy>(
        &mut self,
        mut items: &[S],
        mut convert: impl FnMut(S) -> T,
    ) -> Result<(), CompileError> {
        while !items.is_empty() {
            if self.len.is_multiple_of(PAGE_ITEMS) {
                self.open_page()?;
            }
            let frame = self.frame_of[self.len >> PAGE_SHIFT] as usize;
            let count = items.len().min(PAGE_ITEMS - self.len % PAGE_ITEMS);
            self.frames[frame].extend(items[..count].iter().map(|item| convert(*item)));
            self.len += count;
            items = &items[count..];
            if self.len.is_multiple_of(PAGE_ITEMS)
                && let Some(spill) = &mut self.spill
            {
                spill.append(bytemuck::cast_slice(&self.frames[frame]))?;
            }
        }
        Ok(())
    }

    /// The item at `index`, which must be below `len`.
    #[inline]
    pub(super) fn get(&mut self, index: u32) -> Result<T, CompileError> {
        let page = (index >> PAGE_SHIFT) as usize;
        let mut frame = self.frame_of[page];
        if frame == ABSENT {
            frame = self.fetch(page)?;
        }
        Ok(self.frames[frame as usize][index as usize % PAGE_ITEMS])
    }

    /// The item at `index` of an array that is resident.
    #[inline]
    pub(super) fn get_resident(&self, index: u32) -> T {
        let frame = self.frame_of[(index >> PAGE_SHIFT) as usize];
        self.frames[frame as usize][index as usize % PAGE_ITEMS]
    }

    /// Makes a frame for the page after the last, which is full (or there is none).
    fn open_page(&mut self) -> Result<(), CompileError> {
        let page = self.frame_of.len() as u32;
        let bytes = (PAGE_ITEMS * size_of::<T>()) as u64;
        let headroom = if self.frames.len() < FRAMES_MIN { 0 } else { self.headroom };
        let wanted = Bytes(bytes + headroom);
        let frame = if self.spill.is_none()
            && (self.place.budget.available() >= wanted || self.frames.len() < FRAMES_MIN)
        {
            self.reservations.push(self.place.budget.reserve(Bytes(bytes), "vertices")?);
            self.frames.push(Vec::with_capacity(PAGE_ITEMS));
            self.page_in.push(page);
            self.frames.len() - 1
        } else {
            if self.spill.is_none() {
                let mut spill = Spill::new(self.place.clone(), ".vertices", u64::MAX)?;
                // No page was evicted yet, so frames are in page order and all are full.
                for frame in &self.frames {
                    spill.append(bytemuck::cast_slice(frame))?;
                }
                self.spill = Some(spill);
            }
            self.take_frame(page)
        };
        self.frames[frame].clear();
        self.frame_of.push(frame as u32);
        Ok(())
    }

    /// Evicts the oldest page that is in the spill and gives its frame to `page`.
    fn take_frame(&mut self, page: u32) -> usize {
        let full_pages = self.len >> PAGE_SHIFT;
        loop {
            let frame = self.hand;
            self.hand = (self.hand + 1) % self.frames.len();
            let old = self.page_in[frame] as usize;
            // The page that is being filled is nowhere else.
            if old < full_pages {
                self.frame_of[old] = ABSENT;
                self.page_in[frame] = page;
                return frame;
            }
        }
    }

    #[cold]
    fn fetch(&mut self, page: usize) -> Result<u32, CompileError> {
        let frame = self.take_frame(page as u32);
        self.fetches += 1;
        let items = &mut self.frames[frame];
        let spill = self.spill.as_ref().expect("a page is absent only once there is a spill");
        items.resize(PAGE_ITEMS, T::zeroed());
        spill.read((page * PAGE_ITEMS * size_of::<T>()) as u64, bytemuck::cast_slice_mut(items))?;
        self.frame_of[page] = frame as u32;
        Ok(frame as u32)
    }
}
