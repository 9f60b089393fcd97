//! Every worker a piece of the curve; who is through takes over half of the largest piece.

use std::collections::{BTreeSet, HashMap};

use super::{Policy, View, first_cells};
use crate::schedule::grid::{TileCells, ones};
use crate::schedule::ledger::Ledger;
use crate::units::TileId;

/// Cells `next .. end` along the curve, where cell k of tile t has the number `t * cells_per_tile + k`. Cells that are not free any
/// more are passed over.
#[derive(Clone, Copy, Debug)]
struct Piece {
    next: u64,
    end: u64,
    /// Expected work, as it stands in the ranking.
    rank: u64,
}

impl Piece {
    const EMPTY: Piece = Piece { next: 0, end: 0, rank: 0 };

    fn is_empty(&self) -> bool {
        self.next >= self.end
    }
}

/// A piece is nearly as large as another if it has this part of its work.
const NEARLY: f64 = 0.7;

/// A piece of fewer tiles is short: it costs about the same everywhere.
const SHORT_TILES: u64 = 8;

/// Pieces of the curve, one for each worker; pieces that nobody has; and cells that came back.
///
/// A worker goes along its piece from its start to its end. Who is through takes over a whole piece that nobody has, or the back
/// half, by expected work, of the piece with most of it: so pieces stay in one part and are cut seldom.
pub(in crate::schedule) struct CurvePolicy {
    cells_per_tile: u64,
    pieces: Vec<Piece>,
    /// The piece of each worker.
    of_worker: HashMap<u32, u32>,
    /// Pieces of workers that are not empty, by expected work.
    owned: BTreeSet<(u64, u32)>,
    /// Pieces that nobody has, by number; the first ones lie where the first workers would have had them.
    orphans: BTreeSet<u32>,
    /// Numbers of pieces that are not in use.
    unused: Vec<u32>,
    /// Tiles with free cells behind the workers.
    returned: BTreeSet<TileId>,
}

impl CurvePolicy {
    /// Pieces of equal numbers of free cells for so many workers, who come later.
    pub fn new(ledger: &Ledger, workers: u32) -> CurvePolicy {
        let mut policy = CurvePolicy {
            cells_per_tile: u64::from(ledger.grid().cells_per_tile()),
            pieces: Vec::new(),
            of_worker: HashMap::new(),
            owned: BTreeSet::new(),
            orphans: BTreeSet::new(),
            unused: Vec::new(),
            returned: BTreeSet::new(),
        };
        let total = u128::from(ledger.cells_free());
        let (mut start, mut before) = (0, 0u128);
        for tile in 0..ledger.grid().tile_count() {
            let mut free = ledger.free(TileId(tile));
            while free != 0 {
                let cell = u64::from(free.trailing_zeros());
                free &= free - 1;
                before += 1;
                let share = (policy.pieces.len() as u128 + 1) * total / u128::from(workers);
                if before >= share {
                    let end = u64::from(tile) * policy.cells_per_tile + cell + 1;
                    policy.orphans.insert(policy.pieces.len() as u32);
                    policy.pieces.push(Piece { next: start, end, rank: 0 });
                    start = end;
                    // More workers than cells: the others take pieces over.
                }
            }
        }
        policy
    }

    /// The next cells of a piece.
    fn take(&mut self, number: u32, view: &View<'_>) -> Option<TileCells> {
        let per_tile = self.cells_per_tile;
        let piece = &mut self.pieces[number as usize];
        while !piece.is_empty() {
            let tile = TileId((piece.next / per_tile) as u32);
            let first = piece.next % per_tile;
            let until = per_tile.min(first + (piece.end - piece.next));
            let free = view.ledger.free(tile) & ones(first as u32, (until - first) as u32);
            if free == 0 {
                piece.next += until - first;
                continue;
            }
            let cells = first_cells(free, (view.cells_max)(tile).max(1), true);
            piece.next += 64 - u64::from(cells.leading_zeros()) - first;
            return Some(TileCells { tile, cells });
        }
        None
    }

    /// Expected work of a piece.
    fn work(&self, number: u32, view: &View<'_>) -> f64 {
        let piece = &self.pieces[number as usize];
        if piece.is_empty() {
            return 0.0;
        }
        // One tile stands for the whole: the middle, or, in a short piece, the start, which was just looked at.
        let is_short = piece.end - piece.next < SHORT_TILES * self.cells_per_tile;
        let at = if is_short { piece.next } else { piece.next + (piece.end - piece.next) / 2 };
        let tile = TileId((at.saturating_sub(1) / self.cells_per_tile) as u32);
        (piece.end - piece.next) as f64 * view.costs.estimate(view.grid(), tile).unwrap_or(1.0)
    }

    /// Puts a worker's piece where it belongs in the ranking.
    fn rank(&mut self, number: u32, view: &View<'_>) {
        self.owned.remove(&(self.pieces[number as usize].rank, number));
        // Bits of positive floats are in the order of their values.
        let rank = self.work(number, view).max(0.0).to_bits();
        self.pieces[number as usize].rank = rank;
        if !self.pieces[number as usize].is_empty() {
            self.owned.insert((rank, number));
        }
    }

    /// A piece for a worker that has none: one that nobody has, or part of the largest.
    fn take_over(&mut self, own: u32, view: &View<'_>) -> bool {
        if let Some(orphan) = self.orphans.pop_first() {
            self.pieces[own as usize] = std::mem::replace(&mut self.pieces[orphan as usize], Piece::EMPTY);
            self.unused.push(orphan);
            return true;
        }
        let Some(from) = self.large_and_likely(own, view) else { return false };
        let piece = self.pieces[from as usize];
        let middle = piece.next + (piece.end - piece.next) / 2;
        self.pieces[own as usize] = Piece { next: middle, end: piece.end, rank: 0 };
        self.pieces[from as usize].end = middle;
        self.rank(from, view);
        true
    }

