//! The files that are read and written, checked before any work: a picture can take hours, and no file may be lost.

use std::error::Error;
use std::fmt::{self, Display, Formatter};
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use outcrop::MemoryBudget;
use outcrop::compile::LazyModel;
use outcrop::error::{ModelError, SourceError};
use outcrop::import::GltfPart;
use outcrop::model::MaterialRecord;
use outcrop::source::{DiskSource, PageCache};
use outcrop::texture::{ImageKey, Textures};
use outcrop::units::Bytes;

use crate::common::place::place_of;
use crate::compiled;
use crate::options::Options;

/// What is done with a file.
#[derive(Clone, Copy, PartialEq)]
enum Role {
    Read,
    /// Replaced when it is complete.
    Picture,
    /// Written in place.
    Report,
    /// A compiled file, or one that is kept beside it; `chosen` if the command line names it.
    Compiled {
        chosen: bool,
    },
}

struct Named {
    /// The option, or what else the message calls it.
    what: &'static str,
    path: PathBuf,
    role: Role,
    /// Kept beside a compiled file, and emptied if it is not what it should be.
    is_beside: bool,
}

impl Named {
    fn new(what: &'static str, path: impl Into<PathBuf>, role: Role) -> Named {
        Named { what, path: path.into(), role, is_beside: false }
    }
}

/// One file has two names on the command line. Nothing may be written then, not even what a failed run writes.
#[derive(Debug)]
pub struct WouldOverwrite(String);

impl Display for WouldOverwrite {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl Error for WouldOverwrite {}

/// Refuses what would lose a file, and what could not be written in the end.
pub fn check(options: &Options) -> Result<(), Box<dyn Error>> {
    let inputs = inputs(options);
    for input in &inputs {
        refuse_irregular(&input.path)?;
    }
    let compiled = match (&options.scene, &options.model) {
        (Some(scene), _) => {
            scene.models.iter().flat_map(|model| compiled_files(options, &model.file)).collect()
        }
        (None, Some(model)) => compiled_files(options, model),
        (None, None) => with_working_file(options, compiled::file_of_gears(options)),
    };
    let outputs = outputs(options);
    for output in &outputs {
        refuse_unwritable(output)?;
    }
    let sky = options.scene.as_ref().and_then(|scene| scene.environment_file());
    let sky = sky.map(|path| Named::new("the picture of the environment", path, Role::Read));
    // Before the compiled file's place is looked at: nobody should be told to remove the model from there.
    let files: Vec<Named> = inputs.into_iter().chain(sky).chain(outputs).chain(compiled).collect();
    refuse_overlaps(&files)?;
    check_compiled(&files)
}

/// [`check`] for the compiled files of the parts of a scene, which are known once its glTF file is read.
pub fn check_parts(options: &Options, parts: &[(PathBuf, GltfPart)]) -> Result<(), Box<dyn Error>> {
    let of_part = |(model, part): &(PathBuf, GltfPart)| match part {
        GltfPart::Scene => compiled_files(options, model),
        part => with_working_file(options, compiled::beside_part(model, part)),
    };
    let compiled: Vec<Named> = parts.iter().flat_map(of_part).collect();
    let files: Vec<Named> = outputs(options).into_iter().chain(compiled).collect();
    refuse_overlaps(&files)?;
    check_compiled(&files)
}

/// Refuses to write over an image that a material names: it often has the model's name, as has the picture.
pub fn check_images(
    options: &Options,
    materials: &[MaterialRecord],
    folder: &Path,
) -> Result<(), Box<dyn Error>> {
    let image = |key: ImageKey| Named::new("the model's image", folder.join(key.path), Role::Read);
    let images = Textures::named_by(materials).into_iter().map(image);
    Ok(refuse_overlaps(&images.chain(outputs(options)).collect::<Vec<_>>())?)
}

/// Refuses pipes, devices and folders, which opening or reading would wait for or fail at: a model is read more than once.
pub fn refuse_irregular(path: &Path) -> Result<(), String> {
    match fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => {
            Err(format!("cannot read {}: it is a folder; name a file in it", path.display()))
        }
        Ok(metadata) if !metadata.is_file() => Err(format!(
            "cannot read {}: it is a pipe or a device, and models are read more than once; name a file",
            path.display()
        )),
        // Who opens it says what is wrong.
        _ => Ok(()),
    }
}

