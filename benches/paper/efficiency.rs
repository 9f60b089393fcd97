//! Tables 4 and 5: the efficiency of the tile policies, and the big model on six workers. Both simulated: the real scheduler over
//! costs that are counted here, on machines and a network as in [`ClusterModel`]'s defaults (`docs/results/cluster-simulation.md`).
//! So the figures are the same on every machine.

use std::error::Error;

use outcrop::schedule::simulation::{
    AccessDetail, ClusterModel, CostImage, CostModel, measure, sequential, simulate,
};
use outcrop::schedule::{CentralPoints, ImageGrid, SchedulerOptions, TilePolicy};
use outcrop::trace::Tracer;

use crate::big::Big;
use crate::drive::path;
use crate::plain_scheduler::plain;
use crate::rays::camera_ray;
use crate::scenes::Scene;

/// Numbers of workers in the paper's Table 4.
const WORKERS: [u32; 3] = [2, 4, 6];
/// Each cost counts so many times: a picture of so many samples per pixel.
const SAMPLES: f64 = 64.0;

pub fn tables_4(n: u32, size: u32) -> Result<(), Box<dyn Error>> {
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

/// The big model on six workers, each with a disk of its own and 6 % of the slots.
pub fn table_5(big: &Big, size: u32) -> Result<(), Box<dyn Error>> {
    println!(
        "\nTable 5 (simulated): the big model ({} triangles) on 6 workers, {size} x {size} pixels,",
        big.triangles
    );
    println!(
        "each with 6 % of the blocks and the file on its own disk; loads of all over those of one machine."
    );
    println!(
        "The paper, 83 M triangles: loads 2.8 times those of one machine; each block loaded 131 times at depth 12."
    );
    println!("Rays and accesses are those of one machine, by construction: each cell is rendered once.\n");
    println!(
        "| depth | efficiency % | loads / one machine's | loads per touched block, 6 workers | one machine |"
    );
    println!("|---|---|---|---|---|");
    for depth in [1, 6, 12] {
        let mut octree = big.open(100.0)?;
        let grid = ImageGrid::new(size, size, 64, 8)?;
        let mix = big.mix(depth);
        let mut trace = |tracer: &mut Tracer<'_>, [x, y]: [u32; 2]| {
            path(tracer, mix, camera_ray([x, y], size), y * size + x).map(|_| ())
        };
        let costs = CostModel::default();
        let costs = measure(&mut octree, &grid, AccessDetail::Sequence, &costs, &mut trace, &mut |_| {})?;
        let slots = Some((costs.blocks().len() as f64 * 0.06).ceil() as u32);
        let model = ClusterModel { slots, ..ClusterModel::default() };
        let alone = sequential(&model, &costs);
        let report = simulate(&costs, &model, SchedulerOptions::new(6), 6)?;
        println!(
            "| {depth} | {:.1} | {:.2} | {:.1} | {:.1} |",
            100.0 * report.efficiency(),
            report.loads_ratio(),
            report.loads as f64 / alone.blocks_touched as f64,
            alone.loads as f64 / alone.blocks_touched as f64,
        );
    }
    Ok(())
}
