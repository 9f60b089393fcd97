//! Where the vertices are: an adaptive grid of counts, and the octree cells of it that become buckets.

use crate::simd::{AnyOperation, Simd, SimdLevel, dispatch, whole_f64};

/// Cells per side; a power of two.
const SIDE: usize = 128;
const LEVELS: u32 = SIDE.trailing_zeros();
/// Most buckets, so that a bucket number fits in 16 bits.
const BUCKETS_MAX: usize = u16::MAX as usize;
/// Exponents of the cell size stay in a range where its inverse is a normal number.
const EXPONENT_MIN: i32 = -1000;

/// Memory that a grid and the map made from it need at most.
pub(super) const GRID_BYTES: u64 = (SIDE * SIDE * SIDE * (4 + 2) + SIDE * SIDE * SIDE) as u64;

/// Counts of vertices in 128^3 cells whose size is a power of two. When a vertex falls outside, the cells are merged into larger ones,
/// so that one pass needs no bounds in advance.
#[derive(Debug)]
pub(super) struct Grid {
    /// Cell size is `2^exponent`.
    exponent: i32,
    /// Cell coordinates of the grid's first cell.
    origin: [f64; 3],
    /// Bounds of the vertices so far.
    min: [f64; 3],
    max: [f64; 3],
    counts: Vec<u32>,
}

impl Grid {
    pub(super) fn new() -> Grid {
        Grid {
            exponent: EXPONENT_MIN,
            origin: [0.0; 3],
            min: [f64::INFINITY; 3],
            max: [f64::NEG_INFINITY; 3],
            counts: vec![0; SIDE * SIDE * SIDE],
        }
    }

    /// Counts vertices; those that are not finite are left out.
    pub(super) fn count(&mut self, vertices: impl Iterator<Item = [f64; 3]> + Clone) {
        let (mut min, mut max) = (self.min, self.max);
        let mut all_finite = true;
        for vertex in vertices.clone() {
            let [x, y, z] = vertex;
            // One that is not finite makes the sum of the magnitudes infinite or NaN; one too large for the sum is looked at below.
            all_finite &= x.abs() + y.abs() + z.abs() < f64::INFINITY;
            for axis in 0..3 {
                // In this form one instruction; what NaN does to it is undone below.
                min[axis] = if vertex[axis] < min[axis] { vertex[axis] } else { min[axis] };
                max[axis] = if vertex[axis] > max[axis] { vertex[axis] } else { max[axis] };
            }
        }
        if all_finite {
            self.count_finite((min, max), vertices);
        } else {
            let finite = vertices.filter(is_finite);
            (min, max) = (self.min, self.max);
            for vertex in finite.clone() {
                for axis in 0..3 {
                    min[axis] = min[axis].min(vertex[axis]);
                    max[axis] = max[axis].max(vertex[axis]);
                }
            }
            self.count_finite((min, max), finite);
        }
    }

    /// Counts vertices, all finite and within the bounds, which hold those before, too.
    #[inline]
    fn count_finite(&mut self, (min, max): ([f64; 3], [f64; 3]), vertices: impl Iterator<Item = [f64; 3]>) {
        if (min, max) != (self.min, self.max) {
            self.cover(min, max);
        }
        let (scale, origin) = (self.scale(), self.origin);
        for [x, y, z] in vertices {
            let cell = &mut self.counts[cell_of(scale, origin, [x, y, z]) as usize];
            *cell = cell.saturating_add(1);
        }
    }

    /// The largest magnitude of a finite coordinate so far; 0 if there is none.
    pub(super) fn magnitude_max(&self) -> f64 {
        let ends = self.min.iter().chain(&self.max).map(|x| x.abs());
        ends.filter(|x| x.is_finite()).fold(0.0, f64::max)
    }

    /// Cells per unit of length.
    fn scale(&self) -> f64 {
        power_of_two(-self.exponent)
    }

