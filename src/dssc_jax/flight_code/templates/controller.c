@{comment}

#include "@{study}_controller.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#if defined(__FAST_MATH__) && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "fast arithmetic changes the controller: compile without -ffast-math"
#endif
#if FLT_EVAL_METHOD != 0 && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "numbers are kept with excess precision: on 32-bit x86 compile with -msse2 -mfpmath=sse"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

@{definitions}
static bool is_finite(@{real} x)
{
    return @{fabs}(x) <= @{largest};
}

@{functions}

@{description}
