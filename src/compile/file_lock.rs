//! Files that one process at a time works on.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::Path;
use std::thread;
use std::time::Duration;

/// How often a file that is taken away between opening and locking is opened again.
const ATTEMPTS_MAX: u32 = 100;

/// Opens the file at `path` for reading and writing, makes it if it is not there, and locks it until it is closed; the system lets go of
/// the lock when the process ends, however that happens. `None` if the lock is held already. Where the file system has no locks the file
/// is opened without one: then it is for the user to keep runs apart, as with most programs.
///
/// # Errors
/// What the system says, and [`io::ErrorKind::ResourceBusy`] if the name stands for another file each time.
pub(crate) fn open_locked(path: &Path) -> io::Result<Option<File>> {
    for _ in 0..ATTEMPTS_MAX {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        match for_a_while(|| file.try_lock()) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(error)) if is_without_locks(&error) => {}
            Err(TryLockError::Error(error)) => return Err(error),
        }
        // Between open and lock its owner may have renamed or removed it.
        if same_file(&file, path)? {
            return Ok(Some(file));
        }
    }
    let reason = "another process replaces the file again and again";
    Err(io::Error::new(io::ErrorKind::ResourceBusy, reason))
}

/// The lock, or that it is held after an eighth of a second, too. A program that another thread just starts holds all locks of its
/// parent until it runs, also those that are let go meanwhile.
fn for_a_while(mut try_lock: impl FnMut() -> Result<(), TryLockError>) -> Result<(), TryLockError> {
    for doubling in 0..7 {
        match try_lock() {
            Err(TryLockError::WouldBlock) => thread::sleep(Duration::from_millis(1 << doubling)),
            other => return other,
        }
    }
    try_lock()
}

/// Whether the file system has no locks, or, mounted from another machine, cannot ask for them now.
fn is_without_locks(error: &io::Error) -> bool {
    #[cfg(unix)]
    if error.raw_os_error() == Some(libc::ENOLCK) {
        return true;
    }
    error.kind() == io::ErrorKind::Unsupported
}

/// Whether `path` still names the open `file`.
#[cfg(unix)]
pub(super) fn same_file(file: &File, path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt;
    let open = file.metadata()?;
    match fs::metadata(path) {
        Ok(named) => Ok((open.dev(), open.ino()) == (named.dev(), named.ino())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

/// Whether `path` still names the open `file`.
#[cfg(not(unix))]
pub(super) fn same_file(_file: &File, _path: &Path) -> io::Result<bool> {
    // An open file can neither be renamed nor removed by others there.
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_at_a_time_has_the_file_that_the_name_stands_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let first = open_locked(&path).unwrap().expect("nobody has it");
        assert!(open_locked(&path).unwrap().is_none());
        // Who holds a file without a name is in nobody's way.
        fs::remove_file(&path).unwrap();
        let second = open_locked(&path).unwrap().expect("another file");
        assert!(!same_file(&first, &path).unwrap() && same_file(&second, &path).unwrap());
        drop(second);
        assert!(open_locked(&path).unwrap().is_some());
    }

    #[test]
    fn a_lock_that_is_let_go_soon_is_waited_for() {
        let after = |tries: u32| {
            let mut left = tries;
            for_a_while(|| {
                left = left.saturating_sub(1);
                if left == 0 { Ok(()) } else { Err(TryLockError::WouldBlock) }
            })
        };
        assert!(after(1).is_ok() && after(3).is_ok());
        assert!(matches!(after(1000), Err(TryLockError::WouldBlock)));
    }

    #[test]
    #[cfg(unix)]
    fn a_file_system_without_locks_is_told_from_trouble() {
        assert!(is_without_locks(&io::Error::from_raw_os_error(libc::ENOLCK)));
        assert!(is_without_locks(&io::Error::from_raw_os_error(libc::EOPNOTSUPP)));
        assert!(!is_without_locks(&io::Error::from_raw_os_error(libc::EIO)));
    }
}
