//! The table under a model checker: thousands of thread schedules of small programs, on simulated primitives that
//! hand control over at every atomic operation, lock and wait. A schedule in which no thread can go on (a lost
//! wake-up, a deadlock) fails, as does one that does not end.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use shuttle::rand::{Rng, thread_rng};
use shuttle::sync::{Condvar, Mutex};
use shuttle::thread::{spawn, yield_now};

use crate::error::{LoadError, SourceError};
use crate::units::BlockId;

use super::shim::Checked;
use super::table::Table;
use super::{Lru, Pin};

const SLOT_BYTES: usize = 64;

/// A table and what its users have seen, kept outside the checker's view so that it adds no schedules.
struct Bench {
    table: Table<Lru, Checked>,
    /// Whether a fill of the block runs now.
    filling: Vec<AtomicBool>,
    filled: AtomicU64,
    failed: AtomicU64,
    pinned: AtomicU64,
}

#[derive(Clone, Copy, PartialEq)]
enum Outcome {
    Fill,
    Fail,
    Panic,
}

fn failure() -> LoadError {
    let (what, name) = (String::new(), String::new());
    LoadError::Source(SourceError::Truncated { what, name, end: 0 })
}

impl Bench {
    fn new(slots: u32, blocks: u32) -> Arc<Bench> {
        Arc::new(Bench {
            table: Table::new(slots, SLOT_BYTES, blocks, Lru::new()).unwrap(),
            filling: (0..blocks).map(|_| AtomicBool::new(false)).collect(),
            filled: AtomicU64::new(0),
            failed: AtomicU64::new(0),
            pinned: AtomicU64::new(0),
        })
    }

    /// Pins `block` with a fill that ends as told, if it comes to that.
    fn pin(&self, block: u32, outcome: Outcome) -> Result<Pin<'_>, LoadError> {
        let mut fill = |slot: &mut [u8]| {
            let twice = self.filling[block as usize].swap(true, Ordering::SeqCst);
            assert!(!twice, "two fills of block {block} at once");
            slot[0] = block as u8;
            yield_now();
            slot[SLOT_BYTES - 1] = block as u8;
            self.filling[block as usize].store(false, Ordering::SeqCst);
            if outcome == Outcome::Fill {
                self.filled.fetch_add(1, Ordering::SeqCst);
                return Ok(());
            }
            self.failed.fetch_add(1, Ordering::SeqCst);
            if outcome == Outcome::Panic {
                // Without the panic hook, which would print.
                resume_unwind(Box::new("fill"));
            }
            Err(failure())
        };
        let pinned = catch_unwind(AssertUnwindSafe(|| self.table.pin(BlockId(block), &mut fill)));
        let pin = pinned.unwrap_or_else(|_| Err(failure()))?;
        self.pinned.fetch_add(1, Ordering::SeqCst);
        check(&pin);
        Ok(pin)
    }

    /// What must hold when every thread is done.
    fn check_at_rest(&self) {
        self.table.validate().unwrap();
        let stats = self.table.stats();
        let [filled, failed, pinned] =
            [&self.filled, &self.failed, &self.pinned].map(|count| count.load(Ordering::SeqCst));
        assert_eq!(stats.misses, filled + failed);
        assert_eq!(stats.hits, pinned - filled);
        assert_eq!(stats.filled_bytes, filled * SLOT_BYTES as u64);
        let blocks = self.filling.len() as u32;
        let resident: Vec<_> = (0..blocks).filter(|block| self.resident(*block)).collect();
        assert_eq!(stats.evictions, filled - resident.len() as u64);
        // No pin has leaked: every slot can be had at once.
        let pins: Vec<_> = (0..blocks.min(self.table.slot_count()))
            .map(|block| self.pin(block, Outcome::Fill).unwrap_or_else(|error| panic!("{error}")))
            .collect();
        pins.iter().for_each(check);
    }

    fn resident(&self, block: u32) -> bool {
        let pin = self.table.try_pin(BlockId(block));
        self.pinned.fetch_add(u64::from(pin.is_some()), Ordering::SeqCst);
        pin.as_ref().is_some_and(|pin| {
            check(pin);
            true
        })
    }
}

