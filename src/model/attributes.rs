//! The directory of the pages of attributes. Files whose models have none are as if there were no such thing.

use super::directory::Fields;
use crate::block::attributes::{
    PAGE_HEADER_BYTES, PAGE_TRIANGLES, PageCheck, page_bytes, stored_page_bytes_max,
};
use crate::units::{Bytes, TriangleId};

/// Bytes of an entry in the file.
pub(super) const PAGE_ENTRY_BYTES: usize = 24;

/// What the directory says about one page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PageEntry {
    /// Where the page starts in the file.
    pub offset: u64,
    /// XXH3-64 of its stored bytes; 0 if it has none.
    pub checksum: u64,
    /// Its length in the file; 0 if none of its triangles has an attribute.
    pub stored_bytes: u32,
    /// Distinct texture coordinates in it.
    pub uv_count: u16,
    /// Distinct normals in it.
    pub normal_count: u16,
}

/// The pages of attributes of a compiled file, by triangle id: entry `p` is about the ids from
/// `p * PAGE_TRIANGLES` on. Triangles behind the last page have none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AttributePages {
    entries: Vec<PageEntry>,
}

impl AttributePages {
    /// Whether no triangle has an attribute.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// All entries.
    pub fn entries(&self) -> &[PageEntry] {
        &self.entries
    }

    /// Whether any triangle has texture coordinates.
    pub fn have_uvs(&self) -> bool {
        self.entries.iter().any(|entry| entry.uv_count > 0)
    }

    /// Whether any triangle has normals.
    pub fn have_normals(&self) -> bool {
        self.entries.iter().any(|entry| entry.normal_count > 0)
    }

    /// The page with the attributes of `triangle`, and the triangle's number in it; `None` if the page holds none.
    pub fn place_of(&self, triangle: TriangleId) -> Option<(u32, usize)> {
        let page = usize::try_from(triangle.0 / PAGE_TRIANGLES as u64).ok()?;
        let entry = self.entries.get(page)?;
        // There are at most 2^32 - 1 pages.
        (entry.stored_bytes > 0).then(|| (page as u32, (triangle.0 % PAGE_TRIANGLES as u64) as usize))
    }

    /// Whether the corners of `triangle` may have normals: some triangle of its page has.
    pub fn may_have_normals(&self, triangle: TriangleId) -> bool {
        let page = usize::try_from(triangle.0 / PAGE_TRIANGLES as u64).ok();
        page.and_then(|page| self.entries.get(page)).is_some_and(|entry| entry.normal_count > 0)
    }

    /// What the directory promises about a page that holds something.
    pub fn check(&self, page: u32) -> Option<PageCheck> {
        let entry = self.entries.get(page as usize).filter(|entry| entry.stored_bytes > 0)?;
        let PageEntry { checksum, uv_count, normal_count, .. } = *entry;
        Some(PageCheck { page, checksum, uv_count, normal_count })
    }

    /// Memory of the largest decoded page.
    pub fn page_bytes_max(&self) -> Bytes {
        let sizes = self.entries.iter().map(|entry| page_bytes(entry.uv_count, entry.normal_count));
        Bytes(sizes.max().unwrap_or(0) as u64)
    }

    /// Length of the largest stored page.
    pub fn stored_bytes_max(&self) -> Bytes {
        Bytes(self.entries.iter().map(|entry| u64::from(entry.stored_bytes)).max().unwrap_or(0))
    }

    pub(super) fn resident_bytes(&self) -> u64 {
        (self.entries.capacity() * size_of::<PageEntry>()) as u64
    }

    pub(super) fn reserve(&mut self, count: usize) {
        self.entries.reserve_exact(count);
    }

    pub(super) fn push(&mut self, entry: PageEntry) {
        self.entries.push(entry);
    }

    /// Reads whole entries; pages follow each other without gaps from `next` on. Gives the end of the last one.
    pub(super) fn parse(&mut self, bytes: &[u8], mut next: u64) -> Result<u64, &'static str> {
        for bytes in bytes.as_chunks::<PAGE_ENTRY_BYTES>().0 {
            let entry = PageEntry::get(bytes);
            entry.fault(next)?;
            next += u64::from(entry.stored_bytes);
            self.entries.push(entry);
        }
        Ok(next)
    }
}

impl PageEntry {
    pub(super) fn put(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.offset.to_le_bytes());
        out.extend_from_slice(&self.checksum.to_le_bytes());
        out.extend_from_slice(&self.stored_bytes.to_le_bytes());
        out.extend_from_slice(&self.uv_count.to_le_bytes());
        out.extend_from_slice(&self.normal_count.to_le_bytes());
    }

    fn get(bytes: &[u8; PAGE_ENTRY_BYTES]) -> PageEntry {
        let mut fields = Fields(bytes);
        PageEntry {
            offset: fields.u64(),
            checksum: fields.u64(),
            stored_bytes: fields.u32(),
            uv_count: fields.u16(),
            normal_count: fields.u16(),
        }
    }

    /// Why the entry cannot be right, if it cannot.
    fn fault(&self, offset: u64) -> Result<(), &'static str> {
        let require = |holds: bool, reason| if holds { Ok(()) } else { Err(reason) };
        let corners_max = 3 * PAGE_TRIANGLES;
        let most = usize::from(self.uv_count.max(self.normal_count));
        require(self.offset == offset, "a page does not start where the one before it ends")?;
        require(most <= corners_max, "a page has more attributes than corners")?;
        if most == 0 {
            return require(
                (self.stored_bytes, self.checksum) == (0, 0),
                "a page without attributes has bytes",
            );
        }
        let lengths = PAGE_HEADER_BYTES..=stored_page_bytes_max();
        require(lengths.contains(&(self.stored_bytes as usize)), "a page has an impossible length")
    }
}
