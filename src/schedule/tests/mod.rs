//! Any order of results, losses, joins and late answers: every cell is done once, none is lost, the render ends.

mod parts;
mod world;

use std::time::Duration;

use proptest::prelude::*;

use self::world::{World, event};
use super::*;
use crate::access::BlockSketch;
use crate::error::ScheduleError;
use crate::schedule::parts::{PartCells, PartNotice, PartOptions, PartReport};
use crate::units::{BlockId, LeaseId, SubCoordinatorId, TileId, WorkerId};

/// Every policy, and every switch in both positions.
fn all_options() -> impl Strategy<Value = SchedulerOptions> {
    let policies = prop_oneof![
        1 => Just(TilePolicy::Rows),
        1 => Just(TilePolicy::Nearest(CentralPoints::Even)),
        1 => (0.0..=1.0).prop_map(|weight| TilePolicy::TradeOff { points: CentralPoints::Diagonals, weight }),
        3 => Just(TilePolicy::Curve),
    ];
    let sides = prop_oneof![Just((64, 8)), Just((32, 32)), Just((16, 4)), Just((8, 4))];
    let switches = (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>());
    let numbers = (1u32..20, 1u32..5, prop_oneof![Just(0.0), 0.0..1.0]);
    (policies, sides, switches, numbers).prop_map(|(policy, (tile_side, cell_side), switches, numbers)| {
        let (critical_time, take_over, learn_speeds, five, held) = switches;
        let (expected_workers, leases_in_hand_max, share_of_rest) = numbers;
        SchedulerOptions {
            tile_side,
            cell_side,
            policy,
            piece_choice: if held { PieceChoice::Held } else { PieceChoice::Near },
            tiles_per_worker: if five { 5 } else { 0 },
            share_of_rest,
            critical_time,
            take_over,
            learn_speeds,
            leases_in_hand_max,
            lease_min: Duration::from_secs(2),
            ..SchedulerOptions::new(expected_workers)
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn every_cell_is_done_once_and_the_render_ends(
        options in all_options(),
        width in 1u32..200,
        height in 1u32..150,
        events in prop::collection::vec(event(), 0..250),
    ) {
        let mut world = World::new(width, height, options);
        for event in events {
            world.apply(event);
        }
        world.finish();
    }
}

fn scheduler(options: SchedulerOptions) -> AdaptiveScheduler {
    AdaptiveScheduler::new(200, 100, options).unwrap()
}

fn assignment(answer: Answer) -> Assignment {
    match answer {
        Answer::Assign(assignment) => assignment,
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_cannot_be_is_refused() {
    let mut scheduler = scheduler(SchedulerOptions::new(2));
    let now = Duration::ZERO;
    let stranger = WorkerId(7);
    assert_eq!(scheduler.request(stranger, now), Err(ScheduleError::UnknownWorker { worker: 7 }));
    scheduler.leave(stranger, now);
    scheduler.join(stranger, now);
    scheduler.join(stranger, now);
    assert_eq!(scheduler.progress().workers, 1);
    let result = |tile, cells| TileResult {
        lease: LeaseId(0),
        cells: TileCells { tile: TileId(tile), cells },
        is_last: true,
        spent: Spent { seconds: f64::NAN, work: f64::INFINITY },
        blocks: BlockSketch::default(),
    };
    let tiles = scheduler.grid().tile_count();
    for bad in [result(tiles, 1), result(u32::MAX, 0b11), result(tiles - 1, !0)] {
        let exists = scheduler.grid().cells_of(bad.cells.tile);
        assert!(bad.cells.cells & !exists != 0);
        assert!(matches!(scheduler.complete(stranger, &bad, now), Err(ScheduleError::NoSuchCells { .. })));
    }
    // Nothing of a tile that does not exist is not nothing of one that does.
    for tile in [tiles, u32::MAX] {
        let bad = result(tile, 0);
        let no_such = ScheduleError::NoSuchCells { tile, cells: 0, tile_count: tiles };
        assert_eq!(scheduler.complete(stranger, &bad, now), Err(no_such.clone()));
        let parts = PartOptions::new(1);
        let mut sub = SubScheduler::new(200, 100, SchedulerOptions::new(2), parts).unwrap();
        sub.told(&PartNotice::Grant(vec![PartCells { cells: bad.cells, work: 1.0 }]), now);
        assert_eq!(sub.complete(stranger, &bad, now), Err(no_such.clone()));
        let mut top = PartScheduler::new(scheduler.grid().clone(), parts).unwrap();
        let done = vec![PartCells { cells: bad.cells, work: 1.0 }];
        let given_up = Some(vec![bad.cells]);
        for report in
            [PartReport { done, ..PartReport::default() }, PartReport { given_up, ..PartReport::default() }]
        {
            assert_eq!(top.report(SubCoordinatorId(1), &report, now), Err(no_such.clone()));
        }
    }
    assert_eq!(scheduler.complete(stranger, &result(0, 0), now).unwrap().fresh.count(), 0);
    assert_eq!(scheduler.progress().cells_done, 0);
    // Numbers that are none do no harm.
    assert_eq!(scheduler.complete(stranger, &result(0, 1), now).unwrap().fresh.count(), 1);
    assignment(scheduler.request(stranger, now).unwrap());
}

/// Three workers on a row of tiles, a third each. The first is through when the others have five tiles left; the last one's tiles
/// need the blocks that the first one holds, those of the neighbour need others.
#[test]
fn an_idle_worker_goes_where_its_blocks_are_needed() {
    let taken_over = |piece_choice| {
        let options = SchedulerOptions {
            tile_side: 8,
            cell_side: 8,
            piece_choice,
            leases_in_hand_max: 1,
            ..SchedulerOptions::new(3)
        };
        let mut scheduler = AdaptiveScheduler::new(8 * 48, 8, options).unwrap();
        let mut now = Duration::ZERO;
        (0..3).for_each(|worker| scheduler.join(WorkerId(worker), now));
        let mut render = |scheduler: &mut AdaptiveScheduler, worker: u64| {
            let Assignment { lease, cells, .. } =
                assignment(scheduler.request(WorkerId(worker), now).unwrap());
            now += Duration::from_millis(10);
            let mut blocks = BlockSketch::default();
            let first = if cells.tile.0 / 16 == 1 { 100 } else { 0 };
            (first..first + 20).for_each(|block| blocks.add(BlockId(block), 512));
            let spent = Spent { seconds: 0.01, work: 0.01 };
            let result = TileResult { lease, cells, is_last: true, spent, blocks };
            assert_eq!(scheduler.complete(WorkerId(worker), &result, now).unwrap().fresh, cells);
            cells.tile.0
        };
        for worker in (0..22).map(|step| 1 + step % 2) {
            let tile = render(&mut scheduler, worker);
            assert_eq!(u64::from(tile / 16), worker);
        }
        (0..16).for_each(|_| assert_eq!(render(&mut scheduler, 0) / 16, 0));
        render(&mut scheduler, 0)
    };
    // The middles of what is left of their pieces.
    assert_eq!(taken_over(PieceChoice::Near), 29);
    assert_eq!(taken_over(PieceChoice::Held), 45);
}

/// A worker that only takes gets no more than it may hold.
#[test]
fn a_greedy_worker_has_to_wait() {
    let options = SchedulerOptions { leases_in_hand_max: 3, ..SchedulerOptions::new(2) };
    let mut scheduler = scheduler(options);
    let worker = WorkerId(0);
    scheduler.join(worker, Duration::ZERO);
    for _ in 0..3 {
        assignment(scheduler.request(worker, Duration::ZERO).unwrap());
    }
    assert_eq!(scheduler.request(worker, Duration::ZERO), Ok(Answer::Wait));
}
