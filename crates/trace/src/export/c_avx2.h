#if defined(__GNUC__) && !defined(__clang__)
/* Straight-line code of some hundred operations spills less from sixteen registers where it is put in order before they are given out. */
#pragma GCC optimize("schedule-insns", "sched-pressure")
#endif
#include <immintrin.h>
typedef __m256@d V;
typedef __m256@d M;
INLINE V Lit(N v) { return _mm256_set1_@p(v); }
INLINE V MulAdd(V a, V b, V c) { return _mm256_fmadd_@p(a, b, c); }
INLINE V MulSub(V a, V b, V c) { return _mm256_fmsub_@p(a, b, c); }
INLINE V MulFrom(V a, V b, V c) { return _mm256_fnmadd_@p(a, b, c); }
INLINE V Sqrt(V a) { return _mm256_sqrt_@p(a); }
INLINE V Abs(V a) { return _mm256_andnot_@p(_mm256_set1_@p(-0.0), a); }
INLINE V Min(V a, V b) { return _mm256_min_@p(b, a); }
INLINE V Max(V a, V b) { return _mm256_max_@p(b, a); }
INLINE V Floor(V a) { return _mm256_floor_@p(a); }
INLINE M Lt(V a, V b) { return _mm256_cmp_@p(a, b, _CMP_LT_OQ); }
INLINE M Le(V a, V b) { return _mm256_cmp_@p(a, b, _CMP_LE_OQ); }
INLINE M And(M a, M b) { return _mm256_and_@p(a, b); }
INLINE M Or(M a, M b) { return _mm256_or_@p(a, b); }
INLINE M Not(M a) { return _mm256_xor_@p(a, (M)_mm256_set1_epi32(-1)); }
INLINE V Select(M m, V yes, V no) { return _mm256_blendv_@p(no, yes, m); }
INLINE int Any(M m) { return _mm256_movemask_@p(m) != 0; }
typedef @int I __attribute__((vector_size(32)));
INLINE V Pow2(V k) { return (V)(__builtin_convertvector(k + @bias, I) << @shift); }
