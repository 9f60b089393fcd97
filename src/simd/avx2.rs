//! AVX2 and FMA, with the bit instructions that every CPU with them has too.

use std::arch::x86_64::*;

use super::lanes::{LANES, Simd};
use super::level::Operation;

/// Exists only where the CPU has AVX2, FMA, BMI1 and 2, LZCNT and POPCNT, and is used only inside [`Avx2::enter`].
#[derive(Clone, Copy, Debug)]
pub struct Avx2 {
    // Private: `detect` is the only way to make one.
    _proof: (),
}

impl Avx2 {
    /// The token, if this CPU has the instructions. Cheap: the standard library remembers the answer.
    #[inline]
    pub fn detect() -> Option<Avx2> {
        // The bit instructions came with AVX2 in all CPUs. They shift without flags and take bits off a mask in one step, which
        // is what traversals do between vector instructions.
        let is_there = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        is_there.then_some(Avx2 { _proof: () })
    }
}

/// Calls an intrinsic that touches no memory.
macro_rules! pure {
    ($call:expr) => {
        // SAFETY: `self` exists only if the CPU has the instructions; the intrinsic only computes.
        unsafe { $call }
    };
}

impl Simd for Avx2 {
    type F = __m256;
    type M = __m256;

    const IS_FASTEST: bool = true;

    #[inline(always)]
    fn enter<O: Operation<Avx2>>(self, operation: O) -> O::Output {
        #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
        #[inline(never)]
        fn inside<O: Operation<Avx2>>(token: Avx2, operation: O) -> O::Output {
            operation.run(token)
        }
        // SAFETY: a token exists only if `detect` found all of these features.
        unsafe { inside(self, operation) }
    }
    #[inline(always)]
    fn splat(self, x: f32) -> __m256 {
        pure!(_mm256_set1_ps(x))
    }
    #[inline(always)]
    fn load(self, x: &[f32; LANES]) -> __m256 {
        // SAFETY: as for `pure`; `x` is valid for reading eight f32 and the load may be unaligned.
        unsafe { _mm256_loadu_ps(x.as_ptr()) }
    }
    #[inline(always)]
    unsafe fn load_unchecked(self, x: &[f32], offset: usize) -> __m256 {
        debug_assert!(offset + LANES <= x.len());
        // SAFETY: as for `pure`; the caller puts all eight f32 inside `x`, and the load may be unaligned.
        unsafe { _mm256_loadu_ps(x.as_ptr().add(offset)) }
    }
    #[inline(always)]
    fn prefetch<T>(self, x: &[T], offset: usize) {
        // SAFETY: as for `pure`; the instruction takes any address and faults for none.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(x.as_ptr().wrapping_add(offset).cast()) }
    }
    #[inline(always)]
    fn load_bytes(self, x: &[u8; LANES]) -> __m256 {
        let packed = i64::from_le_bytes(*x);
        pure!(_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_cvtsi64_si128(packed))))
    }
    #[inline(always)]
    fn narrow(self, low: &[f64; LANES / 2], high: &[f64; LANES / 2]) -> __m256 {
        // SAFETY: as for `pure`; both are valid for reading four f64 and the loads may be unaligned.
        unsafe {
            let low = _mm256_cvtpd_ps(_mm256_loadu_pd(low.as_ptr()));
            let high = _mm256_cvtpd_ps(_mm256_loadu_pd(high.as_ptr()));
            _mm256_set_m128(high, low)
        }
    }
    #[inline(always)]
    fn transpose(self, rows: &[__m256; LANES]) -> [__m256; LANES] {
        let [a, b, c, d, e, f, g, h] = *rows;
        pure!({
            // Pairs of rows, then quadruples, then halves.
            let (ab, cd) = (
                [_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)],
                [_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d)],
            );
            let (ef, gh) = (
                [_mm256_unpacklo_ps(e, f), _mm256_unpackhi_ps(e, f)],
                [_mm256_unpacklo_ps(g, h), _mm256_unpackhi_ps(g, h)],
            );
            let upper = [
                _mm256_shuffle_ps::<0x44>(ab[0], cd[0]),
                _mm256_shuffle_ps::<0xee>(ab[0], cd[0]),
                _mm256_shuffle_ps::<0x44>(ab[1], cd[1]),
                _mm256_shuffle_ps::<0xee>(ab[1], cd[1]),
            ];
            let lower = [
                _mm256_shuffle_ps::<0x44>(ef[0], gh[0]),
                _mm256_shuffle_ps::<0xee>(ef[0], gh[0]),
                _mm256_shuffle_ps::<0x44>(ef[1], gh[1]),
                _mm256_shuffle_ps::<0xee>(ef[1], gh[1]),
            ];
            [
                _mm256_permute2f128_ps::<0x20>(upper[0], lower[0]),
                _mm256_permute2f128_ps::<0x20>(upper[1], lower[1]),
                _mm256_permute2f128_ps::<0x20>(upper[2], lower[2]),
                _mm256_permute2f128_ps::<0x20>(upper[3], lower[3]),
                _mm256_permute2f128_ps::<0x31>(upper[0], lower[0]),
                _mm256_permute2f128_ps::<0x31>(upper[1], lower[1]),
                _mm256_permute2f128_ps::<0x31>(upper[2], lower[2]),
                _mm256_permute2f128_ps::<0x31>(upper[3], lower[3]),
            ]
        })
    }
    #[inline(always)]
    fn to_array(self, x: __m256) -> [f32; LANES] {
        let mut lanes = [0.0; LANES];
        // SAFETY: as for `pure`; `lanes` is valid for writing eight f32 and the store may be unaligned.
        unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), x) }
        lanes
    }
    #[inline(always)]
    fn swap_halves(self, x: __m256) -> __m256 {
        pure!(_mm256_permute2f128_ps::<1>(x, x))
    }
    #[inline(always)]
    fn add(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_add_ps(a, b))
    }
    #[inline(always)]
    fn sub(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_sub_ps(a, b))
    }
    #[inline(always)]
    fn mul(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_mul_ps(a, b))
    }
    #[inline(always)]
    fn mul_add(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        pure!(_mm256_fmadd_ps(a, b, c))
    }
    #[inline(always)]
    fn mul_sub(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        pure!(_mm256_fmsub_ps(a, b, c))
    }
    #[inline(always)]
    fn div(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_div_ps(a, b))
    }
    #[inline(always)]
    fn min(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_min_ps(a, b))
    }
    #[inline(always)]
    fn max(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_max_ps(a, b))
    }
    #[inline(always)]
    fn abs(self, a: __m256) -> __m256 {
        pure!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), a))
    }
    #[inline(always)]
    fn flip_sign(self, a: __m256, sign: __m256) -> __m256 {
        pure!(_mm256_xor_ps(a, _mm256_and_ps(sign, _mm256_set1_ps(-0.0))))
    }
    #[inline(always)]
    fn select(self, m: __m256, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_blendv_ps(b, a, m))
    }
    #[inline(always)]
    fn lt(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_cmp_ps::<_CMP_LT_OQ>(a, b))
    }
    #[inline(always)]
    fn le(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_cmp_ps::<_CMP_LE_OQ>(a, b))
    }
    #[inline(always)]
    fn and(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_and_ps(a, b))
    }
    #[inline(always)]
    fn or(self, a: __m256, b: __m256) -> __m256 {
        pure!(_mm256_or_ps(a, b))
    }
    #[inline(always)]
    fn bits(self, m: __m256) -> u32 {
        pure!(_mm256_movemask_ps(m)) as u32
    }
}
