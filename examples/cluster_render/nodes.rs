//! The roles, as the command line asks for them.

use std::error::Error;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use outcrop::cluster::{
    Checkpoint, Coordinator, CoordinatorOptions, CopyOptions, HostRole, Job, Reader, RoleOptions,
    WorkerOptions, model_key, run_coordinator, run_reader, run_worker,
};
use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::model::Model;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Gears, Tessellation};
use outcrop::render::{RenderSettings, Renderer, Threads, WaitingRays};
use outcrop::scene::{Camera, Light, Scene};
use outcrop::schedule::SchedulerOptions;
use outcrop::source::{DiskSource, PageCache};
use outcrop::transport::SharedKey;
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

use crate::common::gears_view;
use crate::common::interrupt::Interrupt;
use crate::common::progress::Meter;
use crate::crew::Crew;
use crate::network::Network;
use crate::options::Options;
use crate::timeline::timeline_svg;

/// Runs the role of `options`, or all of them on this machine if there is none.
pub fn run(options: &Options) -> Result<ExitCode, Box<dyn Error>> {
    let key = key(options)?;
    let interrupt = Interrupt::install()?;
    let network = Network::Tcp(&key);
    match options.role {
        None | Some(HostRole::Coordinator) => coordinate(options, &network, &interrupt),
        Some(HostRole::Worker) => work(options, &network, &interrupt),
        Some(HostRole::Reader) => read(options, &network, &interrupt),
    }
}

fn key(options: &Options) -> Result<SharedKey, Box<dyn Error>> {
    if let Some(path) = &options.key_file {
        return Ok(SharedKey::from_file(path)?);
    }
    match SharedKey::from_environment()? {
        Some(key) => Ok(key),
        // Nobody else is to join.
        None if options.role.is_none() => Ok(SharedKey::generate()?),
        None => Err(format!(
            "nodes need a key: make one with --new-key FILE and give it to all with --key-file FILE, or in {}",
            SharedKey::VARIABLE
        )
        .into()),
    }
}

fn open(path: &Path) -> Result<DiskSource, Box<dyn Error>> {
    Ok(DiskSource::open_with(path, PageCache::Bypass)?)
}

/// Where the compiled model is, or is to be.
pub fn model_path(options: &Options) -> PathBuf {
    let gears = || options.output.with_file_name(format!("cluster-gears{}.outcrop", options.gears_n));
    options.model.clone().unwrap_or_else(gears)
}

/// The compiled model: the one that was given, or gears.
fn model(options: &Options, interrupt: &Interrupt, meter: &mut Meter) -> Result<PathBuf, Box<dyn Error>> {
    let path = model_path(options);
    if options.model.is_some() {
        return Ok(path);
    }
    let mut progress = |progress: outcrop::compile::Progress| {
        meter.set("compiling", progress.fraction.unwrap_or(0.0));
        if interrupt.is_requested() { Control::Cancel } else { Control::Continue }
    };
    let budget = MemoryBudget::new(options.memory);
    let gears = if options.is_small {
        Gears::with_tessellation(options.gears_n, Tessellation::new(27)?)?
    } else {
        Gears::new(options.gears_n)?
    };
    compile_shape(&gears, &path, &CompileOptions::default(), &budget, &mut progress)?;
    Ok(path)
}

/// The gears in their standard view; any other model as a whole.
fn scene(options: &Options, model: &Model) -> Result<Scene, Box<dyn Error>> {
    if options.model.is_some() {
        let aspect = f64::from(options.size[0]) / f64::from(options.size[1]);
        return Ok(Scene::automatic(&model.bounds, aspect));
    }
    let camera = Camera::pinhole(Gears::EYE, gears_view::LOOK_AT, gears_view::UP, gears_view::FOV_DEGREES)?;
    let lights = Gears::LAMPS.map(|position| Light::point(position, [gears_view::INTENSITY; 3]));
    Ok(Scene::new(camera)
        .with_lights(lights)
        .with_background(gears_view::BACKGROUND)
        .with_ambient(gears_view::AMBIENT))
}

