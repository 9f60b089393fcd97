//! Renders a scene file, a model file, a compiled file or, with no argument, procedural gears, inside a memory budget.

#[macro_use]
#[path = "../common/mod.rs"]
mod common;

mod compiled;
mod files;
mod instanced;
mod options;
mod summary;

use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Read};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use common::arguments::{self, Arguments};
use common::gears_view;
use common::interrupt::Interrupt;
use common::memory_log::MemoryLog;
use common::progress::Meter;
use compiled::{Compiled, Origin};
use files::WouldOverwrite;
use options::{Command, Options, SourceKind};
use outcrop::access::{AccessTrace, MissRatioCurve};
use outcrop::budget::Reservation;
use outcrop::compile::Control;
use outcrop::error::{LoadError, RenderError, TraceError};
use outcrop::free_memory::FollowFreeMemory;
use outcrop::geom::Aabb;
use outcrop::model::MaterialRecord;
use outcrop::octree::{LazyOctree, OctreeOptions, TreeQuality};
use outcrop::render::{Layers, Outcome, RenderedImage, Renderer, Threads};
use outcrop::scene::{Camera, GltfView, Light, Scene};
use outcrop::source::{DiskSource, MemorySource, MmapSource, PageCache};
use outcrop::texture::Textures;
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};
use summary::Summary;

fn main() -> ExitCode {
    arguments::run(run)
}

fn run(arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let options = match Options::parse(arguments)? {
        Command::Help => {
            print!("{}", options::HELP);
            return Ok(ExitCode::SUCCESS);
        }
        Command::Run(options) => options,
    };
    files::check(&options)?;
    let interrupt = Interrupt::install()?;
    let budget = MemoryBudget::new(options.memory);
    let log = options.memory_log.clone().map(|path| MemoryLog::start(path, &budget));
    let mut summary = Summary::new();

    let code = job(&options, &budget, &interrupt, &mut summary);
    let may_write = !code.as_ref().is_err_and(|error| error.is::<WouldOverwrite>());
    if let Some(log) = log.filter(|_| may_write) {
        log.finish()?;
    }
    let code = code?;
    summary.end(&options, &budget)?;
    Ok(code)
}

fn job(
    options: &Options,
    budget: &MemoryBudget,
    interrupt: &Interrupt,
    summary: &mut Summary,
) -> Result<ExitCode, Box<dyn Error>> {
    let mut meter = Meter::new();
    if let Some(parts) = instanced::Parts::of(options)? {
        let made = instanced::picture(options, parts, budget, interrupt, &mut meter, summary)?;
        meter.finish();
        let Some((picture, models)) = made else { return Ok(stopped_early()) };
        // The picture first: a full disk must not lose it.
        let code = finish(options, &picture, summary)?;
        models.iter().try_for_each(|model| keep_lazy(model, summary))?;
        return Ok(code);
    }
    let compiled = compiled::prepare(options, budget, interrupt, &mut meter)?;
    meter.finish();
    let Some(compiled) = compiled else { return Ok(stopped_early()) };
    summary.compiled(&compiled);
    if options.compile_only {
        return Ok(ExitCode::SUCCESS);
    }
    let _in_memory = reserve_source(options, &compiled.origin, budget)?;
    let source = match &compiled.origin {
        Origin::File(path) => (open(options, path, budget)?, TreeQuality::Best),
        // Who is in a hurry for a first picture wants it traced soon, not fast.
        Origin::Lazy(model) => (Arc::clone(model) as Arc<dyn BlockSource>, TreeQuality::Quick),
    };
    let rendered = render(options, source, budget, interrupt, &mut meter, summary);
    let (picture, recorded) = rendered.map_err(|error| with_file(error, &compiled.origin))?;
    meter.finish();
    // The picture first: a full disk must not lose it.
    let code = finish(options, &picture, summary)?;
    keep_lazy(&compiled, summary)?;
    recorded?;
    Ok(code)
}

/// What is damaged names the block; the user knows the file.
fn with_file(error: Box<dyn Error>, origin: &Origin) -> Box<dyn Error> {
    let damaged = match error.downcast_ref() {
        Some(RenderError::Trace(TraceError::Load(error))) => {
            matches!(error, LoadError::Block(_) | LoadError::Attributes(_))
        }
        _ => false,
    };
    match origin {
        Origin::File(path) if damaged => format!("{}: {error}", path.display()).into(),
        _ => error,
    }
}

/// Room for a compiled file that is to be held in memory.
fn reserve_source(
    options: &Options,
    origin: &Origin,
    budget: &MemoryBudget,
) -> Result<Option<Reservation>, Box<dyn Error>> {
    let (Origin::File(path), SourceKind::Memory) = (origin, options.source) else { return Ok(None) };
    let bytes =
        std::fs::metadata(path).map_err(|error| format!("cannot read {}: {error}", path.display()))?.len();
    Ok(Some(budget.reserve(Bytes(bytes), "the compiled file, which --source memory holds")?))
}

