// Registers of doubles, and the functions on them that a tape needs. See cpp.py.
#include <stdint.h>
#if defined(__AVX512F__)
enum { W = 8 };
#elif defined(__AVX__)
enum { W = 4 };
#else
enum { W = 2 };
#endif
typedef double V __attribute__((vector_size(W * 8)));
typedef int64_t M __attribute__((vector_size(W * 8)));
#define INLINE static inline __attribute__((always_inline))

/* In one instruction; what `memcpy` writes by halves a processor waits to read as a whole. */
INLINE V loaded(const double *from) {
  typedef double Unaligned __attribute__((vector_size(W * 8), aligned(8), may_alias));
  return *(const Unaligned *)from;
}
INLINE V all(double x) { return V{} + x; }
INLINE V where(M m, V x) { return m ? x : V{}; }
INLINE V vabs(V x) { return (V)((M)x & INT64_MAX); }
INLINE V vmin(V a, V b) { return a < b ? a : b; }
INLINE V vmax(V a, V b) { return a > b ? a : b; }
INLINE V vsqrt(V x) { V y; for (int i = 0; i < W; ++i) y[i] = __builtin_sqrt(x[i]); return y; }
INLINE V vfloor(V x) {
  const double magic = 0x1.8p52;  /* whole numbers only from here on; good below 2^51 */
  V r = (x + magic) - magic;
  return r > x ? r - 1.0 : r;
}
/* Whether any lane is set, by halves. */
INLINE bool any(M m) {
  int64_t part[W];
  __builtin_memcpy(part, &m, sizeof m);
  for (int half = W / 2; half; half /= 2) for (int i = 0; i < half; ++i) part[i] |= part[i + half];
  return part[0] != 0;
}
/* Series where all are small, else the library's functions one by one. */
INLINE V vasin(V x) {
  V z = x * x, y = x + x * z * (1.0 / 6 + z * (3.0 / 40 + z * (15.0 / 336 + z * (105.0 / 3456))));
  const M large = ~(z < 2.5e-5);
  if (any(large)) for (int i = 0; i < W; ++i) if (large[i]) y[i] = __builtin_asin(x[i]);
  return y;
}
INLINE V vatan2(V a, V b) {
  V x = a / b, z = x * x, y = x - x * z * (1.0 / 3 - z * (1.0 / 5 - z * (1.0 / 7 - z * (1.0 / 9))));
  const M large = ~((z < 1e-4) & (b > 0.0));
  if (any(large)) for (int i = 0; i < W; ++i) if (large[i]) y[i] = __builtin_atan2(a[i], b[i]);
  return y;
}

/* Quadrant by Cody and Waite in three parts of pi/2 (33 bits each: exact products), polynomials of fdlibm's k_sin.c and k_cos.c. */
struct Turn { V s, c; };
INLINE Turn sincos(V x) {
  const double magic = 0x1.8p52;
  V t = x * 0x1.45f306dc9c883p-1 + magic, n = t - magic;
  M k = (M)t;
  V r = ((x - n * 0x1.921fb544p0) - n * 0x1.0b4611a6p-34) - n * 0x1.3198a2e037073p-69;
  V z = r * r;
  V p = ((((z * 1.58969099521155010221e-10 - 2.50507602534068634195e-08) * z + 2.75573137070700676789e-06) * z
    - 1.98412698298579493134e-04) * z + 8.33333333332248946124e-03) * z - 1.66666666666666324348e-01;
  V s = r + r * z * p;
  V o = ((((z * -1.13596475577881948265e-11 + 2.08757232129817482790e-09) * z - 2.75573143513906633035e-07) * z
    + 2.48015872894767294178e-05) * z - 1.38888888888741095749e-03) * z + 4.16666666666666019037e-02;
  V c = 1.0 - (0.5 * z - z * z * o);
  M odd = (k << 63) != 0;
  M one = k << 62, two = (k + 1) << 62;
  const M sign = M{} + INT64_MIN;
  Turn f;
  f.s = (V)((M)(odd ? c : s) ^ (one & sign));
  f.c = (V)((M)(odd ? s : c) ^ (two & sign));
  return f;
}
