/* The variables of the FMU, and how they reach the controllers. */
#include "@{study}_controller.h"

#define GUID "@{guid}"
#define SAMPLE_TIME @{sample_time}  /* s */
#define REALS @{reals}u
#define FIRST_OUTPUT @{first_output}u
#define FLAGS @{flags}u

typedef struct {
    @{controllers}
} controllers;

static const double start_values[REALS] = {@{starts}};
static const char *const labels[FLAGS] = {@{labels}};

static void prepare(controllers *all)
{
    @{prepare}
}

@{rules}
static void set_parameters(controllers *all, const double *value)
{
    @{parameters}
    (void)all;
    (void)value;
}

static const char *broken_rule(const controllers *all)  /* NULL: parameters are within their ranges */
{
    @{checks}
    (void)all;
    return NULL;
}

static void advance(controllers *all, double *value, int *flag)
{
    @{steps}
}
