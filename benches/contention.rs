//! Two threads that share an octree beside two processes that share nothing: what threads lose to each other on resident blocks.
//!
//!     cargo bench --bench contention -- [--n WHEELS] [--side PIXELS] [--repetitions N] [--rounds N]
//!
//! Both trace the same rays of the gears, each of the two all of them, at the same time; kind by kind and in turn. Wants both cores
//! of the machine to itself: the ratios by processor time say what is left of that wish.

#[path = "support/rays.rs"]
mod rays;

use std::error::Error;
use std::io::{BufRead, BufReader, Write, stdin, stdout};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Barrier};
use std::time::Instant;

use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::geom::Ray;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::Gears;
use outcrop::source::DiskSource;
use outcrop::trace::{Hit, Occlusion, Tracer};
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};
use rays::numbers::{Random, dot, unit};
use rays::{any_direction, camera_ray};

const KINDS: [&str; 3] = ["camera", "shadow", "bounce"];
/// In a call, so that hits stay in the first cache.
const RAYS_PER_CALL: usize = 128;
/// Squares of the picture, whose rays follow each other.
const TILE: u32 = 32;
const WORKERS: usize = 2;

/// The rays of each kind.
struct Rays([Vec<Ray>; 3]);

/// What one worker says of one kind.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Run {
    wall: f64,
    cpu: f64,
    /// Of the answers.
    sum: u64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut n, mut side, mut repetitions, mut rounds) = (4, 512, 4, 5);
    let mut arguments = std::env::args().skip(1);
    let mut file = None;
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument}: a value is missing"));
        match argument.as_str() {
            "--bench" => {}
            // Only to see that it runs.
            "--test" => (n, side, repetitions, rounds) = (1, 64, 1, 1),
            "--n" => n = value()?.parse()?,
            "--side" => side = value()?.parse()?,
            "--repetitions" => repetitions = value()?.parse()?,
            "--rounds" => rounds = value()?.parse()?,
            // What the processes are started with.
            "--worker" => file = Some(value()?),
            // A filter of another benchmark's names, as `cargo bench NAME` passes it to all.
            _ => return Ok(()),
        }
    }
    if let Some(file) = file {
        return worker(Path::new(&file), side, repetitions);
    }
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("gears.outcrop");
    let gears = Gears::new(n)?;
    let budget = MemoryBudget::new(Bytes::mib(1024));
    compile_shape(&gears, &path, &CompileOptions::default(), &budget, &mut |_| Control::Continue)?;
    drop(budget);
    let octree = open(&path)?;
    let rays = Rays::new(&octree, side)?;
    let arguments = ["--worker".into(), path.into_os_string(), "--side".into(), side.to_string().into()];
    let mut processes = Vec::new();
    for _ in 0..WORKERS {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(&arguments).args(["--repetitions", &repetitions.to_string()]);
        processes.push(Process::start(&mut command)?);
    }
    // Of wall and processor time, by kind.
    let (mut walls, mut cpus) = ([const { Vec::new() }; 3], [const { Vec::new() }; 3]);
    let mut rates = [const { Vec::new() }; 3];
    for round in 0..rounds {
        for (kind, of_kind) in rays.0.iter().enumerate() {
            let (apart, together) = if round % 2 == 0 {
                let apart = of_processes(&mut processes, kind)?;
                (apart, of_threads(&octree, of_kind, kind, repetitions)?)
            } else {
                let together = of_threads(&octree, of_kind, kind, repetitions)?;
                (of_processes(&mut processes, kind)?, together)
            };
            let sum = apart[0].sum;
            assert!(apart.iter().chain(&together).all(|run| run.sum == sum), "all answers are the same");
            let count = (of_kind.len() * repetitions) as f64;
            let rate = |runs: &[Run], time: fn(&Run) -> f64| {
                runs.iter().map(|run| 1e-6 * count / time(run)).sum::<f64>()
            };
            let pair = [rate(&apart, |run| run.wall), rate(&together, |run| run.wall)];
            walls[kind].push(pair[1] / pair[0]);
            cpus[kind].push(rate(&together, |run| run.cpu) / rate(&apart, |run| run.cpu));
            rates[kind].push(pair);
        }
    }
    println!(
        "gears {n}, {side} x {side} pixels, all blocks resident, certified; median of {rounds} rounds\n"
    );
    println!(
        "| rays | two processes, M rays/s together | two threads | threads / processes | least, greatest | by processor time |"
    );
    println!("|---|---|---|---|---|---|");
    for (kind, name) in KINDS.iter().enumerate() {
        let of = |column: usize| median(rates[kind].iter().map(|pair: &[f64; 2]| pair[column]));
        let ratios = walls[kind].iter().copied();
        println!(
            "| {name} | {:.2} | {:.2} | {:.3} | {:.3}, {:.3} | {:.3} |",
            of(0),
            of(1),
            median(ratios.clone()),
            ratios.clone().fold(f64::INFINITY, f64::min),
            ratios.fold(0.0, f64::max),
            median(cpus[kind].iter().copied()),
        );
    }
    Ok(())
}

