//! The vertices of the source, in their own precision, within the budget.

use super::pages::Pages;
use super::spill::SpillPlace;
use crate::error::CompileError;
use crate::import::VertexBatch;

/// What is kept of vertices that come as f64 or as text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Keep {
    /// The f32 of text whose digits that keeps, and otherwise as for `Rounded`.
    Narrow,
    /// Their f32 rounding: enough for a `Float32` file, and to see whether it would be a good one.
    Rounded,
    /// The rounding, and themselves for the case that it is not.
    Both,
    /// Themselves.
    Exact,
}

/// The vertices so far.
#[derive(Debug)]
pub(super) enum VertexStore {
    /// Every vertex came as f32, or as text for [`Keep::Narrow`].
    Float32 {
        pages: Pages<[f32; 3]>,
        /// Largest move of a coordinate of text.
        move_max: f64,
    },
    /// Some came as f64; rounded to f32 with the distance that this moved them (rounded up), which is infinite where f32 cannot
    /// hold them and NaN where they are not finite.
    Rounded {
        rounded: Pages<[f32; 4]>,
        /// Largest finite move.
        move_max: f32,
        /// As they came, for [`Keep::Both`].
        exact: Option<Box<Pages<[f64; 3]>>>,
    },
    /// Some came as f64; as they came.
    Exact(Pages<[f64; 3]>),
}

impl VertexStore {
    pub(super) fn new(place: SpillPlace, headroom: u64) -> VertexStore {
        VertexStore::Float32 { pages: Pages::new(place, headroom), move_max: 0.0 }
    }

    pub(super) fn len(&self) -> usize {
        match self {
            VertexStore::Float32 { pages, .. } => pages.len(),
            VertexStore::Rounded { rounded, .. } => rounded.len(),
            VertexStore::Exact(pages) => pages.len(),
        }
    }

    /// No vertex is moved further by rounding to f32, along no axis (those that f32 cannot hold aside).
    pub(super) fn move_max(&self) -> f64 {
        match self {
            VertexStore::Float32 { move_max, .. } => *move_max,
            VertexStore::Rounded { move_max, .. } => f64::from(*move_max),
            VertexStore::Exact(_) => 0.0,
        }
    }

    /// What it holds of the budget.
    pub(super) fn memory_bytes(&self) -> u64 {
        match self {
            VertexStore::Float32 { pages, .. } => pages.memory_bytes(),
            VertexStore::Rounded { rounded, exact, .. } => {
                rounded.memory_bytes() + exact.as_ref().map_or(0, |exact| exact.memory_bytes())
            }
            VertexStore::Exact(pages) => pages.memory_bytes(),
        }
    }

    pub(super) fn spill_bytes(&self) -> u64 {
        match self {
            VertexStore::Float32 { pages, .. } => pages.spill_bytes(),
            VertexStore::Rounded { rounded, exact, .. } => {
                rounded.spill_bytes() + exact.as_ref().map_or(0, |exact| exact.spill_bytes())
            }
            VertexStore::Exact(pages) => pages.spill_bytes(),
        }
    }

    /// How many pages were read back so far.
    pub(super) fn fetches(&self) -> u64 {
        match self {
            VertexStore::Float32 { pages, .. } => pages.fetches(),
            VertexStore::Rounded { rounded, exact, .. } => {
                rounded.fetches() + exact.as_ref().map_or(0, |exact| exact.fetches())
            }
            VertexStore::Exact(pages) => pages.fetches(),
        }
    }

    /// Gives back what memory it can do without.
    pub(super) fn shrink(&mut self) {
        match self {
            VertexStore::Float32 { pages, .. } => pages.shrink(),
            VertexStore::Rounded { rounded, exact, .. } => {
                rounded.shrink();
                if let Some(exact) = exact {
                    exact.shrink();
                }
            }
            VertexStore::Exact(pages) => pages.shrink(),
        }
    }

