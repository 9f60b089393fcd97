//! The surface area heuristic (J. MacDonald and K. Booth, 1990), binned (I. Wald, 2007): one plane at a time for the coarse
//! tree, up to three at once for the fine ones.

use super::build::{EMPTY, MinBox, double_center};
use crate::simd::{LANES, Simd};

/// Bins per axis for the coarse tree, which is built once.
const BIN_COUNT: usize = 32;

/// Bins per axis for fine trees that are split by up to three planes at once; with 16 they are no better.
pub(super) const BIN_COUNT_AT_ONCE: usize = 8;

/// Bins per axis for those that are split by one plane at a time; with 32 they are no better.
pub(super) const BIN_COUNT_ONE: usize = 16;

/// A fine node gets a plane on each axis whose best plane gains at least this part of what the best of all gains.
const GATE: f32 = 0.9;

/// A fine node that is built quickly gets a plane on each axis along which its centres spread at least this part of how far they
/// spread along the longest.
const EXTENT_GATE: f32 = 0.3;

/// Planes in the middle of the centres, without a look at the primitives: twice their positions, and a bit for each axis that has
/// one, at most `planes_max`. `None` if the centres have no extent.
#[inline(always)]
pub(super) fn middle_planes(centers: &MinBox, planes_max: u32) -> Option<(MinBox, u32)> {
    let extent = |axis: usize| -centers[axis + 4] - centers[axis];
    let mut axes = [0usize, 1, 2];
    for (i, j) in [(0, 1), (1, 2), (0, 1)] {
        if extent(axes[j]) > extent(axes[i]) {
            axes.swap(i, j);
        }
    }
    let longest = extent(axes[0]);
    // False for NaN, and for what overflowed.
    if !(longest > 0.0 && longest < f32::INFINITY) {
        return None;
    }
    let (mut planes, mut mask) = (EMPTY, 0);
    for axis in &axes[..planes_max as usize] {
        if extent(*axis) >= EXTENT_GATE * longest {
            mask |= 1 << axis;
            planes[*axis] = 0.5 * centers[*axis] - 0.5 * centers[*axis + 4];
        }
    }
    Some((planes, mask))
}

/// Planes that split a fine node into octants: twice their positions, and a bit for each axis that has one, at most
/// `planes_max`, from `BINS` bins on each axis. `None` if no plane separates the centres.
#[inline(always)]
pub(super) fn octant_planes<S: Simd, const BINS: usize>(
    simd: S,
    boxes: &[MinBox],
    bounds: &MinBox,
    centers: &MinBox,
    planes_max: u32,
) -> Option<(MinBox, u32)> {
    let (mut low, mut scale) = ([0.0f32; LANES], [0.0f32; LANES]);
    for axis in 0..3 {
        let extent = -centers[axis + 4] - centers[axis];
        // An axis without extent, or with one that overflowed, has one bin and so no plane.
        if extent > 0.0 && extent < f32::INFINITY {
            (low[axis], scale[axis]) = (centers[axis], BINS as f32 / extent);
        }
    }
    let (low_lanes, scale_lanes) = (simd.load(&low), simd.load(&scale));
    let empty = simd.load(&EMPTY);
    let mut bins = [[empty; BINS]; 3];
    let mut counts = [[0u32; BINS]; 3];
    for primitive in boxes {
        let primitive = simd.load(primitive);
        let place = simd.mul(simd.sub(double_center(simd, primitive), low_lanes), scale_lanes);
        let place = simd.to_array(place);
        for axis in 0..3 {
            // The cast saturates, and takes NaN to 0.
            let bin = (place[axis] as i32).clamp(0, BINS as i32 - 1) as usize;
            counts[axis][bin] += 1;
            bins[axis][bin] = simd.min(primitive, bins[axis][bin]);
        }
    }
    let mut best = [(f32::INFINITY, 0usize); 3];
    for axis in 0..3 {
        let mut above = [0.0f32; BINS];
        let (mut merged, mut count) = (empty, 0);
        for border in (1..BINS).rev() {
            merged = simd.min(bins[axis][border], merged);
            count += counts[axis][border];
            above[border] = half_area(&simd.to_array(merged)) * count as f32;
        }
        (merged, count) = (empty, 0);
        for border in 1..BINS {
            merged = simd.min(bins[axis][border - 1], merged);
            count += counts[axis][border - 1];
            let cost = half_area(&simd.to_array(merged)) * count as f32 + above[border];
            if count > 0 && (count as usize) < boxes.len() && cost < best[axis].0 {
                best[axis] = (cost, border);
            }
        }
    }
    let mut axes = [0usize, 1, 2];
    for (i, j) in [(0, 1), (1, 2), (0, 1)] {
        if best[axes[j]].0 < best[axes[i]].0 {
            axes.swap(i, j);
        }
    }
    let whole = half_area(bounds) * boxes.len() as f32;
    let gain = whole - best[axes[0]].0;
    let (mut planes, mut mask) = (EMPTY, 0);
    for (place, axis) in axes[..planes_max as usize].iter().enumerate() {
        let (cost, border) = best[*axis];
        if cost < f32::INFINITY && (place == 0 || whole - cost >= GATE * gain) {
            mask |= 1 << axis;
            planes[*axis] = low[*axis] + border as f32 / scale[*axis];
        }
    }
    (mask != 0).then_some((planes, mask))
}

