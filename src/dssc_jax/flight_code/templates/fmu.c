/* A sampled controller as an FMU for co-simulation, FMI 2.0. The controller itself is in the generated source beside
 * this file; here is only what a simulator calls. fmu_variables.h tells which variable is which.
 *
 * The types below are those of the standard's binary interface (FMI 2.0.4, section 2.1.2 and the following), declared
 * here because a simulator links by names and types, not by headers.
 *
 * doStep(t, T_s) reads the inputs, which are the samples at t, and computes the command that holds from t to t + T_s.
 * So the controller is stepped before the plant, and its command is the plant's input in the same step. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_variables.h"

typedef unsigned int reference;
typedef int boolean;
typedef enum { OK, WARNING, DISCARD, FAILED, FATAL, PENDING } status;
typedef enum { MODEL_EXCHANGE, CO_SIMULATION } kind;
typedef void (*log_function)(void *environment, const char *name, status, const char *category, const char *message, ...);

typedef struct {
    log_function log;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*step_finished)(void *environment, status);
    void *environment;
} callbacks;

typedef enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED, BROKEN } phase;

/* All that changes: saved and restored as a whole. */
typedef struct {
    controllers all;
    double value[REALS];
    int flag[FLAGS];
    double last;  /* communication point of the last step, s */
    bool stepped;
    phase at;
} state;

typedef struct {
    state now;
    const callbacks *given;
    char *name;
} instance;

#ifndef FMI2_FUNCTION_PREFIX
#define EXPORTED(name) name
#else
#define JOINED(prefix, name) prefix##name
#define EXPANDED(prefix, name) JOINED(prefix, name)
#define EXPORTED(name) EXPANDED(FMI2_FUNCTION_PREFIX, name)
#endif

#if defined(_WIN32)
#define PUBLIC(type, name) __declspec(dllexport) type EXPORTED(name)
#elif defined(__GNUC__)
#define PUBLIC(type, name) __attribute__((visibility("default"))) type EXPORTED(name)
#else
#define PUBLIC(type, name) type EXPORTED(name)
#endif

/* Gives a message to the simulator, and returns its status. A message has no % and no number sign, which the
 * simulator would expand. */
static status said(const callbacks *given, const char *name, status how, const char *message)
{
    if (given != NULL && given->log != NULL) {
        given->log(given->environment, name, how, how == WARNING ? "logStatusWarning" : "logStatusError", message);
    }
    return how;
}

static status wrong(const instance *one, const char *message)
{
    return said(one->given, one->name, FAILED, message);
}

static void restart(state *now)
{
    memset(now, 0, sizeof *now);
    memcpy(now->value, start_values, sizeof now->value);
    prepare(&now->all);
    now->at = INSTANTIATED;
}

PUBLIC(const char *, fmi2GetTypesPlatform)(void)
{
    return "default";
}

PUBLIC(const char *, fmi2GetVersion)(void)
{
    return "2.0";
}

PUBLIC(void *, fmi2Instantiate)(const char *name, kind wanted, const char *guid, const char *resources,
                               const callbacks *given, boolean visible, boolean logging)
{
    (void)resources;
    (void)visible;
    (void)logging;
    if (name == NULL || name[0] == 0) {
        said(given, "", FAILED, "the instance has no name");
        return NULL;
    }
    if (wanted != CO_SIMULATION) {
        said(given, name, FAILED, "a sampled controller is an FMU for co-simulation, not for model exchange");
        return NULL;
    }
    if (guid == NULL || strcmp(guid, GUID) != 0) {
        said(given, name, FAILED, "the GUID is another than that of modelDescription.xml: generate the FMU again");
        return NULL;
    }
    instance *one = calloc(1, sizeof *one);
    const size_t length = strlen(name) + 1;
    if (one == NULL || (one->name = malloc(length)) == NULL) {
        free(one);
        said(given, name, FAILED, "no memory");
        return NULL;
    }
    memcpy(one->name, name, length);
    one->given = given;
    restart(&one->now);
    return one;
}

PUBLIC(void, fmi2FreeInstance)(void *component)
{
    instance *one = component;
    if (one != NULL) {
        free(one->name);
        free(one);
    }
}

PUBLIC(status, fmi2SetDebugLogging)(void *component, boolean on, size_t count, const char *const categories[])
{
    (void)component;
    (void)on;
    (void)count;
    (void)categories;
    return OK;  /* there are only warnings and errors */
}

PUBLIC(status, fmi2SetupExperiment)(void *component, boolean bounded, double tolerance, double start, boolean ends,
                                   double stop)
{
    (void)bounded;
    (void)tolerance;
    (void)start;
    (void)ends;
    (void)stop;
    const instance *one = component;
    return one->now.at == INSTANTIATED ? OK : wrong(one, "setupExperiment comes before the initialization");
}