    /// Gives back what is missing for `headroom` bytes of the budget to be free, as far as it can do without.
    pub(super) fn leave(&mut self, headroom: u64) {
        match self {
            VertexStore::Float32 { pages, .. } => pages.leave(headroom),
            VertexStore::Rounded { rounded, exact, .. } => {
                rounded.leave(headroom);
                if let Some(exact) = exact {
                    exact.leave(headroom);
                }
            }
            VertexStore::Exact(pages) => pages.leave(headroom),
        }
    }

    /// Gives up what a `Float32` file has no use for; returns how many bytes of it were spilled.
    pub(super) fn forget_exact(&mut self) -> u64 {
        match self {
            VertexStore::Rounded { exact, .. } => exact.take().map_or(0, |exact| exact.spill_bytes()),
            _ => 0,
        }
    }

    pub(super) fn extend(
        &mut self,
        batch: VertexBatch<'_>,
        keep: Keep,
        place: &SpillPlace,
        headroom: u64,
    ) -> Result<(), CompileError> {
        if let VertexStore::Float32 { pages, move_max } = &mut *self {
            let stays = match batch {
                VertexBatch::Float32(_) => true,
                VertexBatch::Float64(_) => false,
                VertexBatch::Float32Text(_) => keep == Keep::Narrow,
            };
            if !stays {
                *self = widen(pages, *move_max, keep, place, headroom)?;
            }
        }
        match (self, batch) {
            (VertexStore::Float32 { pages, .. }, VertexBatch::Float32(items)) => {
                pages.extend(items, |vertex| vertex)
            }
            (VertexStore::Float32 { pages, move_max }, VertexBatch::Float32Text(items)) => {
                pages.extend(items, |vertex| narrow(vertex, move_max))
            }
            (VertexStore::Float32 { .. }, VertexBatch::Float64(_)) => unreachable!("widened above"),
            (VertexStore::Exact(pages), VertexBatch::Float32(items)) => {
                pages.extend(items, |vertex| vertex.map(f64::from))
            }
            (VertexStore::Exact(pages), VertexBatch::Float64(items) | VertexBatch::Float32Text(items)) => {
                pages.extend(items, |vertex| vertex)
            }
            (VertexStore::Rounded { rounded, exact, .. }, VertexBatch::Float32(items)) => {
                rounded.extend(items, unmoved)?;
                exact.as_mut().map_or(Ok(()), |exact| exact.extend(items, |vertex| vertex.map(f64::from)))
            }
            (
                VertexStore::Rounded { rounded, exact, move_max },
                VertexBatch::Float64(items) | VertexBatch::Float32Text(items),
            ) => {
                rounded.extend(items, |vertex| {
                    let rounded = round(vertex);
                    if rounded[3] > *move_max && rounded[3].is_finite() {
                        *move_max = rounded[3];
                    }
                    rounded
                })?;
                exact.as_mut().map_or(Ok(()), |exact| exact.extend(items, |vertex| vertex))
            }
        }
    }

    /// Whether all that `position` and `narrow` read is in memory.
    pub(super) fn is_resident(&self) -> bool {
        match self {
            VertexStore::Float32 { pages, .. } => pages.is_resident(),
            VertexStore::Rounded { rounded, exact, .. } => {
                rounded.is_resident() && exact.as_ref().is_none_or(|exact| exact.is_resident())
            }
            VertexStore::Exact(pages) => pages.is_resident(),
        }
    }

    /// The position of a vertex below `len`, as exact as it was kept.
    pub(super) fn position(&mut self, vertex: u32) -> Result<[f64; 3], CompileError> {
        match self {
            VertexStore::Float32 { pages, .. } => Ok(pages.get(vertex)?.map(f64::from)),
            VertexStore::Rounded { exact: Some(exact), .. } => exact.get(vertex),
            VertexStore::Rounded { rounded, .. } => {
                let [x, y, z, _] = rounded.get(vertex)?;
                Ok([x, y, z].map(f64::from))
            }
            VertexStore::Exact(pages) => pages.get(vertex),
        }
    }

