//! The operations that kernels are written in, and the version of them that any CPU has.

use super::level::Operation;

/// Lanes of a vector.
pub const LANES: usize = 8;

/// Eight f32 lanes. Implementors are tokens of no size that exist only where the CPU has the instructions.
///
/// Code on the hot path must not hand lanes to closures (`array::map` and the like): a closure that the compiler does not
/// inline is compiled without the level's instructions, and each operation in it becomes a call.
///
/// Kernels may not rely on whether `mul_add` rounds once or twice; bounds count it as two roundings.
pub trait Simd: Copy {
    /// Eight f32.
    type F: Copy;
    /// Eight truth values.
    type M: Copy;

    /// Whether CPUs of the target have nothing faster, as far as there is a version here: what is compiled in many versions for
    /// speed need not be for others.
    const IS_FASTEST: bool;

    /// Runs `operation` in a function of its own, compiled for the instructions.
    fn enter<O: Operation<Self>>(self, operation: O) -> O::Output;

    /// The same number in every lane.
    fn splat(self, x: f32) -> Self::F;
    /// Lane `i` is `x[i]`.
    fn load(self, x: &[f32; LANES]) -> Self::F;
    /// Eight numbers from `x[offset]` on.
    ///
    /// # Safety
    /// `x` has at least `offset + 8` numbers.
    unsafe fn load_unchecked(self, x: &[f32], offset: usize) -> Self::F;
    /// Asks the memory for the cache line that holds `x[offset]`, if there is one. Only time depends on it.
    #[inline(always)]
    fn prefetch<T>(self, _x: &[T], _offset: usize) {}
    /// Lane `i` is the number that `x[i]` stands for; exact.
    fn load_bytes(self, x: &[u8; LANES]) -> Self::F;
    /// Eight numbers, each rounded to nearest.
    fn narrow(self, low: &[f64; LANES / 2], high: &[f64; LANES / 2]) -> Self::F;
    /// Lane `i` of result `j` is lane `j` of row `i`.
    fn transpose(self, rows: &[Self::F; LANES]) -> [Self::F; LANES];
    /// The lanes as an array.
    fn to_array(self, x: Self::F) -> [f32; LANES];
    /// The low four lanes and the high four lanes exchanged.
    fn swap_halves(self, x: Self::F) -> Self::F;
    /// `a + b`.
    fn add(self, a: Self::F, b: Self::F) -> Self::F;
    /// `a - b`.
    fn sub(self, a: Self::F, b: Self::F) -> Self::F;
    /// `a * b`.
    fn mul(self, a: Self::F, b: Self::F) -> Self::F;
    /// `a * b + c`, rounded once or twice.
    fn mul_add(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    /// `a * b - c`, rounded once or twice.
    fn mul_sub(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    /// `a / b`.
    fn div(self, a: Self::F, b: Self::F) -> Self::F;
    /// `if a < b { a } else { b }`: `b` if either is NaN.
    fn min(self, a: Self::F, b: Self::F) -> Self::F;
    /// `if a > b { a } else { b }`: `b` if either is NaN.
    fn max(self, a: Self::F, b: Self::F) -> Self::F;
    /// Magnitude.
    fn abs(self, a: Self::F) -> Self::F;
    /// `a`, negated where the sign bit of `sign` is set.
    fn flip_sign(self, a: Self::F, sign: Self::F) -> Self::F;
    /// `if m { a } else { b }`.
    fn select(self, m: Self::M, a: Self::F, b: Self::F) -> Self::F;
    /// `a < b`; false for NaN.
    fn lt(self, a: Self::F, b: Self::F) -> Self::M;
    /// `a <= b`; false for NaN.
    fn le(self, a: Self::F, b: Self::F) -> Self::M;
    /// Both.
    fn and(self, a: Self::M, b: Self::M) -> Self::M;
    /// Either.
    fn or(self, a: Self::M, b: Self::M) -> Self::M;
    /// Lane `i` as bit `i`.
    fn bits(self, m: Self::M) -> u32;

    /// Each of three numbers in every lane.
    #[inline(always)]
    fn splat3(self, x: [f32; 3]) -> [Self::F; 3] {
        [self.splat(x[0]), self.splat(x[1]), self.splat(x[2])]
    }
    /// Differences of eight pairs of vectors.
    #[inline(always)]
    fn sub3(self, p: [Self::F; 3], q: [Self::F; 3]) -> [Self::F; 3] {
        [self.sub(p[0], q[0]), self.sub(p[1], q[1]), self.sub(p[2], q[2])]
    }
    /// Cross products of eight pairs of vectors; two roundings for each component.
    #[inline(always)]
    fn cross(self, p: [Self::F; 3], q: [Self::F; 3]) -> [Self::F; 3] {
        [
            self.mul_sub(p[1], q[2], self.mul(p[2], q[1])),
            self.mul_sub(p[2], q[0], self.mul(p[0], q[2])),
            self.mul_sub(p[0], q[1], self.mul(p[1], q[0])),
        ]
    }
    /// Dot products of eight pairs of vectors; three roundings.
    #[inline(always)]
    fn dot(self, p: [Self::F; 3], q: [Self::F; 3]) -> Self::F {
        self.mul_add(p[0], q[0], self.mul_add(p[1], q[1], self.mul(p[2], q[2])))
    }
}

/// Plain arrays, which the compiler turns into whatever vectors the target has. Exists on every CPU.
#[derive(Clone, Copy, Debug)]
pub struct Portable;

#[inline(always)]
fn zip<T: Copy, U: Copy, R>(a: [T; LANES], b: [U; LANES], f: impl Fn(T, U) -> R) -> [R; LANES] {
    std::array::from_fn(|i| f(a[i], b[i]))
}

impl Simd for Portable {
    type F = [f32; LANES];
    type M = [bool; LANES];

    const IS_FASTEST: bool = !cfg!(target_arch = "x86_64");

    #[inline(never)]
    fn enter<O: Operation<Portable>>(self, operation: O) -> O::Output {
        operation.run(self)
    }
    #[inline(always)]
    fn splat(self, x: f32) -> Self::F {
        [x; LANES]
    }
    #[inline(always)]
    fn load(self, x: &[f32; LANES]) -> Self::F {
        *x
    }
    #[inline(always)]
    unsafe fn load_unchecked(self, x: &[f32], offset: usize) -> Self::F {
        let x = &x[offset..offset + LANES];
        [x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]]
    }
    #[inline(always)]
    fn load_bytes(self, x: &[u8; LANES]) -> Self::F {
        x.map(f32::from)
    }
    #[inline(always)]
    fn narrow(self, low: &[f64; LANES / 2], high: &[f64; LANES / 2]) -> Self::F {
        let [a, b, c, d] = *low;
        let [e, f, g, h] = *high;
        [a as f32, b as f32, c as f32, d as f32, e as f32, f as f32, g as f32, h as f32]
    }
    #[inline(always)]
    fn transpose(self, rows: &[Self::F; LANES]) -> [Self::F; LANES] {
        std::array::from_fn(|column| std::array::from_fn(|row| rows[row][column]))
    }
    #[inline(always)]
    fn to_array(self, x: Self::F) -> [f32; LANES] {
        x
    }
    #[inline(always)]
    fn swap_halves(self, x: Self::F) -> Self::F {
        [x[4], x[5], x[6], x[7], x[0], x[1], x[2], x[3]]
    }
    #[inline(always)]
    fn add(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn mul_add(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        self.add(self.mul(a, b), c)
    }
    #[inline(always)]
    fn mul_sub(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        self.sub(self.mul(a, b), c)
    }
    #[inline(always)]
    fn div(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn min(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn abs(self, a: Self::F) -> Self::F {
        a.map(f32::abs)
    }
    #[inline(always)]
    fn flip_sign(self, a: Self::F, sign: Self::F) -> Self::F {
        zip(a, sign, |a, s| f32::from_bits(a.to_bits() ^ (s.to_bits() & 0x8000_0000)))
    }
    #[inline(always)]
    fn select(self, m: Self::M, a: Self::F, b: Self::F) -> Self::F {
        std::array::from_fn(|i| if m[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn lt(self, a: Self::F, b: Self::F) -> Self::M {
        zip(a, b, |a, b| a < b)
    }
    #[inline(always)]
    fn le(self, a: Self::F, b: Self::F) -> Self::M {
        zip(a, b, |a, b| a <= b)
    }
    #[inline(always)]
    fn and(self, a: Self::M, b: Self::M) -> Self::M {
        zip(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn or(self, a: Self::M, b: Self::M) -> Self::M {
        zip(a, b, |a, b| a | b)
    }
    #[inline(always)]
    fn bits(self, m: Self::M) -> u32 {
        m.iter().enumerate().fold(0, |bits, (i, lane)| bits | u32::from(*lane) << i)
    }
}
