/* What drives the actuators while another software flies: the thrusts of the rotors [N]. */
typedef struct {
    @{driven}
} @{name}_driven;

/* A bumpless takeover in flight, directly before a sample: the integrals hold the present attitude, thrust and moments, so
 * in steady flight at the commanded velocity, within its limits, the rotors go on as before. Keeps the parameters. Returns
 * 0; 1: an argument is not valid, as for start; 2: the state would not be finite. With 1 or 2 nothing changes. 4: its limits
 * do not let it go on, as with a tilt beyond its largest, or the vehicle turns, which it takes for an error: the state comes
 * as near as it can, and the thrusts may jump. */
unsigned @{name}_transfer(
    @{name} *inner_loop, const @{name}_readings *seen, const @{name}_driven *driven);