pub fn coordinate(
    options: &Options,
    network: &Network<'_>,
    interrupt: &Interrupt,
) -> Result<ExitCode, Box<dyn Error>> {
    let mut meter = Meter::new();
    let path = model(options, interrupt, &mut meter)?;
    let file = open(&path)?;
    let mut settings = RenderSettings::new(options.size[0], options.size[1]);
    settings.samples_per_pixel = options.samples_per_pixel;
    let scene = scene(options, file.model())?;
    let job = Job::new(scene, settings, model_key(file.model()));

    let hub = network.coordinator(options)?;
    let address = hub.address().ok_or("the coordinator listens nowhere")?;
    let budget = MemoryBudget::new(options.memory);
    let coordinator_options = CoordinatorOptions {
        roles: RoleOptions::default(),
        schedule: SchedulerOptions::new(options.workers * u32::from(options.lanes)),
        readers: options.readers + usize::from(options.ship.is_some()),
    };
    let digest = Coordinator::new(job.clone(), coordinator_options, &budget)?.job_digest();
    let (checkpoint, records) = Checkpoint::open(&options.checkpoint, digest)?;
    let coordinator = Coordinator::restore(job.clone(), coordinator_options, records, &budget)?;
    let before = coordinator.progress();
    if before.cells_done > 0 {
        println!(
            "going on from {}: {} of {} cells",
            options.checkpoint.display(),
            before.cells_done,
            before.cells
        );
    }
    let mut crew = Crew::default();
    if let (None, Network::Tcp(key)) = (options.role, network) {
        crew.start(options, key, &address, &path)?;
    } else {
        println!("listening at {address}");
    }

    // For workers that have no file and no other reader.
    let shipping = match &options.ship {
        Some(listen) => {
            let offer = Offer { name: "coordinator's file", listen, memory: options.memory };
            Some(serve(options, network, &path, &address, &offer)?)
        }
        None => None,
    };

    let mut observe = |coordinator: &Coordinator, log: &[String]| {
        for line in log.iter().filter(|line| options.verbose || line.starts_with("refused")) {
            meter.note(line);
        }
        let (progress, (workers, readers)) = (coordinator.progress(), coordinator.members());
        let phase = format!("{workers} workers, {readers} readers");
        meter.set(&phase, progress.cells_done as f64 / progress.cells as f64);
        if interrupt.is_requested() { Control::Cancel } else { Control::Continue }
    };
    let patience = options.patience;
    let done = run_coordinator(&*hub, coordinator, Some(checkpoint), patience, &mut observe)?;
    meter.finish();
    if let Some((stop, shipping)) = shipping {
        stop.store(true, Ordering::Relaxed);
        // What it has to say, it has logged.
        let _ = shipping.join();
    }
    hub.close();
    crew.wait();

    done.film().write(&options.output)?;
    let [map, timeline] = options.beside_output();
    done.map(&budget)?.write(&map)?;
    std::fs::write(&timeline, timeline_svg(done.lanes(), done.spans()))
        .map_err(|error| format!("cannot write {}: {error}", timeline.display()))?;
    report(&done);
    println!("wrote {}, {} and {}", options.output.display(), map.display(), timeline.display());
    if !done.is_finished() {
        println!("the picture is not whole; start again to go on from {}", options.checkpoint.display());
        return Ok(ExitCode::from(Interrupt::EXIT_CODE));
    }
    // Its lock is gone: another coordinator of the same picture may have been faster.
    match std::fs::remove_file(&options.checkpoint) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            return Err(format!("cannot remove {}: {error}", options.checkpoint.display()).into());
        }
        _ => {}
    }
    if options.verify {
        verify(&done, &job, file)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// What a node serves beside what else it does.
struct Offer<'o> {
    name: &'o str,
    listen: &'o str,
    memory: Bytes,
}

