//! The asking side of readers: whom a node asks for a block, and what it does if the answer is late, damaged or none.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;

use smallvec::SmallVec;

use super::Action;
use super::message::{BLOCKS_MAX, Message};
use super::model_file::readers_of;
use crate::block::checksum;
use crate::model::Model;
use crate::transport::{PeerId, TransportEvent};
use crate::units::BlockId;

/// When nobody gives a block, all are asked again after this.
const AGAIN: Duration = Duration::from_millis(50);

/// What can be chosen about how readers are asked.
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
    /// Bytes of blocks that were asked for in advance ([`BlockClient::will_need`]) and may wait for their use.
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

/// Where a node's blocks came from.
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
    /// Frames and blocks that arrived damaged, and were asked for again; and blocks that are damaged on the node's own disk.
    pub damaged: u64,
    /// Times that a reader was given up: it ended the connection, could not be reached, or did not answer.
    pub readers_lost: u64,
    /// Messages that asked for blocks.
    pub requests: u64,
}

/// The node's own file of the model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OwnFile {
    /// There is none.
    #[default]
    Absent,
    /// It is asked last: the readers' memory is faster than this disk.
    Last,
    /// It is asked first; readers only for blocks that are damaged there.
    First,
}

/// What somebody who waits for a block has to do next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Need {
    /// Take the block's stored bytes, which match their checksum. The wait is over.
    Take(Arc<Vec<u8>>),
    /// Connect to a reader and say how that went ([`BlockClient::connected`]).
    Connect {
        /// The reader's place in the list.
        place: usize,
        /// Where it is.
        address: String,
    },
    /// Read the block from the own file and say how that went ([`BlockClient::own_read`]).
    ReadOwn,
    /// Wait until something changes, or until this time; then ask again.
    Wait {
        /// Until when.
        until: Duration,
        /// Whether it is for something that comes over the network.
        for_answer: bool,
    },
    /// Nobody gives the block. The wait is over.
    GiveUp,
}

/// One reader as this node sees it.
struct Link {
    address: String,
    peer: Option<PeerId>,
    is_connecting: bool,
    /// Not to be asked before.
    rest_until: Option<Duration>,
}

impl Link {
    fn new(address: String) -> Link {
        Link { address, peer: None, is_connecting: false, rest_until: None }
    }
}

/// How far one round through the readers is.
#[derive(Clone, Default)]
struct Round {
    /// Places of the readers, the one to be asked first first.
    order: SmallVec<[usize; 8]>,
    /// How many of them did not give the block.
    failed: usize,
    /// How often it came damaged from the next one.
    damaged: u32,
}

impl Round {
    fn place(&self) -> Option<usize> {
        self.order.get(self.failed).copied()
    }

    fn next_reader(self) -> Round {
        Round { failed: self.failed + 1, damaged: 0, ..self }
    }
}

/// Who gave a block.
#[derive(Clone, Copy)]
enum Giver {
    Owner,
    Replica,
    Other,
}

/// What becomes of a block that somebody wants.
enum Stage {
    /// The next reader of the round is not connected.
    Unconnected(Round),
    /// It was asked of the next reader of the round.
    Asked {
        round: Round,
        peer: PeerId,
        deadline: Duration,
    },
    /// The own file is to be read.
    Own,
    /// Nobody gave it; there is another round at this time.
    Again(Duration),
    Here(Arc<Vec<u8>>, Giver),
    GivenUp,
}

/// A block that was asked for.
struct Wanted {
    /// How many wait for it; 0 for one that was asked for in advance.
    waiting: u32,
    since: Duration,
    is_damaged_here: bool,
    stage: Stage,
}

/// The state machine of a node that takes its blocks from readers: events and the time go in; [`Action`]s, and for each block
/// what is [needed](Need) next, come out. No threads, no clock, no sockets, no disk:
/// [`RemoteSource`](super::RemoteSource) drives it in real time.
///
/// Any number of blocks may be on their way at one time. A block is checked when it arrives; a damaged one is asked for again, then of
/// another reader. If its reader is gone, or does not answer, another is asked ([`readers_of`]), and at last the node's own file,
/// if there is one. What it holds is bounded by how many blocks are waited for, and by [`RemoteOptions::ahead_bytes_max`].
pub struct BlockClient {
    model: Arc<Model>,
    options: RemoteOptions,
    own: OwnFile,
    links: Vec<Link>,
    // In order, so that the same events give the same actions.
    wanted: BTreeMap<u32, Wanted>,
    /// Bytes of blocks that were asked for in advance and have not been used.
    ahead_bytes: u64,
    /// Blocks that are asked for very often, and whose turn it is to be asked for them; see [`Message::Block`].
    turns: HashMap<u32, u8>,
    counters: RemoteCounters,
    is_abandoned: bool,
}

