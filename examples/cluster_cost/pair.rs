//! Two real workers beside two processes that know nothing of each other and render half of the picture each: every second tile, so
//! that the halves cost about the same.
//!
//! The time of the independent processes is their mean, from the moment when their model file is open: as if their work were shared
//! out perfectly. That of the cluster is from the same moment of the first worker, when it joins, to the coordinator's last pixel.

use std::error::Error;
use std::fs;
use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use outcrop::cluster::{
    Coordinator, CoordinatorOptions, Job, RoleOptions, WorkerOptions, model_key, run_coordinator, run_worker,
};
use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::Gears;
use outcrop::render::{Region, RenderSettings, Renderer};
use outcrop::scene::{Camera, Light, Scene};
use outcrop::schedule::SchedulerOptions;
use outcrop::source::{DiskSource, PageCache};
use outcrop::transport::{SharedKey, TcpOptions, TcpTransport, Transport};
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

use crate::Options;
use crate::common::gears_view;

const MEMORY: Bytes = Bytes::mib(256);

pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    match (&options.part, &options.model) {
        (Some(part), Some(model)) if part == "worker" => return worker(options, model),
        (Some(part), Some(model)) => return half(options, model, part.parse()?),
        _ => {}
    }
    let folder = tempfile::tempdir_in(".")?;
    let model = match &options.model {
        Some(model) => model.clone(),
        None => {
            let path = folder.path().join("gears.outcrop");
            let budget = MemoryBudget::new(MEMORY);
            compile_shape(&Gears::new(4)?, &path, &CompileOptions::default(), &budget, &mut |_| {
                Control::Continue
            })?;
            path
        }
    };
    println!(
        "| round | two processes, s | cluster, s | ratio | their CPU, s | workers' CPU, s | ratio | coordinator's CPU |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let (mut walls, mut works, mut shares) = (Vec::new(), Vec::new(), Vec::new());
    for round in 1..=options.rounds {
        // In turn which comes first.
        let (halves, cluster) = if round % 2 == 1 {
            let halves = halves(options, &model, folder.path())?;
            (halves, cluster(options, &model)?)
        } else {
            let cluster = cluster(options, &model)?;
            (halves(options, &model, folder.path())?, cluster)
        };
        if halves.pixels != cluster.pixels {
            return Err("the pictures differ".into());
        }
        let (wall, work) = (halves.seconds / cluster.seconds, halves.processor / cluster.processor);
        let share = cluster.coordinator / cluster.seconds;
        println!(
            "| {round} | {:.2} | {:.2} | {wall:.3} | {:.2} | {:.2} | {work:.3} | {:.2} % |",
            halves.seconds,
            cluster.seconds,
            halves.processor,
            cluster.processor,
            100.0 * share
        );
        walls.push(wall);
        works.push(work);
        shares.push(share);
    }
    println!(
        "median: {:.3} of the time, {:.3} of the processors' time; coordinator {:.2} % of a core; all pictures identical",
        median(&mut walls),
        median(&mut works),
        100.0 * median(&mut shares)
    );
    Ok(())
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// One way to make the picture.
struct Made {
    seconds: f64,
    /// Processor time of those who rendered.
    processor: f64,
    coordinator: f64,
    pixels: Vec<u32>,
}

/// Processor time of this process so far.
fn processor_seconds() -> Result<f64, Box<dyn Error>> {
    let stat = fs::read_to_string("/proc/self/stat").map_err(|_| "processor times are read on Linux only")?;
    // After the name, which may hold anything.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |field: usize| fields.get(field).and_then(|text| text.parse::<f64>().ok());
    // Hundredths on every Linux of our day.
    Ok((ticks(11).ok_or("utime")? + ticks(12).ok_or("stime")?) / 100.0)
}

fn scene() -> Result<Scene, Box<dyn Error>> {
    let camera = Camera::pinhole(Gears::EYE, gears_view::LOOK_AT, gears_view::UP, gears_view::FOV_DEGREES)?;
    let lights = Gears::LAMPS.map(|position| Light::point(position, [gears_view::INTENSITY; 3]));
    let scene = Scene::new(camera).with_lights(lights).with_background(gears_view::BACKGROUND);
    Ok(scene.with_ambient(gears_view::AMBIENT))
}

fn job(options: &Options, model: &DiskSource) -> Result<Job, Box<dyn Error>> {
    let mut settings = RenderSettings::new(options.size[0], options.size[1]);
    settings.samples_per_pixel = options.samples_per_pixel;
    Ok(Job::new(scene()?, settings, model_key(model.model())))
}

fn start(options: &Options, model: &Path, part: &str) -> Result<Command, Box<dyn Error>> {
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["pair", "--part", part, "--model"]).arg(model);
    command.args(["--size", &format!("{}x{}", options.size[0], options.size[1])]);
    command.args(["--spp", &options.samples_per_pixel.to_string()]);
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    Ok(command)
}

/// What a process told at its end: `key value` by lines.
fn told(child: Child) -> Result<Vec<(String, f64)>, Box<dyn Error>> {
    let output = child.wait_with_output()?;
    if !output.status.success() {
        return Err("a process failed".into());
    }
    let mut values = Vec::new();
    for line in output.stdout.lines() {
        let line = line?;
        let (key, value) = line.split_once(' ').ok_or("a line without a value")?;
        values.push((key.to_owned(), value.parse()?));
    }
    Ok(values)
}

fn value(values: &[(String, f64)], key: &str) -> Result<f64, String> {
    values.iter().find(|(name, _)| name == key).map(|(_, value)| *value).ok_or(format!("no {key}"))
}