/// Refuses to replace what is no compiled file by one.
pub fn refuse_foreign(path: &Path) -> Result<(), Box<dyn Error>> {
    refuse_irregular(path)?;
    if fs::metadata(path).map_or(true, |metadata| metadata.len() == 0) {
        return Ok(());
    }
    // Without memory nothing but the header is read.
    match DiskSource::open_in(path, PageCache::Use, &MemoryBudget::new(Bytes(0))) {
        Err(SourceError::Model { error: ModelError::NotCompiled, .. }) => Err(format!(
            "{} is no compiled file: remove it or choose another with --compiled",
            path.display()
        )
        .into()),
        _ => Ok(()),
    }
}

fn inputs(options: &Options) -> Vec<Named> {
    let mut inputs = Vec::new();
    inputs.extend(options.scene_file.iter().map(|path| Named::new("the scene file", path, Role::Read)));
    match &options.scene {
        Some(scene) => {
            inputs.extend(scene.models.iter().map(|model| Named::new("the model", &model.file, Role::Read)));
        }
        None => inputs.extend(options.model.iter().map(|path| Named::new("the model", path, Role::Read))),
    }
    inputs
}

fn outputs(options: &Options) -> Vec<Named> {
    let mut outputs = Vec::new();
    if !options.compile_only {
        outputs.push(Named::new("the picture (-o)", &options.output, Role::Picture));
    }
    let reports = [
        ("--stats", &options.stats),
        ("--record-accesses", &options.record_accesses),
        ("--memory-log", &options.memory_log),
    ];
    for (what, path) in reports {
        outputs.extend(path.iter().map(|path| Named::new(what, path, Role::Report)));
    }
    if let Some(path) = &options.memory_log {
        outputs.push(Named::new("the plot of --memory-log", path.with_extension("svg"), Role::Report));
    }
    outputs
}

/// The compiled file of a model, and what is kept beside it.
fn compiled_files(options: &Options, model: &Path) -> Vec<Named> {
    let path = options.compiled.clone().unwrap_or_else(|| compiled::file_of(model));
    let tiles = beside(options, "the file of tiles", compiled::tiles_of(options, model));
    // A compiled file is read as it is.
    if compiled::is_compiled(model) {
        return vec![tiles];
    }
    with_working_file(options, path).into_iter().chain([tiles]).collect()
}

/// A compiled file, and where a lazy compile keeps what it has.
fn with_working_file(options: &Options, path: PathBuf) -> Vec<Named> {
    let working = beside(options, "the working file", LazyModel::working_path(&path));
    vec![of_compile(options, path), working]
}

/// A file that is kept beside a compiled file.
fn beside(options: &Options, what: &'static str, path: PathBuf) -> Named {
    Named { is_beside: true, ..Named::new(what, path, of_compile(options, PathBuf::new()).role) }
}

fn of_compile(options: &Options, path: PathBuf) -> Named {
    Named::new("the compiled file", path, Role::Compiled { chosen: options.compiled.is_some() })
}

fn check_compiled(files: &[Named]) -> Result<(), Box<dyn Error>> {
    for file in files.iter().filter(|file| file.what == "the compiled file") {
        if file.role == (Role::Compiled { chosen: true }) {
            refuse_unwritable(file)?;
        }
        refuse_foreign(&file.path)?;
    }
    for file in files.iter().filter(|file| file.is_beside) {
        refuse_foreign_beside(&file.path)?;
    }
    Ok(())
}

