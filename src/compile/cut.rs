//! A bucket's triangles to blocks: a binned sweep for the lowest surface area, and one counting sort.
//!
//! Triangles are binned once by the middle of their boxes into about 12^3 cells; everything after that works on cells:
//! groups of cells are halved at the plane with the least `area * triangles` of both sides (the surface area heuristic of J. MacDonald
//! and K. Booth, 1990) until each group fits a block, and on until each block has its sub-boxes. Only counts and
//! boxes enter, no sums of floats, so the result does not depend on the order of the triangles.

use super::point::Real;
use crate::geom::Aabb;
use crate::model::SUB_BOX_COUNT;
use crate::simd::Quad;

/// Cells of the grid of one cut: about 12^3, spread over the axes so that cells are near cubes.
const CELLS_MAX: usize = 1728;
/// Most cells along one axis.
const SIDE_MAX: usize = 64;
const NO_CELL: u32 = u32::MAX;

/// A box, padded to four lanes: one vector per side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Box4<R: Real> {
    min: R::Quad,
    max: R::Quad,
}

impl<R: Real> Box4<R> {
    #[inline]
    pub(super) fn empty() -> Box4<R> {
        Box4 { min: Quad::of([R::INFINITY; 4]), max: Quad::of([R::NEG_INFINITY; 4]) }
    }

    /// The box of a triangle.
    #[inline(always)]
    pub(super) fn of(a: R::Quad, b: R::Quad, c: R::Quad) -> Box4<R> {
        Box4 { min: a.least(b).least(c), max: a.most(b).most(c) }
    }

    #[inline(always)]
    pub(super) fn merge(&mut self, other: &Box4<R>) {
        self.min = self.min.least(other.min);
        self.max = self.max.most(other.max);
    }

    /// Grows the box to hold a point.
    #[inline(always)]
    pub(super) fn grow(&mut self, point: R::Quad) {
        self.min = self.min.least(point);
        self.max = self.max.most(point);
    }

    /// Half of the surface; 0 for the empty box.
    #[inline]
    fn half_area(&self) -> f64 {
        let (min, max) = (self.min.to_array(), self.max.to_array());
        let extent = |axis: usize| {
            let extent = max[axis].to_f64() - min[axis].to_f64();
            if extent > 0.0 { extent } else { 0.0 }
        };
        let (x, y, z) = (extent(0), extent(1), extent(2));
        x * y + y * z + z * x
    }

    pub(super) fn to_aabb(self) -> Aabb {
        let (min, max) = (self.min.to_array(), self.max.to_array());
        Aabb { min: [0, 1, 2].map(|i| min[i].to_f64()), max: [0, 1, 2].map(|i| max[i].to_f64()) }
    }

    /// The middles of the box along the axes; cannot overflow.
    #[inline(always)]
    fn middles(&self) -> R::Quad {
        self.min.middle(self.max)
    }
}

/// Triangles of one block: a range of the cut's order.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub(super) start: usize,
    pub(super) len: usize,
    /// Up to eight boxes, empty ones last, in the coordinates of the cut.
    pub(super) sub_boxes: [Aabb; SUB_BOX_COUNT],
}

/// Cuts; keeps its memory from one bucket to the next.
#[derive(Debug)]
pub(super) struct Cutter<R: Real> {
    /// Box of each triangle.
    pub(super) boxes: Vec<Box4<R>>,
    /// Triangle numbers, grouped into pieces by [`Cutter::cut`].
    pub(super) order: Vec<u32>,
    sorted: Vec<u32>,
    /// Cell, later group, of each position of the range that is cut.
    cell_of: Vec<u32>,
    cells: Vec<Cell<R>>,
    /// Numbers of cells that hold triangles.
    full: Vec<u32>,
    groups: Vec<Group>,
    group_of_cell: Vec<u32>,
    starts: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Cell<R: Real> {
    bounds: Box4<R>,
    count: u32,
    at: [u8; 3],
}

/// A range of `full`.
#[derive(Clone, Copy, Debug)]
struct Group {
    start: u32,
    end: u32,
    count: u32,
}

/// A range of the order that is still to be cut.
struct Task {
    start: usize,
    len: usize,
    len_max: usize,
}

/// The best plane of a group.
struct Split {
    axis: usize,
    /// Cells with a coordinate below this go left.
    at: u8,
}

impl<R: Real> Cutter<R> {
    pub(super) fn new() -> Cutter<R> {
        Cutter {
            boxes: Vec::new(),
            order: Vec::new(),
            sorted: Vec::new(),
            cell_of: Vec::new(),
            cells: Vec::new(),
            full: Vec::new(),
            groups: Vec::new(),
            group_of_cell: Vec::new(),
            starts: Vec::new(),
        }
    }

