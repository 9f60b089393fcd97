//! The simulation against what can be worked out by hand, and the scheduler's goals on a made-up image.

use super::cost_image::cells;
use super::*;
use crate::error::ScheduleError;
use crate::schedule::{CentralPoints, ImageGrid, PieceChoice, SchedulerOptions, TilePolicy};

/// A plain with a steep hill: the dearest cell costs 20 times what the cheapest does. A block lies under every square of 32 pixels.
fn hill(side: u32, seconds_per_cell: f64) -> CostImage {
    let grid = ImageGrid::new(side, side, 64, 8).unwrap();
    let across = side.div_ceil(32);
    let block = BlockSize { stored_bytes: 20_000, triangles: 3000 };
    let mut image = CostImage::new(grid.clone(), vec![block; (across * across) as usize]);
    for (_, _, region) in cells(&grid) {
        let Some(region) = region else {
            image.push(0.0, []);
            continue;
        };
        let [x, y] = [region.x, region.y].map(|at| f64::from(at) / f64::from(side) - 0.7);
        let height = 1.0 + 19.0 * (-(x * x + y * y) / 0.02).exp();
        image.push(seconds_per_cell * height, [region.y / 32 * across + region.x / 32]);
    }
    image
}

/// No network, no disk: only the scheduler's own losses.
fn ideal() -> ClusterModel {
    ClusterModel {
        latency_seconds: 0.0,
        worker_bytes_per_second: f64::INFINITY,
        coordinator_bytes_per_second: f64::INFINITY,
        message_seconds: 0.0,
        decision_seconds: 0.0,
        disk_seconds: 0.0,
        disk_bytes_per_second: f64::INFINITY,
        triangle_seconds: 0.0,
        ..ClusterModel::default()
    }
}

#[test]
fn one_ideal_worker_takes_as_long_as_the_work() {
    let costs = hill(256, 1e-3);
    let report = simulate(&costs, &ideal(), SchedulerOptions::new(1), 1).unwrap();
    assert!((report.seconds - costs.total_seconds()).abs() < 1e-5, "{report:?}");
    assert!((report.efficiency() - 1.0).abs() < 1e-4);
    assert_eq!((report.loads, report.schedule.cells_repeated), (64, 0));
    assert!((report.render_seconds - costs.total_seconds()).abs() < 1e-6 && report.wasted_seconds < 1e-9);
}

#[test]
fn times_add_up() {
    let policies = [
        TilePolicy::Rows,
        TilePolicy::Nearest(CentralPoints::Even),
        TilePolicy::TradeOff { points: CentralPoints::Diagonals, weight: 0.5 },
        TilePolicy::Curve,
    ];
    // Idle workers take over by place in the small image, by blocks in the large one.
    // Of the small image, much is still under way twice when its last cell arrives.
    for (side, policy) in [512, 64].into_iter().flat_map(|side| policies.map(|policy| (side, policy))) {
        let costs = hill(side, 1e-3);
        let piece_choice = if side == 512 { PieceChoice::Held } else { PieceChoice::Near };
        let options = SchedulerOptions { policy, piece_choice, ..SchedulerOptions::new(6) };
        let report = simulate(&costs, &ClusterModel::default(), options, 6).unwrap();
        // At speed 1, what counted is the work of the image.
        assert!((report.render_seconds - costs.total_seconds()).abs() < 1e-4, "{policy:?}: {report:?}");
        let spent = report.render_seconds + report.load_seconds + report.wasted_seconds;
        assert!(spent <= 6.0 * report.seconds * (1.0 + 1e-9));
        assert!(report.of_bound() <= 1.0 && report.loads >= report.sequential_loads);
        assert_eq!(simulate(&costs, &ClusterModel::default(), options, 6).unwrap(), report);
    }
}

/// The goals of the design, on an image whose costs are uneven and not known before.
#[test]
fn the_default_reaches_its_goals() {
    for (side, workers, goal) in [(512, 6, 0.97), (1024, 64, 0.95)] {
        // As much work for each worker in both.
        let costs = hill(side, 10e-3 * f64::from(workers) * 512.0 * 512.0 / f64::from(side * side) / 6.0);
        let report =
            simulate(&costs, &ClusterModel::default(), SchedulerOptions::new(workers), workers).unwrap();
        assert!(report.efficiency() > goal, "{workers}: {}, {report:?}", report.efficiency());
    }
}

#[test]
fn fast_workers_get_more() {
    let costs = hill(512, 4e-3);
    let model = ClusterModel { speeds: vec![1.0, 0.25, 2.0], ..ClusterModel::default() };
    let efficiency = |learn_speeds| {
        let options = SchedulerOptions { learn_speeds, ..SchedulerOptions::new(6) };
        simulate(&costs, &model, options, 6).unwrap().efficiency()
    };
    assert!(efficiency(true) > 0.95, "{}", efficiency(true));
}

#[test]
fn lost_workers_cost_their_share_and_no_pixel() {
    let costs = hill(512, 4e-3);
    let run = |losses: Vec<(f64, u32)>| {
        let model = ClusterModel { losses, ..ClusterModel::default() };
        simulate(&costs, &model, SchedulerOptions::new(6), 6)
    };
    let whole = run(vec![]).unwrap();
    // Two of six are gone for half of the time.
    let half = whole.seconds / 2.0;
    let lossy = run(vec![(half, 0), (half, 5)]).unwrap();
    assert!(lossy.schedule.cells_done == lossy.schedule.cells && lossy.schedule.leases_lost > 0);
    let expected = half + half * 6.0 / 4.0;
    assert!((lossy.seconds / expected - 1.0).abs() < 0.1, "{} for {expected}", lossy.seconds);
    // One vanishes near the end: what it held is done by others before it is given up.
    let late = run(vec![(whole.seconds * 0.97, 3)]).unwrap();
    assert!(late.seconds < whole.seconds * 1.1, "{} for {}", late.seconds, whole.seconds);
    let all = (0..6).map(|worker| (half, worker)).collect();
    assert!(matches!(run(all), Err(ScheduleError::Option { .. })));
}