    /// Of the pieces that are nearly as large as the largest, the one whose blocks the worker most likely holds, if that is known;
    /// among equals, the one nearest to where it was: it holds blocks of its neighbourhood.
    fn large_and_likely(&self, own: u32, view: &View<'_>) -> Option<u32> {
        const LOOKED_AT: usize = 32;
        let own_end = self.pieces[own as usize].end;
        let most = f64::from_bits(self.owned.last()?.0);
        let large = self.owned.iter().rev().take(LOOKED_AT);
        let large = large.take_while(|(rank, _)| f64::from_bits(*rank) >= NEARLY * most);
        let away = |piece: u32| self.pieces[piece as usize].next.abs_diff(own_end);
        // Counted in eighths: less is chance.
        let lacks = |piece: u32| match view.affinity {
            Some(affinity) => {
                let Piece { next, end, .. } = self.pieces[piece as usize];
                // In the middle of what would be taken over.
                let tile = TileId(((next + (end - next) / 4 * 3) / self.cells_per_tile) as u32);
                let likelihood = affinity.likelihood(view.slot, view.grid(), tile).unwrap_or(0.0);
                8 - (8.0 * likelihood) as u32
            }
            None => 0,
        };
        large.map(|(_, piece)| *piece).min_by_key(|piece| (lacks(*piece), away(*piece), *piece))
    }

    /// The tile with returned cells nearest to `to` along the curve.
    fn returned_near(&self, to: u64) -> Option<TileId> {
        let at = TileId((to / self.cells_per_tile) as u32);
        let after = self.returned.range(at..).next().copied();
        let before = self.returned.range(..at).next_back().copied();
        match (before, after) {
            (Some(before), Some(after)) if at.0 - before.0 < after.0 - at.0 => Some(before),
            (before, after) => after.or(before),
        }
    }

    /// A piece that nobody has, unless it is empty.
    fn add_orphan(&mut self, piece: Piece) {
        if !piece.is_empty() {
            let number = self.new_piece();
            self.pieces[number as usize] = piece;
            self.orphans.insert(number);
        }
    }

    fn new_piece(&mut self) -> u32 {
        self.unused.pop().unwrap_or_else(|| {
            self.pieces.push(Piece::EMPTY);
            self.pieces.len() as u32 - 1
        })
    }
}

impl Policy for CurvePolicy {
    fn join(&mut self, slot: u32, _: &Ledger) {
        let piece = match self.orphans.pop_first() {
            Some(orphan) => orphan,
            None => self.new_piece(),
        };
        self.of_worker.insert(slot, piece);
        if !self.pieces[piece as usize].is_empty() {
            // Its work is reckoned when its owner first asks.
            self.owned.insert((self.pieces[piece as usize].rank, piece));
        }
    }

    fn leave(&mut self, slot: u32) {
        let Some(piece) = self.of_worker.remove(&slot) else { return };
        self.owned.remove(&(self.pieces[piece as usize].rank, piece));
        if self.pieces[piece as usize].is_empty() {
            self.unused.push(piece);
        } else {
            self.orphans.insert(piece);
        }
    }

    fn pick(&mut self, view: &View<'_>) -> Option<TileCells> {
        let own = *self.of_worker.get(&view.slot)?;
        // What was given up is oldest and first.
        while let Some(tile) = self.returned_near(self.pieces[own as usize].next) {
            let free = view.ledger.free(tile);
            let cells = if free == 0 { 0 } else { first_cells(free, (view.cells_max)(tile), true) };
            if cells == free {
                self.returned.remove(&tile);
            }
            if cells != 0 {
                return Some(TileCells { tile, cells });
            }
        }
        loop {
            let cells = self.take(own, view);
            self.rank(own, view);
            if cells.is_some() {
                return cells;
            }
            if !self.take_over(own, view) {
                return None;
            }
        }
    }

    fn freed(&mut self, cells: TileCells) {
        if !cells.is_empty() {
            self.returned.insert(cells.tile);
        }
    }

    /// Cut into pieces of equal numbers of cells, one for each worker; a piece ends before a gap.
    fn granted(&mut self, cells: &[TileCells], workers: u32) {
        let total: u64 = cells.iter().map(|cells| u64::from(cells.count())).sum();
        let length = total.div_ceil(u64::from(workers.max(1))).max(1);
        let mut open = Piece::EMPTY;
        let mut held = 0;
        for TileCells { tile, cells } in cells.iter().copied() {
            let first = u64::from(tile.0) * self.cells_per_tile;
            let mut left = cells;
            while left != 0 {
                let number = first + u64::from(left.trailing_zeros());
                left &= left - 1;
                if held == length || number > open.end {
                    self.add_orphan(open);
                    (open, held) = (Piece { next: number, end: number, rank: 0 }, 0);
                }
                open.end = number + 1;
                held += 1;
            }
        }
        self.add_orphan(open);
    }

    fn withdrawn(&mut self, from: u64) {
        for number in 0..self.pieces.len() as u32 {
            let piece = self.pieces[number as usize];
            if piece.is_empty() || piece.end <= from {
                continue;
            }
            let end = from.max(piece.next);
            let part = (end - piece.next) as f64 / (piece.end - piece.next) as f64;
            let rank = (f64::from_bits(piece.rank) * part).to_bits();
            self.pieces[number as usize] = Piece { next: piece.next, end, rank };
            let is_empty = end == piece.next;
            if self.owned.remove(&(piece.rank, number)) {
                if !is_empty {
                    self.owned.insert((rank, number));
                }
            } else if is_empty && self.orphans.remove(&number) {
                self.unused.push(number);
            }
        }
    }
}