    /// [`VertexStore::position`] of a store that is resident.
    pub(super) fn position_resident(&self, vertex: u32) -> [f64; 3] {
        match self {
            VertexStore::Float32 { pages, .. } => pages.get_resident(vertex).map(f64::from),
            VertexStore::Rounded { exact: Some(exact), .. } => exact.get_resident(vertex),
            VertexStore::Rounded { rounded, .. } => {
                let [x, y, z, _] = rounded.get_resident(vertex);
                [x, y, z].map(f64::from)
            }
            VertexStore::Exact(pages) => pages.get_resident(vertex),
        }
    }
}

/// What a face is refused for that comes before its vertex.
pub(super) fn unknown_vertex(vertex: u64) -> CompileError {
    CompileError::Limit { reason: format!("a face names vertex {vertex}, which has not come yet") }
}

/// A store for f64 with the f32 vertices that came before, none of which was moved by more than `move_max`. How far each was moved is
/// not known any more: it counts as 0.
fn widen(
    narrow: &mut Pages<[f32; 3]>,
    move_max: f64,
    keep: Keep,
    place: &SpillPlace,
    headroom: u64,
) -> Result<VertexStore, CompileError> {
    let mut exact = Pages::new(place.clone(), headroom);
    let mut rounded = Pages::new(place.clone(), headroom);
    for index in 0..narrow.len() as u32 {
        let vertex = narrow.get(index)?;
        if keep != Keep::Exact {
            rounded.extend(&[vertex], unmoved)?;
        }
        if matches!(keep, Keep::Both | Keep::Exact) {
            exact.extend(&[vertex], |vertex| vertex.map(f64::from))?;
        }
    }
    // Rounded up.
    let move_max = if move_max > 0.0 { (move_max as f32).next_up() } else { 0.0 };
    Ok(match keep {
        Keep::Exact => VertexStore::Exact(exact),
        Keep::Both => VertexStore::Rounded { rounded, move_max, exact: Some(Box::new(exact)) },
        Keep::Narrow | Keep::Rounded => VertexStore::Rounded { rounded, move_max, exact: None },
    })
}

/// A vertex that came as f32. If it is not finite its move is not either.
fn unmoved([x, y, z]: [f32; 3]) -> [f32; 4] {
    [x, y, z, if (x + y + z).is_nan() || [x, y, z].iter().any(|x| !x.is_finite()) { f32::NAN } else { 0.0 }]
}

/// A vertex in f32; `move_max` grows to the largest of its moves along the axes, which are exact in f64.
#[inline]
fn narrow(vertex: [f64; 3], move_max: &mut f64) -> [f32; 3] {
    let [x, y, z] = vertex;
    let rounded = [x as f32, y as f32, z as f32];
    for axis in 0..3 {
        let moved = (vertex[axis] - f64::from(rounded[axis])).abs();
        // False for NaN, which infinities give: text in words.
        if moved > *move_max {
            *move_max = moved;
        }
    }
    rounded
}

/// A vertex in f32, and how far that moved it at most.
#[inline]
fn round(vertex: [f64; 3]) -> [f32; 4] {
    let [x, y, z] = vertex;
    let (rx, ry, rz) = (x as f32, y as f32, z as f32);
    let (dx, dy, dz) = (x - f64::from(rx), y - f64::from(ry), z - f64::from(rz));
    let square = dx * dx + dy * dy + dz * dz;
    if square == 0.0 {
        // Also of moves so short that their squares vanish: they are below 1e-160, and 1e-38 is a bound.
        let moved = if dx == 0.0 && dy == 0.0 && dz == 0.0 { 0.0 } else { f32::MIN_POSITIVE };
        return [rx, ry, rz, moved];
    }
    if !square.is_finite() {
        let is_finite = vertex.iter().all(|x| x.is_finite());
        return [rx, ry, rz, if is_finite { f32::INFINITY } else { f32::NAN }];
    }
    // The relative error of the sum, the root and the rounding to f32 is far below 2^-22; a subnormal bound is made normal.
    let moved = (square.sqrt() * (1.0 + f64::from(f32::EPSILON))) as f32;
    [rx, ry, rz, if moved > f32::MIN_POSITIVE { moved } else { f32::MIN_POSITIVE }]
}
