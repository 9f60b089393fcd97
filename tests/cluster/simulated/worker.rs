//! A worker in simulated time: the real state machines of the worker and of the asking side of readers. Only rendering is made
//! up: it takes some time once the blocks are there, and a pixel is a function of its place and of the bytes of its blocks.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use outcrop::BlockSource;
use outcrop::access::BlockSketch;
use outcrop::cluster::{
    Action, BlockClient, Message, Need, OwnFile, RemoteCounters, RemoteOptions, Worker, WorkerAction,
    WorkerEvent,
};
use outcrop::render::Region;
use outcrop::transport::{SimNetwork, SimTransport, Transport, TransportEvent};
use outcrop::units::BlockId;

use super::super::numbers::Random;
use super::{picture, roles};

/// How readers are asked. Nobody stays away for as long as the patience: who gives up has a fault.
fn remote() -> RemoteOptions {
    RemoteOptions {
        answer_time_max: Duration::from_secs(3),
        retry_after: Duration::from_secs(1),
        tries: 2,
        patience: Duration::from_secs(1800),
        ahead_bytes_max: AHEAD_BYTES_MAX,
    }
}

const AHEAD_BYTES_MAX: u64 = 12 << 10;

/// Blocks that a lane asks for at one time, at most.
const PIPELINE_MAX: u64 = 4;

/// What a lane is at.
struct Rendering {
    lane: u16,
    region: Region,
    /// Blocks that it has not asked for.
    missing: Vec<u32>,
    /// Blocks that it waits for, until it looks again.
    fetching: Vec<(u32, Duration)>,
    /// Of the blocks that it has.
    digests: BTreeMap<u32, u64>,
    /// When it is through, once all blocks are there.
    end: Option<Duration>,
}

/// How blocks came to a worker, as it saw them come.
#[derive(Clone, Copy, Default, Debug, PartialEq, Eq)]
pub struct Fetched {
    pub over_network: u64,
    pub from_own: u64,
    pub own_damaged: u64,
    /// Blocks in requests, whether they arrived or not.
    pub asked: u64,
}

pub struct SimWorker {
    /// To the coordinator.
    pub control: SimTransport,
    /// To readers.
    pub data: SimTransport,
    worker: Worker,
    client: BlockClient,
    own: OwnFile,
    /// Part of the reads of the own file that give damaged bytes.
    own_damaged: f64,
    pipeline: usize,
    asks_ahead: bool,
    /// Digests of the blocks in the cache, the oldest first.
    cache: VecDeque<(u32, u64)>,
    cache_blocks: usize,
    lanes: u16,
    /// Seconds for each pixel.
    slowness: f64,
    rendering: Vec<Rendering>,
    fetched: Fetched,
    /// Whether something has changed for those who wait.
    has_changed: bool,
    next_tick: Duration,
    next_try: Duration,
    pub hung_until: Duration,
    pub is_alive: bool,
}

impl SimWorker {
    pub fn new(
        network: &SimNetwork,
        number: usize,
        own_damaged: f64,
        random: &mut Random,
        now: Duration,
    ) -> SimWorker {
        let lanes = 1 + random.below(2) as u16;
        let own =
            random.pick(&[OwnFile::Absent, OwnFile::Absent, OwnFile::Last, OwnFile::Last, OwnFile::First]);
        let key = (own == OwnFile::Last).then(picture::key);
        SimWorker {
            control: network.open(&format!("worker {number}")),
            data: network.open(&format!("worker {number}, blocks")),
            worker: Worker::new(&format!("worker {number}"), lanes, key, roles()),
            client: BlockClient::new(picture::file().model().clone(), own, remote()),
            own,
            own_damaged,
            pipeline: 1 + random.below(PIPELINE_MAX) as usize,
            asks_ahead: random.below(3) == 0,
            cache: VecDeque::new(),
            cache_blocks: random.pick(&[2, 10, 24, 24]),
            lanes,
            slowness: 1e-4 * (1.0 + 20.0 * random.unit() * random.unit()),
            rendering: Vec::new(),
            fetched: Fetched::default(),
            has_changed: false,
            next_tick: now,
            next_try: now,
            hung_until: Duration::ZERO,
            is_alive: true,
        }
    }

    pub fn counters(&self) -> (RemoteCounters, Fetched) {
        (self.client.counters(), self.fetched)
    }

    pub fn kill(&mut self) {
        self.is_alive = false;
        self.control.close();
        self.data.close();
    }

    pub fn next(&self) -> Duration {
        let mut next = self.next_tick;
        if !self.worker.is_connected() {
            next = next.min(self.next_try);
        }
        for lane in &self.rendering {
            let waits = lane.fetching.iter().map(|(_, until)| *until);
            next = waits.chain(lane.end).fold(next, Duration::min);
        }
        next.max(self.hung_until)
    }

