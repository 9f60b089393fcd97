//! Tables of "Rendering complex scenes on clusters with limited precomputation" (Cadet, Zambal, Lecussan 2004), in the
//! paper's form, with today's library.
//!
//!     cargo bench --bench paper -- [--n WHEELS] [--size PIXELS]
//!
//! Table 4, the efficiency of the tile policies, is simulated: the real scheduler over costs that are counted here, on
//! machines and a network as in [`ClusterModel`]'s defaults (`docs/results/cluster-simulation.md`). So its figures are the same on every machine.

#[path = "support/paths.rs"]
mod paths;
#[path = "support/plain_scheduler.rs"]
mod plain_scheduler;
#[path = "support/scenes.rs"]
mod scenes;

use std::error::Error;

use outcrop::schedule::simulation::{
    AccessDetail, ClusterModel, CostImage, CostModel, measure, sequential, simulate,
};
use outcrop::schedule::{CentralPoints, ImageGrid, SchedulerOptions, TilePolicy};
use outcrop::trace::Tracer;
use plain_scheduler::plain;
use scenes::Scene;

/// Numbers of workers in the paper's Table 4.
const WORKERS: [u32; 3] = [2, 4, 6];
/// Each cost counts so many times: a picture of so many samples per pixel.
const SAMPLES: f64 = 64.0;

fn main() -> Result<(), Box<dyn Error>> {
    let (mut n, mut size) = (3, 512);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--bench" => {}
            // Only to see that it runs.
            "--test" => (n, size) = (1, 128),
            "--n" => n = arguments.next().ok_or("--n: a number is missing")?.parse()?,
            "--size" => size = arguments.next().ok_or("--size: a number is missing")?.parse()?,
            // A filter of another benchmark's names, as `cargo bench NAME` passes it to all.
            _ => return Ok(()),
        }
    }
    println!(
        "Table 4 (simulated): efficiency in % by policy, {size} x {size} pixels, {SAMPLES} samples each."
    );
    println!("The paper, adaptive method, three scenes, 6 workers: 75 to 83.");
    for scene in &Scene::three(n)? {
        table_4(scene, size)?;
    }
    Ok(())
}

fn table_4(scene: &Scene, size: u32) -> Result<(), Box<dyn Error>> {
    let directory = tempfile::tempdir()?;
    let mut octree = scene.open(directory.path())?;
    let grid = ImageGrid::new(size, size, 64, 8)?;
    let mut trace = |tracer: &mut Tracer<'_>, pixel| scene.paths.trace(tracer, pixel, size).map(|_| ());
    let costs = CostModel::default();
    let costs = measure(&mut octree, &grid, AccessDetail::Distinct, &costs, &mut trace, &mut |_| {})?;
    let costs = costs.scaled(SAMPLES);
    let fixed_costs = costs.in_tiles(32, 32)?;
    let model = ClusterModel { ask_ahead: false, ..ClusterModel::default() };
    println!(
        "\n{}: {} triangles, {:.0} s on one machine\n",
        scene.name,
        scene.shape.triangle_count(),
        sequential(&model, &costs).seconds
    );
    println!("| | {} |", WORKERS.map(|workers| format!("{workers} workers")).join(" | "));
    println!("|---|---|---|---|");
    // As the paper describes them: no speeds, no taking over, no asking ahead.
    let adaptive = |policy, workers| SchedulerOptions {
        policy,
        tiles_per_worker: 5,
        share_of_rest: 0.25,
        critical_time: true,
        ..plain(workers)
    };
    let (even, cross) = (CentralPoints::Even, CentralPoints::Diagonals);
    let row =
        |name: &str, costs: &CostImage, model: &ClusterModel, options: &dyn Fn(u32) -> SchedulerOptions| {
            let mut cells = Vec::new();
            for workers in WORKERS {
                let report = simulate(costs, model, options(workers), workers)?;
                assert_eq!(report.schedule.cells_done, report.schedule.cells, "every cell is done");
                cells.push(format!("{:.1}", 100.0 * report.efficiency()));
            }
            println!("| {name} | {} |", cells.join(" | "));
            Ok::<(), Box<dyn Error>>(())
        };
    row("fixed 32 x 32", &fixed_costs, &model, &plain)?;
    for (name, points) in [("even points", even), ("points on an X", cross)] {
        let near = TilePolicy::Nearest(points);
        row(&format!("adaptive, nearest, {name}"), &costs, &model, &|workers| adaptive(near, workers))?;
        let trade_off = TilePolicy::TradeOff { points, weight: 0.5 };
        row(&format!("adaptive, trade-off, {name}"), &costs, &model, &|workers| {
            adaptive(trade_off, workers)
        })?;
    }
    row("this library's default", &costs, &ClusterModel::default(), &SchedulerOptions::new)
}
