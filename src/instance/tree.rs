//! The tree over the boxes of instances: two children per node, boxes in f64.

use crate::geom::{Aabb, RayFrame};

/// Deepest tree over fewer than 2^32 boxes that is halved at each level, and one more.
const DEPTH_MAX: usize = 34;

/// Two children: their boxes, and what they are.
#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: [Aabb; 2],
    children: [Child; 2],
}

/// A node, or a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Child {
    Node(u32),
    Leaf(u32),
}

/// See the module's text.
#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    /// What is at the top, if there is anything, and its box.
    root: Option<(Aabb, Child)>,
}

impl Tree {
    /// What a tree over so many boxes takes, and what building it takes beside.
    pub fn bytes(count: usize) -> u64 {
        (count * (size_of::<Node>() + size_of::<u32>())) as u64
    }

    /// A tree over `boxes`, of which the empty ones are left out.
    pub fn new(boxes: &[Aabb]) -> Tree {
        // There are fewer than 2^24.
        let mut order: Vec<u32> =
            (0u32..).zip(boxes).filter(|(_, bounds)| !bounds.is_empty()).map(|(index, _)| index).collect();
        let mut tree = Tree { nodes: Vec::with_capacity(order.len()), root: None };
        if !order.is_empty() {
            tree.root = Some(tree.build(boxes, &mut order));
        }
        tree
    }

    /// Halves the boxes at the middle one along the axis where their middles spread most; as deep as halving goes.
    fn build(&mut self, boxes: &[Aabb], order: &mut [u32]) -> (Aabb, Child) {
        if let [index] = *order {
            return (boxes[index as usize], Child::Leaf(index));
        }
        let mut middles = Aabb::EMPTY;
        for index in order.iter() {
            middles.grow(boxes[*index as usize].center());
        }
        let spread = middles.extent();
        let axis = (1..3).fold(0, |widest, axis| if spread[axis] > spread[widest] { axis } else { widest });
        let half = order.len() / 2;
        // The number breaks ties, so that the tree is a pure function of the boxes.
        order.select_nth_unstable_by(half, |a, b| {
            let [x, y] = [a, b].map(|index| boxes[*index as usize].center()[axis]);
            x.total_cmp(&y).then(a.cmp(b))
        });
        let place = self.nodes.len();
        let empty = Node { bounds: [Aabb::EMPTY; 2], children: [Child::Leaf(0); 2] };
        self.nodes.push(empty);
        let (left, right) = order.split_at_mut(half);
        let sides = [self.build(boxes, left), self.build(boxes, right)];
        self.nodes[place] = Node { bounds: sides.map(|side| side.0), children: sides.map(|side| side.1) };
        let mut bounds = sides[0].0;
        bounds.merge(&sides[1].0);
        (bounds, Child::Node(place as u32))
    }

    /// The box of all.
    pub fn bounds(&self) -> Aabb {
        self.root.map_or(Aabb::EMPTY, |(bounds, _)| bounds)
    }

