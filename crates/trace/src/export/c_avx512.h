#include <immintrin.h>
typedef __m512@d V;
typedef @mask M;
INLINE V Lit(N v) { return _mm512_set1_@p(v); }
INLINE V MulAdd(V a, V b, V c) { return _mm512_fmadd_@p(a, b, c); }
INLINE V MulSub(V a, V b, V c) { return _mm512_fmsub_@p(a, b, c); }
INLINE V MulFrom(V a, V b, V c) { return _mm512_fnmadd_@p(a, b, c); }
INLINE V Sqrt(V a) { return _mm512_sqrt_@p(a); }
INLINE V Abs(V a) { return _mm512_abs_@p(a); }
INLINE V Min(V a, V b) { return _mm512_min_@p(b, a); }
INLINE V Max(V a, V b) { return _mm512_max_@p(b, a); }
INLINE V Floor(V a) { return _mm512_roundscale_@p(a, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC); }
INLINE M Lt(V a, V b) { return _mm512_cmp_@p_mask(a, b, _CMP_LT_OQ); }
INLINE M Le(V a, V b) { return _mm512_cmp_@p_mask(a, b, _CMP_LE_OQ); }
INLINE M And(M a, M b) { return a & b; }
INLINE M Or(M a, M b) { return a | b; }
INLINE M Not(M a) { return ~a; }
INLINE V Select(M m, V yes, V no) { return _mm512_mask_blend_@p(m, no, yes); }
INLINE int Any(M m) { return m != 0; }
INLINE V Pow2(V k) {
  return (V)_mm512_slli_@epi(_mm512_cvtt@p_@epi(k + @bias), @shift);
}