    /// Changes cell size and origin so that the bounds lie inside, and moves the counts along.
    fn cover(&mut self, min: [f64; 3], max: [f64; 3]) {
        let was_empty = self.min[0] > self.max[0];
        (self.min, self.max) = (min, max);
        let inside = |exponent: i32, origin: [f64; 3]| {
            let scale = power_of_two(-exponent);
            (0..3).all(|axis| {
                let (low, high) = ((min[axis] * scale).floor(), (max[axis] * scale).floor());
                low >= origin[axis] && high < origin[axis] + SIDE as f64
            })
        };
        if !was_empty && inside(self.exponent, self.origin) {
            return;
        }
        // Some room on all sides, so that slowly growing bounds do not merge again and again; fine enough all the same.
        let extent = (0..3).map(|axis| max[axis] * 0.5 - min[axis] * 0.5).fold(0.0, f64::max);
        let largest = (0..3).map(|axis| max[axis].abs().max(min[axis].abs())).fold(0.0, f64::max);
        let mut exponent = (exponent_of(extent) - 5).max(exponent_of(largest) - 50).max(if was_empty {
            EXPONENT_MIN
        } else {
            self.exponent
        });
        let origin = loop {
            let scale = power_of_two(-exponent);
            let origin = [0, 1, 2].map(|axis| {
                let (low, high) = ((min[axis] * scale).floor(), (max[axis] * scale).floor());
                low - ((SIDE as f64 - (high - low + 1.0)) * 0.5).floor()
            });
            if inside(exponent, origin) {
                break origin;
            }
            exponent += 1;
        };
        if !was_empty {
            let shrink = power_of_two(self.exponent - exponent);
            let mut counts = vec![0_u32; self.counts.len()];
            for (index, count) in self.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
                let old = [index % SIDE, index / SIDE % SIDE, index / SIDE / SIDE];
                // Cells are aligned at multiples of their size, so each lies in exactly one larger cell.
                let [x, y, z] = [0, 1, 2].map(|axis| {
                    let coordinate = ((self.origin[axis] + old[axis] as f64) * shrink).floor() - origin[axis];
                    cell_coordinate(coordinate)
                });
                let cell = &mut counts[x + SIDE * (y + SIDE * z)];
                *cell = cell.saturating_add(*count);
            }
            self.counts = counts;
        }
        (self.exponent, self.origin) = (exponent, origin);
    }

    /// Cuts the grid into buckets: octree cells, or neighbouring children of one, with at most `vertices_max` vertices
    /// each (more only where a single cell of the grid has more).
    pub(super) fn into_buckets(self, vertices_max: u64) -> BucketMap {
        let mut pyramid = vec![self.counts];
        for level in 1..=LEVELS {
            let side = SIDE >> level;
            let mut coarse = vec![0_u32; side * side * side];
            let fine = &pyramid[level as usize - 1];
            for (index, count) in fine.iter().enumerate() {
                let (x, y, z) =
                    (index % (2 * side), index / (2 * side) % (2 * side), index / (4 * side * side));
                let cell = &mut coarse[x / 2 + side * (y / 2 + side * (z / 2))];
                *cell = cell.saturating_add(*count);
            }
            pyramid.push(coarse);
        }
        let scale = power_of_two(-self.exponent);
        let mut map = BucketMap { of_cell: Vec::new(), count: 0, scale, origin: self.origin };
        let mut vertices_max = vertices_max.max(1);
        loop {
            map.of_cell.clear();
            map.of_cell.resize(SIDE * SIDE * SIDE, 0);
            map.count = 0;
            let root = u64::from(pyramid[LEVELS as usize][0]);
            if root <= vertices_max {
                map.count = 1;
                return map;
            }
            if map.split(&pyramid, LEVELS, [0; 3], vertices_max) {
                return map;
            }
            vertices_max *= 2;
        }
    }
}

/// From a point to its bucket.
#[derive(Debug)]
pub(super) struct BucketMap {
    of_cell: Vec<u16>,
    count: usize,
    scale: f64,
    origin: [f64; 3],
}

