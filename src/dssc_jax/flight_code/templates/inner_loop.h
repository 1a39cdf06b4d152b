/* Its gains, and what it takes the vehicle for. */
typedef struct {
    @{parameters}
} @{name}_parameters;

/* What it measures: velocity [m/s] and attitude (a unit quaternion, body to inertial) in an inertial frame with z up,
 * and the body rate [rad/s] along axes that point forward, left and up. */
typedef struct {
    @{readings}
} @{name}_readings;

/* The commands of the controllers: velocities [m/s] and the rate of yaw [rad/s]. */
typedef struct {
    @{commands}
} @{name}_commands;

/* Its parameters and its state, with what it commands: rotor_i are the thrusts [N], from 0 to their limit; thrust is the net
 * thrust that the control asks for [N], and limited is 1 where a rotor is at a limit. The members software_.. are for the
 * functions alone. */
typedef struct {
    @{name}_parameters parameters;  /* may be changed between two ticks */
    @{held}
    bool started;
} @{name};

/* The study's parameters, and no state: before the first sample, start it or let it take over. */
void @{name}_init(@{name} *inner_loop);

/* Check changed parameters. Returns 0, or the number of the first one that is not finite or outside of its range: the
 * number in the comments of @{name}_parameters. */
unsigned @{name}_check(const @{name}_parameters *parameters);

/* In hover, with the filters at these readings and all integrals at 0, to which velocity_integral of the study adds: before
 * each take-off, directly before a sample. Keeps the parameters. A settled start is for simulations alone, which know the
 * wind and the mass. Returns 0; 1: a reading is not finite, or the length of the quaternion deviates from 1 by more than
 * @{length_error} %; 2: the state would not be finite. */
unsigned @{name}_start(@{name} *inner_loop, const @{name}_readings *seen);

@{transfer}

/* At each sample of the controllers, before the first of @{ticks} ticks. Finite commands are limited, not refused.
 * Returns 0; or 1, 2 or 3, and keeps the state: rotors stay at their last thrusts, so act on a flag that lasts.
 * 3: it was neither started nor has it taken over. */
unsigned @{name}_sample(
    @{name} *inner_loop, const @{name}_readings *seen, const @{name}_commands *wanted);

/* One tick: the commands of the rotors. Returns 0; or 1, 2 or 3, and keeps the state. */
unsigned @{name}_tick(@{name} *inner_loop, const @{name}_readings *seen);
