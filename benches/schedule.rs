//! What a decision of the scheduler takes, by policy and number of workers: one worker returns its cells and asks for
//! more, in the middle of a render of 4096 x 4096 pixels. And the same on two levels, with all that both levels say to each other.

use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use outcrop::TileScheduler;
use outcrop::access::BlockSketch;
use outcrop::schedule::parts::PartOptions;
use outcrop::schedule::{
    AdaptiveScheduler, Answer, Assignment, CentralPoints, ImageGrid, PartScheduler, PieceChoice,
    SchedulerOptions, Spent, SubScheduler, TilePolicy, TileResult,
};
use outcrop::units::{BlockId, SubCoordinatorId, TileId, WorkerId};

/// Blocks of a tile: a dozen of its own, and some that are everywhere.
fn blocks_of(tile: TileId) -> BlockSketch {
    let mut blocks = BlockSketch::default();
    let own = tile.0 % 3000..tile.0 % 3000 + 12;
    own.chain([3500, 3800]).for_each(|block| blocks.add(BlockId(block), 4000));
    blocks
}

/// A render under way: every worker holds one assignment.
struct Render {
    scheduler: AdaptiveScheduler,
    held: Vec<Option<Assignment>>,
    now: Duration,
    /// Who is next.
    worker: usize,
    fresh: u64,
}

impl Render {
    fn new((policy, piece_choice): (TilePolicy, PieceChoice), workers: usize) -> Render {
        let options = SchedulerOptions { policy, piece_choice, ..SchedulerOptions::new(workers as u32) };
        let scheduler = AdaptiveScheduler::new(4096, 4096, options).expect("valid options");
        let mut render =
            Render { scheduler, held: vec![None; workers], now: Duration::ZERO, worker: 0, fresh: 0 };
        (0..workers).for_each(|worker| render.scheduler.join(WorkerId(worker as u64), render.now));
        // Each has returned something once, so costs and speeds are known.
        for _ in 0..2 * workers {
            render.step();
        }
        render
    }

    /// One worker returns what it holds and asks for more.
    fn step(&mut self) {
        let worker = WorkerId(self.worker as u64);
        // Costs that vary.
        self.now += Duration::from_micros(20);
        if let Some(Assignment { lease, cells, .. }) = self.held[self.worker].take() {
            let work = f64::from(cells.count()) * 1e-3 * (1.0 + f64::from(cells.tile.0 % 17));
            let spent = Spent { seconds: work, work };
            let result = TileResult { lease, cells, is_last: true, spent, blocks: blocks_of(cells.tile) };
            let receipt = self.scheduler.complete(worker, &result, self.now).expect("cells of the image");
            self.fresh += u64::from(receipt.fresh.count());
        }
        let answer = self.scheduler.request(worker, self.now).expect("it joined");
        while self.scheduler.notice().is_some() {}
        let assignment = if let Answer::Assign(assignment) = answer { Some(assignment) } else { None };
        self.held[self.worker] = assignment;
        self.worker = (self.worker + 1) % self.held.len();
    }
}

/// A render under way on two levels.
struct TwoLevels {
    top: PartScheduler,
    subs: Vec<SubScheduler>,
    held: Vec<Option<Assignment>>,
    now: Duration,
    worker: usize,
    fresh: u64,
}

/// Workers of each sub-coordinator, and as many of these.
const SIDE: usize = 100;

impl TwoLevels {
    fn new() -> TwoLevels {
        let parts = PartOptions::new(SIDE as u32);
        let options = SchedulerOptions::for_sub_coordinator(SIDE as u32);
        let grid = ImageGrid::new(4096, 4096, options.tile_side, options.cell_side).expect("valid sides");
        let sub = |_| SubScheduler::new(4096, 4096, options, parts).expect("valid options");
        let mut render = TwoLevels {
            top: PartScheduler::new(grid, parts).expect("valid options"),
            subs: (0..SIDE).map(sub).collect(),
            held: vec![None; SIDE * SIDE],
            now: Duration::ZERO,
            worker: 0,
            fresh: 0,
        };
        for (number, sub) in render.subs.iter_mut().enumerate() {
            (0..SIDE).for_each(|worker| sub.join(WorkerId((number * SIDE + worker) as u64), Duration::ZERO));
            render.top.join(SubCoordinatorId(number as u64), SIDE as u32, Duration::ZERO);
        }
        render.pass_on();
        (0..2 * SIDE * SIDE).for_each(|_| render.step());
        render
    }