fn open(path: &Path) -> Result<LazyOctree, Box<dyn Error>> {
    let budget = MemoryBudget::new(Bytes::mib(4096));
    let options = OctreeOptions { tracers_max: WORKERS as u32, ..OctreeOptions::default() };
    Ok(LazyOctree::open(Arc::new(DiskSource::open(path)?), &budget, options)?)
}

impl Rays {
    /// Of the standard view, from its hits to one lamp after the other, and from its hits anywhere. Touches their blocks.
    fn new(octree: &LazyOctree, side: u32) -> Result<Rays, Box<dyn Error>> {
        let mut camera = Vec::new();
        let tiles = side.div_ceil(TILE);
        for place in (0..tiles * tiles).flat_map(|tile| (0..TILE * TILE).map(move |pixel| (tile, pixel))) {
            let [x, y] = [place.0 % tiles * TILE + place.1 % TILE, place.0 / tiles * TILE + place.1 / TILE];
            if x < side && y < side {
                camera.push(camera_ray([x, y], side));
            }
        }
        let mut hits = vec![None; camera.len()];
        octree.tracer()?.closest_hits(&camera, &mut hits)?;
        let met = || camera.iter().zip(&hits).filter_map(|(ray, hit)| hit.as_ref().map(|hit| (ray, hit)));
        let side_of = |ray: &Ray, hit: &Hit| {
            let normal = unit(hit.normal());
            let towards = -dot(normal, ray.direction).signum();
            [0, 1, 2].map(|axis| towards * normal[axis])
        };
        let start = |hit: &Hit, normal: [f64; 3]| {
            let position = hit.position();
            [0, 1, 2].map(|axis| position[axis] + 1e-6 * normal[axis])
        };
        let mut shadows = Vec::new();
        for lamp in Gears::LAMPS {
            for (ray, hit) in met() {
                let normal = side_of(ray, hit);
                let origin = start(hit, normal);
                let direction = [0, 1, 2].map(|axis| lamp[axis] - origin[axis]);
                if dot(direction, normal) > 0.0 {
                    shadows.push(Ray { t_max: 1.0, ..Ray::new(origin, direction) });
                }
            }
        }
        let mut random = Random(1);
        let bounces = met()
            .map(|(ray, hit)| {
                let (normal, any) = (side_of(ray, hit), any_direction(&mut random));
                Ray::new(start(hit, normal), [0, 1, 2].map(|axis| 1.0001 * normal[axis] + any[axis]))
            })
            .collect();
        let rays = Rays([camera, shadows, bounces]);
        let mut tracer = octree.tracer()?;
        for (kind, rays) in rays.0.iter().enumerate() {
            trace(&mut tracer, rays, kind, 1)?;
        }
        Ok(rays)
    }
}

