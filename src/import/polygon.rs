//! Cuts polygons into triangles.
//!
//! The polygon is projected along the axis in which its Newell normal is longest, which keeps coordinates as they
//! are, and cut there by ears whose orientation is decided exactly (`robust`, after Shewchuk 1997). Every corner
//! stays a corner of some triangle, also one that lies straight between its neighbours: a neighbouring face has it
//! too, and without it the surface would crack (I3). This is why no crate does it: `earcut` drops such corners, and
//! decides orientation in plain f64.
//!
//! Polygons that meet themselves along an edge or in a corner, as those do that reach their holes through a slit,
//! are cut correctly. For those that cross themselves no cutting is correct: either some triangles overlap or,
//! where no ear is left, the rest becomes a fan and is counted.

use std::ops::Range;

use robust::{Coord, orient2d};

/// Most corners that a polygon may have.
pub const CORNERS_MAX: usize = 1 << 16;

/// Corners that may be tested against ears in one polygon: about a second. Only polygons of many thousand corners,
/// most of them reflex and most ears long, come near it; what is left of one then becomes a fan.
const TESTS_MAX: u64 = 1 << 28;

/// How a polygon was cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cut {
    /// Into triangles that all face the same way in the projection.
    Clean,
    /// In part or all as a fan: it crosses itself, has no area, or is not finite.
    Fan,
}

/// Working memory of the cutter: at most 80 bytes for each corner of the largest polygon so far.
#[derive(Default)]
pub(super) struct Cutter {
    /// Corners in the projection, in counterclockwise order.
    points: Vec<Coord<f64>>,
    /// Neighbours among the corners that are left.
    links: Vec<Link>,
    /// Corners that may lie inside an ear, ordered along `sort_axis`, with their coordinate there.
    reflex: Vec<(f64, u32)>,
    sort_axis: usize,
    /// The triangles, as indices of corners.
    triangles: Vec<[u32; 3]>,
}

#[derive(Clone, Copy)]
struct Link {
    previous: u32,
    next: u32,
    /// Whether the corner is left and may lie inside an ear.
    blocks: bool,
}

impl Cutter {
    /// Cuts the polygon with the given corners. The triangles name corners by their index and keep their turn.
    pub(super) fn cut(&mut self, positions: &[[f64; 3]]) -> (Cut, &[[u32; 3]]) {
        let count = positions.len() as u32;
        self.triangles.clear();
        let cut = if !self.project(positions) {
            self.fan(0..count);
            Cut::Fan
        } else if self.is_strictly_convex() {
            self.fan(0..count);
            Cut::Clean
        } else {
            self.clip_ears()
        };
        (cut, &self.triangles)
    }

    /// Triangles from the first corner of a range.
    fn fan(&mut self, range: Range<u32>) {
        let first = range.start;
        self.triangles.extend((first + 2..range.end).map(|last| [first, last - 1, last]));
    }

    /// Projects the corners so that they go counterclockwise; false if there is no direction to do so.
    fn project(&mut self, positions: &[[f64; 3]]) -> bool {
        let origin = positions[0];
        let relative = |index: usize| -> [f64; 3] {
            let position = positions[index % positions.len()];
            std::array::from_fn(|axis| position[axis] - origin[axis])
        };
        let mut normal = [0.0; 3];
        for index in 0..positions.len() {
            let (p, q) = (relative(index), relative(index + 1));
            for (axis, component) in normal.iter_mut().enumerate() {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                *component += (p[u] - q[u]) * (p[v] + q[v]);
            }
        }
        let length = |axis: usize| f64::abs(normal[axis]);
        let mut axis = 0;
        for other in [1, 2] {
            if length(other) > length(axis) {
                axis = other;
            }
        }
        // A NaN or an infinity in any corner reaches at least two components.
        if !(normal.iter().all(|component| component.is_finite()) && length(axis) > 0.0) {
            return false;
        }
        let (mut u, mut v) = ((axis + 1) % 3, (axis + 2) % 3);
        if normal[axis] < 0.0 {
            (u, v) = (v, u);
        }
        self.points.clear();
        self.points.extend(positions.iter().map(|position| Coord { x: position[u], y: position[v] }));
        true
    }

    /// Twice the signed area of three corners, with the exact sign.
    fn turn(&self, a: u32, b: u32, c: u32) -> f64 {
        orient2d(self.points[a as usize], self.points[b as usize], self.points[c as usize])
    }

    /// Whether every corner turns left and the whole goes round once: then a fan from any corner is right.
    fn is_strictly_convex(&self) -> bool {
        let count = self.points.len() as u32;
        let next = |index: u32| if index + 1 == count { 0 } else { index + 1 };
        // A closed chain of left turns goes round once for every two changes between rightward and leftward.
        let mut changes = 0;
        let mut rightward = None;
        for a in 0..count {
            let b = next(a);
            if self.turn(a, b, next(b)) <= 0.0 {
                return false;
            }
            let (from, to) = (self.points[a as usize].x, self.points[b as usize].x);
            if from != to {
                changes += u32::from(rightward == Some(to < from));
                rightward = Some(to > from);
            }
        }
        // The change between the last edge and the first is not counted: one or two of two remain.
        changes <= 2
    }

