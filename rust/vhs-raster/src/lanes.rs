//! Several numbers at once, on any machine, with one meaning.
//!
//! Shading is written once over [`Machine`]; each implementation does every operation on every lane exactly as
//! [`Plain`] says, so a picture cannot depend on which one ran. Only operations that IEEE 754 or integer arithmetic
//! define to the last bit are offered: no fused multiply-add, no approximate reciprocals.

use std::fmt::Debug;

/// Most lanes any machine here has; rows of pictures have this many spare places at their end.
pub(crate) const MOST_LANES: usize = 16;

/// Fewest lanes any machine here has; runs of samples are padded to a multiple of it.
pub(crate) const FEWEST_LANES: usize = 8;

/// Lanes of numbers and what can be done with them.
pub(crate) trait Machine: Copy + Debug {
    /// How many lanes there are; divides [`MOST_LANES`].
    const LANES: usize;
    /// Lanes of f32.
    type F: Copy + Debug;
    /// Lanes of 32 bits.
    type I: Copy + Debug;

    /// The same number in all lanes.
    fn float(x: f32) -> Self::F;
    /// The same number in all lanes.
    fn int(x: i32) -> Self::I;
    /// Lanes from memory.
    fn load(x: &[f32]) -> Self::F;
    /// Lanes to memory.
    fn store(x: Self::F, out: &mut [f32]);
    /// Lanes to memory.
    fn store_ints(x: Self::I, out: &mut [u32]);
    /// `a + b`.
    fn add(a: Self::F, b: Self::F) -> Self::F;
    /// `a - b`.
    fn sub(a: Self::F, b: Self::F) -> Self::F;
    /// `a * b`.
    fn mul(a: Self::F, b: Self::F) -> Self::F;
    /// `a / b`.
    fn div(a: Self::F, b: Self::F) -> Self::F;
    /// The larger; `b` if either is NaN.
    fn max(a: Self::F, b: Self::F) -> Self::F;
    /// The smaller; `b` if either is NaN.
    fn min(a: Self::F, b: Self::F) -> Self::F;
    /// All ones where `a > b`, else zero.
    fn above(a: Self::F, b: Self::F) -> Self::I;
    /// All ones where `a >= b`, else zero.
    fn at_least(a: Self::F, b: Self::F) -> Self::I;
    /// Whether the highest bit is set in any lane.
    fn any(mask: Self::I) -> bool;
    /// The number that all lanes hold, if they hold the same.
    fn common(a: Self::I) -> Option<i32>;
    /// Lanes from memory.
    fn load_ints(x: &[u32]) -> Self::I;
    /// Whether `a > b` in any lane.
    fn any_above(a: Self::F, b: Self::F) -> bool;
    /// Without the part after the point; `i32::MIN` where that does not fit.
    fn truncate(a: Self::F) -> Self::I;
    /// As floating point, rounded.
    fn from_int(a: Self::I) -> Self::F;
    /// Bits of the number.
    fn bits(a: Self::F) -> Self::I;
    /// The number with these bits.
    fn from_bits(a: Self::I) -> Self::F;
    /// Wrapping sum.
    fn plus(a: Self::I, b: Self::I) -> Self::I;
    /// Wrapping difference.
    fn minus(a: Self::I, b: Self::I) -> Self::I;
    /// Product of numbers in 0..32768.
    fn times_small(a: Self::I, b: Self::I) -> Self::I;
    /// Wrapping products of the upper and of the lower 16 bits.
    fn times_pairs(a: Self::I, b: Self::I) -> Self::I;
    /// Bits in both.
    fn and(a: Self::I, b: Self::I) -> Self::I;
    /// Bits in either.
    fn or(a: Self::I, b: Self::I) -> Self::I;
    /// Bits in one of them.
    fn xor(a: Self::I, b: Self::I) -> Self::I;
    /// Bits in `b` but not in `a`.
    fn without(a: Self::I, b: Self::I) -> Self::I;
    /// Shifted left.
    fn left(a: Self::I, n: u32) -> Self::I;
    /// Shifted right, zeros coming in.
    fn right(a: Self::I, n: u32) -> Self::I;
    /// Shifted right, copies of the sign coming in.
    fn right_signed(a: Self::I, n: u32) -> Self::I;
    /// Shifted right by as many bits as `n` says, 0..32, zeros coming in.
    fn right_by(a: Self::I, n: Self::I) -> Self::I;
    /// The larger, signed.
    fn larger(a: Self::I, b: Self::I) -> Self::I;
    /// The smaller, signed.
    fn smaller(a: Self::I, b: Self::I) -> Self::I;
    /// `table[at]` for indices of at least 0; places past the end read the last entry.
    fn look_up(table: &[u32], at: Self::I) -> Self::I;
    /// `table[at]` and `table[at + 1]` likewise, in a table of two or more.
    fn look_up_pairs(table: &[u32], at: Self::I) -> [Self::I; 2];

