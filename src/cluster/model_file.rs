//! The whole compiled file as readers serve it: blocks, and the bytes around them.

use std::io;
use std::sync::Arc;

use crate::block::checksum;
use crate::model::Model;
use crate::source::{BlockSource, DiskSource, MemorySource};

/// A source that can also give any bytes of the compiled file.
pub trait ModelFile: BlockSource {
    /// Length of the file.
    ///
    /// # Errors
    /// The operating system's.
    fn file_bytes(&self) -> io::Result<u64>;

    /// Fills `into` with the bytes from `offset` on.
    ///
    /// # Errors
    /// The operating system's; `UnexpectedEof` beyond the end.
    fn read_range(&self, offset: u64, into: &mut [u8]) -> io::Result<()>;
}

impl ModelFile for DiskSource {
    fn file_bytes(&self) -> io::Result<u64> {
        DiskSource::file_bytes(self)
    }

    fn read_range(&self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        DiskSource::read_range(self, offset, into)
    }
}

impl ModelFile for MemorySource {
    fn file_bytes(&self) -> io::Result<u64> {
        Ok(self.bytes().len() as u64)
    }

    fn read_range(&self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        let start = usize::try_from(offset).ok();
        let range = start.and_then(|start| self.bytes().get(start..)?.get(..into.len()));
        into.copy_from_slice(range.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }
}

impl<S: ModelFile> ModelFile for Arc<S>
where
    Arc<S>: BlockSource,
{
    fn file_bytes(&self) -> io::Result<u64> {
        (**self).file_bytes()
    }

    fn read_range(&self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        (**self).read_range(offset, into)
    }
}

/// A number that two models share only if their triangles, blocks and materials are the same (up to accidents of a 64-bit hash):
/// what nodes compare before they work on one picture.
pub fn model_key(model: &Model) -> u64 {
    let mut bytes = Vec::with_capacity(16 * model.blocks.len() + 1024);
    for block in &model.blocks {
        bytes.extend_from_slice(&block.checksum.to_le_bytes());
        bytes.extend_from_slice(&block.offset.to_le_bytes());
    }
    for page in model.attributes.entries() {
        bytes.extend_from_slice(&page.checksum.to_le_bytes());
    }
    // The shortest decimal numbers that read back as the same bits.
    bytes.extend_from_slice(format!("{:?} {:?}", model.precision, model.materials).as_bytes());
    checksum(&bytes)
}

/// In which order a block is asked of `count` readers: first of the one that holds it in memory, by its number, so that shares are equal;
/// if that one is gone, the others, so that they share its part equally.
pub fn readers_of(block: u32, count: usize) -> impl Iterator<Item = usize> {
    let block = block as usize;
    let owner = block.checked_rem(count).unwrap_or(0);
    let others = count.saturating_sub(1);
    let turn = (block / count.max(1)).checked_rem(others).unwrap_or(0);
    (0..count)
        .take(1)
        .map(move |_| owner)
        .chain((0..others).map(move |k| (owner + 1 + (turn + k) % others) % count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_equal_also_when_a_reader_is_gone() {
        for count in 0..6usize {
            for block in 0..100 {
                let mut order: Vec<usize> = readers_of(block, count).collect();
                order.sort_unstable();
                assert_eq!(order, (0..count).collect::<Vec<_>>());
            }
        }
        for gone in 0..4 {
            let mut shares = [0; 4];
            for block in 0..1200 {
                let first = readers_of(block, 4).find(|reader| *reader != gone).unwrap();
                shares[first] += 1;
            }
            let mut expected = [400; 4];
            expected[gone] = 0;
            assert_eq!(shares, expected);
        }
    }
}
