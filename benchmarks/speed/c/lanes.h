/* Vectors of LANES draws, one draw a lane, by GCC's vector extensions; numbers.h says BITS (64, 32) and LANES.

   With AVX-512 a mask is a bit a lane, otherwise a vector. With either AVX, what the extensions lack are intrinsics for
   one register; for other widths loops over lanes stand in, which -fno-math-errno -fno-trapping-math let the compiler
   turn into vector instructions. */
#ifndef LANES_H
#define LANES_H

#include <immintrin.h>
#include <math.h>

#define INLINE static inline __attribute__((always_inline))
#define EACH(i) for (int i = 0; i < LANES; i++)
#define R(x) ((real)(x))

#if BITS == 64
typedef double real;
typedef long long word;
#define LARGEST 1.3e150 /* of the sum of a state; squares are finite far beyond it */
#else
typedef float real;
typedef int word;
#define LARGEST 1.8e15f
#endif
typedef real vec __attribute__((vector_size(LANES * sizeof(real))));
typedef word words __attribute__((vector_size(LANES * sizeof(real))));

INLINE vec fill(real x) { return x - (vec){0}; }

#ifdef __AVX512F__
#if BITS == 64
typedef __mmask8 mask;
#define SIMD(name) _mm512_##name##_pd
#define COMPARED _mm512_cmp_pd_mask
#else
typedef __mmask16 mask;
#define SIMD(name) _mm512_##name##_ps
#define COMPARED _mm512_cmp_ps_mask
#endif
#define ALL ((mask)-1)
INLINE mask above(vec a, vec b) { return COMPARED(a, b, _CMP_GT_OQ); }
INLINE int any(mask m) { return m != 0; }
INLINE int holds(mask m, int lane) { return m >> lane & 1; }
INLINE vec choose(mask m, vec yes, vec no) { return SIMD(mask_blend)(m, no, yes); }
INLINE vec least(vec a, vec b) { return SIMD(min)(a, b); }
INLINE vec most(vec a, vec b) { return SIMD(max)(a, b); }
INLINE vec root(vec x) { return SIMD(sqrt)(x); }
INLINE vec size(vec x) { return SIMD(abs)(x); }
INLINE vec ceiling(vec x) { return SIMD(ceil)(x); }
#else
typedef words mask;
#define ALL ((mask){0} == (mask){0})
#if defined(__AVX__) && BITS * LANES == 256
#if BITS == 64
#define SIMD(name) _mm256_##name##_pd
typedef __m256d bits;
#else
#define SIMD(name) _mm256_##name##_ps
typedef __m256 bits;
#endif
INLINE mask above(vec a, vec b) { return a > b; }
INLINE int any(mask m) { return SIMD(movemask)((bits)m) != 0; }
INLINE int holds(mask m, int lane) { return m[lane] != 0; }
INLINE vec choose(mask m, vec yes, vec no) { return SIMD(blendv)(no, yes, (bits)m); }
INLINE vec least(vec a, vec b) { return SIMD(min)(a, b); }
INLINE vec most(vec a, vec b) { return SIMD(max)(a, b); }
INLINE vec root(vec x) { return SIMD(sqrt)(x); }
INLINE vec size(vec x) { return SIMD(andnot)(fill(R(-0.0)), x); }
INLINE vec ceiling(vec x) { return SIMD(ceil)(x); }
#else
#define BY_LANE(expression) \
    vec y; \
    EACH(i) y[i] = expression; \
    return y
INLINE mask above(vec a, vec b) { return a > b; }
INLINE int any(mask m) {
    word found = 0;
    EACH(i) found |= m[i];
    return found != 0;
}
INLINE int holds(mask m, int lane) { return m[lane] != 0; }
INLINE vec choose(mask m, vec yes, vec no) { BY_LANE(m[i] ? yes[i] : no[i]); }
INLINE vec least(vec a, vec b) { BY_LANE(a[i] < b[i] ? a[i] : b[i]); }
INLINE vec most(vec a, vec b) { BY_LANE(a[i] > b[i] ? a[i] : b[i]); }
INLINE vec root(vec x) { BY_LANE(R(BITS == 64 ? sqrt(x[i]) : sqrtf(R(x[i])))); }
INLINE vec size(vec x) { BY_LANE(R(BITS == 64 ? fabs(x[i]) : fabsf(R(x[i])))); }
INLINE vec ceiling(vec x) { BY_LANE(R(BITS == 64 ? ceil(x[i]) : ceilf(R(x[i])))); }
#endif
#endif

INLINE vec clip(vec x, vec low, vec high) { return least(most(x, low), high); }

/* |x| with the sign of y. */
INLINE vec signed_as(vec x, vec y) {
    const words sign = (words)fill(R(-0.0));
    return (vec)(((words)x & ~sign) | ((words)y & sign));
}

/* (atan r)/r as a polynomial in z = r^2, |r| <= 7/16; coefficients of s_atan.c and s_atanf.c of FreeBSD's msun, which
   is Sun Microsystems' fdlibm (1993). Odd and even powers apart, to shorten the chain. */
INLINE vec atan_series(vec z) {
    vec w = z * z;
#if BITS == 64
    vec odd = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * (9.09088713343650656196e-02 +
              w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)))));
    vec even = w * (-1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01 + w * (-7.69187620504482999495e-02 +
               w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))));
#else
    vec odd = z * (3.3333328366e-01f + w * (1.4253635705e-01f + w * 6.1687607318e-02f));
    vec even = w * (-1.9999158382e-01f + w * -1.0648017377e-01f);
#endif
    return R(1) - (odd + even);
}

/* atan(y/x) for x > 0 with one division: y/x, pi/4 + (|y| - x)/(|y| + x) or pi/2 - x/|y|, whichever is small. */
INLINE vec atan_ratio(vec y, vec x) {
    vec up = size(y);
    mask steep = above(up, x * R(2.41421356237309504880)), middle = above(up, x * R(0.41421356237309504880));
    vec top = choose(steep, -x, choose(middle, up - x, up));
    vec bottom = choose(steep, up, choose(middle, up + x, x));
    vec offset = choose(steep, fill(R(M_PI_2)), choose(middle, fill(R(M_PI_4)), fill(0)));
    vec ratio = top / bottom;
    return signed_as(offset + ratio * atan_series(ratio * ratio), y);
}

/* The angle of (x, y) in (-pi, pi]; 0 at the origin. */
INLINE vec atan_full(vec y, vec x) {
    vec angle = atan_ratio(y, most(size(x), fill(R(1e-30))));
    return choose(above(fill(0), x), signed_as(fill(R(M_PI)), y) - angle, angle);
}

/* The same angle in (-pi, pi]. */
INLINE vec wrapped(vec angle) { return angle - R(2 * M_PI) * ceiling((angle - R(M_PI)) * R(0.5 * M_1_PI)); }
#endif
