//! A file that appears under its name only when it is whole.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::compile::{TemporaryFile, WriteError};

/// Calls `fill` on a new file beside `path` and gives it that name when `fill` is done. On failure the new file is
/// removed and whatever stood at `path` stays. A link stays, too: what it names is replaced. A pipe or a device is none to be replaced,
/// and refused.
pub(super) fn atomically(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>,
) -> io::Result<()> {
    if path.file_name().is_none() {
        return Err(io::Error::other("the path names no file"));
    }
    let place = place_of(path);
    if fs::metadata(&place).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir()) {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is a pipe or a device; name a file"));
    }
    let cause = |WriteError { error, .. }| error;
    let temporary = TemporaryFile::beside(&place, ".unfinished").map_err(cause)?;
    let mut file = BufWriter::new(temporary.file());
    fill(&mut file)?;
    file.flush()?;
    drop(file);
    temporary.publish(&place).map_err(cause)
}

/// Where the file is, or is to be, whatever links lead there.
fn place_of(path: &Path) -> PathBuf {
    // A link to nothing says where the file is to be.
    let place = fs::canonicalize(path).or_else(|_| fs::read_link(path).map(|to| path.with_file_name(to)));
    place.unwrap_or_else(|_| path.to_path_buf())
}
