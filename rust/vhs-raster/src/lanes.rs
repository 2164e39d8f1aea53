//! Several numbers at once, on any machine, with one meaning.
//!
//! Shading is written once over [`Machine`]; each implementation does every operation on every lane exactly as
//! [`Plain`] says, so a picture cannot depend on which one ran. Only operations that IEEE 754 or integer arithmetic
//! define to the last bit are offered: no fused multiply-add, no approximate reciprocals.

use std::fmt::Debug;

/// Most lanes any machine here has; rows of pictures have this many spare places, and runs of samples are padded to
/// a multiple of it.
pub(crate) const MOST_LANES: usize = 16;

/// Lanes of numbers and what can be done with them.
pub(crate) trait Machine {
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
    /// All ones where equal, else zero.
    fn equal(a: Self::I, b: Self::I) -> Self::I;
    /// `table[at]` for indices of at least 0; places past the end read the last entry.
    fn look_up(table: &[u32], at: Self::I) -> Self::I;

    /// `a` where `mask` is all ones, `b` where it is zero.
    #[inline(always)]
    fn choose(mask: Self::I, a: Self::F, b: Self::F) -> Self::F {
        Self::from_bits(Self::or(Self::and(mask, Self::bits(a)), Self::without(mask, Self::bits(b))))
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
fn both<T: Copy, U: Copy + Default, const N: usize>(a: [T; N], b: [T; N], f: impl Fn(T, T) -> U) -> [U; N] {
    let mut out = [U::default(); N];
    for i in 0..N {
        out[i] = f(a[i], b[i]);
    }
    out
}

#[expect(clippy::cast_possible_wrap, clippy::cast_sign_loss, reason = "lanes are 32 bits, signed or not")]
#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "as documented in the trait")]
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
        each(a, |a| if (-END..END).contains(&a) { a as i32 } else { i32::MIN })
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
    fn equal(a: Self::I, b: Self::I) -> Self::I {
        both(a, b, |a, b| -i32::from(a == b))
    }
    #[inline(always)]
    fn look_up(table: &[u32], at: Self::I) -> Self::I {
        let last = table.len() - 1;
        each(at, |i| table[(i as usize).min(last)] as i32)
    }
}

/// A machine with AVX2. Its operations may run only where AVX2 was found: [`crate::fill`] sees to that.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{Avx2, Machine};
    use std::arch::x86_64::*;

