//! Lanes of a machine with AVX2: one instruction for each operation that [`Plain`](super::Plain) defines.

use super::{Avx2, Machine};
#[allow(clippy::wildcard_imports, reason = "some fifty instructions")]
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

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "tables are below 2^31 long"
)]
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
    #[inline(always)]
    fn look_up_pairs(table: &[u32], at: __m256i) -> [__m256i; 2] {
        assert!(table.len() >= 2, "expected a table of two entries or more");
        // SAFETY: as above; as unsigned numbers all indices are limited to the table's last entry but one, so that
        // 64 bits are readable there.
        unsafe {
            let at = _mm256_min_epu32(at, _mm256_set1_epi32((table.len() - 2) as i32));
            let mut places = [0_u32; 8];
            _mm256_storeu_si256(places.as_mut_ptr().cast(), at);
            let pair = |i: usize| {
                let from = table.as_ptr().add(places[i] as usize);
                from.cast::<i64>().read_unaligned()
            };
            // Every other lane, so that a shift and a blend bring the texels of all lanes together.
            let four =
                |i: usize| _mm256_setr_epi64x(pair(i), pair(i + 2), pair(i + 4), pair(i + 6));
            let (even, odd) = (four(0), four(1));
            [
                _mm256_blend_epi32::<0b1010_1010>(even, _mm256_slli_epi64::<32>(odd)),
                _mm256_blend_epi32::<0b1010_1010>(_mm256_srli_epi64::<32>(even), odd),
            ]
        }
    }
}
