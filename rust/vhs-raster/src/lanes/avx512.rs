//! Lanes of a machine with AVX-512 (F, BW, DQ): one or two instructions for each operation.

use super::{Avx512, Machine};
#[allow(clippy::wildcard_imports, reason = "some fifty instructions")]
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

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "tables are below 2^31 long"
)]
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
    #[inline(always)]
    fn look_up_pairs(table: &[u32], at: __m512i) -> [__m512i; 2] {
        assert!(table.len() >= 2, "expected a table of two entries or more");
        // SAFETY: as above; as unsigned numbers all indices are limited to the table's last entry but one, so that
        // 64 bits are readable there.
        unsafe {
            let at = _mm512_min_epu32(at, _mm512_set1_epi32((table.len() - 2) as i32));
            let mut places = [0_u32; 16];
            _mm512_storeu_si512(places.as_mut_ptr().cast(), at);
            let pair = |i: usize| {
                let from = table.as_ptr().add(places[i] as usize);
                from.cast::<i64>().read_unaligned()
            };
            // Every other lane, so that a shift and a blend bring the texels of all lanes together.
            let eight = |i: usize| {
                _mm512_setr_epi64(
                    pair(i),
                    pair(i + 2),
                    pair(i + 4),
                    pair(i + 6),
                    pair(i + 8),
                    pair(i + 10),
                    pair(i + 12),
                    pair(i + 14),
                )
            };
            let (even, odd) = (eight(0), eight(1));
            let is_odd = 0b1010_1010_1010_1010;
            [
                _mm512_mask_blend_epi32(is_odd, even, _mm512_slli_epi64::<32>(odd)),
                _mm512_mask_blend_epi32(is_odd, _mm512_srli_epi64::<32>(even), odd),
            ]
        }
    }
}
