//! Two levels, messages between them on their way for any time, sub-coordinators and workers lost at any time: every cell is new
//! once, none is lost, the render ends.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use proptest::prelude::*;

use crate::access::BlockSketch;
use crate::schedule::parts::{PartCells, PartNotice, PartOptions, PartReport, PartRest};
use crate::schedule::*;
use crate::units::{SubCoordinatorId, TileId, WorkerId};

#[derive(Clone, Debug)]
struct Event {
    after_ms: u64,
    what: What,
}

#[derive(Clone, Debug)]
enum What {
    JoinTop(usize),
    /// The sub-coordinator is lost with all that is on its way to it and from it. Its workers are, too.
    Lose(usize),
    /// The next message arrives.
    Down(usize),
    Up(usize),
    /// A report of any time, of anybody, arrives once more.
    Again(usize),
    Join(usize, u64),
    Leave(usize, u64),
    Request(usize, u64),
    Return {
        sub: usize,
        worker: u64,
        mask: u64,
        work: f64,
    },
    /// A worker returns to a sub-coordinator what anybody was told at any time by any of them.
    Late {
        sub: usize,
        worker: u64,
        which: usize,
    },
    RestartTop,
}

const SUBS: usize = 4;

fn event() -> impl Strategy<Value = Event> {
    let sub = 0..SUBS;
    let worker = 0u64..3;
    let mask = prop_oneof![3 => Just(!0u64), 1 => any::<u64>()];
    let work = prop_oneof![Just(0.0), 0.001..10.0];
    let what = prop_oneof![
        3 => sub.clone().prop_map(What::JoinTop),
        1 => sub.clone().prop_map(What::Lose),
        10 => sub.clone().prop_map(What::Down),
        10 => sub.clone().prop_map(What::Up),
        1 => any::<usize>().prop_map(What::Again),
        4 => (sub.clone(), worker.clone()).prop_map(|(sub, worker)| What::Join(sub, worker)),
        1 => (sub.clone(), worker.clone()).prop_map(|(sub, worker)| What::Leave(sub, worker)),
        10 => (sub.clone(), worker.clone()).prop_map(|(sub, worker)| What::Request(sub, worker)),
        10 => (sub.clone(), worker.clone(), mask, work)
            .prop_map(|(sub, worker, mask, work)| What::Return { sub, worker, mask, work }),
        1 => (sub, worker, any::<usize>()).prop_map(|(sub, worker, which)| What::Late { sub, worker, which }),
        1 => Just(What::RestartTop),
    ];
    let after_ms = prop_oneof![8 => 0u64..100, 1 => 0u64..10_000];
    (after_ms, what).prop_map(|(after_ms, what)| Event { after_ms, what })
}

/// One sub-coordinator as long as it is not lost.
struct Node {
    id: SubCoordinatorId,
    scheduler: SubScheduler,
    held: BTreeMap<u64, Vec<Assignment>>,
    down: VecDeque<PartNotice>,
    up: VecDeque<PartReport>,
}

struct World {
    grid: ImageGrid,
    top: PartScheduler,
    options: PartOptions,
    scheduler_options: SchedulerOptions,
    nodes: Vec<Option<Node>>,
    next_id: u64,
    now: Duration,
    /// Every report and every assignment that there ever was.
    reports: Vec<(SubCoordinatorId, PartReport)>,
    assigned: Vec<Assignment>,
    /// Cells that were new in some report.
    done: BTreeMap<TileId, u64>,
}

impl World {
    fn new(size: [u32; 2], options: PartOptions, scheduler_options: SchedulerOptions) -> World {
        let SchedulerOptions { tile_side, cell_side, .. } = scheduler_options;
        let grid = ImageGrid::new(size[0], size[1], tile_side, cell_side).unwrap();
        World {
            top: PartScheduler::new(grid.clone(), options).unwrap(),
            grid,
            options,
            scheduler_options,
            nodes: (0..SUBS).map(|_| None).collect(),
            next_id: 0,
            now: Duration::ZERO,
            reports: Vec::new(),
            assigned: Vec::new(),
            done: BTreeMap::new(),
        }
    }

