#if defined(__ARM_NEON)
#include <arm_neon.h>
#endif
typedef N V __attribute__((vector_size(16), may_alias));
typedef @int M __attribute__((vector_size(16), may_alias));
INLINE V Lit(N v) { V a; for (int i = 0; i < W; i++) a[i] = v; return a; }
#if defined(__ARM_NEON)
INLINE V MulAdd(V a, V b, V c) { return (V)vfmaq_@wide(c, a, b); }
INLINE V MulSub(V a, V b, V c) { return (V)vfmaq_@wide(-c, a, b); }
INLINE V MulFrom(V a, V b, V c) { return (V)vfmsq_@wide(c, a, b); }
#else
INLINE V MulAdd(V a, V b, V c) { return a * b + c; }
INLINE V MulSub(V a, V b, V c) { return a * b - c; }
INLINE V MulFrom(V a, V b, V c) { return c - a * b; }
#endif
INLINE V Sqrt(V a) { for (int i = 0; i < W; i++) a[i] = __builtin_sqrt@s(a[i]); return a; }
INLINE V Floor(V a) { for (int i = 0; i < W; i++) a[i] = __builtin_floor@s(a[i]); return a; }
INLINE V Abs(V a) { return (V)((M)a & @quiet); }
INLINE M Lt(V a, V b) { return a < b; }
INLINE M Le(V a, V b) { return a <= b; }
INLINE M And(M a, M b) { return a & b; }
INLINE M Or(M a, M b) { return a | b; }
INLINE M Not(M a) { return ~a; }
INLINE V Select(M m, V yes, V no) { return (V)((m & (M)yes) | (~m & (M)no)); }
INLINE V Min(V a, V b) { return Select(b < a, b, a); }
INLINE V Max(V a, V b) { return Select(b > a, b, a); }
INLINE int Any(M m) { int any = 0; for (int i = 0; i < W; i++) any |= m[i] != 0; return any; }
INLINE V Pow2(V k) { return (V)(__builtin_convertvector(k + @bias, M) << @shift); }