impl BlockClient {
    /// A node that wants blocks of `model` and knows no readers yet.
    pub fn new(model: Arc<Model>, own: OwnFile, options: RemoteOptions) -> BlockClient {
        BlockClient {
            model,
            options,
            own,
            links: Vec::new(),
            wanted: BTreeMap::new(),
            ahead_bytes: 0,
            turns: HashMap::new(),
            counters: RemoteCounters::default(),
            is_abandoned: false,
        }
    }

    /// Where the node's own file stands from now on.
    pub fn set_own(&mut self, own: OwnFile) {
        self.own = own;
    }

    /// Nobody needs blocks any more: who waits for a reader to come back is told to give up.
    pub fn abandon(&mut self) {
        self.is_abandoned = true;
    }

    /// Where the readers are from now on. Their number and order decide who holds which block ([`readers_of`]), so an absent one keeps
    /// its place, as an empty text.
    pub fn set_readers(&mut self, readers: &[String], now: Duration, actions: &mut Vec<Action>) {
        for (place, address) in readers.iter().enumerate() {
            let link = self.links.get(place);
            if link.is_some_and(|link| link.address == *address) {
                continue;
            }
            // Whoever waits for it goes on to the next reader of its round before another takes the place.
            self.lose(place, Duration::ZERO, now, actions);
            let link = Link::new(address.clone());
            if place < self.links.len() {
                self.links[place] = link;
            } else {
                self.links.push(link);
            }
        }
        for place in readers.len()..self.links.len() {
            self.lose(place, Duration::ZERO, now, actions);
        }
        self.links.truncate(readers.len());
    }

    /// Where the readers are now, as [`BlockClient::set_readers`] told.
    pub fn readers(&self) -> impl Iterator<Item = &str> {
        self.links.iter().map(|link| link.address.as_str())
    }

    /// Asks for blocks that will be wanted soon, in one message to each reader that is connected. Only a hint: blocks beyond
    /// [`RemoteOptions::ahead_bytes_max`] are left out. What is never wanted takes up that room as long as the client lives.
    pub fn will_need(&mut self, blocks: &[BlockId], now: Duration, actions: &mut Vec<Action>) {
        if self.own == OwnFile::First {
            return;
        }
        let mut by_peer: BTreeMap<PeerId, Vec<u32>> = BTreeMap::new();
        for block in blocks {
            let bytes = self.stored_bytes(block.0);
            let has_room = self.ahead_bytes + bytes <= self.options.ahead_bytes_max;
            if self.model.entry(*block).is_none() || self.wanted.contains_key(&block.0) || !has_room {
                continue;
            }
            let round = self.round(block.0);
            let link = round.place().and_then(|place| self.links.get(place));
            let Some(peer) = link.and_then(|link| link.peer) else { continue };
            let deadline = now.saturating_add(self.options.answer_time_max);
            let stage = Stage::Asked { round, peer, deadline };
            self.ahead_bytes += bytes;
            self.wanted.insert(block.0, Wanted { waiting: 0, since: now, is_damaged_here: false, stage });
            by_peer.entry(peer).or_default().push(block.0);
        }
        for (peer, blocks) in by_peer {
            for blocks in blocks.chunks(BLOCKS_MAX) {
                self.counters.requests += 1;
                let frame = Message::Read { blocks: blocks.to_vec() }.frame();
                actions.push(Action::Send { to: peer, frame });
            }
        }
    }

    /// Somebody waits for a block from now on; [`BlockClient::need`] says what for. False, and nobody waits, if the model has no such
    /// block.
    pub fn want(&mut self, block: BlockId, now: Duration, actions: &mut Vec<Action>) -> bool {
        if self.model.entry(block).is_none() {
            return false;
        }
        if let Some(wanted) = self.wanted.get_mut(&block.0) {
            wanted.waiting += 1;
            if wanted.waiting == 1 {
                // Asked for in advance; it counts as such no more. Nobody has looked for its answer before.
                wanted.since = now;
                if let Stage::Asked { deadline, .. } = &mut wanted.stage {
                    *deadline = now.saturating_add(self.options.answer_time_max);
                }
                self.ahead_bytes = self.ahead_bytes.saturating_sub(self.stored_bytes(block.0));
            } else {
                // Patience is that of the last who came.
                wanted.since = now;
                if matches!(wanted.stage, Stage::GivenUp) {
                    self.begin(block.0, now, actions);
                }
            }
            return true;
        }
        let wanted = Wanted { waiting: 1, since: now, is_damaged_here: false, stage: Stage::Own };
        self.wanted.insert(block.0, wanted);
        self.begin(block.0, now, actions);
        true
    }

