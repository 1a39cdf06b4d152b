/* A controller of your own for dssc-jax: fill in what step does, and the parameters that it needs.
 *
 *   dssc-jax library my_controller.c        builds my_controller.so and shows what it exports
 *
 * and in the study:   [controller]
 *                     kind = "library"
 *                     file = "my_controller.so"
 *                     k_p = { uniform = [2.0, 4.0] }      a parameter: a number or a law
 *
 * Rules. Whatever the controller remembers stands in my_state: thousands of controllers run at the same time, on
 * several threads, so a static or global variable mixes their flights (dssc-jax library tries that). A step depends on
 * nothing but its arguments: no clock, no file, no random generator. SI units and radians. The sample time is a
 * constant; a study with another loop.sample_time is refused.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>

typedef double real; /* or float */

#define T_S 0.01 /* sample time [s] */

typedef struct {
    real k_p;
    real k_d;
    real limit;
} my_parameters;

typedef struct {
    real y;     /* the plant's output as the sensor shows it */
    real y_dot; /* its derivative */
} my_measurement;

typedef struct {
    real y; /* the reference, with its derivatives */
    real y_dot;
    real y_ddot;
} my_reference;

typedef struct {
    real u;   /* robust part of the command, or all of it */
    real u_n; /* nominal part */
    real u_p; /* their sum, which the plant gets */
} my_command;

typedef struct {
    real filtered; /* what the controller remembers */
} my_state;

typedef struct {
    real error; /* what you want to see in trajectories and metrics */
} my_telemetry;

typedef struct {
    my_parameters parameters; /* set by dssc-jax after init and before reset */
    my_state state;
    bool started;
} my_controller;

/* Default parameters. */
void my_init(my_controller *controller)
{
    controller->parameters.k_p = 4;
    controller->parameters.k_d = 3;
    controller->parameters.limit = 10;
}

/* Forget the state; compute what follows from parameters, if you keep such numbers. */
void my_reset(my_controller *controller)
{
    controller->state.filtered = 0;
    controller->started = false;
}

/* One sample. Returns 0, or a number of your own that tells why the command is not the usual one. */
unsigned my_step(my_controller *controller, my_measurement measurement, my_reference reference, my_command *command,
                 my_telemetry *telemetry)
{
    const my_parameters *const p = &controller->parameters;
    my_state *const state = &controller->state;
    const real error = reference.y - measurement.y;
    if (!controller->started) {
        state->filtered = measurement.y_dot;
        controller->started = true;
    }
    state->filtered += (real)(T_S / (T_S + 0.02)) * (measurement.y_dot - state->filtered);
    command->u = fmin(fmax(p->k_p * error + p->k_d * (reference.y_dot - state->filtered), -p->limit), p->limit);
    command->u_n = 0;
    command->u_p = command->u + command->u_n;
    if (telemetry != NULL) {
        telemetry->error = error;
    }
    return 0;
}

#ifdef DSSC_JAX_LIBRARY
#define DSSC_JAX_OPTIONAL_TELEMETRY /* step takes NULL for telemetry; without this line it never gets NULL */
#include "dssc_jax_library.h"
DSSC_JAX_EXCHANGE(my)
static const dssc_jax_number my_parameter_table[] = {
    DSSC_JAX_PARAMETER(my, k_p, "u/y", "proportional gain", 0, INFINITY),
    DSSC_JAX_PARAMETER(my, k_d, "u s/y", "derivative gain", 0, INFINITY),
    DSSC_JAX_PARAMETER(my, limit, "u", "limit of the command", 0, INFINITY),
};
static const dssc_jax_number my_telemetry_table[] = {
    DSSC_JAX_TELEMETRY(my, error, "y", "error that the controller sees"),
};
DSSC_JAX_CONTROLLER(my, T_S, my_parameter_table, DSSC_JAX_COUNT(my_parameter_table), my_telemetry_table,
                    DSSC_JAX_COUNT(my_telemetry_table));
DSSC_JAX_LIBRARY_OF(&my_description);
#endif
