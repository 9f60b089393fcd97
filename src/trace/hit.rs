//! What a query answers.

use crate::geom::{self, HitErrorBounds, Ray, RayFrame, SightEnd, TriangleHit};
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
    /// For places in buffers.
    pub(super) const UNSET: Hit = Hit {
        t: 0.0,
        u: 0.0,
        v: 0.0,
        triangle: TriangleId(0),
        material: MaterialId(0),
        vertices: [[0.0; 3]; 3],
    };

    /// The point of the hit by barycentric weights; see [`Hit::position_error`] for how far off it can be.
    #[inline]
    pub fn position(&self) -> [f64; 3] {
        geom::hit_position(&self.vertices, self.u, self.v)
    }

    /// A bound, the same for each axis, on the distance between [`Hit::position`] and the point of the triangle's
    /// plane with exactly the weights `u` and `v`: see [`geom::position_error`].
    #[inline]
    pub fn position_error(&self) -> f64 {
        geom::position_error(&self.vertices, self.u, self.v)
    }

    /// Proven bounds on the errors of `t`, `u`, `v` and [`Hit::position`], for `ray`, the one that was traced. They hold for
    /// hits of any [`Tier`](crate::octree::Tier), and are seldom more than a few times the real error.
    pub fn error_bounds(&self, ray: &Ray) -> HitErrorBounds {
        let numbers = TriangleHit { t: self.t, u: self.u, v: self.v };
        RayFrame::new(ray).error_bounds(&self.vertices, &numbers)
    }

    /// The geometric normal `(b - a) x (c - a)`, not normalised: its length is twice the area, its direction says
    /// from which side the vertices are seen in counter-clockwise order.
    #[inline]
    pub fn normal(&self) -> [f64; 3] {
        geom::triangle_normal(&self.vertices)
    }
}

impl From<&Hit> for SightEnd {
    fn from(hit: &Hit) -> SightEnd {
        SightEnd::Surface { position: hit.position(), error: hit.position_error(), normal: hit.normal() }
    }
}

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
        self.words.get(usize::from(material.0 / 64)).is_some_and(|word| word >> (material.0 % 64) & 1 == 1)
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