/// The bytes are the block's own.
fn check(pin: &Pin<'_>) {
    let block = pin.block().0 as u8;
    assert_eq!((pin[0], pin[SLOT_BYTES - 1]), (block, block), "the slot holds another block");
}

/// Runs `program` on so many threads, each with its number, and checks the state that they leave.
fn run(bench: &Arc<Bench>, threads: u32, program: impl Fn(&Bench, u32) + Clone + Send + 'static) {
    let threads: Vec<_> = (0..threads)
        .map(|thread| {
            let (bench, program) = (bench.clone(), program.clone());
            spawn(move || program(&bench, thread))
        })
        .collect();
    for thread in threads {
        thread.join().unwrap();
    }
    bench.check_at_rest();
}

#[test]
fn every_schedule_of_two_misses_of_one_block_fills_it_once() {
    shuttle::check_dfs(
        || {
            let bench = Bench::new(1, 1);
            run(&bench, 2, |bench, _| drop(bench.pin(0, Outcome::Fill).unwrap()));
            assert_eq!(bench.filled.load(Ordering::SeqCst), 1);
        },
        Some(40_000),
    );
}

#[test]
fn with_slots_for_all_each_block_is_filled_once() {
    let program = || {
        let bench = Bench::new(3, 3);
        run(&bench, 3, |bench, thread| {
            for step in 0..3 {
                let pin = bench.pin((thread + step) % 3, Outcome::Fill).unwrap();
                yield_now();
                check(&pin);
            }
        });
        assert_eq!(bench.filled.load(Ordering::SeqCst), 3);
    };
    shuttle::check_random(program, 6000);
    shuttle::check_pct(program, 3000, 3);
}

/// Three threads, two pins each at most: six slots are promised to be enough, for any schedule, though the blocks are
/// many and every pin may evict.
#[test]
fn threads_times_pins_slots_are_always_enough() {
    let program = || {
        let bench = Bench::new(6, 12);
        run(&bench, 3, |bench, _| {
            let mut held = None;
            for _ in 0..4 {
                let block = thread_rng().gen_range(0..12);
                let pin = bench.pin(block, Outcome::Fill).unwrap_or_else(|error| panic!("{error}"));
                held.iter().for_each(check);
                // The older pin is given back here: two are held, at most, at any time.
                held = Some(pin);
            }
        });
    };
    shuttle::check_random(program, 5000);
    shuttle::check_pct(program, 3000, 3);
}

/// One slot for two threads that hold one pin each at most: nobody waits forever, and whoever is refused a slot gets
/// it after the other has gone on.
#[test]
fn a_thread_without_a_slot_is_refused_or_waits_but_never_forever() {
    let program = || {
        let bench = Bench::new(1, 3);
        run(&bench, 3, |bench, thread| {
            for step in 0..2 {
                // A bound on the schedule's length; a thread that gives up is right too.
                for _ in 0..20 {
                    match bench.pin((thread + step) % 3, Outcome::Fill) {
                        Ok(pin) => {
                            yield_now();
                            check(&pin);
                            break;
                        }
                        Err(LoadError::NoSlot { slots }) => assert_eq!(slots, 1),
                        Err(error) => panic!("{error}"),
                    }
                    yield_now();
                }
            }
        });
    };
    shuttle::check_random(program, 8000);
    shuttle::check_pct(program, 4000, 3);
}

#[test]
fn failing_and_panicking_fills_pass_the_block_on_and_leak_nothing() {
    let program = || {
        let bench = Bench::new(2, 3);
        run(&bench, 3, |bench, _| {
            for _ in 0..3 {
                let outcome = match thread_rng().gen_range(0..4) {
                    0 => Outcome::Fail,
                    1 => Outcome::Panic,
                    _ => Outcome::Fill,
                };
                // An error is either this thread's own failed fill or a lack of slots: never another thread's failure.
                match bench.pin(thread_rng().gen_range(0..3), outcome) {
                    Ok(pin) => {
                        yield_now();
                        check(&pin);
                    }
                    Err(LoadError::NoSlot { .. }) => {}
                    Err(_) => assert!(outcome != Outcome::Fill),
                }
            }
        });
    };
    shuttle::check_random(program, 8000);
    shuttle::check_pct(program, 4000, 3);
}

