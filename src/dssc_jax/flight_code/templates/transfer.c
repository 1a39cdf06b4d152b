unsigned @{name}_transfer(
    @{name}_controller *controller, @{name}_measurement measurement,
    @{name}_reference reference, @{real} command)
{
    if (!(@{arguments_valid})) {
        return 1u;
    }
    @{name}_state updated;
    @{name}_command computed;
    @{parameters}
@{computation}
    if (!(@{results_finite})) {
        return 2u;
    }
    controller->state = updated;
    controller->last = computed;
    controller->started = true;
    const @{real} size = @{fabs}(computed.u) + @{fabs}(computed.u_n) + @{fabs}(command);
    return @{fabs}(computed.u_p - command) <= @{tolerance} * size + @{smallest} ? 0u : 4u;
}