    /// One operation in terms of one instruction.
    macro_rules! by_instruction {
        ($($name:ident($($arg:ident: $kind:ident),*) -> $out:ident = $body:expr;)*) => {$(
            #[inline(always)]
            fn $name($($arg: Self::$kind),*) -> Self::$out {
                // SAFETY: these instructions touch registers only and need AVX2, without which `Avx2` is not used.
                unsafe { $body }
            }
        )*};
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "tables are below 2^31 long")]
    impl Machine for Avx2 {
        const LANES: usize = 8;
        type F = __m256;
        type I = __m256i;

        by_instruction! {
            add(a: F, b: F) -> F = _mm256_add_ps(a, b);
            sub(a: F, b: F) -> F = _mm256_sub_ps(a, b);
            mul(a: F, b: F) -> F = _mm256_mul_ps(a, b);
            div(a: F, b: F) -> F = _mm256_div_ps(a, b);
            max(a: F, b: F) -> F = _mm256_max_ps(a, b);
            min(a: F, b: F) -> F = _mm256_min_ps(a, b);
            above(a: F, b: F) -> I = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GT_OQ>(a, b));
            at_least(a: F, b: F) -> I = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GE_OQ>(a, b));
            truncate(a: F) -> I = _mm256_cvttps_epi32(a);
            from_int(a: I) -> F = _mm256_cvtepi32_ps(a);
            bits(a: F) -> I = _mm256_castps_si256(a);
            from_bits(a: I) -> F = _mm256_castsi256_ps(a);
            plus(a: I, b: I) -> I = _mm256_add_epi32(a, b);
            minus(a: I, b: I) -> I = _mm256_sub_epi32(a, b);
            times_small(a: I, b: I) -> I = _mm256_madd_epi16(a, b);
            times_pairs(a: I, b: I) -> I = _mm256_mullo_epi16(a, b);
            and(a: I, b: I) -> I = _mm256_and_si256(a, b);
            or(a: I, b: I) -> I = _mm256_or_si256(a, b);
            xor(a: I, b: I) -> I = _mm256_xor_si256(a, b);
            without(a: I, b: I) -> I = _mm256_andnot_si256(a, b);
            right_by(a: I, n: I) -> I = _mm256_srlv_epi32(a, n);
            larger(a: I, b: I) -> I = _mm256_max_epi32(a, b);
            smaller(a: I, b: I) -> I = _mm256_min_epi32(a, b);
            equal(a: I, b: I) -> I = _mm256_cmpeq_epi32(a, b);
            choose(mask: I, a: F, b: F) -> F = _mm256_blendv_ps(b, a, _mm256_castsi256_ps(mask));
        }

        #[inline(always)]
        fn float(x: f32) -> __m256 {
            // SAFETY: as above.
            unsafe { _mm256_set1_ps(x) }
        }
        #[inline(always)]
        fn int(x: i32) -> __m256i {
            // SAFETY: as above.
            unsafe { _mm256_set1_epi32(x) }
        }
        #[inline(always)]
        fn load(x: &[f32]) -> __m256 {
            let x = &x[..8];
            // SAFETY: as above, and eight numbers are readable behind the reference.
            unsafe { _mm256_loadu_ps(x.as_ptr()) }
        }
        #[inline(always)]
        fn store(x: __m256, out: &mut [f32]) {
            let out = &mut out[..8];
            // SAFETY: as above, and eight numbers are writable behind the reference.
            unsafe { _mm256_storeu_ps(out.as_mut_ptr(), x) };
        }
        #[inline(always)]
        fn store_ints(x: __m256i, out: &mut [u32]) {
            let out = &mut out[..8];
            // SAFETY: as above, and 32 bytes are writable behind the reference.
            unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), x) };
        }
        #[inline(always)]
        fn load_ints(x: &[u32]) -> __m256i {
            let x = &x[..8];
            // SAFETY: as above, and 32 bytes are readable behind the reference.
            unsafe { _mm256_loadu_si256(x.as_ptr().cast()) }
        }
        #[inline(always)]
        fn any(mask: __m256i) -> bool {
            // SAFETY: as above.
            unsafe { _mm256_movemask_ps(_mm256_castsi256_ps(mask)) != 0 }
        }
        #[inline(always)]
        fn common(a: __m256i) -> Option<i32> {
            // SAFETY: as above.
            unsafe {
                let first = _mm_cvtsi128_si32(_mm256_castsi256_si128(a));
                let same = _mm256_cmpeq_epi32(a, _mm256_set1_epi32(first));
                (_mm256_movemask_epi8(same) == -1).then_some(first)
            }
        }
        #[inline(always)]
        fn any_above(a: __m256, b: __m256) -> bool {
            // SAFETY: as above.
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(a, b)) != 0 }
        }
        #[inline(always)]
        fn left(a: __m256i, n: u32) -> __m256i {
            // SAFETY: as above.
            unsafe { _mm256_sllv_epi32(a, _mm256_set1_epi32(n.cast_signed())) }
        }
        #[inline(always)]
        fn right(a: __m256i, n: u32) -> __m256i {
            // SAFETY: as above.
            unsafe { _mm256_srlv_epi32(a, _mm256_set1_epi32(n.cast_signed())) }
        }
        #[inline(always)]
        fn right_signed(a: __m256i, n: u32) -> __m256i {
            // SAFETY: as above.
            unsafe { _mm256_srav_epi32(a, _mm256_set1_epi32(n.cast_signed())) }
        }
        #[inline(always)]
        fn look_up(table: &[u32], at: __m256i) -> __m256i {
            // SAFETY: as above; as unsigned numbers all indices are limited to the table's last entry, and a table
            // is shorter than 2^31.
            unsafe {
                let at = _mm256_min_epu32(at, _mm256_set1_epi32((table.len() - 1) as i32));
                _mm256_i32gather_epi32::<4>(table.as_ptr().cast(), at)
            }
        }
    }
}

