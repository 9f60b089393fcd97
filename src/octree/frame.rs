//! From the model's f64 space to the f32 space of a tree.
//!
//! A tree's space is `(x - base) * scale`. The base is the block's (or the model's centre for the coarse tree), exact in
//! f64; the scale is one power of two for the whole model, 1 unless its coordinates are so large or so small that f32
//! products would leave their range. Where anything is rounded, it is rounded outward.

use crate::geom::{Aabb, round_down_f32, round_up_f32};
use crate::simd::Parallel;

/// The f32 space of one tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    pub base: [f64; 3],
    pub scale: f64,
}

/// Coordinates between 2^-40 and 2^40 need no scale.
const PLAIN_EXPONENT: i32 = 40;

impl Frame {
    /// The scale for a model whose largest coordinate, relative to the bases of its trees, is `reach`: such that scaled
    /// coordinates are below 2 and products of three of them stay in the range of f32.
    pub fn scale_for(reach: f64) -> f64 {
        let exponent = ((reach.to_bits() >> 52) & 0x7ff) as i32 - 1023;
        if reach == 0.0 || !reach.is_finite() || exponent.abs() <= PLAIN_EXPONENT {
            1.0
        } else {
            // Both the power and its inverse stay normal.
            f64::from_bits(((1023 - exponent.clamp(-1000, 1000)) as u64) << 52)
        }
    }

    /// A position in the tree's space, rounded to nearest, and whether that was exact. Overflow gives the largest f32.
    pub fn to_local(self, position: [f64; 3]) -> ([f32; 3], bool) {
        let mut exact = true;
        let local = [0, 1, 2].map(|axis| {
            let x = ((position[axis] - self.base[axis]) * self.scale) as f32;
            let x = x.clamp(f32::MIN, f32::MAX);
            exact &= self.base[axis] + f64::from(x) / self.scale == position[axis];
            x
        });
        (local, exact)
    }

    /// A box in the tree's space: lowest and highest corner, rounded outward.
    pub fn box_to_local(self, bounds: &Aabb) -> ([f32; 3], [f32; 3]) {
        // The difference rounds once and the scale is a power of two: two units of f64, dwarfed by the f32 step only if
        // the difference is not itself an f32, so step in f64 first.
        let low = [0, 1, 2].map(|axis| {
            let difference = bounds.min[axis] - self.base[axis];
            let exact = self.base[axis] == 0.0;
            round_down_f32(if exact { difference } else { difference.next_down() } * self.scale)
        });
        let high = [0, 1, 2].map(|axis| {
            let difference = bounds.max[axis] - self.base[axis];
            let exact = self.base[axis] == 0.0;
            round_up_f32(if exact { difference } else { difference.next_up() } * self.scale)
        });
        (low, high)
    }
}

/// Where the rays of an octree travel: what preparing one needs to know about the model.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Space {
    pub bounds: Aabb,
    /// The coarse tree's frame, in which rays start.
    pub frame: Frame,
    /// Whether all blocks have that frame too.
    pub is_shared: bool,
    /// The model's box in that frame with sixteen times its size around it: rays from within are traced from where they start.
    pub near_low: [f32; 3],
    pub near_high: [f32; 3],
    /// Rays whose origins are not farther apart than this may be traced together.
    pub together: f32,
    /// The frame's scale, if that can be had: rays are not near where it cannot.
    pub scale_f32: f32,
    pub parallel: Parallel,
}

impl Space {
    /// `is_shared`: all blocks have the coarse tree's `frame`.
    pub fn new(bounds: Aabb, frame: Frame, is_shared: bool) -> Space {
        let largest = bounds.extent().iter().fold(0.0f64, |largest, x| largest.max(*x));
        let margin = 16.0 * largest;
        let mut near = ([f32::MIN; 3], [f32::MAX; 3]);
        for axis in 0..3 {
            near.0[axis] = ((bounds.min[axis] - margin - frame.base[axis]) * frame.scale) as f32;
            near.1[axis] = ((bounds.max[axis] + margin - frame.base[axis]) * frame.scale) as f32;
        }
        let reach = (0..3).fold(0.0f32, |reach, axis| reach.max(near.0[axis].abs()).max(near.1[axis].abs()));
        // Three more for the bases of blocks and for parameters, which are not along an axis.
        let parallel = Parallel::new((reach.to_bits() >> 23) as i32 - 127 + 4);
        const SCALE_MAX: f64 = (1u64 << 60) as f64;
        if frame.scale > SCALE_MAX || frame.scale < 1.0 / SCALE_MAX {
            // The exact ray's rounding of its origin could show, or parameters leave the range of f32: prepare every ray
            // with care.
            near = ([f32::NAN; 3], [f32::NAN; 3]);
        }
        let scale_f32 = frame.scale as f32;
        let together = (largest * frame.scale / 64.0) as f32;
        Space { bounds, frame, is_shared, near_low: near.0, near_high: near.1, together, scale_f32, parallel }
    }
}
