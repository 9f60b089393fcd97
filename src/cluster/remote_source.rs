//! Blocks from readers over a network.

use std::collections::HashMap;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex, MutexGuard};
use smallvec::SmallVec;

use super::message::{BLOCKS_MAX, Message, RANGE_BYTES_MAX};
use super::model_file::readers_of;
use crate::block::checksum;
use crate::budget::MemoryBudget;
use crate::error::{BudgetError, ModelError, SourceError};
use crate::model::{Model, ModelReader};
use crate::source::{BlockSource, DIRECTORY};
use crate::transport::{PeerId, Transport, TransportEvent};
use crate::units::{BlockId, Bytes};

const NAME: &str = "the cluster's readers";

/// How often readers that are gone are looked for.
const AGAIN: Duration = Duration::from_millis(50);

/// What can be chosen about a [`RemoteSource`].
#[derive(Clone, Copy, Debug)]
pub struct RemoteOptions {
    /// A reader that does not answer a request within this is given up for `retry_after`.
    pub answer_time_max: Duration,
    /// After a reader failed, it is not asked for so long.
    pub retry_after: Duration,
    /// How often a block that arrives damaged is asked of the same reader before another is asked.
    pub tries: u32,
    /// If no reader gives a block and the node does not have the file: how long it waits for a reader to come back.
    pub patience: Duration,
    /// Bytes of blocks that were asked for in advance ([`RemoteSource::will_need`]) and may wait for their use.
    pub ahead_bytes_max: u64,
}

impl Default for RemoteOptions {
    fn default() -> RemoteOptions {
        RemoteOptions {
            answer_time_max: Duration::from_secs(10),
            retry_after: Duration::from_secs(5),
            tries: 2,
            patience: Duration::from_secs(60),
            ahead_bytes_max: 4 << 20,
        }
    }
}

/// What a [`RemoteSource`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RemoteCounters {
    /// Blocks that came from the reader whose part they are.
    pub from_owner: u64,
    /// Blocks that came from another reader, because that one was gone.
    pub from_other: u64,
    /// Blocks that came from another reader, because so many ask for them that all readers hold them.
    pub from_replica: u64,
    /// Blocks that came from the node's own disk, because no reader gave them.
    pub from_fallback: u64,
    /// Blocks that came from the node's own copy of the file, once that was complete.
    pub from_copy: u64,
    /// Stored bytes of blocks that came over the network.
    pub bytes_received: u64,
    /// Frames and blocks that arrived damaged, and were asked for again.
    pub damaged: u64,
    /// Times that a reader was given up: it ended the connection, could not be reached, or did not answer.
    pub readers_lost: u64,
    /// Messages that asked for blocks.
    pub requests: u64,
}

#[derive(Default)]
struct Counters {
    from_owner: AtomicU64,
    from_other: AtomicU64,
    from_replica: AtomicU64,
    from_fallback: AtomicU64,
    from_copy: AtomicU64,
    bytes_received: AtomicU64,
    damaged: AtomicU64,
    readers_lost: AtomicU64,
    requests: AtomicU64,
}

fn count(counter: &AtomicU64, by: u64) {
    counter.fetch_add(by, Ordering::Relaxed);
}

/// One reader as this node sees it.
struct Link {
    address: String,
    peer: Option<PeerId>,
    is_connecting: bool,
    /// Not to be asked before.
    rest_until: Option<Instant>,
}

impl Link {
    fn new(address: String) -> Link {
        Link { address, peer: None, is_connecting: false, rest_until: None }
    }
}

/// What became of a request.
#[derive(Clone)]
enum Outcome {
    Pending,
    Here(Arc<Vec<u8>>),
    /// It came, but not as it should be.
    Damaged,
    /// The reader does not have it or is gone.
    Lost,
}

/// A block that was asked for.
struct Wanted {
    peer: PeerId,
    outcome: Outcome,
    /// Threads that wait for it; 0 for one that was asked for in advance.
    waiting: u32,
    deadline: Instant,
}