    fn apply(&mut self, event: Event) {
        self.pass(Duration::from_millis(event.after_ms));
        match event.what {
            What::JoinTop(sub) => self.join_top(sub),
            What::Lose(sub) => {
                if let Some(node) = self.nodes[sub].take() {
                    self.top.leave(node.id, self.now);
                }
            }
            What::Down(sub) => self.down(sub),
            What::Up(sub) => self.up(sub),
            What::Again(which) => {
                if !self.reports.is_empty() {
                    let (id, report) = self.reports[which % self.reports.len()].clone();
                    // Of one that takes part, only results may come twice: messages of a connection come once.
                    let late = PartReport { done: report.done, ..PartReport::default() };
                    let is_gone = self.nodes.iter().flatten().all(|node| node.id != id);
                    self.report(if is_gone { id } else { SubCoordinatorId(u64::MAX) }, &late);
                }
            }
            What::Join(sub, worker) => self.join(sub, worker),
            What::Leave(sub, worker) => {
                if let Some(node) = &mut self.nodes[sub] {
                    node.scheduler.leave(WorkerId(worker), self.now);
                    node.held.remove(&worker);
                }
            }
            What::Request(sub, worker) => {
                self.request(sub, worker);
            }
            What::Return { sub, worker, mask, work } => self.give_back(sub, worker, mask, work),
            What::Late { sub, worker, which } => {
                if let Some(node) = self.nodes[sub].as_mut().filter(|_| !self.assigned.is_empty()) {
                    let Assignment { lease, cells, .. } = self.assigned[which % self.assigned.len()];
                    let result = TileResult {
                        lease,
                        cells,
                        is_last: true,
                        spent: Spent::default(),
                        blocks: BlockSketch::default(),
                    };
                    node.scheduler.complete(WorkerId(worker), &result, self.now).unwrap();
                }
            }
            What::RestartTop => self.restart(),
        }
        self.listen();
    }

    fn join_top(&mut self, sub: usize) {
        if self.nodes[sub].is_some() {
            return;
        }
        let id = SubCoordinatorId(self.next_id);
        self.next_id += 1;
        let (width, height) = (self.grid.width(), self.grid.height());
        let scheduler = SubScheduler::new(width, height, self.scheduler_options, self.options).unwrap();
        let (down, up) = (VecDeque::new(), VecDeque::new());
        self.nodes[sub] = Some(Node { id, scheduler, held: BTreeMap::new(), down, up });
        self.top.join(id, 0, self.now);
        self.top.join(id, 7, self.now);
    }

    fn join(&mut self, sub: usize, worker: u64) {
        let Some(node) = &mut self.nodes[sub] else { return };
        node.scheduler.join(WorkerId(worker), self.now);
        node.held.entry(worker).or_default();
    }

    fn request(&mut self, sub: usize, worker: u64) -> Option<Answer> {
        let node = self.nodes[sub].as_mut()?;
        let answer = node.scheduler.request(WorkerId(worker), self.now);
        let held = node.held.get_mut(&worker)?;
        let answer = answer.unwrap();
        if let Answer::Assign(assignment) = answer {
            let TileCells { tile, cells } = assignment.cells;
            assert!(cells != 0 && cells & !node.scheduler.part(tile) == 0, "only its own part is handed out");
            held.push(assignment);
            self.assigned.push(assignment);
        }
        Some(answer)
    }

    fn give_back(&mut self, sub: usize, worker: u64, mask: u64, work: f64) {
        let Some(node) = &mut self.nodes[sub] else { return };
        let Some(held) = node.held.get_mut(&worker).filter(|held| !held.is_empty()) else { return };
        let Assignment { lease, cells, .. } = held.remove(0);
        let cells = TileCells { cells: cells.cells & mask, ..cells };
        let spent = Spent { seconds: work * (worker + 1) as f64, work };
        let result = TileResult { lease, cells, is_last: true, spent, blocks: BlockSketch::default() };
        node.scheduler.complete(WorkerId(worker), &result, self.now).unwrap();
    }

    fn down(&mut self, sub: usize) {
        if let Some(node) = &mut self.nodes[sub]
            && let Some(notice) = node.down.pop_front()
        {
            node.scheduler.told(&notice, self.now);
        }
    }

    fn up(&mut self, sub: usize) {
        let Some(node) = &mut self.nodes[sub] else { return };
        let Some(report) = node.up.pop_front() else { return };
        let id = node.id;
        self.report(id, &report);
        self.reports.push((id, report));
    }

