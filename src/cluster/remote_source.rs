//! Blocks from readers over a network.

use std::io;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex, MutexGuard};

use super::Action;
use super::block_client::{BlockClient, Need, OwnFile, RemoteCounters, RemoteOptions};
use super::file_fetch::{FileFetch, NAME, failed};
use crate::block::checksum;
use crate::budget::MemoryBudget;
use crate::error::{BudgetError, SourceError};
use crate::model::{BlockEntry, Model};
use crate::source::{BlockSource, DIRECTORY};
use crate::transport::{Transport, TransportEvent};
use crate::units::{BlockId, Bytes};

struct State {
    client: BlockClient,
    /// Whether a thread is receiving for all.
    is_receiving: bool,
}

/// A [`BlockSource`] whose blocks come from readers.
///
/// It drives a [`BlockClient`], which decides whom to ask for a block and what to do about an answer. Any number of requests may be
/// on their way at one time: each thread that needs a block sends its request at once, and one of those that wait receives for all.
/// [`RemoteSource::will_need`] asks for many blocks with one message each reader. There are no threads behind it.
pub struct RemoteSource {
    transport: Arc<dyn Transport>,
    model: Arc<Model>,
    fallback: Option<Arc<dyn BlockSource>>,
    /// The node's own copy, asked first once it is there.
    copy: OnceLock<Arc<dyn BlockSource>>,
    start: Instant,
    state: Mutex<State>,
    changed: Condvar,
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
        let own = if fallback.is_some() { OwnFile::Last } else { OwnFile::Absent };
        let client = BlockClient::new(Arc::clone(&model), own, options);
        let source = RemoteSource {
            transport,
            model,
            fallback,
            copy: OnceLock::new(),
            start: Instant::now(),
            state: Mutex::new(State { client, is_receiving: false }),
            changed: Condvar::new(),
        };
        source.set_readers(readers);
        source
    }

    /// Nobody needs blocks any more: who waits for a reader to come back gets an error soon.
    pub fn abandon(&self) {
        self.state.lock().client.abandon();
        self.changed.notify_all();
    }

    /// Where the readers are from now on. Their number and order decide who holds which block (see
    /// [`readers_of`](super::readers_of)), so an absent one keeps its place, as an empty text.
    pub fn set_readers(&self, readers: Vec<String>) {
        let (mut state, mut actions) = (self.state.lock(), Vec::new());
        state.client.set_readers(&readers, self.now(), &mut actions);
        self.perform(&mut state, &mut actions);
    }

    /// Where the readers are now, as [`RemoteSource::set_readers`] told.
    pub fn readers(&self) -> Vec<String> {
        self.state.lock().client.readers().map(str::to_owned).collect()
    }

    /// From now on blocks come from this copy of the same file, and from readers only if the copy is damaged. Counts once.
    pub fn set_copy(&self, copy: Arc<dyn BlockSource>) {
        // A second copy of the same file makes no difference.
        let _ = self.copy.set(copy);
        self.state.lock().client.set_own(OwnFile::First);
    }

    /// Whether [`RemoteSource::set_copy`] was called.
    pub fn has_copy(&self) -> bool {
        self.copy.get().is_some()
    }

    /// Asks for blocks that will be read soon, in one message to each reader, without waiting. Only a hint: blocks beyond
    /// [`RemoteOptions::ahead_bytes_max`] are left out. What is never read takes up that room until the source is dropped.
    pub fn will_need(&self, blocks: &[BlockId]) {
        let (mut state, mut actions) = (self.state.lock(), Vec::new());
        state.client.will_need(blocks, self.now(), &mut actions);
        self.perform(&mut state, &mut actions);
    }

    /// What it did so far.
    pub fn counters(&self) -> RemoteCounters {
        self.state.lock().client.counters()
    }

    fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// Does what the client wants done; whether something could not be done, so that more has changed. Who waits is told if anything was
    /// done at all.
    fn perform(&self, state: &mut State, actions: &mut Vec<Action>) -> bool {
        let mut has_failed = false;
        if !actions.is_empty() {
            self.changed.notify_all();
        }
        while !actions.is_empty() {
            for action in std::mem::take(actions) {
                match action {
                    Action::Send { to, frame } => {
                        if let Err(error) = self.transport.send(to, frame) {
                            has_failed = true;
                            let event = TransportEvent::Disconnected { peer: to, reason: error.to_string() };
                            state.client.handle(event, self.now(), actions);
                        }
                    }
                    Action::Disconnect { peer, .. } => self.transport.disconnect(peer),
                    Action::Log(_) => {}
                }
            }
        }
        has_failed
    }

    /// Reads a block from the node's own copy, and if that is damaged from its file, and says whether it is as it should be.
    fn read_own(&self, block: BlockId, into: &mut Vec<u8>) -> (Result<(), SourceError>, bool) {
        let reason = "this node does not have the file".to_owned();
        let mut read = Err(failed(&format!("block {}", block.0), io::ErrorKind::NotFound, reason));
        for own in self.copy.get().into_iter().chain(&self.fallback) {
            read = own.read_block(block, into);
            let is_as_it_should = |entry: &BlockEntry| checksum(into) == entry.checksum;
            if read.is_ok() && self.model.entry(block).is_some_and(is_as_it_should) {
                return (read, true);
            }
        }
        (read, false)
    }

    /// What the node has on its own disk, if that gives attributes.
    fn attributes(&self) -> Option<&Arc<dyn BlockSource>> {
        let own = self.fallback.iter().chain(self.copy.get());
        own.into_iter().find(|own| own.gives_attributes())
    }

    /// Waits until something changes, or until a time. One of those that wait for an answer receives for all.
    fn wait(&self, state: &mut MutexGuard<'_, State>, until: Duration, for_answer: bool) {
        let left = until.saturating_sub(self.now());
        if !for_answer || state.is_receiving {
            self.changed.wait_for(state, left);
            return;
        }
        state.is_receiving = true;
        let received = MutexGuard::unlocked(state, || self.transport.receive(left));
        state.is_receiving = false;
        let mut actions = Vec::new();
        match received {
            Ok(Some(event)) => state.client.handle(event, self.now(), &mut actions),
            Ok(None) => {}
            Err(_) => state.client.lose_all(self.now(), &mut actions),
        }
        self.perform(state, &mut actions);
        // Another must receive if this one is served, and see what came in any case.
        self.changed.notify_all();
    }
}

