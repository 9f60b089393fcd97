//! Who takes part, what they hold, and how fast they are.

use std::collections::HashMap;

use smallvec::SmallVec;

use super::speed::Speed;
use crate::units::{LeaseId, WorkerId};

/// One that takes part.
pub(super) struct Worker {
    pub id: WorkerId,
    /// What it holds, in the order in which it was given.
    pub leases: SmallVec<[LeaseId; 4]>,
    speed: Speed,
}

/// The workers, by index; an index is used again when its worker has left.
#[derive(Default)]
pub(super) struct Crew {
    slots: HashMap<WorkerId, u32>,
    workers: Vec<Option<Worker>>,
    vacant: Vec<u32>,
    /// Sum of the speeds that are known, and how many.
    speeds: f64,
    known: u32,
}

impl Crew {
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    pub fn slot(&self, worker: WorkerId) -> Option<u32> {
        self.slots.get(&worker).copied()
    }

    pub fn get(&self, slot: u32) -> Option<&Worker> {
        self.workers.get(slot as usize)?.as_ref()
    }

    pub fn get_mut(&mut self, slot: u32) -> Option<&mut Worker> {
        self.workers.get_mut(slot as usize)?.as_mut()
    }

    #[cfg(test)]
    pub fn workers(&self) -> impl Iterator<Item = &Worker> {
        self.workers.iter().flatten()
    }

    /// The new worker's index; none if it takes part already.
    pub fn join(&mut self, id: WorkerId) -> Option<u32> {
        if self.slots.contains_key(&id) {
            return None;
        }
        let slot = self.vacant.pop().unwrap_or_else(|| {
            self.workers.push(None);
            self.workers.len() as u32 - 1
        });
        self.workers[slot as usize] = Some(Worker { id, leases: SmallVec::new(), speed: Speed::default() });
        self.slots.insert(id, slot);
        Some(slot)
    }

    /// Takes a worker out: its index, and what it was.
    pub fn leave(&mut self, id: WorkerId) -> Option<(u32, Worker)> {
        let slot = self.slots.remove(&id)?;
        let worker = self.workers[slot as usize].take()?;
        self.vacant.push(slot);
        if let Some(speed) = worker.speed.value() {
            self.speeds -= speed;
            self.known -= 1;
        }
        Some((slot, worker))
    }

    /// A worker did some work in so many seconds.
    pub fn learn(&mut self, slot: u32, work: f64, seconds: f64) {
        let Some(worker) = self.workers.get_mut(slot as usize).and_then(Option::as_mut) else { return };
        let before = worker.speed.value();
        worker.speed.record(work, seconds);
        if let Some(after) = worker.speed.value() {
            self.speeds += after - before.unwrap_or(0.0);
            self.known += u32::from(before.is_none());
        }
    }

    /// Work per second of a worker; none before its first result.
    pub fn speed(&self, slot: u32) -> Option<f64> {
        self.get(slot)?.speed.value()
    }

    /// Mean of the speeds that are known; none before the first result of anybody.
    pub fn mean_speed(&self) -> Option<f64> {
        // The sum is kept up by differences, so it may end a little below what it stands for.
        (self.known > 0).then(|| (self.speeds / f64::from(self.known)).max(f64::MIN_POSITIVE))
    }
}
