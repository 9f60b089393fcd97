//! The library's scheduler on simulated clusters of 2 to 10,000 workers, over costs that are measured here and now.
//!
//! Scenes are traced at a small size, with counters for each cell of the picture; each traced pixel then stands for a few of the full
//! picture. Results and what they mean: `docs/results/cluster-simulation.md`.

#[macro_use]
#[path = "../common/mod.rs"]
mod common;

#[path = "../../benches/support/paths.rs"]
mod paths;
#[path = "../../benches/support/plain_scheduler.rs"]
mod plain_scheduler;
#[path = "../../benches/support/scenes.rs"]
mod scenes;
mod tables;

use std::error::Error;
use std::process::ExitCode;

use common::arguments::{self, Arguments};
use outcrop::schedule::ImageGrid;
use outcrop::schedule::simulation::{AccessDetail, CostImage, CostModel, measure};
use outcrop::trace::Tracer;
use scenes::Scene;

const HELP: &str = "\
simulate_cluster: the real scheduler over measured costs and a model of network, disks and caches

    cargo run --release --example simulate_cluster -- --n 8

    --n N             size of the scenes: N x N x N wheels, or as many triangles of tori (3)
    --size PIXELS     side of the picture that is rendered (4096)
    --traced PIXELS   side of the picture that is traced to know the costs; divides --size (512)
    --cell PIXELS     side of the smallest part that is handed out; a tile is 8 times as large (8)
    --samples N       samples per pixel: every cost times N (64)
    --workers LIST    numbers of workers (2,6,64,1024,10000)
    --levels          only the tables of one and of two levels of coordinators
    --pieces          only the tables of which piece of the curve an idle worker takes over
    --quick           a small setting that only shows that all of it runs
";

/// What the command line says.
struct Options {
    n: u32,
    size: u32,
    traced: u32,
    cell: u32,
    samples: u32,
    workers: Vec<u32>,
    only_levels: bool,
    only_pieces: bool,
}

fn main() -> ExitCode {
    arguments::run(run)
}

fn parse(mut arguments: Arguments) -> Result<Option<Options>, Box<dyn Error>> {
    let mut options = Options {
        n: 3,
        size: 4096,
        traced: 512,
        cell: 8,
        samples: 64,
        workers: vec![2, 6, 64, 1024, 10_000],
        only_levels: false,
        only_pieces: false,
    };
    while let Some(name) = arguments.option()? {
        match name.as_str() {
            "--n" => options.n = arguments.value()?,
            "--size" => options.size = arguments.value()?,
            "--traced" => options.traced = arguments.value()?,
            "--cell" => options.cell = arguments.value()?,
            "--samples" => options.samples = arguments.value()?,
            "--workers" => {
                options.workers = arguments.number_list()?.iter().map(|count| *count as u32).collect();
            }
            "--levels" => options.only_levels = true,
            "--pieces" => options.only_pieces = true,
            "--quick" => {
                let workers = vec![2, 6, 64];
                options = Options { n: 1, size: 512, traced: 128, cell: 8, samples: 16, workers, ..options };
            }
            "-h" | "--help" => return Ok(None),
            _ => return Err(arguments.unknown()),
        }
    }
    let divides = |part: u32, whole: u32| part > 0 && whole.is_multiple_of(part);
    if !divides(options.traced, options.size) || !divides(options.size / options.traced, options.cell) {
        return Err("--traced: must divide --size, and a cell must hold whole traced pixels".into());
    }
    if options.workers.is_empty() || options.workers.contains(&0) || options.samples == 0 {
        return Err("--workers, --samples: there must be at least one".into());
    }
    Ok(Some(options))
}

fn run(arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let Some(options) = parse(arguments)? else {
        print!("{HELP}");
        return Ok(ExitCode::SUCCESS);
    };
    for scene in &Scene::three(options.n)? {
        let costs = costs(scene, &options, AccessDetail::Distinct)?;
        println!(
            "\n## {}\n\n{} triangles, {} x {} pixels, {} samples each",
            scene.name,
            scene.shape.triangle_count(),
            options.size,
            options.size,
            options.samples
        );
        if options.only_pieces {
            tables::piece_choices(&costs, &options.workers)?;
            drop(costs);
            tables::loads(&self::costs(scene, &options, AccessDetail::Sequence)?)?;
            continue;
        }
        if !options.only_levels {
            tables::by_workers(&costs, &options.workers)?;
            tables::ingredients(&costs, &options.workers)?;
        }
        tables::relays(&costs, &options.workers)?;
        tables::sub_coordinators(&costs, &options.workers)?;
        if options.only_levels {
            continue;
        }
        drop(costs);
        tables::loads(&self::costs(scene, &options, AccessDetail::Sequence)?)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Traces the scene. For the full picture, each traced pixel stands for a square of pixels; every entry into a block is kept only for
/// the picture as it is traced.
fn costs(scene: &Scene, options: &Options, detail: AccessDetail) -> Result<CostImage, Box<dyn Error>> {
    let directory = tempfile::tempdir()?;
    let mut octree = scene.open(directory.path())?;
    let size = options.traced;
    let stands_for = match detail {
        AccessDetail::Distinct => options.size / size,
        AccessDetail::Sequence => 1,
    };
    let cell = options.cell / stands_for;
    let grid = ImageGrid::new(size, size, 8 * cell, cell)?;
    let mut trace = |tracer: &mut Tracer<'_>, pixel| scene.paths.trace(tracer, pixel, size).map(|_| ());
    let model = CostModel::default();
    let costs = measure(&mut octree, &grid, detail, &model, &mut trace, &mut |_| {})?;
    let full = ImageGrid::new(size * stands_for, size * stands_for, 8 * options.cell, options.cell)?;
    let scale = f64::from(options.samples) * f64::from(stands_for).powi(2);
    Ok(costs.over(full).ok_or("the traced picture does not match the full one")?.scaled(scale))
}
