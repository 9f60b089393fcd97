//! What the fuzz targets share.

use outcrop::block::checksum;
use outcrop::error::ImportError;
use outcrop::import::{ImportReport, MeshBuffer};

/// The length of the header of compiled files and of working files; its own checksum is its end.
pub const HEADER_BYTES: usize = 256;
const _: () = assert!(HEADER_BYTES == outcrop::model::HEADER_BYTES);

/// The number at `at` of a file as a size; one that nothing has if it is too large.
pub fn size_at(file: &[u8], at: usize) -> usize {
    let mut word = [0; 8];
    word.copy_from_slice(&file[at..at + 8]);
    usize::try_from(u64::from_le_bytes(word)).unwrap_or(usize::MAX)
}

/// Makes a checksum right. At `at` stand offset and length of a part of the file, and then its checksum; nothing is done for a
/// part that the file does not have.
pub fn seal_part(file: &mut [u8], at: usize) {
    let (offset, bytes) = (size_at(file, at), size_at(file, at + 8));
    if let Some(part) = file.get(offset..).and_then(|rest| rest.get(..bytes)) {
        let sum = checksum(part);
        file[at + 16..at + 24].copy_from_slice(&sum.to_le_bytes());
    }
}

/// Makes the checksums of the parts that a header of so many bytes names at `sections` right, and the header's own, which is its end.
pub fn seal(file: &mut [u8], header_bytes: usize, sections: &[usize]) {
    sections.iter().for_each(|section| seal_part(file, *section));
    let sum = checksum(&file[..header_bytes - 8]);
    file[header_bytes - 8..header_bytes].copy_from_slice(&sum.to_le_bytes());
}

/// Whatever is read must be an error or a mesh of the size that is reported.
pub fn check_import(read: impl FnOnce(&mut MeshBuffer) -> Result<ImportReport, ImportError>) {
    let mut mesh = MeshBuffer::new();
    if let Ok(report) = read(&mut mesh) {
        assert_eq!(report.vertices, mesh.vertices.len() as u64);
        assert_eq!(report.triangles, mesh.triangles.len() as u64);
    }
}