    /// Groups `order[start..start + len]` into pieces of at most `len_max` triangles, appended to `pieces`. Within a piece
    /// triangles keep the order that they had.
    pub(super) fn cut(&mut self, start: usize, len: usize, len_max: usize, pieces: &mut Vec<Piece>) {
        let mut tasks = vec![Task { start, len, len_max: len_max.max(1) }];
        while let Some(task) = tasks.pop() {
            if !self.bin(&task) {
                self.cut_by_order(&task, pieces);
                continue;
            }
            self.group(task.len_max);
            self.sort(&task);
            self.emit(&task, &mut tasks, pieces);
        }
    }

    /// Bins the triangles of a task; false if their middles all coincide.
    fn bin(&mut self, task: &Task) -> bool {
        let order = &self.order[task.start..task.start + task.len];
        let mut middles = Box4::<R>::empty();
        for &triangle in order {
            middles.grow(self.boxes[triangle as usize].middles());
        }
        let ends = middles.to_aabb();
        let extent = |axis: usize| ends.max[axis] - ends.min[axis];
        let extent = [extent(0), extent(1), extent(2)];
        if extent.iter().all(|extent| *extent <= 0.0) {
            return false;
        }
        let sides = sides(extent, task.len);
        let mut scale = [R::from_f64(0.0); 4];
        for axis in 0..3 {
            let cells = sides[axis] as f64 / extent[axis];
            scale[axis] = R::from_f64(if cells.is_finite() { cells } else { 0.0 });
        }
        let empty = Cell { bounds: Box4::empty(), count: 0, at: [0; 3] };
        self.cells.clear();
        self.cells.resize(sides[0] * sides[1] * sides[2], empty);
        self.cell_of.resize(order.len(), 0);
        let last = [sides[0] as u8 - 1, sides[1] as u8 - 1, sides[2] as u8 - 1];
        let [x, y, z] = last.map(|last| R::from_f64(last.into()));
        let (min, scale, lasts) = (middles.min, Quad::of(scale), Quad::of([x, y, z, R::from_f64(0.0)]));
        // There are at most some thousand cells.
        let weights = [1, sides[0] as i16, (sides[0] * sides[1]) as i16, 0];
        let (boxes, cells) = (&self.boxes[..], &mut self.cells[..]);
        for (cell_of, &triangle) in self.cell_of.iter_mut().zip(order) {
            let bounds = &boxes[triangle as usize];
            let index = bounds.middles().cell(min, scale, lasts, weights);
            let cell = &mut cells[index as usize];
            cell.bounds.merge(bounds);
            cell.count += 1;
            *cell_of = index;
        }
        self.full.clear();
        let mut index = 0;
        for z in 0..=last[2] {
            for y in 0..=last[1] {
                for x in 0..=last[0] {
                    let cell = &mut self.cells[index as usize];
                    if cell.count > 0 {
                        cell.at = [x, y, z];
                        self.full.push(index);
                    }
                    index += 1;
                }
            }
        }
        // Extents so small that all cells became one: nothing was gained, and nothing would be again.
        self.full.len() > 1
    }

