//! What a query answers.

use crate::units::{MaterialId, TriangleId};

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter, in lengths of the ray's direction.
    pub t: f64,
    /// Weight of the second vertex, in 0 ..= 1 up to rounding.
    pub u: f64,
    /// Weight of the third vertex, in 0 ..= 1 up to rounding.
    pub v: f64,
    /// The triangle's ordinal in the source.
    pub triangle: TriangleId,
    /// Its material.
    pub material: MaterialId,
    /// Its exact vertices.
    pub vertices: [[f64; 3]; 3],
}

impl Hit {
    /// The point of the hit by barycentric weights; see [`Hit::position_error`] for how far off it can be.
    pub fn position(&self) -> [f64; 3] {
        let [a, b, c] = &self.vertices;
        // From `a` along the edges: for equal vertices on an axis the result is exact on that axis.
        [0, 1, 2].map(|axis| a[axis] + (self.u * (b[axis] - a[axis]) + self.v * (c[axis] - a[axis])))
    }

    /// A bound, on each axis, on the distance between [`Hit::position`] and the plane of the triangle along that
    /// axis' combination of vertices: the rounding of the nine operations in `position`. Offset a secondary ray's
    /// origin by this along the normal and it starts clear of the surface.
    ///
    /// It bounds the distance to the exact point with weights `u` and `v`, which lies in the triangle's plane; the
    /// weights' own rounding moves the point inside that plane only (pbrt-v4, section 6.8, in f64).
    pub fn position_error(&self) -> f64 {
        let [a, b, c] = &self.vertices;
        let mut error = 0.0f64;
        for axis in 0..3 {
            let edges = self.u.abs() * (b[axis] - a[axis]).abs() + self.v.abs() * (c[axis] - a[axis]).abs();
            // Edge, product, sum: 3 roundings on `edges`; the last sum rounds |a| + edges once. 4 covers the rounding
            // of this bound itself.
            error = error.max(UNIT * (5.0 * edges + 1.5 * a[axis].abs()));
        }
        // Below the normal range a product loses absolute, not relative, accuracy.
        error + f64::MIN_POSITIVE
    }

    /// The geometric normal `(b - a) x (c - a)`, not normalised: its length is twice the area, its direction says
    /// which side the vertices turn counter-clockwise on.
    pub fn normal(&self) -> [f64; 3] {
        let [a, b, c] = &self.vertices;
        let e = [0, 1, 2].map(|axis| b[axis] - a[axis]);
        let f = [0, 1, 2].map(|axis| c[axis] - a[axis]);
        [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]]
    }
}

/// Half the distance from 1 to the next f64.
const UNIT: f64 = f64::EPSILON * 0.5;

/// Whether anything lies between a ray's ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Occlusion {
    /// Nothing is hit.
    #[default]
    Clear,
    /// A triangle is hit whose material is not ignored.
    Blocked,
    /// Only triangles of ignored materials are hit: walk through them with `closest_hits_after`.
    Filtered,
}

/// A set of materials, one bit each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MaterialSet {
    words: Vec<u64>,
}

impl MaterialSet {
    /// The set that holds nothing.
    pub fn new() -> MaterialSet {
        MaterialSet::default()
    }

    /// Adds a material. Allocates at most 8 KiB over the set's life.
    pub fn insert(&mut self, material: MaterialId) {
        let word = usize::from(material.0 / 64);
        if self.words.len() <= word {
            self.words.resize(word + 1, 0);
        }
        self.words[word] |= 1 << (material.0 % 64);
    }

    /// Whether the set holds `material`.
    #[inline]
    pub fn contains(&self, material: MaterialId) -> bool {
        self.words
            .get(usize::from(material.0 / 64))
            .is_some_and(|word| word >> (material.0 % 64) & 1 == 1)
    }

    /// Whether the set holds nothing.
    pub fn is_empty(&self) -> bool {
        self.words.iter().all(|word| *word == 0)
    }
}

impl FromIterator<MaterialId> for MaterialSet {
    fn from_iter<I: IntoIterator<Item = MaterialId>>(materials: I) -> MaterialSet {
        let mut set = MaterialSet::new();
        for material in materials {
            set.insert(material);
        }
        set
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn material_sets_hold_what_was_put_in() {
        let set: MaterialSet = [0, 63, 64, 65_535].map(MaterialId).into_iter().collect();
        for inside in [0, 63, 64, 65_535] {
            assert!(set.contains(MaterialId(inside)), "{inside}");
        }
        for outside in [1, 62, 65, 128, 65_534] {
            assert!(!set.contains(MaterialId(outside)), "{outside}");
        }
        assert!(!set.is_empty() && MaterialSet::new().is_empty());
        assert!(!MaterialSet::new().contains(MaterialId(7)));
    }
}
