@{comment}

#include "@{header}"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(__FAST_MATH__) && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "fast arithmetic changes the @{label}: compile without -ffast-math"
#endif
#if FLT_EVAL_METHOD != 0 && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "numbers are kept with excess precision: on 32-bit x86 compile with -msse2 -mfpmath=sse"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

@{body}