    /// Cuts ears off until three corners are left. An ear is a corner that turns left whose triangle holds no other
    /// corner.
    fn clip_ears(&mut self) -> Cut {
        let count = self.points.len() as u32;
        self.links.clear();
        self.links.extend((0..count).map(|index| Link {
            previous: if index == 0 { count - 1 } else { index - 1 },
            next: if index + 1 == count { 0 } else { index + 1 },
            blocks: false,
        }));
        self.collect_reflex();
        let mut left = count;
        let mut tests = 0;
        let mut corner = 0;
        // Corners looked at since the last ear. After a round without an ear, the edge of an ear counts as outside.
        let mut misses = 0;
        let mut closed = true;
        while left > 3 {
            let Link { previous, next, .. } = self.links[corner as usize];
            if self.turn(previous, corner, next) > 0.0 && self.is_ear(corner, closed, &mut tests) {
                self.triangles.push([previous, corner, next]);
                self.unlink(corner);
                left -= 1;
                misses = 0;
                closed = true;
                // Going on behind the next corner gives rounder triangles than going on with it.
                corner = self.links[next as usize].next;
                continue;
            }
            corner = next;
            misses += 1;
            if misses > left {
                if !closed {
                    break;
                }
                closed = false;
                misses = 0;
            }
            if tests > TESTS_MAX {
                break;
            }
        }
        let Link { previous, next, .. } = self.links[corner as usize];
        if left == 3 {
            self.triangles.push([previous, corner, next]);
            // The last three may lie on a line where the polygon has corners on its edges; they must not turn right.
            return if self.turn(previous, corner, next) >= 0.0 { Cut::Clean } else { Cut::Fan };
        }
        let mut last = next;
        while self.links[last as usize].next != corner {
            let after = self.links[last as usize].next;
            self.triangles.push([corner, last, after]);
            last = after;
        }
        Cut::Fan
    }

    /// Takes an ear off. Its neighbours may stop to be reflex; no corner becomes so.
    fn unlink(&mut self, corner: u32) {
        let Link { previous, next, .. } = self.links[corner as usize];
        self.links[previous as usize].next = next;
        self.links[next as usize].previous = previous;
        self.links[corner as usize].blocks = false;
        for neighbor in [previous, next] {
            let Link { previous, next, blocks } = self.links[neighbor as usize];
            if blocks && self.turn(previous, neighbor, next) > 0.0 {
                self.links[neighbor as usize].blocks = false;
            }
        }
    }

    /// Lists the corners that do not turn left. If any corner is inside an ear, then one of these is.
    fn collect_reflex(&mut self) {
        let extent = |of: fn(&Coord<f64>) -> f64| {
            let (min, max) = self
                .points
                .iter()
                .map(of)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), x| (min.min(x), max.max(x)));
            max - min
        };
        self.sort_axis = usize::from(extent(|point| point.y) > extent(|point| point.x));
        self.reflex.clear();
        for corner in 0..self.links.len() as u32 {
            let Link { previous, next, .. } = self.links[corner as usize];
            if self.turn(previous, corner, next) <= 0.0 {
                self.links[corner as usize].blocks = true;
                self.reflex.push((along(self.points[corner as usize], self.sort_axis), corner));
            }
        }
        self.reflex.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    }

    /// Whether no corner is in the triangle of a corner that turns left. With `closed`, its edge belongs to it.
    fn is_ear(&self, corner: u32, closed: bool, tests: &mut u64) -> bool {
        let Link { previous, next, .. } = self.links[corner as usize];
        let [a, b, c] = [previous, corner, next].map(|index| self.points[index as usize]);
        let [min_x, max_x] = [a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x)];
        let [min_y, max_y] = [a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y)];
        let [low, high] = if self.sort_axis == 0 { [min_x, max_x] } else { [min_y, max_y] };
        let first = self.reflex.partition_point(|(key, _)| *key < low);
        for (key, other) in &self.reflex[first..] {
            if *key > high {
                break;
            }
            *tests += 1;
            let link = self.links[*other as usize];
            if !link.blocks || *other == previous || *other == corner || *other == next {
                continue;
            }
            let p = self.points[*other as usize];
            if p.x < min_x || p.x > max_x || p.y < min_y || p.y > max_y || p == a || p == c {
                continue;
            }
            if p == b {
                // The polygon comes back to this place: does it go on into the ear?
                let enters = |to: u32| {
                    let to = self.points[to as usize];
                    orient2d(b, c, to) > 0.0 && orient2d(a, b, to) > 0.0
                };
                if enters(link.previous) || enters(link.next) {
                    return false;
                }
                continue;
            }
            let sides = [orient2d(a, b, p), orient2d(b, c, p), orient2d(c, a, p)];
            let inside = if closed {
                sides.iter().all(|side| *side >= 0.0)
            } else {
                sides.iter().all(|side| *side > 0.0)
            };
            if inside {
                return false;
            }
        }
        true
    }
}

/// One coordinate of a point.
fn along(point: Coord<f64>, axis: usize) -> f64 {
    if axis == 0 { point.x } else { point.y }
}
