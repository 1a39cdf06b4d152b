/* dssc_jax_library.h: how a controller in C describes itself to dssc-jax.
 *
 * A controller NAME has the types NAME_parameters, NAME_measurement, NAME_reference, NAME_command, NAME_telemetry and
 * NAME_controller (which contains its parameters), and the functions NAME_init, NAME_reset and NAME_step: those of the
 * headers that `dssc-jax code` writes. `dssc-jax library --template FILE` writes an example.
 *
 * `dssc-jax library` compiles with -DDSSC_JAX_LIBRARY. Without it, a file that includes this header only within
 * #ifdef DSSC_JAX_LIBRARY needs neither the header nor dssc-jax.
 */
#ifndef DSSC_JAX_LIBRARY_H
#define DSSC_JAX_LIBRARY_H

#include <math.h>
#include <stddef.h>

#define DSSC_JAX_LIBRARY_VERSION 4u

/* Define this before the header is included if every NAME_step of the file takes NULL for its telemetry, and then computes
 * none. Flights that show no telemetry are faster by its cost.
 */
#ifdef DSSC_JAX_OPTIONAL_TELEMETRY
#define DSSC_JAX_WITHOUT_TELEMETRY(STEP) STEP
#else
#define DSSC_JAX_WITHOUT_TELEMETRY(STEP) NULL
#endif

typedef struct {
    const char *name;
    const char *unit; /* SI; y and u for those of the plant's output and command */
    const char *meaning;
    size_t offset; /* in the exchange */
    size_t size;
    double low; /* admissible values, ends included; -INFINITY and INFINITY: no limit */
    double high;
} dssc_jax_number;

typedef struct {
    unsigned version;
    const char *name;
    double sample_time; /* [s], a constant of the code */
    size_t real;        /* bytes of a number: 4 or 8 */
    size_t controller;  /* bytes of NAME_controller, with which the exchange begins */
    size_t exchange;    /* bytes of the whole exchange */
    size_t measurement; /* bytes of NAME_measurement: of y, y_dot and the measured signals of the table, of nothing else */
    size_t signals[5];  /* offsets of the measurement's y, y_dot and the reference's y, y_dot, y_ddot */
    size_t commands[2]; /* offsets of the command's u and u_n */
    size_t total;       /* offset of u_p, their sum */
    size_t flag;
    size_t parameter_count;
    const dssc_jax_number *parameters;
    size_t telemetry_count;
    const dssc_jax_number *telemetry;
    size_t measured_count;           /* measured signals beside y and y_dot */
    const dssc_jax_number *measured; /* by their names in a study */
    void (*init)(void *exchange);
    void (*reset)(void *exchange);
    void (*step)(void *exchange);
    void (*step_without_telemetry)(void *exchange); /* the same with NULL for the telemetry; NULL: the code takes none */
} dssc_jax_controller;