    /// `a` where `mask` is all ones, `b` where it is zero.
    #[inline(always)]
    fn choose(mask: Self::I, a: Self::F, b: Self::F) -> Self::F {
        Self::from_bits(Self::or(
            Self::and(mask, Self::bits(a)),
            Self::without(mask, Self::bits(b)),
        ))
    }

    /// `a` where `mask` is all ones, `b` where it is zero.
    #[inline(always)]
    fn choose_ints(mask: Self::I, a: Self::I, b: Self::I) -> Self::I {
        Self::or(Self::and(mask, a), Self::without(mask, b))
    }

    /// Largest whole number not above `a`, for numbers that fit in i32.
    #[inline(always)]
    fn floor(a: Self::F) -> Self::F {
        let whole = Self::from_int(Self::truncate(a));
        let excess = Self::and(Self::above(whole, a), Self::bits(Self::float(1.0)));
        Self::sub(whole, Self::from_bits(excess))
    }

    /// `a` limited to 0..=1; NaN becomes 0.
    #[inline(always)]
    fn unit(a: Self::F) -> Self::F {
        Self::min(Self::max(a, Self::float(0.0)), Self::float(1.0))
    }

    /// `a * b + c`, rounded twice.
    #[inline(always)]
    fn mul_then_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        Self::add(Self::mul(a, b), c)
    }
}

/// What this machine can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Any machine.
    Plain,
    /// One on which AVX2 was found.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// One on which AVX-512 was found.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Kind {
    /// The best kind that this machine is.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            if has!("avx512f") && has!("avx512bw") && has!("avx512dq") {
                return Self::Avx512;
            }
            if has!("avx2") {
                return Self::Avx2;
            }
        }
        Self::Plain
    }
}

/// Any machine: the definition of every operation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plain;

#[inline(always)]
fn each<T: Copy, U: Copy + Default, const N: usize>(a: [T; N], f: impl Fn(T) -> U) -> [U; N] {
    let mut out = [U::default(); N];
    for i in 0..N {
        out[i] = f(a[i]);
    }
    out
}

#[inline(always)]
fn both<T: Copy, U: Copy + Default, const N: usize>(
    a: [T; N],
    b: [T; N],
    f: impl Fn(T, T) -> U,
) -> [U; N] {
    let mut out = [U::default(); N];
    for i in 0..N {
        out[i] = f(a[i], b[i]);
    }
    out
}

#[expect(
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "lanes are 32 bits, signed or not"
)]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "as documented in the trait"
)]
impl Machine for Plain {
    const LANES: usize = 8;
    type F = [f32; 8];
    type I = [i32; 8];

