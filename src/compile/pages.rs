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
/// Frames in one piece of memory: so many that corners of a triangle are nearly always in one.
const AREA_FRAMES: usize = 32;
const AREA_ITEMS: usize = AREA_FRAMES * PAGE_ITEMS;
const AREA_SHIFT: u32 = AREA_ITEMS.trailing_zeros();
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
    frame_count: usize,
    /// Memory of [`AREA_FRAMES`] frames each, which the system gives when it is touched.
    areas: Vec<Vec<T>>,
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
            frame_count: 0,
            areas: Vec::new(),
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
        if self.spill.is_none() || self.frame_count <= FRAMES_MIN {
            return;
        }
        let full_pages = self.len >> PAGE_SHIFT;
        // The page that is in no other place comes first and stays.
        let last = self.page_in.iter().position(|page| *page as usize >= full_pages).unwrap_or(0);
        // Copied, so that all of the old memory is given back.
        let mut kept = vec![T::zeroed(); AREA_ITEMS];
        for frame in 0..FRAMES_MIN {
            let from = match frame {
                0 => last,
                frame if frame == last => 0,
                frame => frame,
            };
            kept[frame * PAGE_ITEMS..][..PAGE_ITEMS].copy_from_slice(self.frame(from));
        }
        self.page_in.swap(0, last);
        self.areas = vec![kept];
        self.frame_count = FRAMES_MIN;
        self.page_in.truncate(FRAMES_MIN);
        self.reservations.truncate(FRAMES_MIN);
        self.hand = 0;
        self.frame_of.fill(ABSENT);
        for (frame, page) in (0..).zip(&self.page_in) {
            self.frame_of[*page as usize] = frame;
        }
    }

    /// Gives back as much memory as is missing for `headroom` bytes of the budget to be free, in whole areas. Only once there is a
    /// spill, and not the least that works.
    pub(super) fn leave(&mut self, headroom: u64) {
        let missing = headroom.saturating_sub(self.place.budget.available().0);
        if missing == 0 || self.spill.is_none() {
            return;
        }
        let frames_missing = missing.div_ceil((PAGE_ITEMS * size_of::<T>()) as u64) as usize;
        let areas = self.frame_count.saturating_sub(frames_missing) / AREA_FRAMES;
        if areas == 0 {
            return self.shrink();
        }
        let frames = areas * AREA_FRAMES;
        let full_pages = self.len >> PAGE_SHIFT;
        // The page that is in no other place stays.
        let last = self.page_in.iter().position(|page| *page as usize >= full_pages).unwrap_or(0);
        if last >= frames {
            let (kept, given_back) = self.areas.split_at_mut(areas);
            let from =
                &given_back[last / AREA_FRAMES - areas][last % AREA_FRAMES * PAGE_ITEMS..][..PAGE_ITEMS];
            kept[0][..PAGE_ITEMS].copy_from_slice(from);
            self.page_in.swap(0, last);
        }
        self.areas.truncate(areas);
        self.frame_count = frames;
        self.reservations.truncate(frames);
        self.hand %= frames;
        for page in self.page_in.drain(frames..) {
            self.frame_of[page as usize] = ABSENT;
        }
        for (frame, page) in (0..).zip(&self.page_in) {
            self.frame_of[*page as usize] = frame;
        }
    }

    /// What the frames hold of the budget.
    pub(super) fn memory_bytes(&self) -> u64 {
        (self.frame_count * PAGE_ITEMS * size_of::<T>()) as u64
    }

    /// The items of a frame, whether or not they were appended yet.
    fn frame(&self, frame: usize) -> &[T] {
        &self.areas[frame / AREA_FRAMES][frame % AREA_FRAMES * PAGE_ITEMS..][..PAGE_ITEMS]
    }

    fn frame_mut(&mut self, frame: usize) -> &mut [T] {
        &mut self.areas[frame / AREA_FRAMES][frame % AREA_FRAMES * PAGE_ITEMS..][..PAGE_ITEMS]
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
            let start = self.len % PAGE_ITEMS;
            let into = &mut self.frame_mut(frame)[start..start + count];
            for (into, item) in into.iter_mut().zip(items) {
                *into = convert(*item);
            }
            self.len += count;
            items = &items[count..];
            if self.len.is_multiple_of(PAGE_ITEMS)
                && let Some(mut spill) = self.spill.take()
            {
                let appended = spill.append(bytemuck::cast_slice(self.frame(frame)));
                self.spill = Some(spill);
                appended?;
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
        Ok(self.frame(frame as usize)[index as usize % PAGE_ITEMS])
    }

    /// The item at `index` of an array that is resident.
    pub(super) fn get_resident(&self, index: u32) -> T {
        // No page was evicted yet, so frames are in the order of pages.
        self.areas[(index >> AREA_SHIFT) as usize][index as usize % AREA_ITEMS]
    }

    /// An array that is resident, for reading many.
    pub(super) fn resident(&self) -> ResidentPages<'_, T> {
        ResidentPages(&self.areas)
    }

    /// Makes a frame for the page after the last, which is full (or there is none).
    fn open_page(&mut self) -> Result<(), CompileError> {
        let page = self.frame_of.len() as u32;
        let bytes = (PAGE_ITEMS * size_of::<T>()) as u64;
        let headroom = if self.frame_count < FRAMES_MIN { 0 } else { self.headroom };
        let wanted = Bytes(bytes + headroom);
        let frame = if self.spill.is_none()
            && (self.place.budget.available() >= wanted || self.frame_count < FRAMES_MIN)
        {
            self.reservations.push(self.place.budget.reserve(Bytes(bytes), "vertices")?);
            if self.frame_count.is_multiple_of(AREA_FRAMES) {
                self.areas.push(vec![T::zeroed(); AREA_ITEMS]);
            }
            self.page_in.push(page);
            self.frame_count += 1;
            self.frame_count - 1
        } else {
            if self.spill.is_none() {
                let mut spill = Spill::new(self.place.clone(), ".vertices", u64::MAX)?;
                // No page was evicted yet, so frames are in page order and all are full.
                for frame in 0..self.frame_count {
                    spill.append(bytemuck::cast_slice(self.frame(frame)))?;
                }
                self.spill = Some(spill);
            }
            self.take_frame(page)
        };
        self.frame_of.push(frame as u32);
        Ok(())
    }

    /// Evicts the oldest page that is in the spill and gives its frame to `page`.
    fn take_frame(&mut self, page: u32) -> usize {
        let full_pages = self.len >> PAGE_SHIFT;
        loop {
            let frame = self.hand;
            self.hand = (self.hand + 1) % self.frame_count;
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
        let spill = self.spill.take().expect("a page is absent only once there is a spill");
        let offset = (page * PAGE_ITEMS * size_of::<T>()) as u64;
        let read = spill.read(offset, bytemuck::cast_slice_mut(self.frame_mut(frame)));
        self.spill = Some(spill);
        read?;
        self.frame_of[page] = frame as u32;
        Ok(frame as u32)
    }
}