fn halves(options: &Options, model: &Path, folder: &Path) -> Result<Made, Box<dyn Error>> {
    let mut children = Vec::new();
    for half in ["0", "1"] {
        let path = folder.join(format!("half-{half}"));
        children.push((start(options, model, half)?.env("OUTCROP_HALF", &path).spawn()?, path));
    }
    let mut made = Made { seconds: 0.0, processor: 0.0, coordinator: 0.0, pixels: vec![0; 0] };
    for (child, path) in children {
        let values = told(child)?;
        made.seconds += value(&values, "seconds")? / 2.0;
        made.processor += value(&values, "processor")?;
        let bytes = fs::read(path)?;
        let bits =
            bytes.chunks_exact(4).map(|bytes| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
        if made.pixels.is_empty() {
            made.pixels = bits.collect();
        } else {
            // Each half is zero where the other is not.
            made.pixels.iter_mut().zip(bits).for_each(|(pixel, other)| *pixel |= other);
        }
    }
    Ok(made)
}

/// Renders every second tile, from number `half` on.
fn half(options: &Options, model: &Path, half: usize) -> Result<(), Box<dyn Error>> {
    let source = DiskSource::open_with(model, PageCache::Bypass)?;
    let job = job(options, &source)?;
    // The model is open, as it is in a worker that joins.
    let (start, before) = (Instant::now(), processor_seconds()?);
    let budget = MemoryBudget::new(MEMORY);
    let aside =
        budget.reserve(Renderer::region_bytes(&job.scene, source.model(), &job.settings)?, "the picture")?;
    let octree = LazyOctree::open(Arc::new(source), &budget, OctreeOptions::default())?;
    drop(aside);
    let renderer = Renderer::new(&octree, &job.scene, &job.settings, &budget)?;
    let stop = AtomicBool::new(false);
    let mut regions = renderer.regions(&stop)?;
    let ([width, height], side) = (options.size, job.tile_side);
    let mut picture = vec![[0.0f32; 3]; (width * height) as usize];
    for tile_y in 0..height.div_ceil(side) {
        for tile_x in (0..width.div_ceil(side)).filter(|tile_x| (tile_x + tile_y) % 2 == half as u32) {
            let (x, y) = (tile_x * side, tile_y * side);
            let region = Region { x, y, width: side.min(width - x), height: side.min(height - y) };
            let pixels = regions.render(region)?.ok_or("stopped")?;
            for (row, line) in pixels.chunks_exact(region.width as usize).enumerate() {
                let at = (y as usize + row) * width as usize + x as usize;
                picture[at..at + line.len()].copy_from_slice(line);
            }
        }
    }
    println!("seconds {}", start.elapsed().as_secs_f64());
    println!("processor {}", processor_seconds()? - before);
    let bytes: Vec<u8> = picture.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
    fs::write(PathBuf::from(std::env::var("OUTCROP_HALF")?), bytes)?;
    Ok(())
}

fn cluster(options: &Options, model: &Path) -> Result<Made, Box<dyn Error>> {
    let source = DiskSource::open(model)?;
    let job = job(options, &source)?;
    let key = SharedKey::generate()?;
    let hub = TcpTransport::open(key.clone(), TcpOptions::loopback("coordinator"))?;
    let address = hub.address().ok_or("no address")?;
    let budget = MemoryBudget::new(MEMORY);
    let roles = RoleOptions::default();
    let coordinator_options = CoordinatorOptions { roles, schedule: SchedulerOptions::new(2), readers: 0 };
    let coordinator = Coordinator::new(job, coordinator_options, &budget)?;
    let mut children = Vec::new();
    for _ in 0..2 {
        let mut command = start(options, model, "worker")?;
        children.push(command.args(["--connect", &address]).env(SharedKey::VARIABLE, key.to_hex()).spawn()?);
    }
    // Counts from when a worker has joined.
    let mut begin: Option<(Instant, f64)> = None;
    let mut observe = |coordinator: &Coordinator, _: &[String]| {
        if begin.is_none() && coordinator.members().0 > 0 {
            begin = processor_seconds().ok().map(|seconds| (Instant::now(), seconds));
        }
        Control::Continue
    };
    let done = run_coordinator(&hub, coordinator, None, Duration::from_secs(60), &mut observe)?;
    let (start, before) = begin.ok_or("no worker ever came")?;
    let (seconds, coordinator) = (start.elapsed().as_secs_f64(), processor_seconds()? - before);
    hub.close();
    let mut processor = 0.0;
    for child in children {
        processor += value(&told(child)?, "processor")?;
    }
    let pixels = done.film().pixels().as_flattened().iter().map(|value| value.to_bits()).collect();
    Ok(Made { seconds, processor, coordinator, pixels })
}

fn worker(options: &Options, model: &Path) -> Result<(), Box<dyn Error>> {
    let key = SharedKey::from_environment()?.ok_or("no key")?;
    let control = TcpTransport::open(key.clone(), TcpOptions::connecting("worker"))?;
    let data: Arc<dyn Transport> = Arc::new(TcpTransport::open(key, TcpOptions::connecting("data"))?);
    let worker = WorkerOptions {
        file: Some(Arc::new(DiskSource::open_with(model, PageCache::Bypass)?)),
        ..WorkerOptions::new(format!("worker {}", std::process::id()), MemoryBudget::new(MEMORY))
    };
    let before = processor_seconds()?;
    let address = options.connect.as_deref().ok_or("--connect")?;
    run_worker(&control, &data, address, &worker, &AtomicBool::new(false), &mut |_| {})?;
    println!("processor {}", processor_seconds()? - before);
    Ok(())
}
