//! The paper's policies: every worker a central point; the nearest tile, or one that is also far from the others' points.

use std::collections::{BTreeSet, HashMap};

use super::nearest::{TileIndex, distance};
use super::points::central_point;
use super::{Policy, View, first_cells};
use crate::schedule::grid::TileCells;
use crate::schedule::ledger::Ledger;
use crate::schedule::options::CentralPoints;
use crate::units::TileId;

/// Gives each worker the free tile of least `distance to its own point - weight * distance to the nearest other point`.
pub(in crate::schedule) struct CentralPolicy {
    points: CentralPoints,
    weight: f64,
    expected: u32,
    /// The image in tiles.
    sides: [u32; 2],
    /// Number and place of each worker's point.
    of_worker: HashMap<u32, (u32, [f64; 2])>,
    /// Numbers of points that were given back.
    vacant: BTreeSet<u32>,
    given: u32,
    index: TileIndex,
    /// For each tile by place, the two nearest points; kept only where they count.
    near: Vec<[Near; 2]>,
    is_stale: bool,
}

/// A worker's point, seen from a tile.
#[derive(Clone, Copy)]
struct Near {
    distance: f64,
    slot: u32,
}

impl Near {
    const NOBODY: Near = Near { distance: f64::INFINITY, slot: u32::MAX };
}

impl CentralPolicy {
    pub fn new(ledger: &Ledger, points: CentralPoints, weight: f64, expected: u32) -> CentralPolicy {
        let grid = ledger.grid();
        let mut index = TileIndex::new(grid);
        for tile in (0..grid.tile_count()).map(TileId) {
            index.set(tile, ledger.free(tile) != 0);
        }
        let tiles = if weight > 0.0 { grid.tile_count() as usize } else { 0 };
        CentralPolicy {
            points,
            weight,
            expected,
            sides: grid.sides(),
            of_worker: HashMap::new(),
            vacant: BTreeSet::new(),
            given: 0,
            index,
            near: vec![[Near::NOBODY; 2]; tiles],
            is_stale: false,
        }
    }

    /// What the place is granted if `slot` asks.
    fn grant(&self, place: usize, slot: u32) -> f64 {
        let Some([first, second]) = self.near.get(place) else { return 0.0 };
        let other = if first.slot == slot { second } else { first };
        // Alone, no tile is better than another.
        if other.distance.is_finite() { self.weight * other.distance } else { 0.0 }
    }

    /// A point came: it is near to some tiles.
    fn add(near: &mut [[Near; 2]], columns: u32, slot: u32, point: [f64; 2]) {
        for (place, [first, second]) in near.iter_mut().enumerate() {
            let found = Near { distance: distance(point, middle(place, columns)), slot };
            if found.distance < first.distance {
                (*first, *second) = (found, *first);
            } else if found.distance < second.distance {
                *second = found;
            }
        }
    }

    /// A point is gone: tiles that had it among their nearest look at all again.
    fn remove(&mut self, slot: u32) {
        let columns = self.sides[0];
        for (place, pair) in self.near.iter_mut().enumerate() {
            if pair.iter().any(|near| near.slot == slot) {
                *pair = [Near::NOBODY; 2];
                for (other, (_, point)) in &self.of_worker {
                    let found = Near { distance: distance(*point, middle(place, columns)), slot: *other };
                    // Equal distances in the order of the workers, so that the order of the table does not show.
                    let before = |near: &Near| (found.distance, found.slot) < (near.distance, near.slot);
                    if before(&pair[0]) {
                        *pair = [found, pair[0]];
                    } else if before(&pair[1]) {
                        pair[1] = found;
                    }
                }
            }
        }
    }

    fn refresh(&mut self) {
        if std::mem::take(&mut self.is_stale) {
            let near = &self.near;
            let weight = self.weight;
            self.index.set_grants_max(&|place| {
                let [first, second] = near[place].map(|near| near.distance);
                weight
                    * if second.is_finite() {
                        second
                    } else if first.is_finite() {
                        first
                    } else {
                        0.0
                    }
            });
        }
    }
}

/// The middle of a place, counted in tiles.
fn middle(place: usize, columns: u32) -> [f64; 2] {
    let place = place as u32;
    [f64::from(place % columns) + 0.5, f64::from(place / columns) + 0.5]
}

impl Policy for CentralPolicy {
    fn join(&mut self, slot: u32, _: &Ledger) {
        let number = self.vacant.pop_first().unwrap_or_else(|| {
            self.given += 1;
            self.given - 1
        });
        let point = central_point(self.points, number, self.expected, self.sides.map(f64::from));
        self.of_worker.insert(slot, (number, point));
        CentralPolicy::add(&mut self.near, self.sides[0], slot, point);
        self.is_stale = !self.near.is_empty();
    }

    fn leave(&mut self, slot: u32) {
        let Some((number, _)) = self.of_worker.remove(&slot) else { return };
        self.vacant.insert(number);
        self.remove(slot);
        self.is_stale = !self.near.is_empty();
    }

    fn pick(&mut self, view: &View<'_>) -> Option<TileCells> {
        self.refresh();
        let (_, point) = *self.of_worker.get(&view.slot)?;
        while let Some(tile) = self.index.least(point, &|place| self.grant(place, view.slot)) {
            let free = view.ledger.free(tile);
            let cells = if free == 0 { 0 } else { first_cells(free, (view.cells_max)(tile), false) };
            if cells == free {
                self.index.set(tile, false);
            }
            if cells != 0 {
                return Some(TileCells { tile, cells });
            }
        }
        None
    }

    fn freed(&mut self, cells: TileCells) {
        if !cells.is_empty() {
            self.index.set(cells.tile, true);
        }
    }
}