PUBLIC(status, fmi2EnterInitializationMode)(void *component)
{
    instance *one = component;
    if (one->now.at != INSTANTIATED) {
        return wrong(one, "enterInitializationMode comes once, after instantiate or reset");
    }
    one->now.at = INITIALIZING;
    return OK;
}

PUBLIC(status, fmi2ExitInitializationMode)(void *component)
{
    instance *one = component;
    if (one->now.at != INITIALIZING) {
        return wrong(one, "exitInitializationMode comes after enterInitializationMode");
    }
    one->now.at = STEPPING;
    return OK;
}

PUBLIC(status, fmi2Terminate)(void *component)
{
    instance *one = component;
    if (one->now.at != STEPPING && one->now.at != BROKEN) {
        return wrong(one, "terminate comes after the initialization, and once");
    }
    one->now.at = TERMINATED;
    return OK;
}

PUBLIC(status, fmi2Reset)(void *component)
{
    restart(&((instance *)component)->now);
    return OK;
}

PUBLIC(status, fmi2DoStep)(void *component, double at, double step, boolean final)
{
    (void)final;
    instance *one = component;
    state *now = &one->now;
    char text[200];
    if (now->at == BROKEN) {
        return wrong(one, "the controller has failed at the last sample: reset the FMU");
    }
    if (now->at != STEPPING) {
        return wrong(one, "doStep comes after the initialization, and before terminate");
    }
    if (!(fabs(step - SAMPLE_TIME) <= 1e-6 * SAMPLE_TIME)) {
        snprintf(text, sizeof text, "the communication step is %.9g s; the controller's sample time is %.9g s", step,
                 SAMPLE_TIME);
        return wrong(one, text);
    }
    if (now->stepped ? !(fabs(at - now->last - SAMPLE_TIME) <= 0.1 * SAMPLE_TIME) : !(fabs(at) <= 1e300)) {
        snprintf(text, sizeof text, "the step begins at %.9g s; the controller's next sample is at %.9g s", at,
                 now->stepped ? now->last + SAMPLE_TIME : 0.0);
        return wrong(one, text);
    }
    set_parameters(&now->all, now->value);
    const char *const rule = broken_rule(&now->all);
    if (rule != NULL) {
        return wrong(one, rule);
    }
    int before[FLAGS];
    memcpy(before, now->flag, sizeof before);
    advance(&now->all, now->value, now->flag);
    now->last = at;
    now->stepped = true;
    status worst = OK;
    for (size_t i = 0; i < FLAGS; ++i) {
        if ((now->flag[i] & 2) != 0) {
            snprintf(text, sizeof text, "%sthe command or the state would not be finite after the sample at %.9g s",
                     labels[i], at);
            now->at = BROKEN;
            worst = wrong(one, text);
        } else if (now->flag[i] != 0) {
            snprintf(text, sizeof text, "%sa measurement or reference is not finite at %.9g s: the command is held", labels[i], at);
            if (before[i] == 0) {
                said(one->given, one->name, WARNING, text);
            }
            worst = worst == OK ? WARNING : worst;
        }
    }
    return worst;
}

static status unknown(const instance *one, const char *type, reference which)
{
    char text[100];
    snprintf(text, sizeof text, "there is no %s variable with the value reference %u", type, which);
    return wrong(one, text);
}

PUBLIC(status, fmi2GetReal)(void *component, const reference which[], size_t count, double values[])
{
    const instance *one = component;
    for (size_t i = 0; i < count; ++i) {
        if (which[i] >= REALS) {
            return unknown(one, "real", which[i]);
        }
        values[i] = one->now.value[which[i]];
    }
    return OK;
}

PUBLIC(status, fmi2SetReal)(void *component, const reference which[], size_t count, const double values[])
{
    instance *one = component;
    for (size_t i = 0; i < count; ++i) {
        if (which[i] >= REALS) {
            return unknown(one, "real", which[i]);
        }
        if (which[i] >= FIRST_OUTPUT) {
            return wrong(one, "an output cannot be set");
        }
    }
    for (size_t i = 0; i < count; ++i) {
        one->now.value[which[i]] = values[i];
    }
    return OK;
}

PUBLIC(status, fmi2GetInteger)(void *component, const reference which[], size_t count, int values[])
{
    const instance *one = component;
    for (size_t i = 0; i < count; ++i) {
        if (which[i] >= FLAGS) {
            return unknown(one, "integer", which[i]);
        }
        values[i] = one->now.flag[which[i]];
    }
    return OK;
}

