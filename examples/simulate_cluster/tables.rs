//! Simulations put side by side.

use std::error::Error;

use outcrop::schedule::simulation::{
    ClusterModel, CostImage, Relays, SecondLevel, SimulationReport, sequential, simulate, simulate_two_levels,
};
use outcrop::schedule::{CentralPoints, PieceChoice, SchedulerOptions, TilePolicy};

use crate::plain_scheduler::plain;

/// A simulation under one coordinator.
fn run(
    costs: &CostImage,
    model: &ClusterModel,
    options: SchedulerOptions,
    workers: u32,
) -> Result<SimulationReport, Box<dyn Error>> {
    check(costs, model, workers, simulate(costs, model, options, workers)?)
}

/// The figures of a simulation must make sense, whatever they are.
fn check(
    costs: &CostImage,
    model: &ClusterModel,
    workers: u32,
    report: SimulationReport,
) -> Result<SimulationReport, Box<dyn Error>> {
    assert_eq!(report.schedule.cells_done, report.schedule.cells, "every cell is done");
    let work: f64 = costs.total_seconds();
    let speeds: Vec<f64> = (0..workers).map(|worker| model.speed(worker)).collect();
    let [slowest, fastest] =
        [f64::min, f64::max].map(|best| speeds.iter().copied().reduce(best).unwrap_or(1.0));
    let counted = report.render_seconds;
    assert!(
        counted >= work / fastest * 0.999 && counted <= work / slowest * 1.001,
        "the image's work is done once"
    );
    let spent = counted + report.load_seconds + report.wasted_seconds;
    assert!(spent <= f64::from(workers) * report.seconds * 1.001, "nobody works more than all the time");
    Ok(report)
}

fn percent(part: f64) -> String {
    format!("{:.1}", 100.0 * part)
}

/// The default scheduler by number of workers.
pub fn by_workers(costs: &CostImage, workers: &[u32]) -> Result<(), Box<dyn Error>> {
    let model = ClusterModel::default();
    let alone = sequential(&model, costs);
    let (cell, tile) = costs.longest_seconds();
    println!(
        "\nOne machine: {:.1} s, {} loads. Longest cell {:.4} s, longest tile {:.3} s.\n",
        alone.seconds, alone.loads, cell, tile
    );
    println!(
        "| workers | seconds | efficiency % | of bound % | loading % | idle at start % | idle at end % | done twice % | loads / one machine's | MB | messages | coordinator busy % |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for workers in workers.iter().copied() {
        let report = run(costs, &model, SchedulerOptions::new(workers), workers)?;
        let all = f64::from(workers) * report.seconds;
        println!(
            "| {workers} | {:.2} | {} | {} | {} | {} | {} | {} | {:.2} | {:.0} | {} | {} |",
            report.seconds,
            percent(report.efficiency()),
            percent(report.of_bound()),
            percent(report.load_seconds / all),
            percent(report.idle_at_start_seconds / all),
            percent(report.idle_at_end_seconds / all),
            percent(report.wasted_seconds / all),
            report.loads_ratio(),
            report.bytes.0 as f64 * 1e-6,
            report.messages,
            percent(report.coordinator_load)
        );
    }
    Ok(())
}