/// A reader in the process of another node. Ends with the picture.
fn serve(
    options: &Options,
    network: &Network<'_>,
    path: &Path,
    coordinator: &str,
    offer: &Offer<'_>,
) -> Result<(Arc<AtomicBool>, JoinHandle<()>), Box<dyn Error>> {
    let name = offer.name.to_owned();
    let transport = network.reader(&name, Some(offer.listen))?;
    let address = transport.address().ok_or_else(|| format!("{name}: it listens nowhere"))?;
    let budget = MemoryBudget::new(offer.memory);
    let file = Arc::new(open(path)?);
    let reader = Reader::new(file, &name, &address, offer.memory, &budget, RoleOptions::default())?;
    let stop = Arc::new(AtomicBool::new(false));
    let (flag, coordinator) = (Arc::clone(&stop), coordinator.to_owned());
    let (patience, verbose) = (options.patience, options.verbose);
    let thread = thread::spawn(move || {
        let mut log = |line: &str| {
            if verbose {
                eprintln!("{line}");
            }
        };
        match run_reader(&*transport, reader, &coordinator, patience, &flag, &mut log) {
            Ok(counters) if verbose => println!(
                "{name}: {} blocks served, {} of them from disk",
                counters.blocks_asked, counters.blocks_from_disk
            ),
            Ok(_) => {}
            Err(error) => eprintln!("{name}: {error}"),
        }
    });
    Ok((stop, thread))
}

fn report(done: &Coordinator) {
    let (progress, counters) = (done.progress(), done.counters());
    println!(
        "{} of {} cells; {} leases, {} lost, {} raced; {} cells came twice",
        progress.cells_done,
        progress.cells,
        progress.leases,
        progress.leases_lost,
        progress.leases_raced,
        counters.cells_repeated
    );
    println!(
        "{} nodes joined, {} were lost, {} peers were refused; {} messages, {:.1} MB",
        counters.joined,
        counters.lost,
        counters.refused,
        counters.messages,
        counters.bytes as f64 * 1e-6
    );
}

/// Renders the picture by this process alone and compares.
fn verify(done: &Coordinator, job: &Job, file: DiskSource) -> Result<(), Box<dyn Error>> {
    let budget = MemoryBudget::new(Bytes::mib(256));
    let threads = Threads::One;
    let aside = Renderer::bytes_needed(&job.scene, file.model(), &job.settings, &threads)?;
    let aside = budget.reserve(aside, "the picture")?;
    let octree = LazyOctree::open(Arc::new(file), &budget, OctreeOptions::default())?;
    drop(aside);
    let renderer = Renderer::new(&octree, &job.scene, &job.settings, &budget)?;
    let film = renderer.render(&threads, &mut |_| Control::Continue)?.into_complete()?;
    let bits = |pixels: &[[f32; 3]]| pixels.as_flattened().iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    if bits(film.pixels()) != bits(done.film().pixels()) {
        return Err("the picture differs from that of one process".into());
    }
    println!("identical to the picture of one process, bit for bit");
    Ok(())
}

/// A flag that follows ^C.
fn follow(interrupt: &Interrupt) -> Arc<AtomicBool> {
    let (stop, interrupt) = (Arc::new(AtomicBool::new(false)), interrupt.clone());
    let flag = Arc::clone(&stop);
    // Ends with the process.
    thread::spawn(move || {
        while !interrupt.is_requested() {
            thread::sleep(Duration::from_millis(50));
        }
        flag.store(true, Ordering::Relaxed);
    });
    stop
}

fn connect(options: &Options) -> Result<&str, Box<dyn Error>> {
    Ok(options.connect.as_deref().ok_or("--connect: where is the coordinator?")?)
}