    fn report(&mut self, id: SubCoordinatorId, report: &PartReport) {
        let fresh = self.top.report(id, report, self.now).unwrap();
        let mut news: BTreeMap<TileId, u64> = BTreeMap::new();
        for TileCells { tile, cells } in fresh {
            assert!(cells != 0 && news.insert(tile, cells).is_none());
        }
        for TileCells { tile, cells } in report.done.iter().map(|part| part.cells) {
            let done = self.done.entry(tile).or_default();
            assert_eq!(news.remove(&tile).unwrap_or(0), cells & !*done, "new is what was not done");
            *done |= cells;
        }
        assert!(news.is_empty());
    }

    /// The top dies and comes back; sub-coordinators join it anew, with new numbers.
    fn restart(&mut self) {
        let bytes = self.top.checkpoint().to_bytes();
        let checkpoint = ScheduleCheckpoint::from_bytes(&bytes).unwrap();
        for (tile, done) in &self.done {
            assert_eq!(checkpoint.done(*tile), *done);
        }
        self.top = PartScheduler::restore(&checkpoint, self.options).unwrap();
        for sub in 0..SUBS {
            if self.nodes[sub].take().is_some() {
                self.join_top(sub);
            }
        }
    }

    /// Time goes by; everybody keeps appointments.
    fn pass(&mut self, time: Duration) {
        let until = self.now + time;
        for round in 0.. {
            assert!(round < 100_000, "appointments without end");
            let ticks = self.nodes.iter().flatten().filter_map(|node| node.scheduler.next_tick());
            let reports = self.nodes.iter().flatten().filter_map(|node| node.scheduler.report_at());
            let next = ticks.chain(reports).chain(self.top.next_tick()).min();
            let Some(next) = next.filter(|next| *next <= until) else { break };
            self.now = self.now.max(next);
            if self.top.next_tick().is_some_and(|next| next <= self.now) {
                self.top.tick(self.now);
            }
            for node in self.nodes.iter_mut().flatten() {
                if node.scheduler.next_tick().is_some_and(|next| next <= self.now) {
                    node.scheduler.tick(self.now);
                }
            }
            self.listen();
        }
        self.now = until;
    }

    /// What is said goes on its way, and workers heed what they hear.
    fn listen(&mut self) {
        while let Some((id, notice)) = self.top.notice() {
            // To one that is gone it does not matter.
            if let Some(node) = self.nodes.iter_mut().flatten().find(|node| node.id == id) {
                node.down.push_back(notice);
            }
        }
        for node in self.nodes.iter_mut().flatten() {
            while let Some(notice) = node.scheduler.notice() {
                if let Notice::Shorten { worker, lease, keep } = notice
                    && let Some(held) = node.held.get_mut(&worker.0)
                    && let Some(at) = held.iter().position(|held| held.lease == lease)
                {
                    held[at].cells = keep;
                    if keep.is_empty() {
                        held.remove(at);
                    }
                }
            }
            while node.scheduler.report_at().is_some_and(|due| due <= self.now) {
                let report = node.scheduler.take_report(self.now);
                node.up.push_back(report.expect("what is due is said"));
            }
            node.scheduler.check().unwrap();
        }
        self.check();
    }

    /// Who has a cell to do: never two sub-coordinators, on their books and on the way together.
    fn check(&self) {
        self.top.check().unwrap();
        if self.top.is_finished() {
            return;
        }
        for tile in (0..self.grid.tile_count()).map(TileId) {
            let done = self.done.get(&tile).copied().unwrap_or(0);
            for node in self.nodes.iter().flatten() {
                let granted = node.down.iter().flat_map(|notice| match notice {
                    PartNotice::Grant(parts) => parts.iter().map(|part| part.cells).collect(),
                    _ => Vec::new(),
                });
                let given = node.up.iter().filter_map(|report| report.given_up.as_ref()).flatten().copied();
                let on_its_way = granted.chain(given).filter(|cells| cells.tile == tile);
                let there = on_its_way.fold(node.scheduler.part(tile), |all, cells| all | cells.cells);
                let owned = self.top.owned(node.id, tile);
                assert_eq!(owned & !there, 0, "{tile:?}: what is owned is there or on its way");
                assert_eq!(there & !done & !owned, 0, "{tile:?}: what is there and not done is owned");
            }
        }
    }