/// Tells that there is no picture because the user asked to stop.
fn stopped_early() -> ExitCode {
    eprintln!("stopped while compiling: nothing was finished");
    ExitCode::from(Interrupt::EXIT_CODE)
}

/// Seals a model that was compiled as rays reached it, if that is all of it.
fn keep_lazy(compiled: &Compiled, summary: &mut Summary) -> Result<(), Box<dyn Error>> {
    if let Origin::Lazy(model) = &compiled.origin {
        let is_whole = model.is_complete() && !model.report().details_left_out;
        let report = is_whole.then(|| model.finish(&mut |_| Control::Continue)).transpose()?;
        summary.lazy(&model.report(), report.map(|_| model.output()));
    }
    Ok(())
}

/// What is written.
struct Picture {
    image: RenderedImage,
    /// If they were asked for and the picture is whole.
    layers: Option<Layers>,
}

/// What layers will take, set aside before a cache takes all that is left.
fn reserve_layers(options: &Options, budget: &MemoryBudget) -> Result<Option<Reservation>, Box<dyn Error>> {
    let bytes = Layers::bytes_needed(options.settings.width, options.settings.height);
    Ok(options.layers.then(|| budget.reserve(bytes, "the layers")).transpose()?)
}

/// Renders the picture and the layers, for which `set_aside` is.
fn draw(
    renderer: &Renderer<'_>,
    options: &Options,
    set_aside: Option<Reservation>,
    interrupt: &Interrupt,
    meter: &mut Meter,
) -> Result<Picture, Box<dyn Error>> {
    let threads = Threads::Count(options.threads as usize);
    let image = renderer.render(&threads, &mut progress_of(meter, interrupt))?;
    let is_whole = image.report.outcome == Outcome::Complete;
    let has_layers = set_aside.is_some() && is_whole;
    drop(set_aside);
    let layers = has_layers.then(|| renderer.layers(&mut progress_of(meter, interrupt))).transpose()?;
    Ok(Picture { image, layers })
}

/// Writes the picture.
fn finish(options: &Options, picture: &Picture, summary: &mut Summary) -> Result<ExitCode, Box<dyn Error>> {
    let Picture { image, layers } = picture;
    let is_whole = image.report.outcome == Outcome::Complete;
    let output = if is_whole { options.output.clone() } else { place_of_partial(&options.output) };
    match layers {
        Some(layers) => layers.write(&image.film, &output)?,
        None => image.film.write(&output)?,
    }
    summary.rendered(image, &output);
    if is_whole {
        return Ok(ExitCode::SUCCESS);
    }
    let report = &image.report;
    eprintln!(
        "stopped after {} of {} tiles: the unfinished picture is {}",
        report.tiles_finished,
        report.tiles_total,
        output.display()
    );
    Ok(ExitCode::from(Interrupt::EXIT_CODE))
}

/// `NAME.partial.EXT` if there is a picture already, which may be a good one.
fn place_of_partial(output: &Path) -> PathBuf {
    match output.extension() {
        Some(kind) if output.exists() => {
            let mut extension = std::ffi::OsString::from("partial.");
            extension.push(kind);
            output.with_extension(extension)
        }
        _ => output.to_path_buf(),
    }
}