/// The plane that minimises the sum over both sides of area times count, as twice its position and the bit of its axis;
/// `None` if no plane separates the centres. `centers` is the box of twice the centres.
pub(super) fn best_plane(boxes: &[MinBox], centers: &MinBox) -> Option<(MinBox, u32)> {
    let mut best = None;
    let mut best_cost = f32::INFINITY;
    for axis in 0..3 {
        let (low, extent) = (centers[axis], -centers[axis + 4] - centers[axis]);
        if !(extent > 0.0 && extent < f32::INFINITY) {
            continue;
        }
        let scale = BIN_COUNT as f32 / extent;
        let mut bins = [(EMPTY, 0u32); BIN_COUNT];
        for primitive in boxes {
            let center = primitive[axis] - primitive[axis + 4];
            // The cast saturates, and takes NaN to 0.
            let (bounds, count) = &mut bins[(((center - low) * scale) as usize).min(BIN_COUNT - 1)];
            merge(bounds, primitive);
            *count += 1;
        }
        // Costs of the parts above each border, from the top.
        let mut above = [0.0f32; BIN_COUNT];
        let (mut bounds, mut count) = (EMPTY, 0);
        for bin in (1..BIN_COUNT).rev() {
            merge(&mut bounds, &bins[bin].0);
            count += bins[bin].1;
            above[bin] = half_area(&bounds) * count as f32;
        }
        (bounds, count) = (EMPTY, 0);
        for bin in 1..BIN_COUNT {
            merge(&mut bounds, &bins[bin - 1].0);
            count += bins[bin - 1].1;
            let cost = half_area(&bounds) * count as f32 + above[bin];
            if count > 0 && (count as usize) < boxes.len() && cost < best_cost {
                best_cost = cost;
                let mut plane = [f32::INFINITY; LANES];
                plane[axis] = low + bin as f32 / scale;
                best = Some((plane, 1 << axis));
            }
        }
    }
    best
}

fn merge(into: &mut MinBox, other: &MinBox) {
    for lane in 0..LANES {
        into[lane] = if other[lane] < into[lane] { other[lane] } else { into[lane] };
    }
}

/// Half the surface; 0 for the empty box.
fn half_area(bounds: &MinBox) -> f32 {
    let [x, y, z] = [-bounds[4] - bounds[0], -bounds[5] - bounds[1], -bounds[6] - bounds[2]];
    if x < 0.0 { 0.0 } else { x * y + y * z + z * x }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Portable;

    #[test]
    fn separates_a_far_primitive() {
        let at = |x: f32| [x, 0.0, 0.0, 0.0, -x - 1.0, -1.0, -1.0, 0.0];
        let boxes: Vec<MinBox> = [0.0, 1.0, 2.0, 3.0, 100.0].map(at).to_vec();
        let centers = [1.0, 1.0, 1.0, 0.0, -201.0, -1.0, -1.0, 0.0];
        let (plane, mask) = best_plane(&boxes, &centers).unwrap();
        assert_eq!(mask, 1);
        assert!(plane[0] > 7.0 && plane[0] < 201.0);
        let bounds = [0.0, 0.0, 0.0, 0.0, -101.0, -1.0, -1.0, 0.0];
        let at_once = octant_planes::<_, BIN_COUNT_AT_ONCE>(Portable, &boxes, &bounds, &centers, 3).unwrap();
        let one = octant_planes::<_, BIN_COUNT_ONE>(Portable, &boxes, &bounds, &centers, 1).unwrap();
        for (planes, mask) in [at_once, one] {
            assert_eq!(mask, 1);
            assert!(planes[0] > 7.0 && planes[0] < 201.0);
        }
        let one_place = [1.0, 1.0, 1.0, 0.0, -1.0, -1.0, -1.0, 0.0];
        let (planes, mask) = middle_planes(&centers, 3).unwrap();
        assert_eq!((mask, planes[0]), (1, 101.0));
        assert_eq!(middle_planes(&one_place, 3), None);
        assert_eq!(octant_planes::<_, 8>(Portable, &[boxes[0]; 9], &boxes[0], &one_place, 3), None);
        assert_eq!(best_plane(&boxes[..1], &[1.0, 1.0, 1.0, 0.0, -1.0, -1.0, -1.0, 0.0]), None);
    }
}
