@{comment}

#include "@{name}.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>

#if defined(__FAST_MATH__) && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "fast arithmetic changes the monitor: compile without -ffast-math"
#endif
#if FLT_EVAL_METHOD != 0 && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "numbers are kept with excess precision: on 32-bit x86 compile with -msse2 -mfpmath=sse"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

@{definitions}
void @{name}_init(@{name} *monitor)
{
    monitor->current = 0;
    monitor->latched = 0;
    monitor->sample = 0;
    for (unsigned flag = 0; flag < @{flag_count}; flag++) {
        monitor->first[flag] = -1;
    }
    @{begin}
}

uint32_t @{name}_step(@{name} *monitor, const @{name}_sample *seen)
{
    const @{name} before = *monitor;
@{computation}
    return monitor->current;
}
