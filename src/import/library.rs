//! The materials that a model names, and which of them the sink has.

use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};

use super::feed::Feed;
use super::mtl;
use super::report::{ImportOptions, ImportReport};
use super::text::{self, is_blank, shown, trimmed};
use crate::error::ImportError;
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// Materials that are kept from libraries: what a compiled file can hold, less the default one.
const MATERIALS_MAX: usize = (1 << 16) - 1;

/// Bytes of their names that are kept.
const NAME_BYTES_MAX: usize = 4 << 20;

/// Libraries that a model may name.
const LIBRARIES_MAX: usize = 256;

/// Materials by name and by index, in the order of their libraries. All go to the sink, so that their order there
/// is that of the library too.
pub(super) struct Materials<'a> {
    /// The model file: libraries are looked for beside it.
    model: &'a Path,
    /// Whether the caller named a library, which takes the place of those that the model names.
    replaced: bool,
    /// Whether pictures of materials are wanted.
    with_images: bool,
    ids: Vec<MaterialId>,
    by_name: HashMap<String, MaterialId>,
    name_bytes: usize,
}

impl<'a> Materials<'a> {
    /// No materials, or those of the library that the options name.
    pub(super) fn new(
        model: &'a Path,
        options: &ImportOptions,
        feed: &mut Feed<'_>,
    ) -> Result<Materials<'a>, ImportError> {
        let mut materials = Materials {
            model,
            replaced: false,
            with_images: feed.takes_attributes(),
            ids: Vec::new(),
            by_name: HashMap::new(),
            name_bytes: 0,
        };
        if let Some(path) = &options.materials {
            materials.replaced = true;
            let records = materials.read(path, &mut feed.report);
            let records = records.map_err(|error| ImportError::Io { path: path.clone(), error })?;
            materials.add(records, feed)?;
        }
        Ok(materials)
    }

    /// Loads the libraries that the model names in one line. What is missing becomes a warning.
    pub(super) fn load_named(
        &mut self,
        names: &[u8],
        line: Option<u64>,
        feed: &mut Feed<'_>,
    ) -> Result<(), ImportError> {
        if self.replaced {
            return Ok(());
        }
        for (name, path) in libraries(self.model, names) {
            let report = &mut feed.report;
            let Some(path) = path else {
                let text = format!("the material library `{}` is not there", shown(name));
                report.warn(self.model, line, text);
                continue;
            };
            if report.material_files.contains(&path) {
                continue;
            }
            if report.material_files.len() == LIBRARIES_MAX {
                report.warn_once(
                    self.model,
                    line,
                    "too many material libraries; the rest is left out".into(),
                );
                continue;
            }
            match self.read(&path, report) {
                Ok(records) => self.add(records, feed)?,
                Err(error) => report.warn(&path, None, format!("cannot read the material library: {error}")),
            }
        }
        Ok(())
    }

    /// Reads a library.
    fn read(&mut self, path: &Path, report: &mut ImportReport) -> io::Result<Vec<MaterialRecord>> {
        report.material_files.push(path.to_path_buf());
        let mut records = Vec::new();
        let mut full = false;
        let images = self.with_images.then(|| self.model.parent().unwrap_or(Path::new("")));
        mtl::read(path, images, report, &mut |record| {
            self.name_bytes += record.name.len();
            full = self.ids.len() + records.len() == MATERIALS_MAX || self.name_bytes > NAME_BYTES_MAX;
            if !full {
                records.push(record);
            }
            !full
        })?;
        if full {
            report.warn(path, None, format!("{} materials are enough; the rest is left out", self.ids.len()));
        }
        Ok(records)
    }

    /// Sends materials to the sink. A name that is there already gets the new meaning.
    fn add(&mut self, records: Vec<MaterialRecord>, feed: &mut Feed<'_>) -> Result<(), ImportError> {
        for record in records {
            let name = record.name.clone();
            let id = feed.add_material(record)?;
            self.ids.push(id);
            self.by_name.insert(name, id);
        }
        Ok(())
    }

    /// The model file.
    pub(super) fn model(&self) -> &'a Path {
        self.model
    }

    /// Materials in the order of their libraries.
    pub(super) fn ids(&self) -> &[MaterialId] {
        &self.ids
    }

    /// The library's only material, for models whose faces name none; with a warning, the default one if the caller
    /// named a library that holds several.
    pub(super) fn only(&self, feed: &mut Feed<'_>) -> Option<MaterialId> {
        match self.ids.as_slice() {
            [] => None,
            [id] => Some(*id),
            ids => {
                let count = ids.len();
                let text =
                    format!("faces name no materials and the library has {count}; the default one is used");
                feed.report.warn_once(self.model, None, text);
                None
            }
        }
    }

    /// The material of that name, for `usemtl`; with a warning, the default one if there is none.
    pub(super) fn named(&self, name: &[u8], line: u64, feed: &mut Feed<'_>) -> Option<MaterialId> {
        let name = trimmed(name);
        let id = self.by_name.get(&text::name(name)).copied();
        if id.is_none() {
            let text = format!("the material `{}` is not defined; the default one is used", shown(name));
            feed.report.warn_once(self.model, Some(line), text);
        }
        id
    }
}

/// The names in a `mtllib` line, with their files where these are there. Names may hold blanks, so the longest run of
/// words that is a file counts as one name.
pub(super) fn libraries<'t>(model: &Path, names: &'t [u8]) -> Vec<(&'t [u8], Option<PathBuf>)> {
    const WORDS_MAX: usize = 64;
    let find = |name: &[u8]| candidates(model, name).into_iter().find(|path| path.is_file());
    let mut found = Vec::new();
    let mut rest = trimmed(names);
    while !rest.is_empty() && found.len() < WORDS_MAX {
        let blank = |index: &usize| rest.get(*index).is_none_or(is_blank);
        let ends: Vec<usize> =
            (1..=rest.len()).filter(|end| blank(end) && !blank(&(end - 1))).take(WORDS_MAX).collect();
        let longest = ends.iter().rev().find_map(|end| Some((*end, find(&rest[..*end])?)));
        let (end, path) = match longest {
            Some((end, path)) => (end, Some(path)),
            // There is a first word, since `rest` is trimmed and not empty.
            None => (ends[0], None),
        };
        found.push((&rest[..end], path));
        rest = trimmed(&rest[end..]);
    }
    found
}

/// Where a library of that name may be: beside the model, under the name as it is, with `\` for `/`, and with
/// folders dropped (files move from machine to machine with absolute paths in them).
pub(super) fn candidates(model: &Path, name: &[u8]) -> Vec<PathBuf> {
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