#[derive(Default)]
struct State {
    links: Vec<Link>,
    wanted: HashMap<u32, Wanted>,
    /// Bytes of blocks that were asked for in advance and have not been used.
    ahead_bytes: u64,
    /// Blocks that are asked for very often, and whose turn it is to be asked for them; see [`Message::Block`].
    turns: HashMap<u32, u8>,
    /// Whether a thread is receiving for all.
    is_receiving: bool,
}

impl State {
    /// Whom to ask for a block, the first one first.
    fn order(&self, block: u32) -> SmallVec<[usize; 8]> {
        let mut order: SmallVec<[usize; 8]> = readers_of(block, self.links.len()).collect();
        if let (Some(turn), false) = (self.turns.get(&block), order.is_empty()) {
            let turn = usize::from(*turn) % order.len();
            order.rotate_left(turn);
        }
        order
    }
}

/// A [`BlockSource`] whose blocks come from readers.
///
/// Any number of requests may be on their way at one time: each thread that needs a block sends its request at once, and one of
/// those that wait receives for all. [`RemoteSource::will_need`] asks for many blocks with one message each reader. A block is
/// checked when it arrives; a damaged one is asked for again. If its reader is gone, another reader is asked, and at
/// last the node's own disk, if it has the file. There are no threads behind it.
pub struct RemoteSource {
    transport: Arc<dyn Transport>,
    model: Arc<Model>,
    fallback: Option<Arc<dyn BlockSource>>,
    /// The node's own copy, asked first once it is there.
    copy: OnceLock<Arc<dyn BlockSource>>,
    options: RemoteOptions,
    state: Mutex<State>,
    changed: Condvar,
    counters: Counters,
    is_abandoned: AtomicBool,
}

impl RemoteSource {
    /// A source for a node that has the file itself, and asks the readers first: their memory is faster than its disk. `transport` must be
    /// used for nothing else. `readers` as in [`RemoteSource::set_readers`].
    pub fn beside(
        fallback: Arc<dyn BlockSource>,
        transport: Arc<dyn Transport>,
        readers: Vec<String>,
        options: RemoteOptions,
    ) -> RemoteSource {
        let model = Arc::clone(fallback.model());
        RemoteSource::new(model, Some(fallback), transport, readers, options)
    }

    /// A source for a node that made itself a copy of the file: readers are asked only for blocks that are damaged there. `transport`
    /// must be used for nothing else.
    pub fn with_copy(
        copy: Arc<dyn BlockSource>,
        transport: Arc<dyn Transport>,
        readers: Vec<String>,
        options: RemoteOptions,
    ) -> RemoteSource {
        let source = RemoteSource::new(Arc::clone(copy.model()), None, transport, readers, options);
        source.set_copy(copy);
        source
    }

    /// A source for a node that does not have the file: header, directory and materials come from the first reader that
    /// answers. `transport` must be used for nothing else.
    ///
    /// # Errors
    /// [`SourceError`] if no reader gives a sound model.
    pub fn open(
        transport: Arc<dyn Transport>,
        readers: Vec<String>,
        options: RemoteOptions,
    ) -> Result<RemoteSource, SourceError> {
        RemoteSource::open_if(transport, readers, options, &mut |_| Ok(()))
    }

    /// The same if `budget` has room for directory and materials, which is asked before they are allocated (I1). The room is given back
    /// when this returns: the octree that is opened over the source takes it again, for as long as it lives.
    ///
    /// # Errors
    /// [`SourceError::Budget`], or as for [`RemoteSource::open`].
    pub fn open_in(
        transport: Arc<dyn Transport>,
        readers: Vec<String>,
        options: RemoteOptions,
        budget: &MemoryBudget,
    ) -> Result<RemoteSource, SourceError> {
        let mut room = None;
        RemoteSource::open_if(transport, readers, options, &mut |bytes| {
            // What was taken for a reader that failed is given back first.
            room = None;
            room = Some(budget.reserve(bytes, DIRECTORY)?);
            Ok(())
        })
    }