impl BucketMap {
    /// How many buckets there are, in octree order; at least 1. Some may stay empty.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The buckets of the first `count` points `sum * third_of_unit` (those behind are of no account), where `scale` is `third_of_unit`
    /// times [`BucketMap::scale`]. Whether all of them are valid; those that are not get any bucket.
    #[inline]
    pub(super) fn buckets<const N: usize>(
        &self,
        sums: &[[f64; N]; 3],
        scale: f64,
        buckets: &mut [u16; N],
        count: usize,
    ) -> bool {
        let (cells, are_valid) =
            dispatch(SimdLevel::best(), Cells { sums, scale, origin: self.origin, count });
        for (bucket, cell) in buckets.iter_mut().zip(cells).take(count) {
            *bucket = self.of_cell[cell as usize];
        }
        are_valid
    }

    /// Cells per unit of length.
    pub(super) fn scale(&self) -> f64 {
        self.scale
    }

    /// Gives buckets to the children of a node with too many vertices; false if there are too many buckets.
    fn split(&mut self, pyramid: &[Vec<u32>], level: u32, node: [usize; 3], vertices_max: u64) -> bool {
        let child_level = level - 1;
        let side = SIDE >> child_level;
        let (mut open, mut sum) = (None, 0);
        for child in 0..8 {
            let cell = [0, 1, 2].map(|axis| 2 * node[axis] + (child >> axis & 1));
            let count = u64::from(pyramid[child_level as usize][cell[0] + side * (cell[1] + side * cell[2])]);
            if count > vertices_max && child_level > 0 {
                if !self.split(pyramid, child_level, cell, vertices_max) {
                    return false;
                }
                continue;
            }
            let bucket = match open {
                Some(bucket) if sum + count <= vertices_max => bucket,
                _ => {
                    sum = 0;
                    self.count += 1;
                    self.count - 1
                }
            };
            if self.count > BUCKETS_MAX {
                return false;
            }
            open = Some(bucket);
            sum += count;
            let size = 1 << child_level;
            let [x, y, z] = cell.map(|c| c * size);
            for z in z..z + size {
                for y in y..y + size {
                    let row = SIDE * (y + SIDE * z);
                    self.of_cell[row + x..row + x + size].fill(bucket as u16);
                }
            }
        }
        true
    }
}

/// The cells of many points, with the widest vectors there are.
struct Cells<'a, const N: usize> {
    sums: &'a [[f64; N]; 3],
    scale: f64,
    origin: [f64; 3],
    /// Points behind these are of no account.
    count: usize,
}

impl<const N: usize> AnyOperation for Cells<'_, N> {
    type Output = ([u32; N], bool);

    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) -> ([u32; N], bool) {
        let [x, y, z] = self.sums;
        let mut cells = [0; N];
        let mut are_valid = true;
        for at in 0..N {
            let sum = [x[at], y[at], z[at]];
            cells[at] = cell_of(self.scale, self.origin, sum);
            are_valid &= is_valid(sum) | (at >= self.count);
        }
        (cells, are_valid)
    }
}

/// Whether [`Point::sum`](super::point::Point::sum) is of valid vertices.
#[inline(always)]
pub(super) fn is_valid([x, y, z]: [f64; 3]) -> bool {
    (x + y + z).is_finite()
}

fn is_finite(point: &[f64; 3]) -> bool {
    point.iter().all(|x| x.is_finite())
}

/// The cell of a point, if a length of 1 has `scale` cells.
#[inline(always)]
fn cell_of(scale: f64, origin: [f64; 3], point: [f64; 3]) -> u32 {
    let at = |axis: usize| cell_coordinate(point[axis] * scale - origin[axis]) as u32;
    let (x, y, z) = (at(0), at(1), at(2));
    // The axes take up bits of their own.
    x | y << LEVELS | z << (2 * LEVELS)
}

/// Which cell along an axis: the nearest inside for points outside, 0 for NaN.
#[inline(always)]
fn cell_coordinate(x: f64) -> usize {
    whole_f64(x, (SIDE - 1) as u8) as usize
}

/// `2^exponent`, 0 or infinity beyond the range of f64.
fn power_of_two(exponent: i32) -> f64 {
    libm::ldexp(1.0, exponent)
}

/// The exponent of a finite number at least 0; a very low one for 0.
fn exponent_of(x: f64) -> i32 {
    if x > 0.0 { libm::ilogb(x) } else { EXPONENT_MIN - 100 }
}
