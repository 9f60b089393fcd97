//! Asking for memory ahead of its use.

/// Asks the memory for the cache line that holds `x[index]`, if there is one. Only time depends on it.
#[inline(always)]
pub fn prefetch<T>(x: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: SSE is a part of x86-64; the instruction takes any address and faults for none.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(x.as_ptr().wrapping_add(index).cast()) }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (x, index);
}