/// A machine with AVX-512 (F, BW, DQ); the same care is taken as for [`Avx2`].
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Avx512;

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{Avx512, Machine};
    use std::arch::x86_64::*;

    /// One operation in terms of one instruction.
    macro_rules! by_instruction {
        ($($name:ident($($arg:ident: $kind:ident),*) -> $out:ident = $body:expr;)*) => {$(
            #[inline(always)]
            fn $name($($arg: Self::$kind),*) -> Self::$out {
                // SAFETY: these instructions touch registers only and need AVX-512, without which `Avx512` is not used.
                unsafe { $body }
            }
        )*};
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "tables are below 2^31 long")]
    impl Machine for Avx512 {
        const LANES: usize = 16;
        type F = __m512;
        type I = __m512i;

        by_instruction! {
            add(a: F, b: F) -> F = _mm512_add_ps(a, b);
            sub(a: F, b: F) -> F = _mm512_sub_ps(a, b);
            mul(a: F, b: F) -> F = _mm512_mul_ps(a, b);
            div(a: F, b: F) -> F = _mm512_div_ps(a, b);
            max(a: F, b: F) -> F = _mm512_max_ps(a, b);
            min(a: F, b: F) -> F = _mm512_min_ps(a, b);
            above(a: F, b: F) -> I = _mm512_movm_epi32(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b));
            at_least(a: F, b: F) -> I = _mm512_movm_epi32(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(a, b));
            truncate(a: F) -> I = _mm512_cvttps_epi32(a);
            from_int(a: I) -> F = _mm512_cvtepi32_ps(a);
            bits(a: F) -> I = _mm512_castps_si512(a);
            from_bits(a: I) -> F = _mm512_castsi512_ps(a);
            plus(a: I, b: I) -> I = _mm512_add_epi32(a, b);
            minus(a: I, b: I) -> I = _mm512_sub_epi32(a, b);
            times_small(a: I, b: I) -> I = _mm512_madd_epi16(a, b);
            times_pairs(a: I, b: I) -> I = _mm512_mullo_epi16(a, b);
            and(a: I, b: I) -> I = _mm512_and_si512(a, b);
            or(a: I, b: I) -> I = _mm512_or_si512(a, b);
            xor(a: I, b: I) -> I = _mm512_xor_si512(a, b);
            without(a: I, b: I) -> I = _mm512_andnot_si512(a, b);
            right_by(a: I, n: I) -> I = _mm512_srlv_epi32(a, n);
            larger(a: I, b: I) -> I = _mm512_max_epi32(a, b);
            smaller(a: I, b: I) -> I = _mm512_min_epi32(a, b);
            equal(a: I, b: I) -> I = _mm512_movm_epi32(_mm512_cmpeq_epi32_mask(a, b));
            choose(mask: I, a: F, b: F) -> F = _mm512_mask_blend_ps(_mm512_movepi32_mask(mask), b, a);
        }

        #[inline(always)]
        fn float(x: f32) -> __m512 {
            // SAFETY: as above.
            unsafe { _mm512_set1_ps(x) }
        }
        #[inline(always)]
        fn int(x: i32) -> __m512i {
            // SAFETY: as above.
            unsafe { _mm512_set1_epi32(x) }
        }
        #[inline(always)]
        fn load(x: &[f32]) -> __m512 {
            let x = &x[..16];
            // SAFETY: as above, and sixteen numbers are readable behind the reference.
            unsafe { _mm512_loadu_ps(x.as_ptr()) }
        }
        #[inline(always)]
        fn store(x: __m512, out: &mut [f32]) {
            let out = &mut out[..16];
            // SAFETY: as above, and sixteen numbers are writable behind the reference.
            unsafe { _mm512_storeu_ps(out.as_mut_ptr(), x) };
        }
        #[inline(always)]
        fn store_ints(x: __m512i, out: &mut [u32]) {
            let out = &mut out[..16];
            // SAFETY: as above, and 64 bytes are writable behind the reference.
            unsafe { _mm512_storeu_si512(out.as_mut_ptr().cast(), x) };
        }
        #[inline(always)]
        fn load_ints(x: &[u32]) -> __m512i {
            let x = &x[..16];
            // SAFETY: as above, and 64 bytes are readable behind the reference.
            unsafe { _mm512_loadu_si512(x.as_ptr().cast()) }
        }
        #[inline(always)]
        fn any(mask: __m512i) -> bool {
            // SAFETY: as above.
            unsafe { _mm512_movepi32_mask(mask) != 0 }
        }
        #[inline(always)]
        fn common(a: __m512i) -> Option<i32> {
            // SAFETY: as above.
            unsafe {
                let first = _mm512_cvtsi512_si32(a);
                (_mm512_cmpeq_epi32_mask(a, _mm512_set1_epi32(first)) == u16::MAX).then_some(first)
            }
        }
        #[inline(always)]
        fn any_above(a: __m512, b: __m512) -> bool {
            // SAFETY: as above.
            unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b) != 0 }
        }
        #[inline(always)]
        fn left(a: __m512i, n: u32) -> __m512i {
            // SAFETY: as above.
            unsafe { _mm512_sllv_epi32(a, _mm512_set1_epi32(n.cast_signed())) }
        }
        #[inline(always)]
        fn right(a: __m512i, n: u32) -> __m512i {
            // SAFETY: as above.
            unsafe { _mm512_srlv_epi32(a, _mm512_set1_epi32(n.cast_signed())) }
        }
        #[inline(always)]
        fn right_signed(a: __m512i, n: u32) -> __m512i {
            // SAFETY: as above.
            unsafe { _mm512_srav_epi32(a, _mm512_set1_epi32(n.cast_signed())) }
        }
        #[inline(always)]
        fn look_up(table: &[u32], at: __m512i) -> __m512i {
            // SAFETY: as above; as unsigned numbers all indices are limited to the table's last entry, and a table
            // is shorter than 2^31.
            unsafe {
                let at = _mm512_min_epu32(at, _mm512_set1_epi32((table.len() - 1) as i32));
                _mm512_i32gather_epi32::<4>(at, table.as_ptr().cast())
            }
        }
    }
}