PUBLIC(status, fmi2SetInteger)(void *component, const reference which[], size_t count, const int values[])
{
    (void)which;
    (void)values;
    return count == 0 ? OK : wrong(component, "an output cannot be set");
}

PUBLIC(status, fmi2GetBoolean)(void *component, const reference which[], size_t count, boolean values[])
{
    (void)values;
    return count == 0 ? OK : unknown(component, "boolean", which[0]);
}

PUBLIC(status, fmi2SetBoolean)(void *component, const reference which[], size_t count, const boolean values[])
{
    (void)values;
    return count == 0 ? OK : unknown(component, "boolean", which[0]);
}

PUBLIC(status, fmi2GetString)(void *component, const reference which[], size_t count, const char *values[])
{
    (void)values;
    return count == 0 ? OK : unknown(component, "string", which[0]);
}

PUBLIC(status, fmi2SetString)(void *component, const reference which[], size_t count, const char *const values[])
{
    (void)values;
    return count == 0 ? OK : unknown(component, "string", which[0]);
}

PUBLIC(status, fmi2GetFMUstate)(void *component, void **kept)
{
    const instance *one = component;
    if (*kept == NULL && (*kept = malloc(sizeof(state))) == NULL) {
        return wrong(one, "no memory");
    }
    memcpy(*kept, &one->now, sizeof(state));
    return OK;
}

PUBLIC(status, fmi2SetFMUstate)(void *component, void *kept)
{
    instance *one = component;
    if (kept == NULL) {
        return wrong(one, "there is no saved state");
    }
    memcpy(&one->now, kept, sizeof(state));
    return OK;
}

PUBLIC(status, fmi2FreeFMUstate)(void *component, void **kept)
{
    (void)component;
    if (kept != NULL) {
        free(*kept);
        *kept = NULL;
    }
    return OK;
}

PUBLIC(status, fmi2SerializedFMUstateSize)(void *component, void *kept, size_t *size)
{
    (void)kept;
    (void)size;
    return wrong(component, "a saved state has no form outside of memory");
}

PUBLIC(status, fmi2SerializeFMUstate)(void *component, void *kept, char bytes[], size_t size)
{
    (void)kept;
    (void)bytes;
    (void)size;
    return wrong(component, "a saved state has no form outside of memory");
}

PUBLIC(status, fmi2DeSerializeFMUstate)(void *component, const char bytes[], size_t size, void **kept)
{
    (void)bytes;
    (void)size;
    (void)kept;
    return wrong(component, "a saved state has no form outside of memory");
}

PUBLIC(status, fmi2GetDirectionalDerivative)(void *component, const reference of[], size_t outputs,
                                            const reference by[], size_t inputs, const double seed[], double slope[])
{
    (void)of;
    (void)outputs;
    (void)by;
    (void)inputs;
    (void)seed;
    (void)slope;
    return wrong(component, "there are no directional derivatives");
}

PUBLIC(status, fmi2SetRealInputDerivatives)(void *component, const reference which[], size_t count, const int order[],
                                           const double values[])
{
    (void)which;
    (void)order;
    (void)values;
    return count == 0 ? OK : wrong(component, "inputs are samples and have no derivatives");
}

PUBLIC(status, fmi2GetRealOutputDerivatives)(void *component, const reference which[], size_t count,
                                            const int order[], double values[])
{
    (void)which;
    (void)order;
    (void)values;
    return count == 0 ? OK : wrong(component, "outputs are samples and have no derivatives");
}

PUBLIC(status, fmi2CancelStep)(void *component)
{
    return wrong(component, "a step is over when doStep returns");
}

PUBLIC(status, fmi2GetStatus)(void *component, int which, status *value)
{
    (void)component;
    (void)which;
    (void)value;
    return DISCARD;
}

PUBLIC(status, fmi2GetRealStatus)(void *component, int which, double *value)
{
    const instance *one = component;
    if (which != 2 || !one->now.stepped) {
        return DISCARD;
    }
    *value = one->now.last + SAMPLE_TIME;  /* end of the last successful step */
    return OK;
}

PUBLIC(status, fmi2GetIntegerStatus)(void *component, int which, int *value)
{
    (void)component;
    (void)which;
    (void)value;
    return DISCARD;
}

PUBLIC(status, fmi2GetBooleanStatus)(void *component, int which, boolean *value)
{
    if (which != 3) {
        return DISCARD;
    }
    *value = ((const instance *)component)->now.at == TERMINATED;
    return OK;
}

PUBLIC(status, fmi2GetStringStatus)(void *component, int which, const char **value)
{
    (void)component;
    (void)which;
    (void)value;
    return DISCARD;
}
