//! The two forms of a vertex in a compiled file, behind one trait, so that scatter and cut are written once.

use bytemuck::Pod;

use crate::block::{self, VertexInput};
use crate::geom::Precision;
use crate::simd::{Quad, Quad32, Quad64};

/// A lattice coordinate that stands for "not finite or out of range".
pub(super) const OUTSIDE: i64 = i64::MIN;

/// A vertex: `[f32; 3]`, or `[i64; 3]` in steps of the lattice.
pub(super) trait Point: Pod + PartialEq + Send + Sync {
    /// In which the cut computes: exact for every valid point.
    type Real: Real;

    /// The coordinates, exactly.
    fn real(self) -> [Self::Real; 3];

    /// Vertex `index` of `vertices`, and any number in the fourth lane.
    #[inline(always)]
    fn quad(vertices: &[Self], index: usize) -> <Self::Real as Real>::Quad {
        let [x, y, z] = vertices[index].real();
        Quad::of([x, y, z, x])
    }

    /// The sum of three vertices in the units of `real`. The sum of its parts is finite if and only if all three are valid.
    fn sum(a: Self, b: Self, c: Self) -> [f64; 3];

    /// Whether a file can hold it.
    fn is_valid(self) -> bool;

    /// A hash of the exact bits.
    fn hash(self) -> u64;

    /// As the block encoder takes them.
    fn input(vertices: &[Self]) -> VertexInput<'_>;

    /// Whether a block of these vertices counts them with 24 bytes each.
    fn is_wide(vertices: &[Self], precision: Precision) -> bool;

    /// Whether the bits are the same (for floats stricter than `==`: the two zeros differ).
    fn same(self, other: Self) -> bool;
}

/// Odd multipliers of the hashes: 2^64 and 2^64 / golden ratio and roots of small primes, without structure.
const MULTIPLIERS: [u64; 3] = [0x9e37_79b9_7f4a_7c15, 0xbf58_476d_1ce4_e5b9, 0x94d0_49bb_1331_11eb];

impl Point for [f32; 3] {
    type Real = f32;

    #[inline]
    fn real(self) -> [f32; 3] {
        self
    }

    #[inline(always)]
    fn quad(vertices: &[Self], index: usize) -> Quad32 {
        // One load, but for the last vertex.
        let pair = vertices.get(index..).and_then(|rest| rest.first_chunk::<2>());
        match pair.and_then(|pair| pair.as_flattened().first_chunk::<4>()) {
            Some(lanes) => Quad32::of(*lanes),
            None => {
                let [x, y, z] = vertices[index];
                Quad32::of([x, y, z, x])
            }
        }
    }

    #[inline(always)]
    fn sum(a: Self, b: Self, c: Self) -> [f64; 3] {
        // Sums of three f32 cannot overflow f64, so the total is finite if and only if every term is.
        let axis = |axis: usize| f64::from(a[axis]) + f64::from(b[axis]) + f64::from(c[axis]);
        [axis(0), axis(1), axis(2)]
    }

    fn is_valid(self) -> bool {
        self.iter().all(|x| x.is_finite())
    }

    #[inline]
    fn hash(self) -> u64 {
        let bits = |axis: usize| u64::from(self[axis].to_bits());
        let (x, y, z) = (bits(0), bits(1), bits(2));
        let hash = (x << 32 | y).wrapping_mul(MULTIPLIERS[0]) ^ z.wrapping_mul(MULTIPLIERS[1]);
        (hash ^ hash >> 32).wrapping_mul(MULTIPLIERS[2])
    }

    fn input(vertices: &[Self]) -> VertexInput<'_> {
        VertexInput::Float32(vertices)
    }

    fn is_wide(_vertices: &[Self], _precision: Precision) -> bool {
        false
    }

    #[inline]
    fn same(self, other: Self) -> bool {
        let same = |axis: usize| self[axis].to_bits() == other[axis].to_bits();
        same(0) & same(1) & same(2)
    }
}

impl Point for [i64; 3] {
    type Real = f64;

    #[inline]
    fn real(self) -> [f64; 3] {
        // Within 2^52, so exact.
        [self[0] as f64, self[1] as f64, self[2] as f64]
    }

    #[inline(always)]
    fn sum(a: Self, b: Self, c: Self) -> [f64; 3] {
        let mut is_valid = true;
        for axis in 0..3 {
            is_valid &= a[axis] != OUTSIDE && b[axis] != OUTSIDE && c[axis] != OUTSIDE;
        }
        if !is_valid {
            return [f64::NAN; 3];
        }
        let axis = |axis: usize| a[axis] as f64 + b[axis] as f64 + c[axis] as f64;
        [axis(0), axis(1), axis(2)]
    }

    fn is_valid(self) -> bool {
        // As `Lattice::quantize` gives them.
        self.iter().all(|x| x.unsigned_abs() <= 1 << 52)
    }

    #[inline]
    fn hash(self) -> u64 {
        let mut hash = 0_u64;
        for (x, multiplier) in self.into_iter().zip(MULTIPLIERS) {
            hash = (hash ^ x as u64).wrapping_mul(multiplier);
            hash ^= hash >> 29;
        }
        hash.wrapping_mul(MULTIPLIERS[0])
    }

    fn input(vertices: &[Self]) -> VertexInput<'_> {
        VertexInput::Lattice(vertices)
    }

    fn is_wide(vertices: &[Self], precision: Precision) -> bool {
        matches!(precision, Precision::Lattice(lattice) if block::is_wide(lattice, vertices))
    }

    #[inline]
    fn same(self, other: Self) -> bool {
        self == other
    }
}

/// The float type of a cut.
pub(super) trait Real: Copy + PartialOrd + Send + Sync + std::fmt::Debug {
    /// Four of them.
    type Quad: Quad<Real = Self>;
    const INFINITY: Self;
    const NEG_INFINITY: Self;
    fn to_f64(self) -> f64;
    /// The nearest.
    fn from_f64(x: f64) -> Self;
}

impl Real for f32 {
    type Quad = Quad32;
    const INFINITY: f32 = f32::INFINITY;
    const NEG_INFINITY: f32 = f32::NEG_INFINITY;

    #[inline]
    fn from_f64(x: f64) -> f32 {
        x as f32
    }

    #[inline]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    type Quad = Quad64;
    const INFINITY: f64 = f64::INFINITY;
    const NEG_INFINITY: f64 = f64::NEG_INFINITY;

    #[inline]
    fn from_f64(x: f64) -> f64 {
        x
    }

    #[inline]
    fn to_f64(self) -> f64 {
        self
    }
}