/* A row of the table of parameters. */
#define DSSC_JAX_PARAMETER(NAME, FIELD, UNIT, MEANING, LOW, HIGH)                                        \
    {                                                                                                    \
        #FIELD, UNIT, MEANING, offsetof(NAME##_exchange, controller.parameters.FIELD),                   \
            sizeof(((NAME##_parameters *)0)->FIELD), LOW, HIGH                                           \
    }

/* A row of the table of telemetry. */
#define DSSC_JAX_TELEMETRY(NAME, FIELD, UNIT, MEANING)                                                   \
    {                                                                                                    \
        #FIELD, UNIT, MEANING, offsetof(NAME##_exchange, telemetry.FIELD),                               \
            sizeof(((NAME##_telemetry *)0)->FIELD), -INFINITY, INFINITY                                  \
    }

/* A row of the table of measured signals: the member of the measurement, and the signal's name in a study. */
#define DSSC_JAX_MEASURED(NAME, FIELD, SIGNAL, UNIT, MEANING)                                            \
    {                                                                                                    \
        SIGNAL, UNIT, MEANING, offsetof(NAME##_exchange, measurement.FIELD),                             \
            sizeof(((NAME##_measurement *)0)->FIELD), -INFINITY, INFINITY                                \
    }

/* What a call exchanges: all that a controller keeps, gets and gives. */
#define DSSC_JAX_EXCHANGE(NAME)                                                                          \
    typedef struct {                                                                                     \
        NAME##_controller controller;                                                                    \
        NAME##_measurement measurement;                                                                  \
        NAME##_reference reference;                                                                      \
        NAME##_command command;                                                                          \
        NAME##_telemetry telemetry;                                                                      \
        unsigned flag;                                                                                   \
    } NAME##_exchange;                                                                                   \
    static void NAME##_init_exchange(void *exchange)                                                     \
    {                                                                                                    \
        NAME##_init(&((NAME##_exchange *)exchange)->controller);                                         \
    }                                                                                                    \
    static void NAME##_reset_exchange(void *exchange)                                                    \
    {                                                                                                    \
        NAME##_reset(&((NAME##_exchange *)exchange)->controller);                                        \
    }                                                                                                    \
    static void NAME##_step_exchange(void *exchange)                                                     \
    {                                                                                                    \
        NAME##_exchange *const x = (NAME##_exchange *)exchange;                                          \
        x->flag = NAME##_step(&x->controller, x->measurement, x->reference, &x->command, &x->telemetry); \
    }                                                                                                    \
    static inline void NAME##_step_without_telemetry(void *exchange)                                     \
    {                                                                                                    \
        NAME##_exchange *const x = (NAME##_exchange *)exchange;                                          \
        x->flag = NAME##_step(&x->controller, x->measurement, x->reference, &x->command, NULL);          \
    }

/* The description of a controller: its sample time, and its tables (arrays of dssc_jax_number; NULL, 0: none). */
#define DSSC_JAX_CONTROLLER(NAME, SAMPLE_TIME, PARAMETERS, PARAMETER_COUNT, TELEMETRY, TELEMETRY_COUNT)  \
    DSSC_JAX_CONTROLLER_OF_SIGNALS(NAME, SAMPLE_TIME, PARAMETERS, PARAMETER_COUNT, TELEMETRY,            \
                                   TELEMETRY_COUNT, NULL, 0)

/* The same of a controller that takes measured signals beside y and y_dot. */
#define DSSC_JAX_CONTROLLER_OF_SIGNALS(NAME, SAMPLE_TIME, PARAMETERS, PARAMETER_COUNT, TELEMETRY,        \
                                       TELEMETRY_COUNT, MEASURED, MEASURED_COUNT)                        \
    static const dssc_jax_controller NAME##_description = {                                              \
        DSSC_JAX_LIBRARY_VERSION, #NAME, SAMPLE_TIME,                                                    \
        sizeof(((NAME##_command *)0)->u), sizeof(NAME##_controller), sizeof(NAME##_exchange),            \
        sizeof(NAME##_measurement),                                                                      \
        {offsetof(NAME##_exchange, measurement.y), offsetof(NAME##_exchange, measurement.y_dot),         \
         offsetof(NAME##_exchange, reference.y), offsetof(NAME##_exchange, reference.y_dot),             \
         offsetof(NAME##_exchange, reference.y_ddot)},                                                   \
        {offsetof(NAME##_exchange, command.u), offsetof(NAME##_exchange, command.u_n)},                  \
        offsetof(NAME##_exchange, command.u_p),                                                          \
        offsetof(NAME##_exchange, flag), PARAMETER_COUNT, PARAMETERS, TELEMETRY_COUNT, TELEMETRY,        \
        MEASURED_COUNT, MEASURED,                                                                        \
        NAME##_init_exchange, NAME##_reset_exchange, NAME##_step_exchange,                               \
        DSSC_JAX_WITHOUT_TELEMETRY(NAME##_step_without_telemetry)}

#define DSSC_JAX_COUNT(TABLE) (sizeof(TABLE) / sizeof((TABLE)[0]))

#if defined(__GNUC__)
#define DSSC_JAX_EXPORT __attribute__((visibility("default")))
#else
#define DSSC_JAX_EXPORT
#endif

/* The one symbol of a library: addresses of its controllers' descriptions, and NULL. */
#define DSSC_JAX_LIBRARY_OF(...)                                                                         \
    extern const dssc_jax_controller *const dssc_jax_controllers[];                                      \
    DSSC_JAX_EXPORT const dssc_jax_controller *const dssc_jax_controllers[] = {__VA_ARGS__, NULL}

#endif