/// All rays of a kind, so many times.
fn trace(
    tracer: &mut Tracer<'_>,
    rays: &[Ray],
    kind: usize,
    repetitions: usize,
) -> Result<Run, Box<dyn Error>> {
    let (mut hits, mut occlusions) = ([None; RAYS_PER_CALL], [Occlusion::Clear; RAYS_PER_CALL]);
    let (wall, cpu) = (Instant::now(), thread_cpu_seconds());
    let mut sum = 0u64;
    for _ in 0..repetitions {
        for call in rays.chunks(RAYS_PER_CALL) {
            if KINDS[kind] == "shadow" {
                let occlusions = &mut occlusions[..call.len()];
                tracer.occluded(call, None, occlusions)?;
                sum += occlusions.iter().filter(|occlusion| **occlusion == Occlusion::Blocked).count() as u64;
            } else {
                let hits: &mut [Option<Hit>] = &mut hits[..call.len()];
                tracer.closest_hits(call, hits)?;
                for hit in hits.iter().flatten() {
                    sum = sum.rotate_left(5).wrapping_add(hit.t.to_bits() ^ hit.triangle.0);
                }
            }
        }
    }
    Ok(Run { wall: wall.elapsed().as_secs_f64(), cpu: thread_cpu_seconds() - cpu, sum })
}

/// Processor time of this thread; the wall's where the system has no such clock.
fn thread_cpu_seconds() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
    }
    #[cfg(not(unix))]
    {
        static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
        START.get_or_init(Instant::now).elapsed().as_secs_f64()
    }
}

fn of_threads(
    octree: &LazyOctree,
    rays: &[Ray],
    kind: usize,
    repetitions: usize,
) -> Result<Vec<Run>, Box<dyn Error>> {
    let barrier = Barrier::new(WORKERS);
    std::thread::scope(|scope| {
        let one = || -> Result<Run, String> {
            // As a process has its own.
            let rays = rays.to_vec();
            let tracer = octree.tracer().map_err(|error| error.to_string());
            barrier.wait();
            trace(&mut tracer?, &rays, kind, repetitions).map_err(|error| error.to_string())
        };
        let threads: Vec<_> = (0..WORKERS).map(|_| scope.spawn(one)).collect();
        threads.into_iter().map(|thread| Ok(thread.join().map_err(|_| "a thread panicked")??)).collect()
    })
}

/// A process with an octree of its own, whose blocks are resident.
struct Process {
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Process {
    fn start(command: &mut Command) -> Result<Process, Box<dyn Error>> {
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let orders = child.stdin.take().ok_or("no pipe to the process")?;
        let answers = BufReader::new(child.stdout.take().ok_or("no pipe from the process")?);
        let mut process = Process { child, orders, answers };
        process.line()?;
        Ok(process)
    }

    fn line(&mut self) -> Result<String, Box<dyn Error>> {
        let mut line = String::new();
        match self.answers.read_line(&mut line)? {
            0 => Err("a process ended early".into()),
            _ => Ok(line),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn of_processes(processes: &mut [Process], kind: usize) -> Result<Vec<Run>, Box<dyn Error>> {
    for process in processes.iter_mut() {
        writeln!(process.orders, "{kind}")?;
    }
    processes
        .iter_mut()
        .map(|process| {
            let line = process.line()?;
            let mut words = line.split_whitespace();
            let mut word = || words.next().ok_or("a word is missing");
            Ok(Run { wall: word()?.parse()?, cpu: word()?.parse()?, sum: word()?.parse()? })
        })
        .collect()
}

/// What a process does: it traces the kind that each line asks for.
fn worker(path: &Path, side: u32, repetitions: usize) -> Result<(), Box<dyn Error>> {
    let octree = open(path)?;
    let rays = Rays::new(&octree, side)?;
    println!("ready");
    stdout().flush()?;
    for line in stdin().lines() {
        let kind: usize = line?.trim().parse()?;
        let run = trace(&mut octree.tracer()?, &rays.0[kind], kind, repetitions)?;
        println!("{} {} {}", run.wall, run.cpu, run.sum);
        stdout().flush()?;
    }
    Ok(())
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