    #[inline(always)]
    fn float(x: f32) -> Self::F {
        [x; 8]
    }
    #[inline(always)]
    fn int(x: i32) -> Self::I {
        [x; 8]
    }
    #[inline(always)]
    fn load(x: &[f32]) -> Self::F {
        let mut out = [0.0; 8];
        out.copy_from_slice(&x[..8]);
        out
    }
    #[inline(always)]
    fn store(x: Self::F, out: &mut [f32]) {
        out[..8].copy_from_slice(&x);
    }
    #[inline(always)]
    fn store_ints(x: Self::I, out: &mut [u32]) {
        out[..8].copy_from_slice(&each(x, |x| x as u32));
    }
    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        both(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn above(a: Self::F, b: Self::F) -> Self::I {
        both(a, b, |a, b| -i32::from(a > b))
    }
    #[inline(always)]
    fn at_least(a: Self::F, b: Self::F) -> Self::I {
        both(a, b, |a, b| -i32::from(a >= b))
    }
    #[inline(always)]
    fn any(mask: Self::I) -> bool {
        mask.iter().any(|&m| m < 0)
    }
    #[inline(always)]
    fn common(a: Self::I) -> Option<i32> {
        a.iter().all(|&x| x == a[0]).then_some(a[0])
    }
    #[inline(always)]
    fn load_ints(x: &[u32]) -> Self::I {
        let mut out = [0; 8];
        out.copy_from_slice(&x[..8]);
        each(out, |x: u32| x as i32)
    }
    #[inline(always)]
    fn any_above(a: Self::F, b: Self::F) -> bool {
        a.iter().zip(&b).any(|(a, b)| a > b)
    }
    #[inline(always)]
    fn truncate(a: Self::F) -> Self::I {
        const END: f32 = 2_147_483_648.0;
        each(a, |a| {
            if (-END..END).contains(&a) {
                a as i32
            } else {
                i32::MIN
            }
        })
    }
    #[inline(always)]
    fn from_int(a: Self::I) -> Self::F {
        each(a, |a| a as f32)
    }
    #[inline(always)]
    fn bits(a: Self::F) -> Self::I {
        each(a, |a| a.to_bits() as i32)
    }
    #[inline(always)]
    fn from_bits(a: Self::I) -> Self::F {
        each(a, |a| f32::from_bits(a as u32))
    }
    #[inline(always)]
    fn plus(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::wrapping_add)
    }
    #[inline(always)]
    fn minus(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::wrapping_sub)
    }
    #[inline(always)]
    fn times_small(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::wrapping_mul)
    }
    #[inline(always)]
    fn times_pairs(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, |a, b| {
            let low = (a as u16).wrapping_mul(b as u16);
            let high = ((a >> 16) as u16).wrapping_mul((b >> 16) as u16);
            (u32::from(low) | u32::from(high) << 16) as i32
        })
    }
    #[inline(always)]
    fn and(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn or(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, |a, b| a | b)
    }
    #[inline(always)]
    fn xor(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, |a, b| a ^ b)
    }
    #[inline(always)]
    fn without(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, |a, b| !a & b)
    }
    #[inline(always)]
    fn left(a: Self::I, n: u32) -> Self::I {
        each(a, |a| a << n)
    }
    #[inline(always)]
    fn right(a: Self::I, n: u32) -> Self::I {
        each(a, |a| (a as u32 >> n) as i32)
    }
    #[inline(always)]
    fn right_signed(a: Self::I, n: u32) -> Self::I {
        each(a, |a| a >> n)
    }
    #[inline(always)]
    fn right_by(a: Self::I, n: Self::I) -> Self::I {
        both(a, n, |a, n| (a as u32 >> (n as u32 & 31)) as i32)
    }
    #[inline(always)]
    fn larger(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::max)
    }
    #[inline(always)]
    fn smaller(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, i32::min)
    }
    #[inline(always)]
    fn look_up(table: &[u32], at: Self::I) -> Self::I {
        let last = table.len() - 1;
        each(at, |i| table[(i as usize).min(last)] as i32)
    }
    #[inline(always)]
    fn look_up_pairs(table: &[u32], at: Self::I) -> [Self::I; 2] {
        let last = table.len() - 2;
        [0, 1].map(|k| each(at, |i| table[(i as usize).min(last) + k] as i32))
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

/// A machine with AVX2. Its operations may run only where AVX2 was found: only [`Kind`] leads to them.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Avx2;

/// A machine with AVX-512; the same care is taken as for [`Avx2`].
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Avx512;
