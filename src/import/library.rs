//! The materials that a model names, and which of them the sink has.

use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};

use super::feed::Feed;
use super::mtl;
use super::report::{ImportOptions, ImportReport};
use super::text::{shown, words};
use crate::error::ImportError;
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// Materials that are kept from libraries; a compiled file can hold no more.
const MATERIALS_MAX: usize = 1 << 16;

/// Libraries that a model may name.
const LIBRARIES_MAX: usize = 256;

/// Materials by name and by index. One goes to the sink when a face first uses it, so that a library larger than
/// the model costs nothing.
pub(super) struct Materials<'a> {
    /// The model file: libraries are looked for beside it.
    model: &'a Path,
    /// Whether the caller named a library, which takes the place of those that the model names.
    replaced: bool,
    entries: Vec<Entry>,
    by_name: HashMap<String, usize>,
}

struct Entry {
    record: MaterialRecord,
    id: Option<MaterialId>,
}

impl<'a> Materials<'a> {
    /// No materials, or those of the library that the options name.
    pub(super) fn new(
        model: &'a Path,
        options: &ImportOptions,
        report: &mut ImportReport,
    ) -> Result<Materials<'a>, ImportError> {
        let mut materials =
            Materials { model, replaced: false, entries: Vec::new(), by_name: HashMap::new() };
        if let Some(path) = &options.materials {
            materials.replaced = true;
            materials.load(path, report).map_err(|error| ImportError::Io { path: path.clone(), error })?;
        }
        Ok(materials)
    }

    /// Loads the libraries that the model names in one line. What is missing becomes a warning.
    pub(super) fn load_named(&mut self, names: &[u8], line: Option<u64>, report: &mut ImportReport) {
        if self.replaced {
            return;
        }
        for name in split_names(names, &|name| self.find(name).is_some()) {
            let Some(path) = self.find(name) else {
                let text = format!("the material library `{}` is not there", shown(name));
                report.warn(self.model, line, text);
                continue;
            };
            if report.material_files.contains(&path) {
                continue;
            }
            if report.material_files.len() == LIBRARIES_MAX {
                report.warn(self.model, line, "too many material libraries; this one is left out");
                continue;
            }
            if let Err(error) = self.load(&path, report) {
                report.warn(&path, None, format!("cannot read the material library: {error}"));
            }
        }
    }

    /// Loads a library. A name that is there already gets the new meaning.
    fn load(&mut self, path: &Path, report: &mut ImportReport) -> io::Result<()> {
        report.material_files.push(path.to_path_buf());
        let mut full = false;
        mtl::read(path, report, &mut |record| {
            full = self.entries.len() == MATERIALS_MAX;
            if !full {
                self.by_name.insert(record.name.clone(), self.entries.len());
                self.entries.push(Entry { record, id: None });
            }
            !full
        })?;
        if full {
            report.warn(path, None, format!("more than {MATERIALS_MAX} materials; the rest is left out"));
        }
        Ok(())
    }

    /// The file that a library name means, if it is there.
    fn find(&self, name: &[u8]) -> Option<PathBuf> {
        library_paths(self.model, name).into_iter().find(|path| path.is_file())
    }

    /// Materials known so far.
    pub(super) fn count(&self) -> usize {
        self.entries.len()
    }

    /// The library's only material, for models whose faces name none; with a warning, the default one if the caller
    /// named a library that holds several.
    pub(super) fn only(&mut self, feed: &mut Feed<'_>) -> Result<Option<MaterialId>, ImportError> {
        match self.entries.len() {
            0 => Ok(None),
            1 => self.indexed(0, feed).map(Some),
            count => {
                let text =
                    format!("faces name no materials and the library has {count}; the default one is used");
                feed.report.warn(self.model, None, text);
                Ok(None)
            }
        }
    }

    /// The material of that name, for `usemtl`; with a warning, the default one if there is none.
    pub(super) fn named(
        &mut self,
        name: &[u8],
        line: u64,
        feed: &mut Feed<'_>,
    ) -> Result<Option<MaterialId>, ImportError> {
        let name = name.trim_ascii();
        let text = String::from_utf8_lossy(name);
        match self.by_name.get(text.as_ref()) {
            Some(index) => self.indexed(*index, feed).map(Some),
            None => {
                let text = format!("the material `{}` is not defined; the default one is used", shown(name));
                feed.report.warn_once(self.model, Some(line), text);
                Ok(None)
            }
        }
    }

    /// The material of that index, less than `count()`.
    pub(super) fn indexed(&mut self, index: usize, feed: &mut Feed<'_>) -> Result<MaterialId, ImportError> {
        let entry = &mut self.entries[index];
        match entry.id {
            Some(id) => Ok(id),
            None => {
                let id = feed.add_material(entry.record.clone())?;
                entry.id = Some(id);
                Ok(id)
            }
        }
    }
}

/// Splits the names of a `mtllib` line. Names may hold blanks, so the longest run of words that is a file counts as
/// one name.
pub(super) fn split_names<'t>(names: &'t [u8], exists: &dyn Fn(&[u8]) -> bool) -> Vec<&'t [u8]> {
    const WORDS_MAX: usize = 64;
    let mut found = Vec::new();
    let mut rest = names.trim_ascii();
    while !rest.is_empty() && found.len() < WORDS_MAX {
        let ends = words(rest).take(WORDS_MAX).map(|word| {
            // Every word is a part of `rest`.
            word.as_ptr() as usize - rest.as_ptr() as usize + word.len()
        });
        let ends: Vec<usize> = ends.collect();
        let end = ends.iter().rev().find(|end| exists(&rest[..**end])).or(ends.first());
        let Some(end) = end else { break };
        found.push(&rest[..*end]);
        rest = rest[*end..].trim_ascii_start();
    }
    found
}

/// Where a library of that name may be: beside the model, under the name as it is, with `\` for `/`, and with
/// folders dropped (files move from machine to machine with absolute paths in them).
pub(super) fn library_paths(model: &Path, name: &[u8]) -> Vec<PathBuf> {
    let folder = model.parent().unwrap_or(Path::new(""));
    let name = name.strip_prefix(b"\"").and_then(|name| name.strip_suffix(b"\"")).unwrap_or(name);
    let slashes: Vec<u8> = name.iter().map(|byte| if *byte == b'\\' { b'/' } else { *byte }).collect();
    let last = slashes.rsplit(|byte| *byte == b'/').next().unwrap_or_default();
    let mut paths = vec![folder.join(path_of(name))];
    for other in [slashes.as_slice(), last] {
        let path = folder.join(path_of(other));
        if !paths.contains(&path) {
            paths.push(path);
        }
    }
    paths
}

/// A path of bytes that may have any encoding.
#[cfg(unix)]
fn path_of(name: &[u8]) -> PathBuf {
    use std::os::unix::ffi::OsStrExt;
    PathBuf::from(std::ffi::OsStr::from_bytes(name))
}

/// A path of bytes that may have any encoding; as Unicode, since nothing better is known.
#[cfg(not(unix))]
fn path_of(name: &[u8]) -> PathBuf {
    PathBuf::from(String::from_utf8_lossy(name).into_owned())
}
