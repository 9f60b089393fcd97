//! Which instructions the CPU has, and running an operation with them.

use super::lanes::{Portable, Simd};

/// A set of vector instructions that the kernels are compiled for. Results of certified queries do not depend on it (I2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum SimdLevel {
    /// Whatever the target was compiled for; plain arrays of eight lanes.
    Portable,
    /// x86-64 with AVX2 and FMA. Asking for it on another CPU gives `Portable`.
    Avx2,
}

impl SimdLevel {
    /// The fastest level that this CPU has.
    pub fn best() -> SimdLevel {
        #[cfg(target_arch = "x86_64")]
        if super::avx2::Avx2::detect().is_some() {
            return SimdLevel::Avx2;
        }
        SimdLevel::Portable
    }
}

/// An operation that is generic over the lanes it runs on.
///
/// `run` and everything that it calls on the hot path must be `#[inline(always)]`: only what is inlined into the
/// function that [`dispatch`] enters is compiled with the level's instructions.
pub trait Operation<S: Simd> {
    /// What it returns.
    type Output;

    /// Does it with the lanes of `simd`.
    fn run(self, simd: S) -> Self::Output;
}

/// An operation for whatever lanes [`dispatch`] finds.
pub trait AnyOperation {
    /// What it returns.
    type Output;

    /// Does it with the lanes of `simd`.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// Makes an operation for certain lanes of one for any.
struct Certain<O>(O);

impl<S: Simd, O: AnyOperation> Operation<S> for Certain<O> {
    type Output = O::Output;

    #[inline(always)]
    fn run(self, simd: S) -> O::Output {
        self.0.run(simd)
    }
}

/// Runs `operation` with the instructions of `level`, or portably where the CPU lacks them.
///
/// The change of instruction set costs a call that cannot be inlined: do it once per query call or per block, never
/// per node (per-node dispatch cost 2.4 times in a measurement).
#[inline]
pub fn dispatch<O: AnyOperation>(level: SimdLevel, operation: O) -> O::Output {
    #[cfg(target_arch = "x86_64")]
    if level == SimdLevel::Avx2
        && let Some(token) = super::avx2::Avx2::detect()
    {
        return token.enter(Certain(operation));
    }
    let _ = level;
    Portable.enter(Certain(operation))
}
