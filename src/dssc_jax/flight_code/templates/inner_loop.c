@{comment}

#include "@{name}.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#if defined(__FAST_MATH__) && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "fast arithmetic changes the inner loop: compile without -ffast-math"
#endif
#if FLT_EVAL_METHOD != 0 && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "numbers are kept with excess precision: on 32-bit x86 compile with -msse2 -mfpmath=sse"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

static bool is_finite(@{real} x)
{
    return @{fabs}(x) <= @{largest};
}

@{definitions}
static bool are_readings_finite(const @{name}_readings *seen)
{
    return @{readings_finite};
}

static unsigned keep(@{name} *inner_loop, const @{name} *kept)
{
    const @{name} updated = *kept;
    if (!(@{held_finite})) {
        return 2u;
    }
    *inner_loop = updated;
    return 0u;
}

unsigned @{name}_init(@{name} *inner_loop, const @{name}_readings *seen)
{
    @{name} updated;
    if (!are_readings_finite(seen)) {
        return 1u;
    }
    @{unread}
@{start}
    return keep(inner_loop, &updated);
}

unsigned @{name}_sample(@{name} *inner_loop, const @{name}_readings *seen, const @{name}_commands *wanted)
{
    const @{name} held = *inner_loop;
    @{name} updated;
    if (!are_readings_finite(seen) || !(@{commands_finite})) {
        return 1u;
    }
@{sample}
    return keep(inner_loop, &updated);
}

unsigned @{name}_tick(@{name} *inner_loop, const @{name}_readings *seen)
{
    const @{name} held = *inner_loop;
    @{name} updated;
    if (!are_readings_finite(seen)) {
        return 1u;
    }
@{tick}
    return keep(inner_loop, &updated);
}