    /// Calls `visit` for each box that the ray may meet up to `frame.t_max`, which `visit` may lower, the nearer of two siblings
    /// first, until it gives true. Gives whether it did. `box_tests` grows by one for each box tested.
    #[inline(always)]
    pub fn visit<E>(
        &self,
        frame: &mut RayFrame,
        box_tests: &mut u64,
        mut visit: impl FnMut(u32, &mut RayFrame) -> Result<bool, E>,
    ) -> Result<bool, E> {
        let Some((bounds, root)) = self.root else { return Ok(false) };
        let line = Line::new(frame);
        *box_tests += 1;
        let Some(near) = line.enter(&bounds, frame.t_max) else { return Ok(false) };
        let mut stack = [(near, root); DEPTH_MAX];
        let mut len = 1;
        while len > 0 {
            len -= 1;
            let (near, mut child) = stack[len];
            if near > line.parameter_high(frame.t_max) {
                continue;
            }
            while let Child::Node(index) = child {
                let node = &self.nodes[index as usize];
                *box_tests += 2;
                let found = [0, 1].map(|side| line.enter(&node.bounds[side], frame.t_max));
                child = match found {
                    [None, None] => break,
                    [Some(_), None] => node.children[0],
                    [None, Some(_)] => node.children[1],
                    [Some(left), Some(right)] => {
                        let farther = usize::from(left <= right);
                        stack[len] = (if farther == 0 { left } else { right }, node.children[farther]);
                        len += 1;
                        node.children[1 - farther]
                    }
                };
            }
            if let Child::Leaf(index) = child
                && visit(index, frame)?
            {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

/// A ray ready for boxes, in the parameter of the frame's scaled direction.
struct Line {
    origin: [f64; 3],
    inverse: [f64; 3],
    low: f64,
    to_parameter: f64,
}

/// More than the roundings of an entry or an exit, which are 3, with room: a difference, a quotient, a product.
const WIDEN: f64 = 8.0 * f64::EPSILON;
/// More than the error of a hit's `t`.
const T_MARGIN: f64 = 1.0 / (1u64 << 38) as f64;

impl Line {
    fn new(frame: &RayFrame) -> Line {
        // Components are zero or not below 2^-570, so that no other inverse is infinite.
        let inverse = frame.direction().map(|x| 1.0 / x);
        let to_parameter = 1.0 / frame.scale();
        let low = frame.t_min * to_parameter * (1.0 - T_MARGIN);
        Line { origin: frame.origin(), inverse, low, to_parameter }
    }

    #[inline(always)]
    fn parameter_high(&self, t: f64) -> f64 {
        if t >= f64::MAX { f64::INFINITY } else { t * self.to_parameter * (1.0 + T_MARGIN) }
    }

    /// Where the ray enters a box that it may meet up to `t_max`. Never misses one that it meets; NaN (a plane through the origin of a ray
    /// along it) is no constraint.
    #[inline(always)]
    fn enter(&self, bounds: &Aabb, t_max: f64) -> Option<f64> {
        let (mut near, mut far) = (self.low, self.parameter_high(t_max));
        for axis in 0..3 {
            let low = (bounds.min[axis] - self.origin[axis]) * self.inverse[axis];
            let high = (bounds.max[axis] - self.origin[axis]) * self.inverse[axis];
            let (entry, exit) = if self.inverse[axis].is_sign_negative() { (high, low) } else { (low, high) };
            // Signs are exact, and what is negative matters by its sign alone.
            let (entry, exit) = (entry * (1.0 - WIDEN), exit * (1.0 + WIDEN));
            near = if entry > near { entry } else { near };
            far = if exit < far { exit } else { far };
        }
        (near <= far).then_some(near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Ray;
    use std::convert::Infallible;

    #[test]
    fn every_box_that_is_met_is_visited() {
        let mut state = 7u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        let mut met = 0;
        for count in [0, 1, 2, 3, 100] {
            let boxes: Vec<Aabb> = (0..count)
                .map(|_| {
                    let mut bounds = Aabb::EMPTY;
                    let at = [random(), random(), random()];
                    bounds.grow(at);
                    bounds.grow(at.map(|x| x + 0.2 * random()));
                    bounds
                })
                .collect();
            let tree = Tree::new(&boxes);
            assert_eq!(
                tree.bounds(),
                boxes.iter().fold(Aabb::EMPTY, |mut all, b| {
                    all.merge(b);
                    all
                })
            );
            for turn in 0..300 {
                // A point of a box is certainly met; along an axis, or not.
                let origin = [0, 1, 2].map(|_| 3.0 * random());
                let aim = boxes
                    .get(turn % count.max(1))
                    .map_or([0.0; 3], |b| if turn % 2 == 0 { b.min } else { b.center() });
                let mut direction = [0, 1, 2].map(|axis| aim[axis] - origin[axis]);
                let mut origin = origin;
                if turn % 3 == 0 {
                    direction = [0.0, 0.0, direction[2]];
                    (origin[0], origin[1]) = (aim[0], aim[1]);
                }
                let mut frame = RayFrame::new(&Ray::new(origin, direction));
                let mut visited = vec![];
                let found = tree.visit(&mut frame, &mut 0, |index, _| {
                    visited.push(index);
                    Ok::<_, Infallible>(false)
                });
                assert_eq!(found, Ok(false));
                if count > 0 {
                    assert!(visited.contains(&((turn % count) as u32)), "{turn} of {count}");
                    met += visited.len();
                }
                visited.sort_unstable();
                visited.dedup();
                assert!(visited.len() <= count);
                // Nothing before the ray begins or behind its end.
                let ray = Ray { t_max: 1e-9, ..Ray::new([50.0; 3], direction) };
                let none = tree.visit(&mut RayFrame::new(&ray), &mut 0, |_, _| Ok::<_, Infallible>(true));
                assert_eq!(none, Ok(false));
            }
        }
        assert!(met > 1000);
    }
}
