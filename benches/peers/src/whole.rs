//! Whole jobs: from a model file that no cache holds to a picture, one process each, one thread.

use std::fs::File;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use outcrop::MemoryBudget;
use outcrop::compile::{Control, LazyModel, Threads};
use outcrop::error::Error;
use outcrop::octree::{LazyOctree, OctreeOptions, Tier, TreeQuality};
use outcrop::procedural::Gears;
use outcrop::render::{RenderSettings, Renderer};
use outcrop::scene::{Camera, Light, Scene};
use outcrop::source::{BlockSource, DiskSource};
use outcrop::units::Bytes;

use crate::clock::median;
use crate::embree::{Embree, Mode};
use crate::engine::Engine;
use crate::mesh::Mesh;
use crate::outcrop_engine::{Outcrop, compile, open, open_lazily, open_with};
use crate::picture;
use crate::rays::VERTICAL_FIELD_DEGREES;

/// Edge length of the picture.
const SIZE: usize = 512;
/// What outcrop is given, for compiling and for rendering.
const MEMORY: Bytes = Bytes::mib(160);

/// The jobs, by the names under which the program calls itself; the first is what the others are compared with.
const JOBS: [(&str, &str); 9] = [
    ("embree-compact-low", "Embree compact, low"),
    ("embree-default", "Embree default"),
    ("outcrop", "outcrop: compile, trace, same shading"),
    ("outcrop-compiled", "outcrop: the compiled file, same shading"),
    ("outcrop-compiled-quick", "outcrop: the compiled file, quick trees, same shading"),
    ("outcrop-lazy", "outcrop: lazy compile, quick trees, same shading"),
    ("outcrop-lazy-again", "outcrop: the same again, from the working file"),
    ("outcrop-render", "outcrop: compile and `Renderer`"),
    ("outcrop-render-compiled", "outcrop: the compiled file, `Renderer`"),
];

/// One job, in this process: the work that a user would wait for.
pub fn job(name: &str, model: &Path, output: &Path, compiled: &Path) -> Result<(), String> {
    let draw = |engine: &mut dyn Engine| picture::write(&picture::trace(engine, SIZE), SIZE, output);
    match name {
        "embree-compact-low" | "embree-default" => {
            let mut mesh = Mesh::read(model).map_err(|error| error.to_string())?;
            Embree::pad(&mut mesh);
            let mode = if name == "embree-default" { Mode::DEFAULT } else { Mode::COMPACT_LOW };
            draw(&mut Embree::new(&mesh, mode)?)?;
        }
        "outcrop-render" | "outcrop-render-compiled" => {
            if name == "outcrop-render" {
                compile(model, compiled, MEMORY)?;
            }
            render(compiled, output).map_err(|error| error.to_string())?;
        }
        "outcrop-compiled-quick" | "outcrop-lazy" | "outcrop-lazy-again" => {
            let options = OctreeOptions { quality: TreeQuality::Quick, ..OctreeOptions::default() };
            let lazy = lazy_output(compiled);
            if name == "outcrop-lazy" {
                // The first run may not find what an earlier one left.
                _ = std::fs::remove_file(LazyModel::working_path(&lazy));
            }
            let octree = match name {
                "outcrop-compiled-quick" => open_with(compiled, MEMORY, options)?,
                _ => open_lazily(model, &lazy, MEMORY, options)?,
            };
            draw(&mut Outcrop::new("outcrop", &octree)?)?;
        }
        "outcrop" | "outcrop-compiled" => {
            if name == "outcrop" {
                compile(model, compiled, MEMORY)?;
            }
            draw(&mut Outcrop::new("outcrop", &open(compiled, MEMORY, Tier::Certified)?)?)?;
        }
        _ => return Err(format!("no job is called {name}")),
    }
    println!("{}", peak_kib().unwrap_or(0));
    Ok(())
}

/// Where a lazy compile would leave the compiled file; its working file is beside it.
fn lazy_output(compiled: &Path) -> PathBuf {
    compiled.with_extension("lazy")
}

/// The same picture by the library's own renderer.
fn render(compiled: &Path, output: &Path) -> Result<(), Error> {
    let camera = Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], VERTICAL_FIELD_DEGREES)?;
    let lights = Gears::LAMPS.map(|position| Light::point(position, [1.0 / Gears::LAMPS.len() as f32; 3]));
    let scene = Scene::new(camera).with_lights(lights);
    let settings = RenderSettings::new(SIZE as u32, SIZE as u32);
    let budget = MemoryBudget::new(MEMORY);
    let source: Arc<dyn BlockSource> = Arc::new(DiskSource::open(compiled)?);
    let needed = Renderer::bytes_needed(&scene, source.model(), &settings, &Threads::One)?;
    // The octree takes what is left for its cache.
    let aside = budget.reserve(needed, "the renderer")?;
    let octree = LazyOctree::open(source, &budget, OctreeOptions::default())?;
    drop(aside);
    let renderer = Renderer::new(&octree, &scene, &settings, &budget)?;
    let image = renderer.render(&Threads::One, &mut |_| Control::Continue)?;
    Ok(image.into_complete()?.write(output)?)
}