    /// Cuts all cells into groups of at most `len_max` triangles (more where one cell has more).
    fn group(&mut self, len_max: usize) {
        self.groups.clear();
        let count = self.full.iter().map(|cell| self.cells[*cell as usize].count).sum();
        let blocks = 1.0 / len_max as f64;
        // Half triangles, half blocks: a plane that leaves whole blocks is worth a little more area. Measured on gears: 12 % fewer
        // blocks of the same total area.
        let weight = |triangles: u32| {
            let blocks = f64::from(triangles) * blocks;
            blocks + blocks.ceil()
        };
        let mut open = vec![Group { start: 0, end: self.full.len() as u32, count }];
        while let Some(group) = open.pop() {
            match (group.count as usize > len_max).then(|| self.halve(group, weight)).flatten() {
                Some((left, right)) => open.extend([right, left]),
                None => self.groups.push(group),
            }
        }
    }

    /// Parts a group at its best plane; `None` if it is one cell.
    fn halve(&mut self, group: Group, weight: impl Fn(u32) -> f64) -> Option<(Group, Group)> {
        let range = group.start as usize..group.end as usize;
        let split = best_split(&self.cells, &self.full[range.clone()], weight)?;
        let cells = &self.cells;
        let full = &mut self.full[range];
        let mut left = 0;
        let mut left_count = 0;
        for index in 0..full.len() {
            let cell = &cells[full[index] as usize];
            if cell.at[split.axis] < split.at {
                left_count += cell.count;
                full.swap(left, index);
                left += 1;
            }
        }
        let middle = group.start + left as u32;
        Some((
            Group { start: group.start, end: middle, count: left_count },
            Group { start: middle, end: group.end, count: group.count - left_count },
        ))
    }

    /// One counting sort brings the order into groups.
    fn sort(&mut self, task: &Task) {
        self.group_of_cell.clear();
        self.group_of_cell.resize(self.cells.len(), NO_CELL);
        self.starts.clear();
        let mut start = 0;
        for (index, group) in self.groups.iter().enumerate() {
            for cell in &self.full[group.start as usize..group.end as usize] {
                self.group_of_cell[*cell as usize] = index as u32;
            }
            self.starts.push(start);
            start += group.count;
        }
        if self.sorted.len() < task.len {
            self.sorted.resize(task.len, 0);
        }
        let order = &mut self.order[task.start..task.start + task.len];
        for (triangle, cell) in order.iter().zip(&self.cell_of) {
            let next = &mut self.starts[self.group_of_cell[*cell as usize] as usize];
            self.sorted[*next as usize] = *triangle;
            *next += 1;
        }
        order.copy_from_slice(&self.sorted[..task.len]);
    }

    /// Turns groups into pieces, or into tasks where one cell holds too much.
    fn emit(&mut self, task: &Task, tasks: &mut Vec<Task>, pieces: &mut Vec<Piece>) {
        let mut start = task.start;
        for index in 0..self.groups.len() {
            let group = self.groups[index];
            let len = group.count as usize;
            if len > task.len_max {
                tasks.push(Task { start, len, len_max: task.len_max });
            } else {
                let sub_boxes = self.sub_boxes(group);
                pieces.push(Piece { start, len, sub_boxes });
            }
            start += len;
        }
    }

    /// Goes on halving a group, always the part with the largest area, until there are enough parts.
    fn sub_boxes(&mut self, group: Group) -> [Aabb; SUB_BOX_COUNT] {
        let bounds = |cutter: &Cutter<R>, group: Group| {
            let mut bounds = Box4::empty();
            for cell in &cutter.full[group.start as usize..group.end as usize] {
                bounds.merge(&cutter.cells[*cell as usize].bounds);
            }
            bounds
        };
        let mut parts = [(group, bounds(self, group), 0.0); SUB_BOX_COUNT];
        parts[0].2 = parts[0].1.half_area();
        let mut count = 1;
        while count < SUB_BOX_COUNT {
            let mut largest = None;
            for (index, (part, _, area)) in parts[..count].iter().enumerate() {
                if part.end - part.start > 1 && largest.is_none_or(|(_, best)| *area > best) {
                    largest = Some((index, *area));
                }
            }
            let Some((index, _)) = largest else { break };
            // More than one cell, so there is a plane between two of them.
            let Some((left, right)) = self.halve(parts[index].0, f64::from) else { break };
            for (at, part) in [(index, left), (count, right)] {
                let bounds = bounds(self, part);
                parts[at] = (part, bounds, bounds.half_area());
            }
            count += 1;
        }
        let mut sub_boxes = [Aabb::EMPTY; SUB_BOX_COUNT];
        for (into, (_, bounds, _)) in sub_boxes.iter_mut().zip(&parts[..count]) {
            *into = bounds.to_aabb();
        }
        sub_boxes
    }

