//! A reader in simulated time, with a disk that fails and a line that damages what it sends.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use outcrop::cluster::{Action, Message, ModelFile, Reader, ReaderCounters};
use outcrop::error::SourceError;
use outcrop::model::Model;
use outcrop::source::MemorySource;
use outcrop::source::testing::{FaultRates, FaultySource};
use outcrop::transport::{SimNetwork, SimTransport, Transport, TransportEvent};
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};

use super::super::numbers::Random;
use super::{picture, roles};

/// The file on a disk that fails now and then.
struct ShakyFile(FaultySource<MemorySource>);

impl BlockSource for ShakyFile {
    fn model(&self) -> &Arc<Model> {
        self.0.model()
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        self.0.read_block(block, into)
    }
}

impl ModelFile for ShakyFile {
    fn file_bytes(&self) -> io::Result<u64> {
        picture::file().file_bytes()
    }

    fn read_range(&self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        picture::file().read_range(offset, into)
    }
}

/// How bad disks and lines of a run are.
#[derive(Clone, Copy)]
pub struct Troubles {
    pub disk: FaultRates,
    /// Part of the frames with a block in which a bit is turned over.
    pub damaged_frames: f64,
}

/// What readers did, also those that are dead, and what was done to them.
#[derive(Clone, Copy, Default, Debug, PartialEq, Eq)]
pub struct ReaderTotals {
    pub counters: ReaderCounters,
    pub frames_damaged: u64,
    pub disk_faults: u64,
}

impl ReaderTotals {
    pub fn add(&mut self, other: &ReaderTotals) {
        let (sum, more) = (&mut self.counters, &other.counters);
        sum.blocks_asked += more.blocks_asked;
        sum.blocks_from_disk += more.blocks_from_disk;
        sum.blocks_failed += more.blocks_failed;
        sum.blocks_hot += more.blocks_hot;
        sum.bytes_sent += more.bytes_sent;
        sum.bad_frames += more.bad_frames;
        self.frames_damaged += other.frames_damaged;
        self.disk_faults += other.disk_faults;
    }
}

struct Alive {
    transport: SimTransport,
    reader: Reader,
    file: Arc<ShakyFile>,
}

pub struct SimReader {
    pub number: usize,
    memory: Bytes,
    troubles: Troubles,
    alive: Option<Alive>,
    /// A dead one is started again then.
    pub back_at: Duration,
    pub hung_until: Duration,
    next_tick: Duration,
    next_try: Duration,
    starts: u64,
    totals: ReaderTotals,
}

impl SimReader {
    pub fn new(number: usize, memory: Bytes, troubles: Troubles, now: Duration) -> SimReader {
        SimReader {
            number,
            memory,
            troubles,
            alive: None,
            back_at: now,
            hung_until: Duration::ZERO,
            next_tick: now,
            next_try: now,
            starts: 0,
            totals: ReaderTotals::default(),
        }
    }

    pub fn transport(&self) -> Option<&SimTransport> {
        self.alive.as_ref().map(|alive| &alive.transport)
    }

    pub fn is_alive(&self) -> bool {
        self.alive.is_some()
    }

    /// What it held is gone.
    pub fn kill(&mut self, back_at: Duration) {
        if let Some(alive) = self.alive.take() {
            alive.transport.close();
            self.totals.add(&totals(&alive));
            self.back_at = back_at;
        }
    }

    /// All that it did in all its lives.
    pub fn totals(&self) -> ReaderTotals {
        let mut sum = self.totals;
        if let Some(alive) = &self.alive {
            sum.add(&totals(alive));
        }
        sum
    }

    pub fn next(&self) -> Duration {
        let Some(alive) = &self.alive else { return self.back_at };
        let next =
            if alive.reader.is_connected() { self.next_tick } else { self.next_tick.min(self.next_try) };
        next.max(self.hung_until)
    }

    fn start(&mut self, network: &SimNetwork) {
        self.starts += 1;
        // It may come back under the old address or under a new one.
        let address = format!("reader {} {}", self.number, self.starts / 2);
        let seed = (self.number as u64) << 32 | self.starts;
        let file = Arc::new(ShakyFile(FaultySource::new(picture::file(), seed, self.troubles.disk)));
        let budget = MemoryBudget::new(Bytes::mib(4));
        let model_file = Arc::clone(&file) as Arc<dyn ModelFile>;
        let reader = Reader::new(model_file, &address, &address, self.memory, &budget, roles()).unwrap();
        self.alive = Some(Alive { transport: network.open(&address), reader, file });
    }

    pub fn run(&mut self, network: &SimNetwork, now: Duration, random: &mut Random) {
        if self.alive.is_none() && now >= self.back_at {
            self.start(network);
        }
        let Some(Alive { transport, reader, .. }) = &mut self.alive else { return };
        if now < self.hung_until {
            return;
        }
        let mut actions = Vec::new();
        let mut events = VecDeque::new();
        if !reader.is_connected() && now >= self.next_try {
            self.next_try = now + Duration::from_millis(700);
            if let Ok(peer) = transport.connect("coordinator") {
                reader.connected(peer, now, &mut actions);
            }
        }
        while let Some(event) = transport.take_arrived() {
            events.push_back(event);
        }
        if now >= self.next_tick {
            self.next_tick = now + Duration::from_millis(500);
            reader.tick(now, &mut actions);
        }
        loop {
            for action in std::mem::take(&mut actions) {
                match action {
                    Action::Send { to, mut frame } => {
                        let is_block = matches!(Message::parse(&frame), Ok((Message::Block { .. }, _)));
                        if is_block && random.unit() < self.troubles.damaged_frames {
                            random.flip(&mut frame);
                            self.totals.frames_damaged += 1;
                        }
                        if let Err(error) = transport.send(to, frame) {
                            let reason = error.to_string();
                            events.push_back(TransportEvent::Disconnected { peer: to, reason });
                        }
                    }
                    Action::Disconnect { peer, .. } => transport.disconnect(peer),
                    Action::Log(_) => {}
                }
            }
            let Some(event) = events.pop_front() else { break };
            reader.handle(now, event, &mut actions);
            assert!(reader.held_bytes() <= self.memory, "a reader holds no more than it may");
        }
    }
}

fn totals(alive: &Alive) -> ReaderTotals {
    ReaderTotals {
        counters: alive.reader.counters(),
        frames_damaged: 0,
        disk_faults: alive.file.0.fault_count(),
    }
}