    pub fn run(&mut self, now: Duration, random: &mut Random) {
        if !self.is_alive || now < self.hung_until {
            return;
        }
        let mut events = VecDeque::new();
        if !self.worker.is_connected() && now >= self.next_try {
            self.next_try = now + Duration::from_millis(700);
            if let Ok(peer) = self.control.connect("coordinator") {
                events.push_back(WorkerEvent::Connected(peer));
            }
        }
        while let Some(event) = self.control.take_arrived() {
            events.push_back(WorkerEvent::Network(event));
        }
        self.receive_blocks(now);
        self.fetch(now, random);
        let is_due = |lane: &Rendering| lane.end.is_some_and(|end| end <= now);
        for lane in self.rendering.extract_if(.., |lane| is_due(lane)).collect::<Vec<_>>() {
            let time = Duration::from_secs_f64(self.slowness * lane.region.pixels() as f64);
            let work = lane.region.pixels() as f64;
            let pixels = picture::pixels(lane.region, &lane.digests);
            let mut blocks = BlockSketch::default();
            let count = picture::file().model().blocks.len() as u32;
            lane.digests.keys().for_each(|block| blocks.add(BlockId(*block), count));
            events.push_back(WorkerEvent::Rendered { lane: lane.lane, pixels, time, work, blocks });
        }
        let mut actions = Vec::new();
        if now >= self.next_tick {
            self.next_tick = now + Duration::from_millis(500);
            self.worker.tick(now, &mut actions);
        }
        loop {
            for action in std::mem::take(&mut actions) {
                match action {
                    WorkerAction::Network(Action::Send { to, frame }) => {
                        if let Err(error) = self.control.send(to, frame) {
                            let reason = error.to_string();
                            events.push_back(WorkerEvent::Network(TransportEvent::Disconnected {
                                peer: to,
                                reason,
                            }));
                        }
                    }
                    WorkerAction::Network(Action::Disconnect { peer, .. }) => self.control.disconnect(peer),
                    WorkerAction::Network(Action::Log(_)) => {}
                    WorkerAction::Readers(readers) => {
                        let mut asked = Vec::new();
                        self.client.set_readers(&readers, now, &mut asked);
                        self.perform(now, asked);
                        self.look_again(now);
                    }
                    WorkerAction::Open(_) => {
                        for lane in self.rendering.drain(..) {
                            lane.fetching.iter().for_each(|(block, _)| self.client.leave(BlockId(*block)));
                        }
                        events.push_back(WorkerEvent::Opened);
                    }
                    WorkerAction::Render { lane, region } => self.begin(lane, region, now),
                }
            }
            let Some(event) = events.pop_front() else { break };
            self.worker.handle(now, event, &mut actions);
        }
        self.fetch(now, random);
        assert_eq!(self.worker.failure(), None);
        self.check();
    }

    /// What is asked for is bounded by lanes and options, whatever readers do.
    fn check(&self) {
        let (blocks, ahead_bytes) = self.client.outstanding();
        let smallest = picture::sound().iter().map(Vec::len).min().unwrap() as u64;
        let waited_for = usize::from(self.lanes) * self.pipeline;
        assert!(ahead_bytes <= AHEAD_BYTES_MAX);
        assert!(blocks <= waited_for + (AHEAD_BYTES_MAX / smallest) as usize, "{blocks} blocks");
        if !self.asks_ahead {
            assert!(blocks <= waited_for && ahead_bytes == 0);
        }
    }

    fn begin(&mut self, lane: u16, region: Region, now: Duration) {
        assert!(self.rendering.iter().all(|other| other.lane != lane), "a lane does one thing");
        let (mut digests, mut missing) = (BTreeMap::new(), Vec::new());
        for block in picture::blocks_of_region(region) {
            match self.cache.iter().find(|(held, _)| *held == block) {
                Some((_, digest)) => _ = digests.insert(block, *digest),
                None => missing.push(block),
            }
        }
        if self.asks_ahead {
            let blocks: Vec<BlockId> = missing.iter().copied().map(BlockId).collect();
            let mut actions = Vec::new();
            self.client.will_need(&blocks, now, &mut actions);
            self.perform(now, actions);
        }
        self.rendering.push(Rendering { lane, region, missing, fetching: Vec::new(), digests, end: None });
    }