    /// What one who waits for a block ([`BlockClient::want`]) has to do next; [`Need::GiveUp`] if nobody does.
    pub fn need(&mut self, block: BlockId, now: Duration, actions: &mut Vec<Action>) -> Need {
        // Each turn goes a step on, and a round ends with a wait, with the own file, or by giving up.
        loop {
            let waited = self.wanted.get_mut(&block.0).filter(|wanted| wanted.waiting > 0);
            let Some(wanted) = waited else { return Need::GiveUp };
            match &mut wanted.stage {
                Stage::Here(bytes, giver) => {
                    let (bytes, giver) = (Arc::clone(bytes), *giver);
                    match giver {
                        Giver::Owner => self.counters.from_owner += 1,
                        Giver::Replica => self.counters.from_replica += 1,
                        Giver::Other => self.counters.from_other += 1,
                    }
                    self.end_wait(block.0);
                    return Need::Take(bytes);
                }
                Stage::GivenUp => {
                    self.end_wait(block.0);
                    return Need::GiveUp;
                }
                Stage::Own => return Need::ReadOwn,
                Stage::Again(at) => {
                    let at = *at;
                    if now < at && !self.is_abandoned {
                        return Need::Wait { until: at, for_answer: false };
                    }
                    if self.is_hopeless(block.0, now) {
                        self.set(block.0, Stage::GivenUp);
                    } else {
                        self.begin(block.0, now, actions);
                    }
                }
                Stage::Asked { peer, deadline, .. } => {
                    let (peer, until) = (*peer, *deadline);
                    if now < until {
                        return Need::Wait { until, for_answer: true };
                    }
                    self.lose_peer(peer, now, actions);
                }
                Stage::Unconnected(round) => {
                    let round = std::mem::take(round);
                    let link = round.place().and_then(|place| Some((place, self.links.get_mut(place)?)));
                    if let Some((place, link)) = link
                        && link.can_be_connected(now)
                    {
                        let need = if link.is_connecting {
                            let until = now.saturating_add(self.options.answer_time_max);
                            Need::Wait { until, for_answer: false }
                        } else {
                            link.is_connecting = true;
                            Need::Connect { place, address: link.address.clone() }
                        };
                        self.set(block.0, Stage::Unconnected(round));
                        return need;
                    }
                    self.ask(block.0, round, now, actions);
                }
            }
        }
    }

    /// One who waited for a block does so no more, without having taken it.
    pub fn leave(&mut self, block: BlockId) {
        if self.wanted.get(&block.0).is_some_and(|wanted| wanted.waiting > 0) {
            self.end_wait(block.0);
        }
    }

    /// How an attempt to [connect](Need::Connect) went.
    pub fn connected(
        &mut self,
        place: usize,
        address: &str,
        peer: Option<PeerId>,
        now: Duration,
        actions: &mut Vec<Action>,
    ) {
        // The list may have changed meanwhile.
        let link = self.links.get_mut(place).filter(|link| link.address == address && link.peer.is_none());
        match (link, peer) {
            (Some(link), Some(peer)) => {
                link.is_connecting = false;
                link.peer = Some(peer);
            }
            (Some(link), None) => {
                link.is_connecting = false;
                self.lose(place, self.options.retry_after, now, actions);
            }
            (None, Some(peer)) => {
                let reason = "it is not a reader any more".to_owned();
                actions.push(Action::Disconnect { peer, reason });
            }
            (None, None) => {}
        }
        // Those that waited for it ask it, or the next one.
        for block in
            self.blocks_at(|stage| matches!(stage, Stage::Unconnected(round) if round.place() == Some(place)))
        {
            if let Some(Wanted { stage: Stage::Unconnected(round), .. }) = self.wanted.get_mut(&block) {
                let round = std::mem::take(round);
                self.ask(block, round, now, actions);
            }
        }
    }

    /// How reading a block from the own file ([`Need::ReadOwn`]) went: whether its bytes match their checksum. Then the wait is over.
    pub fn own_read(&mut self, block: BlockId, is_sound: bool, now: Duration, actions: &mut Vec<Action>) {
        let is_first = self.own == OwnFile::First;
        let Some(wanted) = self.wanted.get_mut(&block.0) else { return };
        if is_sound {
            if is_first {
                self.counters.from_copy += 1;
            } else {
                self.counters.from_fallback += 1;
            }
            self.end_wait(block.0);
            return;
        }
        self.counters.damaged += u64::from(!wanted.is_damaged_here);
        wanted.is_damaged_here = true;
        // Another who waits may have said so already.
        if matches!(wanted.stage, Stage::Own) {
            if is_first {
                let round = self.round(block.0);
                self.ask(block.0, round, now, actions);
            } else {
                self.end_round(block.0, now);
            }
        }
    }

