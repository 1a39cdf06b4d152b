/* The controllers for the bench, as functions of arrays of numbers. */
#include "@{study}_controller.h"

typedef @{real} real;
typedef uint@{precision}_t bits;
#define EPSILON @{limits}_EPSILON
#define SMALLEST @{limits}_MIN
#define LARGEST @{limits}_MAX
#define CHANNELS @{channels}u
#define SIGNALS @{signals}u
#define MOST_PARAMETERS @{most_parameters}
#define MOST_RESULTS @{most_results}

@{functions}

@{names}

static const channel_shape shapes[] = {
    @{shapes}
};

static void prepare(unsigned channel, const real *given)
{
    switch (channel) {
    @{prepare}
    default:
        break;
    }
}

static void restart(unsigned channel)
{
    switch (channel) {
    @{restart}
    default:
        break;
    }
}

static unsigned check(unsigned channel)
{
    switch (channel) {
    @{check}
    default:
        return 0;
    }
}

static unsigned advance(unsigned channel, const real *row, real *results, bool telemetry)
{
    switch (channel) {
    @{advance}
    default:
        return 0;
    }
}