impl BlockSource for RemoteSource {
    fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// Readers serve blocks; attributes come from the node's own disk, if it has the file or a copy of it.
    fn gives_attributes(&self) -> bool {
        self.attributes().is_some()
    }

    fn read_attributes(&self, page: u32, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        match self.attributes() {
            Some(own) => own.read_attributes(page, into),
            None => Err(SourceError::NoAttributes { page, name: NAME.to_owned() }),
        }
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let (mut state, mut actions) = (self.state.lock(), Vec::new());
        if !state.client.want(block, self.now(), &mut actions) {
            return Err(SourceError::NoSuchBlock {
                block,
                name: NAME.to_owned(),
                // The directory has at most 2^32 - 1 entries.
                count: self.model.blocks.len() as u32,
            });
        }
        // What the own file gave the last time, and `into` with it.
        let mut own = None;
        loop {
            let need = state.client.need(block, self.now(), &mut actions);
            let has_failed = self.perform(&mut state, &mut actions);
            match need {
                Need::Take(bytes) => {
                    into.clear();
                    into.extend_from_slice(&bytes);
                    return Ok(());
                }
                Need::Connect { place, address } => {
                    let peer = MutexGuard::unlocked(&mut state, || self.transport.connect(&address)).ok();
                    state.client.connected(place, &address, peer, self.now(), &mut actions);
                    self.perform(&mut state, &mut actions);
                    self.changed.notify_all();
                }
                Need::ReadOwn => {
                    let (read, is_sound) = MutexGuard::unlocked(&mut state, || self.read_own(block, into));
                    state.client.own_read(block, is_sound, self.now(), &mut actions);
                    self.perform(&mut state, &mut actions);
                    self.changed.notify_all();
                    if is_sound {
                        return Ok(());
                    }
                    own = Some(read);
                }
                // What has been asked may have changed; it is looked at again.
                Need::Wait { .. } if has_failed => {}
                Need::Wait { until, for_answer } => self.wait(&mut state, until, for_answer),
                Need::GiveUp if self.fallback.is_some() => {
                    drop(state);
                    return own.unwrap_or_else(|| self.read_own(block, into).0);
                }
                Need::GiveUp => {
                    let reason = "no reader gives it, and this node does not have the file".to_owned();
                    into.clear();
                    return Err(failed(&format!("block {}", block.0), io::ErrorKind::NotConnected, reason));
                }
            }
        }
    }
}

impl std::fmt::Debug for RemoteSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RemoteSource").finish_non_exhaustive()
    }
}