    /// Something happened on the network, or a frame could not be sent ([`TransportEvent::Disconnected`]).
    pub fn handle(&mut self, event: TransportEvent, now: Duration, actions: &mut Vec<Action>) {
        match event {
            TransportEvent::Frame { peer, bytes } => match Message::parse(&bytes) {
                Ok((Message::Block { block, turn }, stored)) => {
                    self.block_came(peer, block, turn, stored, now, actions);
                }
                Ok((Message::NoBlock { block, .. }, _)) => {
                    if let Some(round) = self.answered(peer, block) {
                        self.ask(block, round.next_reader(), now, actions);
                    }
                }
                // A reader may tell what it likes; only blocks matter here.
                Ok(_) => {}
                Err(_) => {
                    self.counters.damaged += 1;
                    self.lose_peer(peer, now, actions);
                }
            },
            TransportEvent::Disconnected { peer, .. } => self.lose_peer(peer, now, actions),
            TransportEvent::Connected { peer, .. } => {
                let reason = "nobody has any business here".to_owned();
                actions.push(Action::Disconnect { peer, reason });
            }
            TransportEvent::Refused { .. } => {}
        }
    }

    /// The transport is gone: so are all readers.
    pub fn lose_all(&mut self, now: Duration, actions: &mut Vec<Action>) {
        (0..self.links.len()).for_each(|place| {
            if self.links[place].peer.is_some() {
                self.lose(place, self.options.retry_after, now, actions);
            }
        });
    }

    /// What it did so far.
    pub fn counters(&self) -> RemoteCounters {
        self.counters
    }

    /// How many blocks are waited for or were asked for in advance, and how many bytes the latter have.
    pub fn outstanding(&self) -> (usize, u64) {
        (self.wanted.len(), self.ahead_bytes)
    }

    fn stored_bytes(&self, block: u32) -> u64 {
        self.model.entry(BlockId(block)).map_or(0, |entry| u64::from(entry.stored_bytes))
    }

    /// Whom to ask for a block, the first one first.
    fn round(&self, block: u32) -> Round {
        let mut order: SmallVec<[usize; 8]> = readers_of(block, self.links.len()).collect();
        if let (Some(turn), false) = (self.turns.get(&block), order.is_empty()) {
            let turn = usize::from(*turn) % order.len();
            order.rotate_left(turn);
        }
        Round { order, failed: 0, damaged: 0 }
    }

    fn set(&mut self, block: u32, stage: Stage) {
        if let Some(wanted) = self.wanted.get_mut(&block) {
            wanted.stage = stage;
        }
    }

    /// A round begins.
    fn begin(&mut self, block: u32, now: Duration, actions: &mut Vec<Action>) {
        if self.own == OwnFile::First {
            self.set(block, Stage::Own);
        } else {
            let round = self.round(block);
            self.ask(block, round, now, actions);
        }
    }

    /// Asks the first reader of what is left of a round that can be asked.
    fn ask(&mut self, block: u32, mut round: Round, now: Duration, actions: &mut Vec<Action>) {
        let is_ahead = self.wanted.get(&block).is_none_or(|wanted| wanted.waiting == 0);
        if is_ahead {
            // It was only to be there in time.
            self.forget(block);
            return;
        }
        while let Some(place) = round.place() {
            match self.links.get(place) {
                Some(Link { peer: Some(peer), .. }) => {
                    let peer = *peer;
                    self.counters.requests += 1;
                    let frame = Message::Read { blocks: vec![block] }.frame();
                    actions.push(Action::Send { to: peer, frame });
                    let deadline = now.saturating_add(self.options.answer_time_max);
                    self.set(block, Stage::Asked { round, peer, deadline });
                    return;
                }
                Some(link) if link.can_be_connected(now) => {
                    self.set(block, Stage::Unconnected(round));
                    return;
                }
                _ => round = round.next_reader(),
            }
        }
        match self.own {
            OwnFile::Last => self.set(block, Stage::Own),
            OwnFile::Absent | OwnFile::First => self.end_round(block, now),
        }
    }