/// What each part of the scheduler is worth: rows add one thing to the row before.
pub fn ingredients(costs: &CostImage, workers: &[u32]) -> Result<(), Box<dyn Error>> {
    let patient = ClusterModel { ask_ahead: false, ..ClusterModel::default() };
    let eager = ClusterModel::default();
    let near = TilePolicy::Nearest(CentralPoints::Even);
    type Change<'a> = (&'a str, &'a ClusterModel, &'a dyn Fn(u32) -> SchedulerOptions);
    let nearest = |workers| SchedulerOptions { policy: near, ..plain(workers) };
    let five = |workers| SchedulerOptions { tiles_per_worker: 5, ..nearest(workers) };
    let late = |workers| SchedulerOptions { share_of_rest: 0.25, ..five(workers) };
    let critical = |workers| SchedulerOptions { critical_time: true, ..late(workers) };
    let cross = |workers| SchedulerOptions {
        policy: TilePolicy::Nearest(CentralPoints::Diagonals),
        ..critical(workers)
    };
    let trade_off = |workers| SchedulerOptions {
        policy: TilePolicy::TradeOff { points: CentralPoints::Even, weight: 0.5 },
        ..critical(workers)
    };
    let curve =
        |workers| SchedulerOptions { policy: TilePolicy::Curve, critical_time: false, ..late(workers) };
    let speeds = |workers| SchedulerOptions { learn_speeds: true, ..curve(workers) };
    let take_over = |workers| SchedulerOptions { take_over: true, ..speeds(workers) };
    let long = |workers| SchedulerOptions {
        hand_out_min: SchedulerOptions::new(workers).hand_out_min,
        ..take_over(workers)
    };
    let side = costs.grid().tile_side();
    let coarse = costs.in_tiles(side / 2, side / 2)?;
    let rows: [Change<'_>; 13] = [
        ("fixed tiles of half the side, in rows", &patient, &plain),
        ("fixed tiles, in rows", &patient, &plain),
        ("nearest to even points", &patient, &nearest),
        ("+ at least five hand-outs per worker", &patient, &five),
        ("+ late subdivision, down to a cell", &patient, &late),
        ("+ critical time (the paper)", &patient, &critical),
        ("the same, points on an X", &patient, &cross),
        ("the same, trade-off 0.5", &patient, &trade_off),
        ("pieces of a curve in their place", &patient, &curve),
        ("+ learnt speeds", &patient, &speeds),
        ("+ taking over and racing", &patient, &take_over),
        ("+ asking ahead", &eager, &take_over),
        ("+ hand-outs not too short (default)", &eager, &long),
    ];
    let counts: Vec<u32> = workers.iter().copied().filter(|count| (6..=1024).contains(count)).collect();
    let names: Vec<String> = counts.iter().map(|count| format!("{count} workers")).collect();
    println!(
        "\nEfficiency in %, and on 6 workers of speeds 1, 0.5 and 2:\n\n| | {} | 6 mixed |",
        names.join(" | ")
    );
    println!("|---|{}", "---|".repeat(names.len() + 1));
    for (at, (name, model, options)) in rows.iter().enumerate() {
        let costs = if at == 0 { &coarse } else { costs };
        let mut cells = Vec::new();
        for workers in counts.iter().copied() {
            cells.push(percent(run(costs, model, options(workers), workers)?.efficiency()));
        }
        let mixed = ClusterModel { speeds: vec![1.0, 0.5, 2.0], ..(*model).clone() };
        cells.push(percent(run(costs, &mixed, options(6), 6)?.efficiency()));
        println!("| {name} | {} |", cells.join(" | "));
    }
    Ok(())
}

/// A second level that only gathers, between the coordinator and many workers.
pub fn relays(costs: &CostImage, workers: &[u32]) -> Result<(), Box<dyn Error>> {
    println!(
        "\n| workers | relays | seconds | efficiency % | coordinator busy % | messages | idle at start % | idle at end % |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for workers in workers.iter().copied().filter(|count| *count >= 64) {
        let square_root = workers.isqrt();
        for count in [0, square_root] {
            let relays = (count > 0).then_some(Relays { count, gather_seconds: 1e-3 });
            let model = ClusterModel { relays, ..ClusterModel::default() };
            // With relays, the coordinator needs no long hand-outs.
            let hand_out_min =
                SchedulerOptions::new(if count > 0 { count * 4 } else { workers }).hand_out_min;
            let options = SchedulerOptions { hand_out_min, ..SchedulerOptions::new(workers) };
            let report = run(costs, &model, options, workers)?;
            let all = f64::from(workers) * report.seconds;
            println!(
                "| {workers} | {count} | {:.2} | {} | {} | {} | {} | {} |",
                report.seconds,
                percent(report.efficiency()),
                percent(report.coordinator_load),
                report.messages,
                percent(report.idle_at_start_seconds / all),
                percent(report.idle_at_end_seconds / all)
            );
        }
    }
    Ok(())
}