    /// What the top says arrives.
    fn pass_on(&mut self) {
        while let Some((sub, notice)) = self.top.notice() {
            self.subs[sub.0 as usize].told(&notice, self.now);
        }
    }

    /// One worker returns what it holds and asks for more; what is due is reported.
    fn step(&mut self) {
        self.now += Duration::from_micros(5);
        if self.top.next_tick().is_some_and(|tick| tick <= self.now) {
            self.top.tick(self.now);
            self.pass_on();
        }
        let worker = WorkerId(self.worker as u64);
        let number = self.worker / SIDE;
        let sub = &mut self.subs[number];
        if let Some(Assignment { lease, cells, .. }) = self.held[self.worker].take() {
            let work = f64::from(cells.count()) * 1e-3 * (1.0 + f64::from(cells.tile.0 % 17));
            let result = TileResult {
                lease,
                cells,
                is_last: true,
                spent: Spent { seconds: work, work },
                blocks: blocks_of(cells.tile),
            };
            sub.complete(worker, &result, self.now).expect("cells of the image");
        }
        let answer = sub.request(worker, self.now).expect("it joined");
        while sub.notice().is_some() {}
        self.held[self.worker] =
            if let Answer::Assign(assignment) = answer { Some(assignment) } else { None };
        while let Some(report) = self.subs[number].take_report(self.now) {
            let id = SubCoordinatorId(number as u64);
            let fresh = self.top.report(id, &report, self.now).expect("cells of the image");
            self.fresh += fresh.iter().map(|cells| u64::from(cells.count())).sum::<u64>();
            self.pass_on();
        }
        self.worker = (self.worker + 1) % self.held.len();
    }
}

fn two_levels(criterion: &mut Criterion) {
    let mut render = TwoLevels::new();
    while !render.top.is_finished() {
        render.step();
    }
    assert_eq!(render.fresh, render.top.progress().cells);
    criterion.bench_function("schedule/two levels/10000", |bencher| {
        bencher.iter_custom(|decisions| {
            let (mut left, mut time) = (decisions, Duration::ZERO);
            while left > 0 {
                let mut render = TwoLevels::new();
                let count = left.min(DECISIONS);
                let start = Instant::now();
                (0..count).for_each(|_| render.step());
                time += start.elapsed();
                left -= count;
                assert!(!render.top.is_finished());
            }
            time
        });
    });
}

fn decisions(criterion: &mut Criterion) {
    let even = CentralPoints::Even;
    let policies = [
        ("curve", (TilePolicy::Curve, PieceChoice::Near)),
        ("curve, held blocks", (TilePolicy::Curve, PieceChoice::Held)),
        ("nearest", (TilePolicy::Nearest(even), PieceChoice::Near)),
        ("trade-off", (TilePolicy::TradeOff { points: even, weight: 0.5 }, PieceChoice::Near)),
        ("rows", (TilePolicy::Rows, PieceChoice::Near)),
    ];
    for (name, policy) in policies {
        for workers in [6, 1000, 10_000] {
            // A whole render keeps its books: nothing is done twice when nobody is slow.
            let mut render = Render::new(policy, workers);
            while !render.scheduler.is_finished() {
                render.step();
            }
            let progress = render.scheduler.progress();
            assert_eq!(render.fresh, progress.cells);
            criterion.bench_function(&format!("schedule/{name}/{workers}"), |bencher| {
                bencher.iter_custom(|decisions| {
                    let (mut left, mut time) = (decisions, Duration::ZERO);
                    while left > 0 {
                        // Not to its end: there it would be another question.
                        let mut render = Render::new(policy, workers);
                        let count = left.min(DECISIONS);
                        let start = Instant::now();
                        for _ in 0..count {
                            render.step();
                        }
                        time += start.elapsed();
                        left -= count;
                        assert!(!render.scheduler.is_finished());
                    }
                    time
                });
            });
        }
    }
}

/// So many from each render.
const DECISIONS: u64 = 3000;

criterion_group! { name = benches; config = Criterion::default().sample_size(10); targets = decisions, two_levels }
criterion_main!(benches);