    /// All are lost but one, and one worker of that does what it is told.
    fn finish(&mut self, lost: bool) {
        for sub in 1..SUBS {
            if lost && let Some(node) = self.nodes[sub].take() {
                self.top.leave(node.id, self.now);
            }
        }
        self.join_top(0);
        let worker = 99;
        self.join(0, worker);
        for _ in 0..400_000 {
            self.listen();
            for sub in 0..SUBS {
                while self.nodes[sub].as_ref().is_some_and(|node| !node.down.is_empty()) {
                    self.down(sub);
                }
                self.listen();
                while self.nodes[sub].as_ref().is_some_and(|node| !node.up.is_empty()) {
                    self.up(sub);
                }
            }
            self.listen();
            match self.request(0, worker).expect("it joined") {
                Answer::Done => return self.check_end(),
                Answer::Assign(_) => {
                    self.pass(Duration::from_millis(1));
                    self.give_back(0, worker, !0, 0.001);
                }
                Answer::Wait => {
                    let ticks = self.nodes.iter().flatten().filter_map(|node| node.scheduler.next_tick());
                    let reports = self.nodes.iter().flatten().filter_map(|node| node.scheduler.report_at());
                    let on_its_way = self.nodes.iter().flatten().any(|node| !node.down.is_empty());
                    match ticks.chain(reports).chain(self.top.next_tick()).min() {
                        Some(next) => self.pass(next.saturating_sub(self.now)),
                        None => assert!(on_its_way, "who waits is woken some time: {:?}", self.top),
                    }
                }
            }
        }
        panic!("no end: {:?}", self.top);
    }