#[test]
fn small_caches_load_again() {
    let costs = hill(512, 1e-3);
    let loads = |slots| {
        let model = ClusterModel { slots, ..ClusterModel::default() };
        sequential(&model, &costs)
    };
    let (ample, tight) = (loads(None), loads(Some(1)));
    assert_eq!((ample.loads, ample.blocks_touched), (256, 256));
    // A block's cells come one after the other along the curve.
    assert_eq!(tight.loads, 256);
    let model = ClusterModel { slots: Some(0), ..ideal() };
    assert_eq!(sequential(&model, &costs).loads, 256, "a cache has one slot at least");
}

/// Relays take load off the coordinator and lose nothing.
#[test]
fn relays_gather_messages() {
    let costs = hill(1024, 1e-3);
    let run = |relays| {
        let model = ClusterModel { relays, ..ClusterModel::default() };
        simulate(&costs, &model, SchedulerOptions::new(256), 256).unwrap()
    };
    let (flat, tree) = (run(None), run(Some(Relays { count: 16, gather_seconds: 1e-3 })));
    assert_eq!(tree.schedule.cells_done, tree.schedule.cells);
    assert!(tree.messages < flat.messages && tree.coordinator_load < flat.coordinator_load);
    assert!((tree.render_seconds - flat.render_seconds).abs() < 1e-4);
}

fn two_levels(
    costs: &CostImage,
    model: &ClusterModel,
    workers: u32,
    level: &SecondLevel,
) -> SimulationReport {
    let options = SchedulerOptions::for_sub_coordinator(workers / level.parts.expected);
    simulate_two_levels(costs, model, options, workers, level).unwrap()
}

/// With so many workers one coordinator is busy all the time; under sub-coordinators the picture takes half as long, and the top
/// has a tenth of the messages.
#[test]
fn sub_coordinators_take_the_load() {
    let costs = hill(1024, 20e-3);
    let flat = simulate(&costs, &ClusterModel::default(), SchedulerOptions::new(2500), 2500).unwrap();
    let tree = two_levels(&costs, &ClusterModel::default(), 2500, &SecondLevel::new(50));
    assert_eq!(tree.schedule.cells_done, tree.schedule.cells);
    assert!((tree.render_seconds - costs.total_seconds()).abs() < 1e-3, "{tree:?}");
    let spent = tree.render_seconds + tree.load_seconds + tree.wasted_seconds;
    assert!(spent <= 2500.0 * tree.seconds * (1.0 + 1e-9) && tree.of_bound() <= 1.0);
    assert!(tree.coordinator_load < 0.5 && tree.sub_coordinator_load < 0.9, "{tree:?}");
    assert!(tree.messages < flat.messages / 10, "{} of {}", tree.messages, flat.messages);
    assert!(tree.seconds < flat.seconds / 2.0, "{} of {}", tree.seconds, flat.seconds);
    assert_eq!(two_levels(&costs, &ClusterModel::default(), 2500, &SecondLevel::new(50)), tree);
}

/// One sub-coordinator of four is gone for half of the time, and its workers for as long as that is not noticed.
#[test]
fn a_lost_sub_coordinator_costs_little_and_no_pixel() {
    let costs = hill(512, 100e-3);
    let whole = two_levels(&costs, &ClusterModel::default(), 64, &SecondLevel::new(4));
    let losses = vec![(whole.seconds / 2.0, 1)];
    let model = ClusterModel {
        losses: vec![(whole.seconds / 3.0, 60)],
        loss_noticed_seconds: 0.2,
        ..ClusterModel::default()
    };
    let lossy = two_levels(&costs, &model, 64, &SecondLevel { losses, ..SecondLevel::new(4) });
    assert_eq!((lossy.schedule.cells_done, lossy.schedule.workers), (lossy.schedule.cells, 63));
    assert!((lossy.render_seconds - costs.total_seconds()).abs() < 1e-3, "{lossy:?}");
    assert!(lossy.seconds < whole.seconds * 1.25, "{} for {}", lossy.seconds, whole.seconds);
    let all = SecondLevel { losses: (0..4).map(|sub| (0.1, sub)).collect(), ..SecondLevel::new(4) };
    let options = SchedulerOptions::for_sub_coordinator(16);
    let error = simulate_two_levels(&costs, &model, options, 64, &all);
    assert!(matches!(error, Err(ScheduleError::Option { .. })));
}

#[test]
fn an_image_in_other_tiles_costs_the_same() {
    // Tiles at the border hold fewer cells.
    let costs = hill(200, 1e-3);
    for (tile, cell) in [(64, 8), (32, 32), (64, 16), (16, 8), (8, 8)] {
        let other = costs.in_tiles(tile, cell).unwrap();
        assert!((other.total_seconds() - costs.total_seconds()).abs() < 1e-6);
        let places = cells(other.grid()).filter(|(_, _, region)| region.is_some());
        for (tile, cell, region) in places {
            let block = region.unwrap().y / 32 * 7 + region.unwrap().x / 32;
            let entered = other.accesses(tile, cell);
            assert!(!entered.is_empty() && entered.iter().all(|entered| *entered == block));
        }
        let run = sequential(&ClusterModel::default(), &other);
        assert_eq!((run.loads, run.blocks_touched), (49, 49));
    }
    assert_eq!(costs.in_tiles(64, 8).unwrap(), costs);
    assert!(costs.in_tiles(12, 12).is_err() && costs.in_tiles(8, 4).is_err());
}
