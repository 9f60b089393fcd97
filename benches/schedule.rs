//! What a decision of the scheduler takes, by policy and number of workers: one worker returns its cells and asks for
//! more, in the middle of a render of 4096 x 4096 pixels.

use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use outcrop::TileScheduler;
use outcrop::schedule::{
    AdaptiveScheduler, Answer, Assignment, CentralPoints, SchedulerOptions, Spent, TilePolicy, TileResult,
};
use outcrop::units::WorkerId;

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
    fn new(policy: TilePolicy, workers: usize) -> Render {
        let options = SchedulerOptions { policy, ..SchedulerOptions::new(workers as u32) };
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
            let result = TileResult { lease, cells, is_last: true, spent };
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

fn decisions(criterion: &mut Criterion) {
    let even = CentralPoints::Even;
    let policies = [
        ("curve", TilePolicy::Curve),
        ("nearest", TilePolicy::Nearest(even)),
        ("trade-off", TilePolicy::TradeOff { points: even, weight: 0.5 }),
        ("rows", TilePolicy::Rows),
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

criterion_group! { name = benches; config = Criterion::default().sample_size(10); targets = decisions }
criterion_main!(benches);
