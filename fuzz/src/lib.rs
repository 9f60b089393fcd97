//! What the fuzz targets share.

use std::io::Write;
use std::path::Path;

/// Calls `test` with a temporary file of that extension and content, for readers that take a path.
pub fn with_file<T>(extension: &str, content: &[u8], test: impl FnOnce(&Path) -> T) -> T {
    let mut file = tempfile::Builder::new()
        .suffix(&format!(".{extension}"))
        .tempfile()
        .expect("the folder for temporary files can be written");
    file.write_all(content).expect("the folder for temporary files has room");
    test(file.path())
}