    fn open_if(
        transport: Arc<dyn Transport>,
        readers: Vec<String>,
        options: RemoteOptions,
        claim: &mut dyn FnMut(Bytes) -> Result<(), BudgetError>,
    ) -> Result<RemoteSource, SourceError> {
        let mut last = failed("the header", io::ErrorKind::NotConnected, "there are no readers".to_owned());
        for address in readers.iter().filter(|address| !address.is_empty()) {
            let fetched = FileFetch::start(&*transport, address, options.answer_time_max)
                .and_then(|mut fetch| fetch.model(claim));
            match fetched {
                Ok(model) => {
                    return Ok(RemoteSource::new(Arc::new(model), None, transport, readers, options));
                }
                // Another reader would give no smaller model.
                Err(error @ SourceError::Budget(_)) => return Err(error),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn new(
        model: Arc<Model>,
        fallback: Option<Arc<dyn BlockSource>>,
        transport: Arc<dyn Transport>,
        readers: Vec<String>,
        options: RemoteOptions,
    ) -> RemoteSource {
        let links = readers.into_iter().map(Link::new).collect();
        RemoteSource {
            transport,
            model,
            fallback,
            copy: OnceLock::new(),
            options,
            state: Mutex::new(State { links, ..State::default() }),
            changed: Condvar::new(),
            counters: Counters::default(),
            is_abandoned: AtomicBool::new(false),
        }
    }

    /// Nobody needs blocks any more: who waits for a reader to come back gets an error soon.
    pub fn abandon(&self) {
        self.is_abandoned.store(true, Ordering::Relaxed);
    }

    /// Where the readers are from now on. Their number and order decide who holds which block (see
    /// [`readers_of`](super::readers_of)), so an absent one keeps its place, as an empty text.
    pub fn set_readers(&self, readers: Vec<String>) {
        let mut state = self.state.lock();
        for (place, address) in readers.iter().enumerate() {
            if state.links.get(place).is_some_and(|link| link.address != *address) {
                self.lose(&mut state, place, Duration::ZERO);
                state.links[place] = Link::new(address.clone());
            } else if state.links.get(place).is_none() {
                state.links.push(Link::new(address.clone()));
            }
        }
        for place in readers.len()..state.links.len() {
            self.lose(&mut state, place, Duration::ZERO);
        }
        state.links.truncate(readers.len());
    }

    /// Where the readers are now, as [`RemoteSource::set_readers`] told.
    pub fn readers(&self) -> Vec<String> {
        self.state.lock().links.iter().map(|link| link.address.clone()).collect()
    }

    /// From now on blocks come from this copy of the same file, and from readers only if the copy is damaged. Counts once.
    pub fn set_copy(&self, copy: Arc<dyn BlockSource>) {
        // A second copy of the same file makes no difference.
        let _ = self.copy.set(copy);
    }

    /// Whether [`RemoteSource::set_copy`] was called.
    pub fn has_copy(&self) -> bool {
        self.copy.get().is_some()
    }

    /// Asks for blocks that will be read soon, in one message to each reader, without waiting. Only a hint: blocks beyond
    /// [`RemoteOptions::ahead_bytes_max`] are left out. What is never read takes up that room until the source is dropped.
    pub fn will_need(&self, blocks: &[BlockId]) {
        if self.copy.get().is_some() {
            return;
        }
        let mut state = self.state.lock();
        let mut by_peer: HashMap<PeerId, Vec<u32>> = HashMap::new();
        for block in blocks {
            let Some(entry) = self.model.entry(*block) else { continue };
            let bytes = u64::from(entry.stored_bytes);
            if state.wanted.contains_key(&block.0) || state.ahead_bytes + bytes > self.options.ahead_bytes_max
            {
                continue;
            }
            let first = state.order(block.0).first().copied();
            let Some(peer) = first.and_then(|first| state.links[first].peer) else { continue };
            let deadline = Instant::now() + self.options.answer_time_max;
            state.ahead_bytes += bytes;
            state.wanted.insert(block.0, Wanted { peer, outcome: Outcome::Pending, waiting: 0, deadline });
            by_peer.entry(peer).or_default().push(block.0);
        }
        for (peer, blocks) in by_peer {
            for blocks in blocks.chunks(BLOCKS_MAX) {
                count(&self.counters.requests, 1);
                let frame = Message::Read { blocks: blocks.to_vec() }.frame();
                if self.transport.send(peer, frame).is_err() {
                    self.lose_peer(&mut state, peer);
                }
            }
        }
    }

    /// What it did so far.
    pub fn counters(&self) -> RemoteCounters {
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        RemoteCounters {
            from_owner: get(&self.counters.from_owner),
            from_other: get(&self.counters.from_other),
            from_replica: get(&self.counters.from_replica),
            from_fallback: get(&self.counters.from_fallback),
            from_copy: get(&self.counters.from_copy),
            bytes_received: get(&self.counters.bytes_received),
            damaged: get(&self.counters.damaged),
            readers_lost: get(&self.counters.readers_lost),
            requests: get(&self.counters.requests),
        }
    }

    /// Reads a block from the node's own copy; false if there is none, or it is damaged there.
    fn read_copy(&self, block: BlockId, into: &mut Vec<u8>) -> bool {
        let Some(copy) = self.copy.get() else { return false };
        let is_sound = copy.read_block(block, into).is_ok()
            && self.model.entry(block).is_some_and(|entry| checksum(into) == entry.checksum);
        count(if is_sound { &self.counters.from_copy } else { &self.counters.damaged }, 1);
        if !is_sound {
            into.clear();
        }
        is_sound
    }

    /// Asks the readers for a block, one after the other; whether one gave it.
    fn ask_readers(&self, block: BlockId, into: &mut Vec<u8>) -> bool {
        let (order, owner) = {
            let state = self.state.lock();
            (state.order(block.0), readers_of(block.0, state.links.len()).next())
        };
        for (nth, place) in order.iter().copied().enumerate() {
            if let Some(bytes) = self.ask(place, block.0) {
                let from = if Some(place) == owner {
                    &self.counters.from_owner
                } else if nth == 0 {
                    &self.counters.from_replica
                } else {
                    &self.counters.from_other
                };
                count(from, 1);
                into.extend_from_slice(&bytes);
                return true;
            }
        }
        false
    }

    /// Asks reader number `place` for a block until it has given it, or is given up.
    fn ask(&self, place: usize, block: u32) -> Option<Arc<Vec<u8>>> {
        let mut state = self.state.lock();
        for _ in 0..self.options.tries.max(1) {
            let outcome = self.ask_once(&mut state, place, block);
            match outcome {
                Outcome::Here(bytes) => return Some(bytes),
                Outcome::Damaged => {}
                Outcome::Lost | Outcome::Pending => return None,
            }
        }
        None
    }

    fn ask_once(&self, state: &mut MutexGuard<'_, State>, place: usize, block: u32) -> Outcome {
        if !state.wanted.contains_key(&block) {
            let Some(peer) = self.connected(state, place) else { return Outcome::Lost };
            // Connecting gives up the lock for a while.
            if !state.wanted.contains_key(&block) {
                count(&self.counters.requests, 1);
                if self.transport.send(peer, Message::Read { blocks: vec![block] }.frame()).is_err() {
                    self.lose(state, place, self.options.retry_after);
                    return Outcome::Lost;
                }
                let deadline = Instant::now() + self.options.answer_time_max;
                let wanted = Wanted { peer, outcome: Outcome::Pending, waiting: 1, deadline };
                state.wanted.insert(block, wanted);
                return self.wait(state, block);
            }
        }
        if let Some(wanted) = state.wanted.get_mut(&block) {
            wanted.waiting += 1;
            if wanted.waiting == 1 {
                // Asked for in advance; it counts as such no more.
                let bytes = self.model.entry(BlockId(block)).map_or(0, |entry| u64::from(entry.stored_bytes));
                state.ahead_bytes = state.ahead_bytes.saturating_sub(bytes);
            }
        }
        self.wait(state, block)
    }

    /// Waits until a block that was asked for is there or given up.
    fn wait(&self, state: &mut MutexGuard<'_, State>, block: u32) -> Outcome {
        loop {
            let Some(wanted) = state.wanted.get_mut(&block) else { return Outcome::Lost };
            if !matches!(wanted.outcome, Outcome::Pending) {
                wanted.waiting -= 1;
                let outcome = wanted.outcome.clone();
                if wanted.waiting == 0 {
                    state.wanted.remove(&block);
                }
                return outcome;
            }
            let (deadline, peer) = (wanted.deadline, wanted.peer);
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                self.lose_peer(state, peer);
                continue;
            }
            if state.is_receiving {
                self.changed.wait_until(state, deadline);
                continue;
            }
            state.is_receiving = true;
            let received = MutexGuard::unlocked(state, || self.transport.receive(left));
            state.is_receiving = false;
            match received {
                Ok(Some(event)) => self.handle(state, event),
                Ok(None) => {}
                Err(_) => {
                    let peers: Vec<PeerId> = state.links.iter().filter_map(|link| link.peer).collect();
                    peers.into_iter().for_each(|peer| self.lose_peer(state, peer));
                }
            }
            // Another must receive if this one is served, and see what came in any case.
            self.changed.notify_all();
        }
    }

    fn handle(&self, state: &mut State, event: TransportEvent) {
        match event {
            TransportEvent::Frame { peer, bytes } => match Message::parse(&bytes) {
                Ok((Message::Block { block, turn }, stored)) => {
                    let Some(wanted) = state.wanted.get_mut(&block).filter(|wanted| wanted.peer == peer)
                    else {
                        // Late, after it was asked elsewhere.
                        return;
                    };
                    let entry = self.model.entry(BlockId(block));
                    let is_sound = entry.is_some_and(|entry| {
                        stored.len() == entry.stored_bytes as usize && checksum(stored) == entry.checksum
                    });
                    if is_sound {
                        count(&self.counters.bytes_received, stored.len() as u64);
                        wanted.outcome = Outcome::Here(Arc::new(stored.to_vec()));
                        if turn > 0 {
                            state.turns.insert(block, turn);
                        } else {
                            state.turns.remove(&block);
                        }
                    } else {
                        count(&self.counters.damaged, 1);
                        wanted.outcome = Outcome::Damaged;
                    }
                    self.drop_unused(state, block);
                }
                Ok((Message::NoBlock { block, .. }, _)) => {
                    if let Some(wanted) = state.wanted.get_mut(&block).filter(|wanted| wanted.peer == peer) {
                        wanted.outcome = Outcome::Lost;
                        self.drop_unused(state, block);
                    }
                }
                // A reader may tell what it likes; only blocks matter here.
                Ok(_) => {}
                Err(_) => {
                    count(&self.counters.damaged, 1);
                    self.lose_peer(state, peer);
                }
            },
            TransportEvent::Disconnected { peer, .. } => self.lose_peer(state, peer),
            TransportEvent::Connected { peer, .. } => self.transport.disconnect(peer),
            TransportEvent::Refused { .. } => {}
        }
    }

    /// Forgets a block that was asked for in advance and did not come.
    fn drop_unused(&self, state: &mut State, block: u32) {
        let is_useless = state.wanted.get(&block).is_some_and(|wanted| {
            wanted.waiting == 0 && !matches!(wanted.outcome, Outcome::Here(_) | Outcome::Pending)
        });
        if is_useless {
            state.wanted.remove(&block);
            let bytes = self.model.entry(BlockId(block)).map_or(0, |entry| u64::from(entry.stored_bytes));
            state.ahead_bytes = state.ahead_bytes.saturating_sub(bytes);
        }
    }

    /// The connection to reader number `place`, made if need be.
    fn connected(&self, state: &mut MutexGuard<'_, State>, place: usize) -> Option<PeerId> {
        while state.links.get(place).is_some_and(|link| link.is_connecting) {
            self.changed.wait(state);
        }
        let link = state.links.get_mut(place)?;
        if link.peer.is_some() {
            return link.peer;
        }
        if link.address.is_empty() || link.rest_until.is_some_and(|until| Instant::now() < until) {
            return None;
        }
        link.is_connecting = true;
        let address = link.address.clone();
        let result = MutexGuard::unlocked(state, || self.transport.connect(&address));
        self.changed.notify_all();
        // The list may have changed meanwhile.
        let link = state.links.get_mut(place).filter(|link| link.address == address);
        let Some(link) = link else {
            if let Ok(peer) = result {
                self.transport.disconnect(peer);
            }
            return None;
        };
        link.is_connecting = false;
        match result {
            Ok(peer) => link.peer = Some(peer),
            Err(_) => self.lose(state, place, self.options.retry_after),
        }
        state.links.get(place)?.peer
    }

    fn lose_peer(&self, state: &mut State, peer: PeerId) {
        match state.links.iter().position(|link| link.peer == Some(peer)) {
            Some(place) => self.lose(state, place, self.options.retry_after),
            None => self.give_up(state, peer),
        }
    }

    /// Gives a reader up, for a while.
    fn lose(&self, state: &mut State, place: usize, rest: Duration) {
        let Some(link) = state.links.get_mut(place) else { return };
        link.rest_until = Some(Instant::now() + rest);
        if !rest.is_zero() {
            count(&self.counters.readers_lost, 1);
        }
        if let Some(peer) = link.peer.take() {
            self.transport.disconnect(peer);
            self.give_up(state, peer);
        }
    }

    /// Nothing will come from `peer` any more.
    fn give_up(&self, state: &mut State, peer: PeerId) {
        let mut lost = Vec::new();
        for (block, wanted) in &mut state.wanted {
            if wanted.peer == peer && matches!(wanted.outcome, Outcome::Pending) {
                wanted.outcome = Outcome::Lost;
                lost.push(*block);
            }
        }
        lost.into_iter().for_each(|block| self.drop_unused(state, block));
        self.changed.notify_all();
    }
}

impl BlockSource for RemoteSource {
    fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// Readers serve blocks; attributes come from the node's own disk, if it has the file.
    fn gives_attributes(&self) -> bool {
        self.fallback.as_ref().is_some_and(|fallback| fallback.gives_attributes())
    }

    fn read_attributes(&self, page: u32, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        match &self.fallback {
            Some(fallback) => fallback.read_attributes(page, into),
            None => Err(SourceError::NoAttributes { page, name: NAME.to_owned() }),
        }
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        if self.model.entry(block).is_none() {
            return Err(SourceError::NoSuchBlock {
                block,
                name: NAME.to_owned(),
                // The directory has at most 2^32 - 1 entries.
                count: self.model.blocks.len() as u32,
            });
        }
        let start = Instant::now();
        let mut is_damaged_here = false;
        loop {
            if self.read_copy(block, into) || self.ask_readers(block, into) {
                return Ok(());
            }
            if let Some(fallback) = &self.fallback {
                let read = fallback.read_block(block, into);
                let is_sound = read.is_ok()
                    && self.model.entry(block).is_some_and(|entry| checksum(into) == entry.checksum);
                if is_sound {
                    count(&self.counters.from_fallback, 1);
                    return Ok(());
                }
                // Damaged on this disk: a reader that comes back may still give it. If none does, whoever decodes the block says what
                // is wrong with it.
                let may_come = !self.state.lock().links.is_empty();
                if !may_come
                    || start.elapsed() >= self.options.patience
                    || self.is_abandoned.load(Ordering::Relaxed)
                {
                    return read;
                }
                count(&self.counters.damaged, u64::from(!is_damaged_here));
                is_damaged_here = true;
                into.clear();
                std::thread::sleep(AGAIN);
                continue;
            }
            if start.elapsed() >= self.options.patience || self.is_abandoned.load(Ordering::Relaxed) {
                let reason = "no reader gives it, and this node does not have the file".to_owned();
                return Err(failed(&format!("block {}", block.0), io::ErrorKind::NotConnected, reason));
            }
            std::thread::sleep(AGAIN);
        }
    }
}

fn failed(what: &str, kind: io::ErrorKind, reason: String) -> SourceError {
    SourceError::Io { what: what.to_owned(), name: NAME.to_owned(), error: io::Error::new(kind, reason) }
}

/// Reads bytes of the compiled file from a reader, one range after the other.
pub(super) struct FileFetch<'t> {
    transport: &'t dyn Transport,
    peer: PeerId,
    time_max: Duration,
    /// Length of the file.
    pub file_bytes: u64,
}

impl<'t> FileFetch<'t> {
    pub fn start(
        transport: &'t dyn Transport,
        address: &str,
        time_max: Duration,
    ) -> Result<FileFetch<'t>, SourceError> {
        let peer = transport
            .connect(address)
            .map_err(|error| failed("the header", io::ErrorKind::NotConnected, error.to_string()))?;
        let mut fetch = FileFetch { transport, peer, time_max, file_bytes: u64::MAX };
        // The answer says how long the file is.
        fetch.part("the header", 0, &mut [0; 1])?;
        Ok(fetch)
    }

