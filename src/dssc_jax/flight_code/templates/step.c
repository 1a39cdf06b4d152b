unsigned @{name}_step(
    @{name}_controller *controller, @{name}_measurement measurement,
    @{name}_reference reference, @{name}_command *command, @{name}_telemetry *telemetry)
{
    if (!(@{signals_valid})) {
        *command = controller->last;
        return 1u;
    }
    @{name}_command computed;
    @{state_before}
    @{parameters}
@{computation}
    if (!(@{results_finite})) {
        *command = controller->last;
        return 2u;
    }
    @{state_after}
    controller->last = computed;
    controller->started = true;
    *command = computed;
@{telemetry}
    return 0;
}
