//! Four lanes: a point or a side of a box, whose fourth lane is of no account. What every x86-64 has (SSE2), so there is nothing to
//! dispatch; other targets, and f64, have plain arrays.

use std::fmt::Debug;

/// Four numbers.
pub trait Quad: Copy + Debug + Send + Sync {
    /// What a lane holds.
    type Real;

    /// Lanes of an array.
    fn of(lanes: [Self::Real; 4]) -> Self;
    /// The lanes.
    fn to_array(self) -> [Self::Real; 4];
    /// `if other < self { other } else { self }` in each lane.
    fn least(self, other: Self) -> Self;
    /// `if other > self { other } else { self }` in each lane.
    fn most(self, other: Self) -> Self;
    /// `0.5 * self + 0.5 * other` in each lane: cannot overflow.
    fn middle(self, other: Self) -> Self;
    /// The cell of a point: along each axis the whole part of `(self - min) * scale`, moved into 0 to `last` (0 for NaN), counted with
    /// the axis' weight. `last` and weights are whole numbers, weights below 2^15 and `last` below 2^8; those of the fourth lane are 0.
    fn cell(self, min: Self, scale: Self, last: Self, weights: [i16; 4]) -> u32;
}

/// Four lanes as an array.
#[derive(Clone, Copy, Debug)]
pub struct Plain<R>([R; 4]);

macro_rules! plain {
    ($float:ty) => {
        impl Quad for Plain<$float> {
            type Real = $float;

            #[inline(always)]
            fn of(lanes: [$float; 4]) -> Self {
                Plain(lanes)
            }
            #[inline(always)]
            fn to_array(self) -> [$float; 4] {
                self.0
            }
            #[inline(always)]
            fn least(mut self, other: Self) -> Self {
                for i in 0..4 {
                    self.0[i] = if other.0[i] < self.0[i] { other.0[i] } else { self.0[i] };
                }
                self
            }
            #[inline(always)]
            fn most(mut self, other: Self) -> Self {
                for i in 0..4 {
                    self.0[i] = if other.0[i] > self.0[i] { other.0[i] } else { self.0[i] };
                }
                self
            }
            #[inline(always)]
            fn middle(mut self, other: Self) -> Self {
                for i in 0..4 {
                    self.0[i] = 0.5 * self.0[i] + 0.5 * other.0[i];
                }
                self
            }
            #[inline(always)]
            fn cell(self, min: Self, scale: Self, last: Self, weights: [i16; 4]) -> u32 {
                let mut cell = 0;
                for i in 0..3 {
                    let at = ((self.0[i] - min.0[i]) * scale.0[i]) as u32;
                    cell += at.min(last.0[i] as u32) * weights[i] as u32;
                }
                cell
            }
        }
    };
}
plain!(f32);
plain!(f64);

/// Four f32.
#[cfg(not(target_arch = "x86_64"))]
pub type Quad32 = Plain<f32>;
/// Four f64.
pub type Quad64 = Plain<f64>;
#[cfg(target_arch = "x86_64")]
pub use sse2::Quad32;

#[cfg(target_arch = "x86_64")]
mod sse2 {
    use super::Quad;
    use std::arch::x86_64::*;

    /// Four f32.
    #[derive(Clone, Copy, Debug)]
    pub struct Quad32(__m128);

    /// Calls intrinsics that touch no memory.
    macro_rules! pure {
        ($call:expr) => {
            // SAFETY: SSE2 is a part of x86-64; the intrinsics only compute.
            #[allow(unused_unsafe)]
            unsafe {
                $call
            }
        };
    }

    impl Quad for Quad32 {
        type Real = f32;

        #[inline(always)]
        fn of(lanes: [f32; 4]) -> Quad32 {
            // SAFETY: SSE2 is a part of x86-64; `lanes` is valid for reading four f32 and the load may be unaligned.
            Quad32(unsafe { _mm_loadu_ps(lanes.as_ptr()) })
        }
        #[inline(always)]
        fn to_array(self) -> [f32; 4] {
            let mut lanes = [0.0; 4];
            // SAFETY: as for `of`; `lanes` is valid for writing four f32.
            unsafe { _mm_storeu_ps(lanes.as_mut_ptr(), self.0) }
            lanes
        }
        #[inline(always)]
        fn least(self, other: Quad32) -> Quad32 {
            // The instruction gives its second operand where the comparison is false.
            Quad32(pure!(_mm_min_ps(other.0, self.0)))
        }
        #[inline(always)]
        fn most(self, other: Quad32) -> Quad32 {
            Quad32(pure!(_mm_max_ps(other.0, self.0)))
        }
        #[inline(always)]
        fn middle(self, other: Quad32) -> Quad32 {
            pure!({
                let half = _mm_set1_ps(0.5);
                Quad32(_mm_add_ps(_mm_mul_ps(half, self.0), _mm_mul_ps(half, other.0)))
            })
        }
        #[inline(always)]
        fn cell(self, min: Quad32, scale: Quad32, last: Quad32, weights: [i16; 4]) -> u32 {
            pure!({
                let at = _mm_mul_ps(_mm_sub_ps(self.0, min.0), scale.0);
                // 0 for NaN; then a number that the conversion takes and 16 bits hold.
                let at = _mm_cvttps_epi32(_mm_min_ps(_mm_max_ps(at, _mm_setzero_ps()), last.0));
                let at = _mm_packs_epi32(at, at);
                let [x, y, z, w] = weights;
                // Sums of the first two lanes and of the last two.
                let sums = _mm_madd_epi16(at, _mm_set_epi16(0, 0, 0, 0, w, z, y, x));
                _mm_cvtsi128_si32(_mm_add_epi32(sums, _mm_shuffle_epi32::<1>(sums))) as u32
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;

    #[test]
    fn vectors_are_what_arrays_are() {
        let mut random = Random::new(11);
        let mut number = || match random.next_u64() % 12 {
            0 => 0.0,
            1 => -0.0,
            2 => f32::MAX,
            3 => f32::MIN,
            _ => (random.next_u64() as i32 as f32) * (0.5_f32).powi((random.next_u64() % 40) as i32),
        };
        for _ in 0..20_000 {
            let [a, b, c, d] = [0; 4].map(|_| [0; 4].map(|_| number()));
            let bits = |lanes: [f32; 4]| lanes.map(f32::to_bits);
            let (p, q) = (Plain::<f32>::of(a), Plain::<f32>::of(b));
            let (v, w) = (Quad32::of(a), Quad32::of(b));
            assert_eq!(bits(v.least(w).to_array()), bits(p.least(q).to_array()));
            assert_eq!(bits(v.most(w).to_array()), bits(p.most(q).to_array()));
            assert_eq!(bits(v.middle(w).to_array()), bits(p.middle(q).to_array()));
            // Also infinities and NaN, which differences and products bring.
            let last = c.map(|x| (x.to_bits() % 64) as f32);
            let last = [last[0], last[1], last[2], 0.0];
            let weights = [1, d[0].to_bits() as i16 & 0x3f, d[1].to_bits() as i16 & 0x7fff, 0];
            let plain = p.cell(q, Plain::<f32>::of(d), Plain::<f32>::of(last), weights);
            assert_eq!(v.cell(w, Quad32::of(d), Quad32::of(last), weights), plain, "{a:?} {b:?} {d:?}");
        }
    }
}
