//! Permutes lanes by the machine's instruction for it.

use fearless_simd::{ExtractToken, Simd, SimdBase, SimdInto, u32x8};

use super::vector::{WIDTH, Words};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{__m256i, __m512i, _mm256_permutevar8x32_epi32, _mm512_permutexvar_epi32};

    fearless_simd::kernel!(
        #[inline(always)]
        pub fn permute8(token: Avx2, words: __m256i, order: __m256i) -> __m256i {
            _mm256_permutevar8x32_epi32(words, order)
        }
    );

    fearless_simd::kernel!(
        #[inline(always)]
        pub fn permute16(token: Avx512, words: __m512i, order: __m512i) -> __m512i {
            _mm512_permutexvar_epi32(order, words)
        }
    );
}

/// `words[order]` for machines whose registers have eight lanes.
#[inline(always)]
pub fn permute8<S: Simd>(words: u32x8<S>, order: u32x8<S>) -> u32x8<S> {
    #[cfg(target_arch = "x86_64")]
    if let Some(token) = words.token().level().as_avx2() {
        return x86::permute8(token, words.into(), order.into()).simd_into(words.token());
    }
    let mut permuted = [0; 8];
    for (place, lane) in permuted.iter_mut().zip(order.to_array()) {
        *place = words.to_array()[lane as usize];
    }
    permuted.simd_into(words.token())
}

/// `words[order]` for machines whose registers have sixteen lanes.
#[inline(always)]
pub fn permute16<S: Simd>(words: Words<S>, order: Words<S>) -> Words<S> {
    #[cfg(target_arch = "x86_64")]
    if let Some(token) = words.token().level().as_avx512() {
        return x86::permute16(token, words.into(), order.into()).simd_into(words.token());
    }
    let mut permuted = [0; WIDTH];
    for (place, lane) in permuted.iter_mut().zip(order.to_array()) {
        *place = words.to_array()[lane as usize];
    }
    permuted.simd_into(words.token())
}