/// The items of [`Pages`] that are all in memory.
pub(super) struct ResidentPages<'a, T>(&'a [Vec<T>]);

impl<T: Pod> ResidentPages<'_, T> {
    /// The item at `index`.
    #[inline(always)]
    pub(super) fn get(&self, index: u32) -> T {
        self.0[(index >> AREA_SHIFT) as usize][index as usize % AREA_ITEMS]
    }

    /// The items at three indices.
    #[inline(always)]
    pub(super) fn get_three(&self, indices: [u32; 3]) -> [T; 3] {
        let [a, b, c] = indices;
        if ((a ^ b) | (a ^ c)) >> AREA_SHIFT == 0 {
            // As in nearly all triangles.
            let items = &self.0[(a >> AREA_SHIFT) as usize][..];
            let at = |index: u32| items[index as usize % AREA_ITEMS];
            return [at(a), at(b), at(c)];
        }
        [self.get(a), self.get(b), self.get(c)]
    }
}

#[cfg(test)]
mod tests {
    use super::super::temporary::DiskQuota;
    use super::*;
    use crate::budget::MemoryBudget;

    #[test]
    fn what_others_need_is_given_back_and_nothing_is_lost() {
        let page_bytes = (PAGE_ITEMS * size_of::<[f32; 3]>()) as u64;
        // The last page is not full; it may be in any frame.
        for pages in [100_u32, 171, 200, 231, 260] {
            for free_pages in [10, 40, 90, 1000] {
                let budget = MemoryBudget::new(Bytes(100 * page_bytes + (4 << 20)));
                let place = SpillPlace {
                    dir: std::env::temp_dir(),
                    name: "pages-test".into(),
                    quota: DiskQuota::new(None),
                    budget: budget.clone(),
                };
                let mut list = Pages::<[f32; 3]>::new(place, 2 << 20);
                let count = pages * PAGE_ITEMS as u32 - 100;
                let indices: Vec<u32> = (0..count).collect();
                for batch in indices.chunks(1000) {
                    list.extend(batch, |index| [index as f32, -1.0, 0.5]).unwrap();
                }
                let held = list.memory_bytes();
                let headroom = free_pages * page_bytes;
                list.leave(headroom);
                let is_least = list.frame_count <= FRAMES_MIN;
                assert!(list.is_resident() || is_least || budget.available().0 >= headroom);
                assert!(
                    list.is_resident() || free_pages < 40 || list.memory_bytes() < held,
                    "{pages} {free_pages}"
                );
                // To the end of the page that is not full, and into the next.
                let more: Vec<u32> = (count..count + 150).collect();
                list.extend(&more, |index| [index as f32, -1.0, 0.5]).unwrap();
                // Every page, in an order that is not theirs, three times.
                for step in 0..3 * pages {
                    let index = (step * 37 % pages * PAGE_ITEMS as u32 + step * 101 % 4096).min(count);
                    assert_eq!(list.get(index).unwrap()[0], index as f32);
                }
                for index in more {
                    assert_eq!(list.get(index).unwrap()[0], index as f32);
                }
            }
        }
    }
}