    fn perform(&mut self, now: Duration, mut actions: Vec<Action>) {
        while !actions.is_empty() {
            for action in std::mem::take(&mut actions) {
                match action {
                    Action::Send { to, frame } => {
                        if let Ok((Message::Read { blocks }, _)) = Message::parse(&frame) {
                            self.fetched.asked += blocks.len() as u64;
                        }
                        if let Err(error) = self.data.send(to, frame) {
                            let event = TransportEvent::Disconnected { peer: to, reason: error.to_string() };
                            self.client.handle(event, now, &mut actions);
                        }
                    }
                    Action::Disconnect { peer, .. } => self.data.disconnect(peer),
                    Action::Log(_) => {}
                }
            }
        }
    }

    /// Everybody who waits for a block looks at it anew.
    fn look_again(&mut self, now: Duration) {
        let waits = self.rendering.iter_mut().flat_map(|lane| &mut lane.fetching);
        waits.for_each(|(_, until)| *until = now);
    }

    fn receive_blocks(&mut self, now: Duration) {
        let mut has_changed = false;
        while let Some(event) = self.data.take_arrived() {
            has_changed = true;
            let mut actions = Vec::new();
            self.client.handle(event, now, &mut actions);
            self.perform(now, actions);
        }
        if has_changed {
            self.look_again(now);
        }
    }

    /// Every lane asks for what it lacks, and goes on with what has come.
    fn fetch(&mut self, now: Duration, random: &mut Random) {
        loop {
            self.has_changed = false;
            let mut rendering = std::mem::take(&mut self.rendering);
            for lane in rendering.iter_mut().filter(|lane| lane.end.is_none()) {
                self.fetch_for(lane, now, random);
            }
            self.rendering = rendering;
            if !self.has_changed {
                return;
            }
            self.look_again(now);
        }
    }

    fn fetch_for(&mut self, lane: &mut Rendering, now: Duration, random: &mut Random) {
        loop {
            while lane.fetching.len() < self.pipeline
                && let Some(block) = lane.missing.pop()
            {
                let mut actions = Vec::new();
                assert!(self.client.want(BlockId(block), now, &mut actions));
                self.perform(now, actions);
                lane.fetching.push((block, now));
            }
            let mut here = Vec::new();
            for (block, until) in &mut lane.fetching {
                if *until <= now {
                    match self.wait(*block, now, random) {
                        Ok(digest) => here.push((*block, digest)),
                        Err(next) => *until = next,
                    }
                }
            }
            if here.is_empty() {
                break;
            }
            lane.fetching.retain(|(block, _)| here.iter().all(|(other, _)| other != block));
            for (block, digest) in here {
                lane.digests.insert(block, digest);
                self.keep(block, digest);
            }
        }
        if lane.missing.is_empty() && lane.fetching.is_empty() {
            let time = self.slowness * (0.5 + random.unit()) * lane.region.pixels() as f64;
            lane.end = Some(now + Duration::from_secs_f64(time));
        }
    }

    /// Goes on with a block that is waited for: its digest once it is here, or until when there is nothing to do.
    fn wait(&mut self, block: u32, now: Duration, random: &mut Random) -> Result<u64, Duration> {
        let sound = &picture::sound()[block as usize];
        loop {
            let mut actions = Vec::new();
            let need = self.client.need(BlockId(block), now, &mut actions);
            self.perform(now, actions);
            let mut actions = Vec::new();
            match need {
                Need::Take(bytes) => {
                    assert!(*bytes == *sound, "block {block} is not what it should be");
                    self.fetched.over_network += 1;
                    return Ok(picture::digest(&bytes));
                }
                Need::Connect { place, address } => {
                    let peer = self.data.connect(&address).ok();
                    self.client.connected(place, &address, peer, now, &mut actions);
                }
                Need::ReadOwn => {
                    assert_ne!(self.own, OwnFile::Absent);
                    let is_sound = random.unit() >= self.own_damaged;
                    self.fetched.own_damaged += u64::from(!is_sound);
                    self.fetched.from_own += u64::from(is_sound);
                    self.client.own_read(BlockId(block), is_sound, now, &mut actions);
                    if is_sound {
                        self.perform(now, actions);
                        return Ok(picture::digest(sound));
                    }
                }
                Need::Wait { until, .. } => {
                    assert!(until > now, "to wait for nothing is to turn in a circle");
                    return Err(until);
                }
                Need::GiveUp => panic!("there is always a reader that comes back"),
            }
            self.perform(now, actions);
            // Others may be concerned.
            self.has_changed = true;
        }
    }

    fn keep(&mut self, block: u32, digest: u64) {
        // Some ask for what all want again and again.
        let is_passed_over = block == picture::HOT && self.cache_blocks < 4;
        if !is_passed_over && self.cache.iter().all(|(held, _)| *held != block) {
            if self.cache.len() >= self.cache_blocks {
                self.cache.pop_front();
            }
            self.cache.push_back((block, digest));
        }
    }
}