/// Refuses to empty a file that only happens to have the name of one that is kept beside a compiled file.
fn refuse_foreign_beside(path: &Path) -> Result<(), String> {
    refuse_irregular(path)?;
    let mut start = Vec::new();
    // Who opens it says what is wrong.
    let Ok(_) = File::open(path).and_then(|file| file.take(4).read_to_end(&mut start)) else { return Ok(()) };
    // A working file has no header until its cells are there.
    if start.is_empty() || start == [0; 4] || start == *b"\x89out" {
        return Ok(());
    }
    Err(format!(
        "{} is something else than what would be kept under that name: move it away, or choose another with --compiled",
        path.display()
    ))
}

fn refuse_unwritable(file: &Named) -> Result<(), String> {
    let cannot = |why: String| Err(format!("cannot write {}: {why}", file.path.display()));
    let folder = file.path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        return cannot(format!("there is no folder {}", folder.display()));
    }
    let tried = match fs::metadata(&file.path) {
        Ok(metadata) if metadata.is_dir() => return cannot("it is a folder".to_string()),
        Ok(metadata) if file.role == Role::Picture && !metadata.is_file() => {
            return cannot("it is a pipe or a device; name a file".to_string());
        }
        // The new one is made beside it first.
        Ok(_) if file.role == Role::Picture => {
            let mut beside = place_of(&file.path).into_os_string();
            beside.push(".unfinished");
            if Path::new(&beside).exists() { Ok(()) } else { try_to_make(Path::new(&beside)) }
        }
        // Changes nothing; a pipe would wait for who reads it.
        Ok(metadata) if metadata.is_file() && file.role == Role::Report => {
            OpenOptions::new().append(true).open(&file.path).map(|_| ())
        }
        Err(error) if error.kind() == ErrorKind::NotFound => try_to_make(&file.path),
        _ => Ok(()),
    };
    tried.or_else(|error| cannot(error.to_string()))
}

/// Makes a file that is not there, and removes it again.
fn try_to_make(path: &Path) -> Result<(), std::io::Error> {
    match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(_) => fs::remove_file(path),
        // A link to nothing: whoever writes will make what it names, or say why not.
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(()),
        Err(error) => Err(error),
    }
}

/// Refuses two names of one file, if it is written by one of them.
fn refuse_overlaps(files: &[Named]) -> Result<(), WouldOverwrite> {
    for (index, second) in files.iter().enumerate() {
        let clash = files[..index]
            .iter()
            .find(|first| may_not_be_one(first.role, second.role) && is_one(first, second));
        if let Some(first) = clash {
            return Err(WouldOverwrite(format!(
                "{} {} and {} {} are one file, which would be overwritten: choose another name",
                first.what,
                first.path.display(),
                second.what,
                second.path.display()
            )));
        }
    }
    Ok(())
}

fn may_not_be_one(first: Role, second: Role) -> bool {
    match (first, second) {
        // Models of a scene may be one file, and have one compiled file then.
        (Role::Read, Role::Read) | (Role::Compiled { .. }, Role::Compiled { .. }) => false,
        // The compiled file of a model may be another model of the scene. It is not replaced if it is something else.
        (Role::Read, Role::Compiled { chosen }) | (Role::Compiled { chosen }, Role::Read) => chosen,
        _ => true,
    }
}

fn is_one(first: &Named, second: &Named) -> bool {
    // Nothing is lost in a device, as /dev/null.
    let is_device = |path: &Path| fs::metadata(path).is_ok_and(|metadata| !metadata.is_file());
    !is_device(&first.path)
        && (place_of(&first.path) == place_of(&second.path) || is_one_inode(&first.path, &second.path))
}

#[cfg(unix)]
fn is_one_inode(first: &Path, second: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let inode = |path: &Path| fs::metadata(path).map(|metadata| (metadata.dev(), metadata.ino())).ok();
    inode(first).is_some_and(|first| inode(second) == Some(first))
}

#[cfg(not(unix))]
fn is_one_inode(_first: &Path, _second: &Path) -> bool {
    false
}
