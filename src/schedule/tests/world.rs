//! Workers that do anything that workers may do, and a record of what came of it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use proptest::prelude::*;

use crate::access::BlockSketch;
use crate::schedule::*;
use crate::units::{BlockId, LeaseId, TileId, WorkerId};

/// Something happens after some milliseconds.
#[derive(Clone, Debug)]
pub struct Event {
    after_ms: u64,
    what: What,
}

#[derive(Clone, Debug)]
enum What {
    Join(u64),
    Leave(u64),
    Request(u64),
    /// The worker returns the cells of one of its assignments that the mask lets through.
    Return {
        worker: u64,
        which: usize,
        mask: u64,
        is_last: bool,
        work: f64,
    },
    /// Somebody returns something that was assigned at any time, to anybody.
    Late {
        worker: u64,
        which: usize,
        mask: u64,
    },
    Restart,
}

pub fn event() -> impl Strategy<Value = Event> {
    let worker = 0u64..6;
    let mask =
        prop_oneof![2 => Just(!0u64), 1 => any::<u64>(), 1 => (0u32..64).prop_map(|count| (1 << count) - 1)];
    let work = prop_oneof![Just(0.0), 0.001..10.0];
    let returned = (worker.clone(), any::<usize>(), mask.clone(), any::<bool>(), work)
        .prop_map(|(worker, which, mask, is_last, work)| What::Return { worker, which, mask, is_last, work });
    let what = prop_oneof![
        3 => worker.clone().prop_map(What::Join),
        1 => worker.clone().prop_map(What::Leave),
        8 => worker.clone().prop_map(What::Request),
        8 => returned,
        1 => (worker, any::<usize>(), mask).prop_map(|(worker, which, mask)| What::Late { worker, which, mask }),
        1 => Just(What::Restart),
    ];
    let after_ms = prop_oneof![8 => 0u64..100, 1 => 0u64..10_000];
    (after_ms, what).prop_map(|(after_ms, what)| Event { after_ms, what })
}

pub struct World {
    scheduler: AdaptiveScheduler,
    options: SchedulerOptions,
    now: Duration,
    /// What each worker was told to do and has not given back, with the cells that it still cares about.
    held: BTreeMap<u64, Vec<Assignment>>,
    /// Everything that was ever assigned.
    assigned: Vec<Assignment>,
    lease_ids: BTreeSet<LeaseId>,
    /// Cells that were new in some result.
    done: BTreeMap<TileId, u64>,
}

impl World {
    pub fn new(width: u32, height: u32, options: SchedulerOptions) -> World {
        World {
            scheduler: AdaptiveScheduler::new(width, height, options).unwrap(),
            options,
            now: Duration::ZERO,
            held: BTreeMap::new(),
            assigned: Vec::new(),
            lease_ids: BTreeSet::new(),
            done: BTreeMap::new(),
        }
    }

    pub fn apply(&mut self, event: Event) {
        self.pass(Duration::from_millis(event.after_ms));
        match event.what {
            What::Join(worker) => {
                self.scheduler.join(WorkerId(worker), self.now);
                self.held.entry(worker).or_default();
            }
            What::Leave(worker) => {
                self.scheduler.leave(WorkerId(worker), self.now);
                self.held.remove(&worker);
            }
            What::Request(worker) => {
                self.request(worker);
            }
            What::Return { worker, which, mask, is_last, work } => {
                let Some(held) = self.held.get_mut(&worker).filter(|held| !held.is_empty()) else { return };
                let which = which % held.len();
                let assignment = held[which];
                if is_last {
                    held.remove(which);
                }
                let spent = Spent { seconds: work * (worker + 1) as f64, work };
                self.complete(worker, assignment, mask, is_last, spent);
            }
            What::Late { worker, which, mask } => {
                if !self.assigned.is_empty() {
                    let assignment = self.assigned[which % self.assigned.len()];
                    self.complete(worker, assignment, mask, true, Spent::default());
                }
            }
            What::Restart => self.restart(),
        }
        self.listen();
    }

    /// One worker that does what it is told, and is told everything, brings the render to its end.
    pub fn finish(&mut self) {
        let worker = 99;
        self.scheduler.join(WorkerId(worker), self.now);
        self.held.entry(worker).or_default();
        // Each lost lease lasts twice as long as the one before: the sum of all is bounded.
        for _ in 0..200_000 {
            match self.request(worker) {
                Some(Answer::Done) => {
                    assert!(self.scheduler.is_finished());
                    return self.check_end();
                }
                Some(Answer::Assign(assignment)) => {
                    self.pass(Duration::from_millis(1));
                    let spent = Spent { seconds: 0.001, work: 0.001 };
                    self.held.insert(worker, Vec::new());
                    self.complete(worker, assignment, !0, true, spent);
                }
                Some(Answer::Wait) => {
                    // Others hold something and never come back; their leases run out.
                    let next = self.scheduler.next_tick().expect("who waits is woken some time");
                    assert!(!self.scheduler.is_finished());
                    self.pass(next.saturating_sub(self.now));
                }
                None => panic!("a worker that joined is known"),
            }
            self.listen();
        }
        panic!("no end: {:?}", self.scheduler.progress());
    }