fn open(
    options: &Options,
    path: &Path,
    budget: &MemoryBudget,
) -> Result<Arc<dyn BlockSource>, Box<dyn Error>> {
    Ok(match options.source {
        SourceKind::Disk => Arc::new(DiskSource::open_in(path, PageCache::Bypass, budget)?),
        SourceKind::Cached => Arc::new(DiskSource::open_in(path, PageCache::Use, budget)?),
        // SAFETY: the file was published whole under its name by a rename and this program does not write to it; a user
        // who truncates it during the render asks for the signal that the documentation of `open` promises.
        SourceKind::Mmap => Arc::new(unsafe { MmapSource::open(path) }?),
        SourceKind::Memory => {
            let bytes =
                read_shared(path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
            Arc::new(MemorySource::new(bytes)?)
        }
    })
}

/// A whole file, held once at all times.
fn read_shared(path: &Path) -> std::io::Result<Arc<[u8]>> {
    let mut file = File::open(path)?;
    let mut bytes: Arc<[u8]> = std::iter::repeat_n(0, file.metadata()?.len() as usize).collect();
    // Nobody else has it yet.
    if let Some(bytes) = Arc::get_mut(&mut bytes) {
        file.read_exact(bytes)?;
    }
    Ok(bytes)
}

/// The picture, and whether the accesses of `--record-accesses` could be written.
fn render(
    options: &Options,
    (source, quality): (Arc<dyn BlockSource>, TreeQuality),
    budget: &MemoryBudget,
    interrupt: &Interrupt,
    meter: &mut Meter,
    summary: &mut Summary,
) -> Result<(Picture, Result<(), String>), Box<dyn Error>> {
    let settings = options.settings;
    let threads = Threads::Count(options.threads as usize);
    let mut scene = scene(options, &source.model().bounds, budget)?;
    if let Some(model) = &options.model {
        scene = with_textures(scene, &source.model().materials, model, options, budget)?;
    }
    // The octree's cache takes what is left of the budget, so the picture's share is set aside first.
    let picture_bytes = Renderer::bytes_needed(&scene, source.model(), &settings, &threads)?;
    let set_aside = budget.reserve(picture_bytes, "the picture")?;
    let for_layers = reserve_layers(options, budget)?;
    let mut octree = LazyOctree::open(source, budget, octree_options(options, quality))?;
    drop(set_aside);
    let recording = match &options.record_accesses {
        Some(path) => Some((path, octree.record_accesses(Box::new(BufWriter::new(create(path)?)))?)),
        None => None,
    };
    summary.opened(&octree, picture_bytes);
    let renderer = Renderer::new(&octree, &scene, &settings, budget)?;
    let picture = draw(&renderer, options, for_layers, interrupt, meter)?;
    let Some((path, recorder)) = recording else { return Ok((picture, Ok(()))) };
    let trace = recorder.finish().and_then(|_| AccessTrace::open(path));
    meter.finish();
    let recorded = trace.map(|trace| summary.accesses(path, &MissRatioCurve::of(&trace)));
    Ok((picture, recorded.map_err(|error| format!("{}: {error}", path.display()))))
}

fn octree_options(options: &Options, quality: TreeQuality) -> OctreeOptions {
    OctreeOptions {
        tracers_max: options.threads,
        simd: options.simd,
        tier: options.tier,
        quality: options.quality.unwrap_or(quality),
        leaf_layout: options.leaf_layout,
        slots_max: options.slots_max,
        policy: options.policy,
        follow_free_memory: options.keep_free.map(|keep_free| FollowFreeMemory { keep_free }),
    }
}

fn progress_of<'m>(
    meter: &'m mut Meter,
    interrupt: &'m Interrupt,
) -> impl FnMut(outcrop::render::Progress) -> Control + Send + 'm {
    |progress| {
        meter.set("rendering", progress.samples as f64 / progress.samples_total as f64);
        if interrupt.is_requested() { Control::Cancel } else { Control::Continue }
    }
}

/// The scene with the pictures that a model's materials name, if any; they are converted once, beside the compiled file.
fn with_textures(
    scene: Scene,
    materials: &[MaterialRecord],
    model: &Path,
    options: &Options,
    budget: &MemoryBudget,
) -> Result<Scene, Box<dyn Error>> {
    if Textures::named_by(materials).is_empty() {
        return Ok(scene);
    }
    let folder = model.parent().unwrap_or(Path::new(""));
    files::check_images(options, materials, folder)?;
    let tiles = compiled::tiles_of(options, model);
    Ok(scene.with_textures(Textures::open(materials, folder, &tiles, budget)?))
}

fn create(path: &Path) -> Result<File, String> {
    File::create(path).map_err(|error| format!("cannot write {}: {error}", path.display()))
}

/// The cameras and lights of the model file, if it is one that has them.
fn file_view(options: &Options) -> Result<GltfView, Box<dyn Error>> {
    let file = options.model.as_deref().filter(|path| options::is_gltf(path));
    Ok(file.map(GltfView::read).transpose()?.unwrap_or_default())
}

/// The scene that the options describe; what they leave out is chosen to fit the model.
fn scene(options: &Options, bounds: &Aabb, budget: &MemoryBudget) -> Result<Scene, Box<dyn Error>> {
    if let Some(file) = &options.scene {
        // In the shape of the picture that is made.
        let mut file = file.clone();
        file.settings = options.settings;
        return Ok(file.scene(bounds, budget)?);
    }
    let aspect = f64::from(options.settings.width) / f64::from(options.settings.height);
    let up = options.up;
    let framing = match up {
        Some(up) => Camera::framing_with_up(bounds, up, aspect),
        None => Camera::framing(bounds, aspect),
    };
    let view = file_view(options)?;
    let look_at = options.look_at.unwrap_or_else(|| bounds.center());
    let eye = options.eye.unwrap_or_else(|| framing.eye());
    // The framing camera's own up is at a right angle to its view; any up that is given or usual will do here.
    let up = up.unwrap_or(if options.eye.is_some() { [0.0, 0.0, 1.0] } else { framing.frame()[1] });
    let camera = match options.orthographic {
        Some(height) => Camera::orthographic(eye, look_at, up, height)?,
        None if options.eye.is_none() && options.look_at.is_none() && options.fov.is_none() => {
            view.cameras.first().copied().filter(|_| options.up.is_none()).unwrap_or(framing)
        }
        None => Camera::pinhole(eye, look_at, up, options.fov.unwrap_or(gears_view::FOV_DEGREES))?,
    };
    let scene = Scene::new(camera);
    if options.lights.is_empty() {
        return Ok(match view.lights.is_empty() {
            true => scene.with_automatic_lights(),
            false => scene.with_lights(view.lights),
        });
    }
    let lights = options.lights.iter().map(|&(position, intensity)| Light::point(position, [intensity; 3]));
    Ok(scene.with_lights(lights).with_background(gears_view::BACKGROUND).with_ambient(gears_view::AMBIENT))
}