    /// Pieces of triangles that cannot be told apart by place.
    fn cut_by_order(&mut self, task: &Task, pieces: &mut Vec<Piece>) {
        self.cut_evenly(task.start, task.len, task.len_max, pieces);
    }

    /// Pieces of `len_max` triangles of `order[start..start + len]` as it stands.
    pub(super) fn cut_evenly(
        &mut self,
        mut start: usize,
        len: usize,
        len_max: usize,
        pieces: &mut Vec<Piece>,
    ) {
        let end = start + len;
        while start < end {
            let len = len_max.min(end - start);
            let mut bounds = Box4::empty();
            for triangle in &self.order[start..start + len] {
                bounds.merge(&self.boxes[*triangle as usize]);
            }
            let mut sub_boxes = [Aabb::EMPTY; SUB_BOX_COUNT];
            sub_boxes[0] = bounds.to_aabb();
            pieces.push(Piece { start, len, sub_boxes });
            start += len;
        }
    }
}

/// Cells along each axis: near cubes, about [`CELLS_MAX`] of them, fewer for few triangles.
fn sides(extent: [f64; 3], len: usize) -> [usize; 3] {
    let cells_max = CELLS_MAX.min(len).max(8) as f64;
    let largest = extent.into_iter().fold(0.0, f64::max);
    // The size of a cell, as a part of the largest extent, shrinks until there are enough cells.
    let mut best = [1; 3];
    for step in 1..=SIDE_MAX {
        let sides =
            extent.map(|extent| ((extent / largest * step as f64).round() as usize).clamp(1, SIDE_MAX));
        if sides.iter().product::<usize>() as f64 > cells_max && step > 2 {
            break;
        }
        best = sides;
    }
    best
}

/// The plane with the least `area * count` on both sides; `None` for a single cell.
fn best_split<R: Real>(cells: &[Cell<R>], group: &[u32], weight: impl Fn(u32) -> f64) -> Option<Split> {
    if group.len() < 2 {
        return None;
    }
    let (mut low, mut high) = ([u8::MAX; 3], [0; 3]);
    for cell in group {
        let at = cells[*cell as usize].at;
        for axis in 0..3 {
            low[axis] = low[axis].min(at[axis]);
            high[axis] = high[axis].max(at[axis]);
        }
    }
    let mut slabs = [[(Box4::<R>::empty(), 0_u32); SIDE_MAX]; 3];
    for cell in group {
        let cell = &cells[*cell as usize];
        for axis in 0..3 {
            let slab = &mut slabs[axis][usize::from(cell.at[axis] - low[axis])];
            slab.0.merge(&cell.bounds);
            slab.1 += cell.count;
        }
    }
    let mut best: Option<(f64, Split)> = None;
    for axis in 0..3 {
        let count = usize::from(high[axis] - low[axis]) + 1;
        let slabs = &slabs[axis][..count];
        let mut right_cost = [0.0; SIDE_MAX];
        let (mut bounds, mut triangles) = (Box4::empty(), 0);
        for index in (1..count).rev() {
            bounds.merge(&slabs[index].0);
            triangles += slabs[index].1;
            right_cost[index] = bounds.half_area() * weight(triangles);
        }
        let (mut bounds, mut triangles) = (Box4::empty(), 0);
        for index in 1..count {
            bounds.merge(&slabs[index - 1].0);
            triangles += slabs[index - 1].1;
            let cost = bounds.half_area() * weight(triangles) + right_cost[index];
            // Both sides hold a cell: the slabs at both ends are full. NaN (areas that overflow) loses to nothing.
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, Split { axis, at: low[axis] + index as u8 }));
            }
        }
    }
    best.map(|(_, split)| split)
}