    fn check_end(&self) {
        assert!(self.top.is_finished());
        for tile in (0..self.grid.tile_count()).map(TileId) {
            assert_eq!(self.done.get(&tile).copied().unwrap_or(0), self.grid.cells_of(tile), "{tile:?}");
        }
        let progress = self.top.progress();
        assert_eq!((progress.cells_done, progress.cells_free), (progress.cells, 0));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn two_levels_do_every_cell_once_and_the_render_ends(
        scheduler_options in super::all_options(),
        expected in 1u32..6,
        first_share in prop_oneof![Just(1.0), 0.01..1.0],
        size in (1u32..200, 1u32..150),
        events in prop::collection::vec(event(), 0..250),
        lost in any::<bool>(),
    ) {
        let options = PartOptions { first_share, ..PartOptions::new(expected) };
        let mut world = World::new([size.0, size.1], options, scheduler_options);
        for event in events {
            world.apply(event);
        }
        world.finish(lost);
    }
}

fn grid() -> ImageGrid {
    ImageGrid::new(256, 256, 64, 8).unwrap()
}

#[test]
fn the_first_get_equal_pieces_of_the_curve() {
    let whole = PartOptions { first_share: 1.0, ..PartOptions::new(3) };
    let mut top = PartScheduler::new(grid(), whole).unwrap();
    for id in 0..4 {
        top.join(SubCoordinatorId(id), 8, Duration::ZERO);
    }
    let mut grants = Vec::new();
    while let Some((id, notice)) = top.notice() {
        match notice {
            PartNotice::Grant(parts) => {
                grants.push(parts.iter().map(|part| part.cells).collect::<Vec<_>>());
            }
            // For the fourth, who was not expected.
            PartNotice::GiveUp { share } => assert!(share == 0.5 && id.0 < 3 && grants.len() == 3),
            PartNotice::Finished => panic!("nothing is done"),
        }
    }
    let counts: Vec<u32> = grants.iter().map(|cells| cells.iter().map(TileCells::count).sum()).collect();
    // Of 1,024 cells.
    assert_eq!(counts, [341, 341, 342]);
    let tiles: Vec<TileId> = grants.iter().flat_map(|cells| cells.iter().map(|cells| cells.tile)).collect();
    assert!(tiles.is_sorted() && tiles.iter().collect::<BTreeSet<_>>().len() == 16);
    // Half of them, if nothing else is asked for.
    let mut top = PartScheduler::new(grid(), PartOptions::new(3)).unwrap();
    for id in 0..3 {
        top.join(SubCoordinatorId(id), 8, Duration::ZERO);
        let Some((_, PartNotice::Grant(parts))) = top.notice() else { panic!("no part for {id}") };
        let count: u32 = parts.iter().map(|part| part.cells.count()).sum();
        assert!((170..=171).contains(&count), "{count}");
    }
}

/// Who is through gets so much of the rest of the one that would be through last that both are through at one time.
#[test]
fn the_last_one_gives_up_its_share() {
    let whole = PartOptions { first_share: 1.0, ..PartOptions::new(3) };
    let mut top = PartScheduler::new(grid(), whole).unwrap();
    let ids = [0, 1, 2].map(SubCoordinatorId);
    ids.iter().for_each(|id| top.join(*id, 8, Duration::ZERO));
    while top.notice().is_some() {}
    let rest = |cells, work, speed| PartRest { cells, cells_leased: 0, workers: 8, work, speed };
    let report = |rest, asks| PartReport { rest, asks, ..PartReport::default() };
    let mut tell = |id: usize, rest, asks| {
        let fresh = top.report(ids[id], &report(rest, asks), Duration::from_secs(1)).unwrap();
        assert!(fresh.is_empty());
        top.notice()
    };
    assert_eq!(tell(0, rest(300, 30.0, 10.0), false), None);
    assert_eq!(tell(1, rest(300, 90.0, 10.0), false), None);
    // Twice as fast: of 9 s, 6 s of the other's time.
    let told = tell(2, rest(0, 0.0, 20.0), true).unwrap();
    let PartNotice::GiveUp { share } = told.1 else { panic!("{told:?}") };
    assert!(told.0 == ids[1] && (share - 2.0 / 3.0).abs() < 1e-9);
    // One that was told is not told again; the next one by its end is.
    let told = tell(0, rest(0, 0.0, 10.0), true);
    assert_eq!(told, None, "nobody else has anything");
    let cells = vec![TileCells { tile: TileId(6), cells: 0xffff }, TileCells { tile: TileId(15), cells: 1 }];
    let given = PartReport { given_up: Some(cells), rest: rest(100, 30.0, 10.0), ..PartReport::default() };
    top.report(ids[1], &given, Duration::from_secs(1)).unwrap();
    // Cells of the last tile were never its own.
    assert_eq!(
        top.notice(),
        Some((
            ids[2],
            PartNotice::Grant(vec![PartCells {
                cells: TileCells { tile: TileId(6), cells: 0xffff },
                // Nothing was done anywhere.
                work: 0.0
            }])
        ))
    );
    // And the one that waits takes from who is the last one now.
    assert!(matches!(top.notice(), Some((id, PartNotice::GiveUp { .. })) if id == ids[1]));
    top.check().unwrap();
}

#[test]
fn reports_of_cells_that_do_not_exist_count_for_nothing() {
    let mut top = PartScheduler::new(ImageGrid::new(200, 100, 64, 8).unwrap(), PartOptions::new(2)).unwrap();
    top.join(SubCoordinatorId(0), 1, Duration::ZERO);
    let tiles = top.grid().tile_count();
    for bad in [(tiles, 1), (u32::MAX, 0), (tiles - 1, !0)] {
        let bad = TileCells { tile: TileId(bad.0), cells: bad.1 };
        let good = TileCells { tile: TileId(0), cells: 1 };
        let [good_done, bad_done] = [good, bad].map(|cells| PartCells { cells, work: 1.0 });
        let done = PartReport { done: vec![good_done, bad_done], ..PartReport::default() };
        let given = PartReport { done: vec![good_done], given_up: Some(vec![bad]), ..PartReport::default() };
        for report in [done, given] {
            assert!(top.report(SubCoordinatorId(0), &report, Duration::ZERO).is_err());
        }
    }
    assert_eq!(top.progress().cells_done, 0);
    top.check().unwrap();
    for options in [
        PartOptions { expected: 0, ..PartOptions::new(1) },
        PartOptions { first_share: 0.0, ..PartOptions::new(1) },
        PartOptions { first_share: f64::NAN, ..PartOptions::new(1) },
    ] {
        assert!(PartScheduler::new(grid(), options).is_err());
    }
}
