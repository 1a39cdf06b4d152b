/* A bumpless start: a state with which the next step, at the same sample, gives this command u_p.
 * Returns 0, or
 * 1: an argument is not finite; nothing is changed,
 * 2: the state would not be finite; nothing is changed,
 * 4: the controller cannot give this command (a limit, no integral action): its state comes as
 *    near as it can, and the first command differs by more than @{smallest} and rounding. */
unsigned @{name}_transfer(
    @{name}_controller *controller, @{name}_measurement measurement,
    @{name}_reference reference, @{real} command);