pub fn work(
    options: &Options,
    network: &Network<'_>,
    interrupt: &Interrupt,
) -> Result<ExitCode, Box<dyn Error>> {
    let name = options.name.clone().unwrap_or_else(|| format!("worker {}", std::process::id()));
    let control = network.worker(&name)?;
    let data = network.worker(&format!("{name}, blocks"))?;
    let file = match &options.model {
        Some(path) => Some(Arc::new(open(path)?) as Arc<dyn BlockSource>),
        None => None,
    };
    let mut memory = options.memory;
    let serving = match (&options.serve, &options.model) {
        (Some(listen), Some(path)) => {
            let share = Bytes(memory.0 / 4);
            memory = Bytes(memory.0 - share.0);
            let offer = Offer { name: &format!("{name}, part of the blocks"), listen, memory: share };
            Some(serve(options, network, path, connect(options)?, &offer)?)
        }
        _ => None,
    };
    let copy = match &options.keep {
        Some(path) => Some(CopyOptions::new(path, network.worker(&format!("{name}, copy"))?)),
        None => None,
    };
    let worker = WorkerOptions {
        lanes: options.lanes,
        file,
        copy,
        waiting: options.waiting,
        loader_threads: options.loaders,
        patience: options.patience,
        ..WorkerOptions::new(name, MemoryBudget::new(memory))
    };
    let mut log = |line: &str| {
        if options.verbose {
            eprintln!("{line}");
        }
    };
    let report = run_worker(&*control, &data, connect(options)?, &worker, &follow(interrupt), &mut log)?;
    if let Some((_, serving)) = serving {
        // Others may be in the middle of something.
        let _ = serving.join();
    }
    println!("{} cells; {} blocks loaded", report.worker.cells, report.trace.blocks_loaded);
    if options.waiting != WaitingRays::Never {
        println!(
            "up to {} rays of a lane waited, and up to {} blocks were asked for at one time; {:.2} s without tracing",
            report.trace.suspended_peak,
            report.loads.in_flight_peak,
            report.loads.loading.as_secs_f64()
        );
    }
    if let Some(remote) = report.remote {
        println!(
            "blocks from their readers {}, from other readers {}, from all that hold hot ones {}, from disk {}, from the copy {}; damaged {}; {} messages asked for them",
            remote.from_owner,
            remote.from_other,
            remote.from_replica,
            remote.from_fallback,
            remote.from_copy,
            remote.damaged,
            remote.requests
        );
    }
    if let Some(copy) = report.copy {
        println!(
            "a copy of the file, {}: {} blocks kept, {} fetched; damaged {}",
            if copy.is_complete { "complete" } else { "not complete yet" },
            copy.blocks_kept,
            copy.blocks_fetched,
            copy.damaged
        );
    }
    Ok(ExitCode::SUCCESS)
}

pub fn read(
    options: &Options,
    network: &Network<'_>,
    interrupt: &Interrupt,
) -> Result<ExitCode, Box<dyn Error>> {
    let name = options.name.clone().unwrap_or_else(|| format!("reader {}", std::process::id()));
    let path = options.model.as_ref().ok_or("a reader needs the compiled model")?;
    let transport = network.reader(&name, options.listen.as_deref())?;
    let own = transport.address().ok_or("the reader listens nowhere")?;
    let address = options.advertise.clone().unwrap_or(own);
    let budget = MemoryBudget::new(options.memory);
    let file = Arc::new(open(path)?);
    let reader = Reader::new(file, &name, &address, options.memory, &budget, RoleOptions::default())?;
    let mut log = |line: &str| {
        if options.verbose {
            eprintln!("{line}");
        }
    };
    let stop = follow(interrupt);
    let counters = run_reader(&*transport, reader, connect(options)?, options.patience, &stop, &mut log)?;
    println!(
        "{} blocks served, {} of them from disk; {:.1} MB",
        counters.blocks_asked,
        counters.blocks_from_disk,
        counters.bytes_sent as f64 * 1e-6
    );
    Ok(ExitCode::SUCCESS)
}