    /// Nobody gave it.
    fn end_round(&mut self, block: u32, now: Duration) {
        // Damaged on this disk: a reader that comes back may still give it. If none does, whoever decodes the block says what is
        // wrong with it.
        let nobody_comes = self.own == OwnFile::Last && self.links.is_empty();
        let stage = if nobody_comes || self.is_hopeless(block, now) {
            Stage::GivenUp
        } else {
            Stage::Again(now.saturating_add(AGAIN))
        };
        self.set(block, stage);
    }

    fn is_hopeless(&self, block: u32, now: Duration) -> bool {
        let since = self.wanted.get(&block).map_or(now, |wanted| wanted.since);
        self.is_abandoned || now.saturating_sub(since) >= self.options.patience
    }

    /// Takes a block's round if it was asked of `peer` and has not come.
    fn answered(&mut self, peer: PeerId, block: u32) -> Option<Round> {
        match &mut self.wanted.get_mut(&block)?.stage {
            Stage::Asked { round, peer: asked, .. } if *asked == peer => Some(std::mem::take(round)),
            // Late, after it was asked elsewhere.
            _ => None,
        }
    }

    fn block_came(
        &mut self,
        peer: PeerId,
        block: u32,
        turn: u8,
        stored: &[u8],
        now: Duration,
        actions: &mut Vec<Action>,
    ) {
        let Some(mut round) = self.answered(peer, block) else { return };
        let is_sound = self.model.entry(BlockId(block)).is_some_and(|entry| {
            stored.len() == entry.stored_bytes as usize && checksum(stored) == entry.checksum
        });
        if !is_sound {
            self.counters.damaged += 1;
            round.damaged += 1;
            let is_enough = round.damaged >= self.options.tries.max(1);
            self.ask(block, if is_enough { round.next_reader() } else { round }, now, actions);
            return;
        }
        self.counters.bytes_received += stored.len() as u64;
        if turn > 0 {
            self.turns.insert(block, turn);
        } else {
            self.turns.remove(&block);
        }
        let owner = readers_of(block, self.links.len()).next();
        let giver = match round.failed {
            _ if round.place() == owner => Giver::Owner,
            0 => Giver::Replica,
            _ => Giver::Other,
        };
        self.set(block, Stage::Here(Arc::new(stored.to_vec()), giver));
    }

    /// One less waits for a block.
    fn end_wait(&mut self, block: u32) {
        let Some(wanted) = self.wanted.get_mut(&block) else { return };
        wanted.waiting = wanted.waiting.saturating_sub(1);
        if wanted.waiting == 0 {
            self.wanted.remove(&block);
        }
    }

    /// Forgets a block that was asked for in advance and did not come.
    fn forget(&mut self, block: u32) {
        if self.wanted.remove(&block).is_some() {
            self.ahead_bytes = self.ahead_bytes.saturating_sub(self.stored_bytes(block));
        }
    }

    fn blocks_at(&self, is_there: impl Fn(&Stage) -> bool) -> Vec<u32> {
        let there = self.wanted.iter().filter(|(_, wanted)| is_there(&wanted.stage));
        there.map(|(block, _)| *block).collect()
    }

    fn lose_peer(&mut self, peer: PeerId, now: Duration, actions: &mut Vec<Action>) {
        match self.links.iter().position(|link| link.peer == Some(peer)) {
            Some(place) => self.lose(place, self.options.retry_after, now, actions),
            None => self.give_up(peer, now, actions),
        }
    }

    /// Gives a reader up, for a while.
    fn lose(&mut self, place: usize, rest: Duration, now: Duration, actions: &mut Vec<Action>) {
        let Some(link) = self.links.get_mut(place) else { return };
        link.rest_until = Some(now.saturating_add(rest));
        self.counters.readers_lost += u64::from(!rest.is_zero());
        if let Some(peer) = link.peer.take() {
            let reason = "the reader was given up".to_owned();
            actions.push(Action::Disconnect { peer, reason });
            self.give_up(peer, now, actions);
        }
    }

    /// Nothing will come from `peer` any more: others are asked.
    fn give_up(&mut self, peer: PeerId, now: Duration, actions: &mut Vec<Action>) {
        for block in
            self.blocks_at(|stage| matches!(stage, Stage::Asked { peer: asked, .. } if *asked == peer))
        {
            if let Some(round) = self.answered(peer, block) {
                self.ask(block, round.next_reader(), now, actions);
            }
        }
    }
}

impl Link {
    /// Whether there is any use in an attempt.
    fn can_be_connected(&self, now: Duration) -> bool {
        self.peer.is_none()
            && !self.address.is_empty()
            && (self.is_connecting || self.rest_until.is_none_or(|until| now >= until))
    }
}

impl std::fmt::Debug for BlockClient {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BlockClient").finish_non_exhaustive()
    }
}
