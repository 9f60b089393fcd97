//! A file that appears under its name only when it is whole.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Calls `fill` on a new file beside `path` and gives it that name when `fill` is done. On failure the new file is
/// removed and whatever stood at `path` stays. A link stays, too: what it names is replaced. What is there and no file, as a pipe or
/// a device, is written to.
pub(super) fn atomically(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let path = &fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    if fs::metadata(path).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir()) {
        let mut file = BufWriter::new(File::create(path)?);
        fill(&mut file)?;
        return file.flush();
    }
    let name = path.file_name().ok_or_else(|| io::Error::other("the path names no file"))?;
    let mut temporary_name = std::ffi::OsString::from(".");
    temporary_name.push(name);
    temporary_name.push(format!(".{}.tmp", std::process::id()));
    let temporary = Temporary(path.with_file_name(temporary_name));
    let mut file = BufWriter::new(File::create(&temporary.0)?);
    fill(&mut file)?;
    file.flush()?;
    file.get_ref().sync_all()?;
    drop(file);
    fs::rename(&temporary.0, path)
}

/// Removes the file on drop; after the rename there is nothing left to remove.
struct Temporary(PathBuf);

impl Drop for Temporary {
    fn drop(&mut self) {
        // A drop can report no error, and an error is on its way already if the file still exists.
        let _ = fs::remove_file(&self.0);
    }
}