/// Largest resident memory of this process so far.
fn peak_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// What one run took.
#[derive(Clone, Copy)]
struct Run {
    cpu_seconds: f64,
    peak_kib: u64,
}

/// Runs every job `repetitions` times, in turn, and prints medians.
pub fn run(model: &Path, repetitions: usize) -> Result<(), String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let compiled = folder.path().join("model.outcrop");
    let output = |name: &str| folder.path().join(format!("{name}.png"));
    let mut runs = [const { Vec::new() }; JOBS.len()];
    for _ in 0..repetitions {
        for (runs, (name, _)) in runs.iter_mut().zip(JOBS) {
            for file in [model, &compiled, &LazyModel::working_path(lazy_output(&compiled))] {
                forget(file);
            }
            runs.push(child(name, model, &output(name), &compiled)?);
        }
    }
    let bytes = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    println!(
        "{}: {:.1} MB, compiled {:.1} MB; {SIZE} x {SIZE} pixels with shadows, files out of the page cache, one \
         thread, median of {repetitions} interleaved repetitions; outcrop has a budget of {MEMORY}\n",
        model.file_name().unwrap_or_default().to_string_lossy(),
        bytes(model) as f64 / 1e6,
        bytes(&compiled) as f64 / 1e6
    );
    println!(
        "| whole job | CPU s, user and system | ratio to the first | peak resident MB | pixels that differ |"
    );
    println!("|---|---|---|---|---|");
    let reference = picture::read(&output(JOBS[0].0))?;
    for (index, (name, title)) in JOBS.into_iter().enumerate() {
        let picture = picture::read(&output(name))?;
        // Two steps of 255 are rounding; more is another surface or another shadow.
        let different = reference.iter().zip(&picture).filter(|(a, b)| a.abs_diff(**b) > 2).count();
        println!(
            "| {title} | {:.2} | {:.2} | {:.0} | {different} |",
            median(runs[index].iter().map(|run| run.cpu_seconds)),
            median(runs[index].iter().zip(&runs[0]).map(|(own, first)| own.cpu_seconds / first.cpu_seconds)),
            median(runs[index].iter().map(|run| run.peak_kib as f64 / 1000.0 * 1.024)),
        );
    }
    Ok(())
}

/// Runs one job in a process of its own.
fn child(name: &str, model: &Path, output: &Path, compiled: &Path) -> Result<Run, String> {
    let program: PathBuf = std::env::current_exe().map_err(|error| error.to_string())?;
    let before = children_cpu_seconds();
    let result = Command::new(program)
        .args(["job", name])
        .args([model, output, compiled])
        .output()
        .map_err(|error| error.to_string())?;
    let cpu_seconds = children_cpu_seconds() - before;
    let text = String::from_utf8_lossy(&result.stdout);
    if !result.status.success() {
        return Err(format!("{name}: {}", String::from_utf8_lossy(&result.stderr)));
    }
    let peak_kib = text.lines().last().and_then(|line| line.trim().parse().ok()).unwrap_or(0);
    Ok(Run { cpu_seconds, peak_kib })
}

/// User and system CPU time of all child processes that were waited for.
fn children_cpu_seconds() -> f64 {
    // SAFETY: rusage is plain data for which zero is a value.
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    // SAFETY: the call writes one rusage to where the pointer says.
    let status = unsafe { libc::getrusage(libc::RUSAGE_CHILDREN, &mut usage) };
    assert_eq!(status, 0, "this system measures no CPU time of child processes");
    [usage.ru_utime, usage.ru_stime].iter().map(|time| time.tv_sec as f64 + 1e-6 * time.tv_usec as f64).sum()
}

/// Asks the system to drop the file's pages from its cache.
fn forget(path: &Path) {
    if let Ok(file) = File::open(path) {
        // Pages that are not yet on disk stay.
        _ = file.sync_all();
        // SAFETY: an open file; the call gives advice and touches no memory of this process.
        unsafe { libc::posix_fadvise(file.as_raw_fd(), 0, 0, libc::POSIX_FADV_DONTNEED) };
    }
}