/// A second level that decides.
pub fn sub_coordinators(costs: &CostImage, workers: &[u32]) -> Result<(), Box<dyn Error>> {
    println!(
        "\n| workers | sub-coordinators | seconds | efficiency % | of bound % | top busy % | busiest sub busy % | top's messages | loading % | idle at start % | idle at end % | done twice % |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let model = ClusterModel::default();
    for workers in workers.iter().copied().filter(|count| *count >= 64) {
        let square_root = workers.isqrt();
        for count in [0, square_root / 2, square_root, square_root * 2] {
            let report = if count == 0 {
                run(costs, &model, SchedulerOptions::new(workers), workers)?
            } else {
                let level = SecondLevel::new(count);
                let options = SchedulerOptions::for_sub_coordinator(workers.div_ceil(count));
                let report = simulate_two_levels(costs, &model, options, workers, &level)?;
                check(costs, &model, workers, report)?
            };
            let all = f64::from(workers) * report.seconds;
            println!(
                "| {workers} | {count} | {:.2} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
                report.seconds,
                percent(report.efficiency()),
                percent(report.of_bound()),
                percent(report.coordinator_load),
                percent(report.sub_coordinator_load),
                report.messages,
                percent(report.load_seconds / all),
                percent(report.idle_at_start_seconds / all),
                percent(report.idle_at_end_seconds / all),
                percent(report.wasted_seconds / all)
            );
        }
    }
    Ok(())
}

/// Which piece is taken over: efficiency and loads, with small caches and with large ones.
pub fn piece_choices(costs: &CostImage, workers: &[u32]) -> Result<(), Box<dyn Error>> {
    let blocks = costs.blocks().len() as u32;
    println!(
        "\n| workers | cache of each | one machine, loads per touched block | efficiency %, near | held | loads / one machine's, near | held | loads per touched block, near | held |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for share in [6, 25, 100] {
        let model = ClusterModel { slots: Some((blocks * share).div_ceil(100)), ..ClusterModel::default() };
        let alone = sequential(&model, costs);
        let touched = alone.blocks_touched.max(1) as f64;
        for workers in workers.iter().copied() {
            let reports = [PieceChoice::Near, PieceChoice::Held].map(|piece_choice| {
                let options = SchedulerOptions { piece_choice, ..SchedulerOptions::new(workers) };
                run(costs, &model, options, workers)
            });
            let [near, held] = reports;
            let (near, held) = (near?, held?);
            println!(
                "| {workers} | {share} % | {:.2} | {} | {} | {:.3} | {:.3} | {:.1} | {:.1} |",
                alone.loads as f64 / touched,
                percent(near.efficiency()),
                percent(held.efficiency()),
                near.loads_ratio(),
                held.loads_ratio(),
                near.loads as f64 / touched,
                held.loads as f64 / touched
            );
        }
    }
    Ok(())
}

/// Loads of 6 workers with small caches over those of one machine with one such cache.
pub fn loads(costs: &CostImage) -> Result<(), Box<dyn Error>> {
    const WORKERS: u32 = 6;
    let blocks = costs.blocks().len() as u32;
    println!("\nLoads of {WORKERS} workers over loads of one, {} x {0} pixels:\n", costs.grid().width());
    println!(
        "| cache of each | one machine, loads per touched block | curve | curve, held blocks | nearest, even points | trade-off 0.5 | rows |"
    );
    println!("|---|---|---|---|---|---|---|");
    let even = CentralPoints::Even;
    let policies = [
        (TilePolicy::Curve, PieceChoice::Near),
        (TilePolicy::Curve, PieceChoice::Held),
        (TilePolicy::Nearest(even), PieceChoice::Near),
        (TilePolicy::TradeOff { points: even, weight: 0.5 }, PieceChoice::Near),
        (TilePolicy::Rows, PieceChoice::Near),
    ];
    for share in [6, 25] {
        let model = ClusterModel { slots: Some((blocks * share).div_ceil(100)), ..ClusterModel::default() };
        let alone = sequential(&model, costs);
        let mut cells = Vec::new();
        for (policy, piece_choice) in policies {
            let options = SchedulerOptions { policy, piece_choice, ..SchedulerOptions::new(WORKERS) };
            cells.push(format!("{:.2}", run(costs, &model, options, WORKERS)?.loads_ratio()));
        }
        let per_block = alone.loads as f64 / alone.blocks_touched.max(1) as f64;
        println!("| {share} % | {per_block:.2} | {} |", cells.join(" | "));
    }
    Ok(())
}