/// A thread looks for a slot while another moves its one pin from slot to slot under its eyes. One of the two slots is
/// always free to take, so the look must not conclude that there is none.
#[test]
fn a_pin_that_moves_during_the_search_is_not_counted_twice() {
    let program = || {
        let bench = Bench::new(2, 3);
        drop(bench.pin(0, Outcome::Fill).unwrap());
        drop(bench.pin(1, Outcome::Fill).unwrap());
        run(&bench, 2, |bench, thread| {
            if thread == 0 {
                drop(bench.pin(2, Outcome::Fill).unwrap_or_else(|error| panic!("{error}")));
            } else {
                (0..8).for_each(|step| _ = bench.resident(step % 2));
            }
        });
    };
    shuttle::check_random(program, 10_000);
}

/// All slots are pinned but one, which is being filled; the fill goes on until a thread that looks for a slot has one.
/// So a slot that is given back must reach that thread at once, not at the end of the load.
#[test]
fn a_slot_given_back_reaches_a_waiting_thread_while_another_load_goes_on() {
    let program = || {
        let bench = Bench::new(2, 3);
        let served = Arc::new((Mutex::new(false), Condvar::new()));
        run(&bench, 3, move |bench, thread| match thread {
            0 => {
                let pin = bench.pin(0, Outcome::Fill).unwrap();
                yield_now();
                drop(pin);
            }
            1 => {
                let pin = bench.pin(1, Outcome::Fill).unwrap();
                *served.0.lock().unwrap() = true;
                served.1.notify_all();
                drop(pin);
            }
            _ => {
                let mut fill = |_: &mut [u8]| {
                    let mut served_now = served.0.lock().unwrap();
                    while !*served_now {
                        served_now = served.1.wait(served_now).unwrap();
                    }
                    bench.failed.fetch_add(1, Ordering::SeqCst);
                    Err(failure())
                };
                // By its fill, or for want of a slot if both others were first.
                assert!(bench.table.pin(BlockId(2), &mut fill).is_err());
            }
        });
    };
    shuttle::check_random(program, 8000);
    shuttle::check_pct(program, 4000, 3);
}

/// With one slot, a thread that finds it being filled waits, and takes it over when that fill fails.
#[test]
fn a_load_in_progress_is_waited_for_before_a_slot_is_refused() {
    let program = || {
        let bench = Bench::new(1, 2);
        run(&bench, 2, |bench, thread| match thread {
            0 => assert!(bench.pin(0, Outcome::Fail).is_err()),
            // The other thread never has a pin, so its load is all that there is to wait for.
            _ => drop(
                bench.pin(1, Outcome::Fail).err().filter(|e| !matches!(e, LoadError::NoSlot { .. })).unwrap(),
            ),
        });
    };
    shuttle::check_random(program, 4000);
}

/// One thread takes slots away while others, which hold one pin each, need them: with a slot for each of them nobody is
/// refused, whatever the limit, and nobody waits forever for a slot that is on its way back.
#[test]
fn a_limit_that_comes_and_goes_refuses_nobody() {
    let program = || {
        let bench = Bench::new(2, 4);
        run(&bench, 3, |bench, thread| {
            if thread == 2 {
                [0, 2, 1].into_iter().for_each(|limit| bench.table.limit_slots(limit));
            } else {
                for step in 0..3 {
                    let block = (2 * thread + step) % 4;
                    let pin = bench.pin(block, Outcome::Fill).unwrap_or_else(|error| panic!("{error}"));
                    check(&pin);
                }
            }
        });
    };
    shuttle::check_random(program, 8000);
    shuttle::check_pct(program, 4000, 3);
}
