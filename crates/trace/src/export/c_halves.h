typedef struct { Half a, b; } V;
typedef struct { HalfMask a, b; } M;
#define ONE(T, name) INLINE T name(T x) { return (T){Half##name(x.a), Half##name(x.b)}; }
#define TWO(T, of, name) INLINE T name(of x, of y) { return (T){Half##name(x.a, y.a), Half##name(x.b, y.b)}; }
#define THREE(name) INLINE V name(V x, V y, V z) { return (V){Half##name(x.a, y.a, z.a), Half##name(x.b, y.b, z.b)}; }
ONE(V, Sqrt) ONE(V, Abs) ONE(V, Floor) ONE(V, Neg) ONE(V, Pow2) ONE(M, Not)
TWO(V, V, Min) TWO(V, V, Max) TWO(V, V, Add) TWO(V, V, Sub) TWO(V, V, Mul) TWO(V, V, Div)
TWO(M, V, Lt) TWO(M, V, Le) TWO(M, M, And) TWO(M, M, Or)
THREE(MulAdd) THREE(MulSub) THREE(MulFrom) THREE(Over)
INLINE V Lit(N v) { return (V){HalfLit(v), HalfLit(v)}; }
INLINE V Select(M m, V yes, V no) { return (V){HalfSelect(m.a, yes.a, no.a), HalfSelect(m.b, yes.b, no.b)}; }
INLINE int Any(M m) { return HalfAny(m.a) | HalfAny(m.b); }
INLINE V Load(const N *p) { return (V){HalfLoad(p), HalfLoad(p + LANES / 2)}; }
INLINE void Store(N *p, V v) { HalfStore(p, v.a); HalfStore(p + LANES / 2, v.b); }
