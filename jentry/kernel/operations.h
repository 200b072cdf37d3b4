/* Operations on numbers as XLA has them, in C99 and in CUDA. Arguments are variables. */
#ifdef __CUDACC__
#define INLINE static __device__ __forceinline__
#else
#include <stdbool.h>
#include <tgmath.h>
#define INLINE static inline
#endif

typedef float f32;
typedef double f64;
typedef int i32;
typedef long long i64;
typedef unsigned int u32;
typedef unsigned long long u64;

/* NaN if any of both is */
#define MAX(x, y) ((x) > (y) || (x) != (x) ? (x) : (y))
#define MIN(x, y) ((x) < (y) || (x) != (x) ? (x) : (y))
#define SIGN(x) ((x) > 0 ? 1 : (x) < 0 ? -1 : (x)) /* of -0 and NaN: themselves */

/* Whole numbers: division by zero, and of the smallest by -1, has a result */
#define QUOTIENT(x, y) ((y) == 0 ? -1 : (y) == -1 ? -(x) : (x) / (y))
#define REMAINDER(x, y) ((y) == 0 ? (x) : (y) == -1 ? 0 : (x) % (y))
#define QUOTIENT_UNSIGNED(x, y) ((y) == 0 ? -1 : (x) / (y))
#define REMAINDER_UNSIGNED(x, y) ((y) == 0 ? (x) : (x) % (y))

/* Shifts by all bits of a number or more have a result */
#define LEFT(x, n, bits) ((u64)(n) >= bits ? 0 : (u64)(x) << (n))
#define RIGHT(x, n, bits) ((u64)(n) >= bits ? 0 : (x) >> (n))
#define RIGHT_SIGNED(x, n, bits) ((u64)(n) >= bits ? ((x) < 0 ? -1 : 0) : (x) >> (n))

/* A real number without its fraction; the nearest number of the type where it has none */
#define TO_I32(x) ((i32)whole(x, -2147483648.0, 2147483647.0))
#define TO_U32(x) ((u32)whole(x, 0.0, 4294967295.0))
#define TO_I64(x) whole(x, -9223372036854775808.0, 9223372036854775808.0)
INLINE i64 whole(f64 x, f64 least, f64 most) {
  if (x != x) return 0;
  if (x >= most) return most < 9e18 ? (i64)most : 9223372036854775807ll;
  return x <= least ? (i64)least : (i64)x;
}
INLINE u64 TO_U64(f64 x) {
  return !(x > 0.0) ? 0 : x >= 18446744073709551616.0 ? ~0ull : (u64)x;
}

INLINE i64 bits_of(f64 x) {
  union { f64 x; i64 bits; } both;
  both.x = x;
  return both.bits;
}
INLINE f64 of_bits(i64 bits) {
  union { f64 x; i64 bits; } both;
  both.bits = bits;
  return both.x;
}

#ifndef __CUDACC__
/* The x at which erf(x) = y, by Halley's method from Winitzki's approximation. The error is
   that of erfc, which is small where erf is near 1. */
INLINE f64 erfinv(f64 y) {
  f64 size = fabs(y), a = 0.147, l, b, x;
  if (!(size < 1.0)) return size == 1.0 ? y * (1.0 / 0.0) : 0.0 / 0.0;
  l = log((1.0 - size) * (1.0 + size));
  b = 2.0 / (3.141592653589793 * a) + 0.5 * l;
  x = sqrt(sqrt(b * b - l / a) - b);
  for (int i = 0; i < 4; i++) {
    f64 off = size < 0.5 ? erf(x) - size : (1.0 - size) - erfc(x);
    x -= off / (1.1283791670955126 * exp(-x * x) + x * off);
  }
  return copysign(x, y);
}
#endif
