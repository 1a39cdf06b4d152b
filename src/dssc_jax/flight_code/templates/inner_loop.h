/* What it measures: velocity [m/s] and attitude (a unit quaternion, body to inertial) in an inertial frame with z up,
 * and the body rate [rad/s] along axes that point forward, left and up. */
typedef struct {
    @{readings}
} @{name}_readings;

/* The commands of the controllers: velocities [m/s] and the rate of yaw [rad/s]. */
typedef struct {
    @{commands}
} @{name}_commands;

/* Its state, with what it commands: rotor_i are the thrusts [N], from 0 to their limit; thrust is the net thrust that the
 * control asks for [N], and limited is 1 where a rotor is at a limit. The members software_.. are for the functions alone. */
typedef struct {
    @{held}
} @{name};

/* In hover, with the filters at these readings and all integrals at 0, to which velocity_integral of the study adds: before
 * each take-off, and again where it takes over in flight, directly before a sample. There, what the integrals would have
 * held, such as the command against a steady wind, has to build up first: a settled start is for simulations alone, which
 * know the wind and the mass. Returns 0; 1: a reading is not finite, or the length of the quaternion deviates from 1 by
 * more than @{length_error} %; 2: the state would not be finite. */
unsigned @{name}_init(@{name} *inner_loop, const @{name}_readings *seen);

/* At each sample of the controllers, before the first of @{ticks} ticks. Finite commands are limited, not refused.
 * Returns 0; or 1 or 2, and keeps the state: rotors stay at their last thrusts, so act on a flag that lasts. */
unsigned @{name}_sample(@{name} *inner_loop, const @{name}_readings *seen, const @{name}_commands *wanted);

/* One tick: the commands of the rotors. Returns 0; or 1 or 2, and keeps the state. */
unsigned @{name}_tick(@{name} *inner_loop, const @{name}_readings *seen);
