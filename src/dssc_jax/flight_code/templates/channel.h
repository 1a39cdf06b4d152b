typedef struct {
    @{parameters}
} @{name}_parameters;

typedef struct {
    @{measurement}
} @{name}_measurement;

typedef struct {
    @{reference}
} @{name}_reference;

typedef struct {
    @{command}
} @{name}_command;

typedef struct {
    @{state}
} @{name}_state;

typedef struct {
    @{telemetry}
} @{name}_telemetry;

typedef struct {
    @{name}_parameters parameters;  /* may be changed between two samples */
    @{name}_state state;
    @{name}_command last;  /* what is held while a flag is raised */
    bool started;
} @{name}_controller;

/* The study's parameters, and no state: the first step starts from its own sample. */
void @{name}_init(@{name}_controller *controller);

/* Forget the state; the next step starts anew. Keeps the parameters and the last command. */
void @{name}_reset(@{name}_controller *controller);

/* Check changed parameters. Returns 0, or the number of the first one that is not finite or outside of
 * its range: the number in the comments of @{name}_parameters. */
unsigned @{name}_check(const @{name}_parameters *parameters);

/* One sample. Telemetry may be NULL, which saves the work for it. Returns 0, or
 * 1: a measurement or reference is not finite,
 * 2: the command or the state would not be finite.
 * With a flag the state stays as it is, the last command is given again (0 before the first one), and
 * telemetry is not written.@{angle} */
unsigned @{name}_step(
    @{name}_controller *controller, @{name}_measurement measurement,
    @{name}_reference reference, @{name}_command *command, @{name}_telemetry *telemetry);

@{transfer}