    /// Header, directory and materials.
    pub fn model(
        &mut self,
        claim: &mut dyn FnMut(Bytes) -> Result<(), BudgetError>,
    ) -> Result<Model, SourceError> {
        let file_bytes = self.file_bytes;
        let claim = |bytes| claim(bytes).map_err(|error| FetchError::Source(error.into()));
        let model = ModelReader::read_if(file_bytes, claim, |what, offset, into: &mut [u8]| {
            self.range(what, offset, into).map_err(FetchError::Source)
        });
        model.map_err(|error| match error {
            FetchError::Source(error) => error,
            FetchError::Model(error) => SourceError::Model { name: NAME.to_owned(), error },
        })
    }

    /// Fills `into` with the bytes from `offset` on.
    pub fn range(&mut self, what: &str, offset: u64, into: &mut [u8]) -> Result<(), SourceError> {
        let mut at = offset;
        for piece in into.chunks_mut(RANGE_BYTES_MAX as usize) {
            self.part(what, at, piece)?;
            at += piece.len() as u64;
        }
        Ok(())
    }

    fn part(&mut self, what: &str, offset: u64, into: &mut [u8]) -> Result<(), SourceError> {
        // At most `RANGE_BYTES_MAX`.
        let frame = Message::ReadFile { offset, length: into.len() as u32 }.frame();
        let gone = |reason: String| failed(what, io::ErrorKind::NotConnected, reason);
        self.transport.send(self.peer, frame).map_err(|error| gone(error.to_string()))?;
        let deadline = Instant::now() + self.time_max;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let event = self.transport.receive(left).map_err(|error| gone(error.to_string()))?;
            match event {
                None => {
                    return Err(failed(what, io::ErrorKind::TimedOut, "a reader does not answer".to_owned()));
                }
                Some(TransportEvent::Frame { peer, bytes }) if peer == self.peer => {
                    match Message::parse(&bytes) {
                        Ok((Message::FilePart { offset: found, file_bytes }, part)) if found == offset => {
                            self.file_bytes = file_bytes;
                            if part.len() != into.len() {
                                let name = NAME.to_owned();
                                return Err(SourceError::Truncated {
                                    what: what.to_owned(),
                                    name,
                                    end: file_bytes,
                                });
                            }
                            into.copy_from_slice(part);
                            return Ok(());
                        }
                        Ok(_) => {}
                        Err(error) => {
                            return Err(failed(what, io::ErrorKind::InvalidData, error.to_string()));
                        }
                    }
                }
                Some(TransportEvent::Disconnected { peer, reason }) if peer == self.peer => {
                    return Err(gone(reason));
                }
                Some(_) => {}
            }
        }
    }
}

impl Drop for FileFetch<'_> {
    fn drop(&mut self) {
        self.transport.disconnect(self.peer);
    }
}

enum FetchError {
    Model(ModelError),
    Source(SourceError),
}

impl From<ModelError> for FetchError {
    fn from(error: ModelError) -> FetchError {
        FetchError::Model(error)
    }
}

impl std::fmt::Debug for RemoteSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RemoteSource").finish_non_exhaustive()
    }
}