    fn check_end(&mut self) {
        let grid = self.scheduler.grid().clone();
        let mut pixels = 0;
        for tile in (0..grid.tile_count()).map(TileId) {
            let cells = self.done.get(&tile).copied().unwrap_or(0);
            assert_eq!(cells, grid.cells_of(tile), "{tile:?}");
            pixels += grid.pixels(TileCells { tile, cells });
        }
        assert_eq!(pixels, u64::from(grid.width()) * u64::from(grid.height()));
        let progress = self.scheduler.progress();
        assert_eq!((progress.cells_done, progress.cells_leased), (progress.cells, 0));
        assert!(self.scheduler.next_tick().is_none(), "nothing is left to run out");
    }

    /// Time goes by; the coordinator keeps its appointments.
    fn pass(&mut self, time: Duration) {
        let until = self.now + time;
        let mut ticks = 0;
        while let Some(next) = self.scheduler.next_tick().filter(|next| *next <= until) {
            self.now = self.now.max(next);
            self.scheduler.tick(self.now);
            self.check();
            self.listen();
            ticks += 1;
            assert!(ticks < 100_000, "ticks without end");
        }
        self.now = until;
    }

    fn request(&mut self, worker: u64) -> Option<Answer> {
        let answer = self.scheduler.request(WorkerId(worker), self.now);
        self.check();
        if !self.held.contains_key(&worker) {
            assert!(answer.is_err());
            return None;
        }
        let answer = answer.unwrap();
        if let Answer::Assign(assignment) = answer {
            let cells = assignment.cells;
            assert!(!cells.is_empty());
            assert_eq!(cells.cells & !self.scheduler.grid().cells_of(cells.tile), 0);
            let done = self.done.get(&cells.tile).copied().unwrap_or(0);
            assert_eq!(cells.cells & done, 0, "what is done is not handed out again");
            assert!(self.lease_ids.insert(assignment.lease), "a lease's number is its own");
            let held = self.held.entry(worker).or_default();
            held.push(assignment);
            self.assigned.push(assignment);
        }
        Some(answer)
    }

    fn complete(&mut self, worker: u64, assignment: Assignment, mask: u64, is_last: bool, spent: Spent) {
        let TileCells { tile, cells } = assignment.cells;
        let cells = TileCells { tile, cells: cells & mask };
        // Any blocks at all, and none.
        let mut blocks = BlockSketch::default();
        for block in 0..(mask % 40) as u32 {
            blocks.add(BlockId(block.wrapping_mul(tile.0 + 77) % 1000), 1000);
        }
        let result = TileResult { lease: assignment.lease, cells, is_last, spent, blocks };
        let receipt = self.scheduler.complete(WorkerId(worker), &result, self.now).unwrap();
        let done = self.done.entry(tile).or_default();
        assert_eq!(receipt.fresh.tile, tile);
        assert_eq!(receipt.fresh.cells, cells.cells & !*done, "new is what was not done");
        assert_eq!(receipt.repeated, (cells.cells & *done).count_ones());
        *done |= cells.cells;
        self.check();
    }

    /// The coordinator dies and comes back; workers join again.
    fn restart(&mut self) {
        let bytes = self.scheduler.checkpoint().to_bytes();
        let checkpoint = ScheduleCheckpoint::from_bytes(&bytes).unwrap();
        for (tile, done) in &self.done {
            assert_eq!(checkpoint.done(*tile), *done);
        }
        self.scheduler = AdaptiveScheduler::restore(&checkpoint, self.options).unwrap();
        self.held.clear();
        self.check();
    }

    /// What a worker hears, it heeds. What it does not hold any more it does not mind.
    fn listen(&mut self) {
        while let Some(notice) = self.scheduler.notice() {
            match notice {
                Notice::Shorten { worker, lease, keep } => {
                    let held = self.held.get_mut(&worker.0);
                    let held = held.expect("a notice to one who left");
                    if let Some(at) = held.iter().position(|held| held.lease == lease) {
                        assert_eq!(keep.cells & !held[at].cells.cells, 0, "a lease does not grow");
                        held[at].cells = keep;
                        if keep.is_empty() {
                            held.remove(at);
                        }
                    }
                }
                Notice::Wake { worker } => assert!(self.held.contains_key(&worker.0)),
            }
        }
    }

    fn check(&self) {
        self.scheduler.check().unwrap();
    }
}
