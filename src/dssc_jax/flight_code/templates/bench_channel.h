static @{name}_controller controller_of_@{name};

static void prepare_@{name}(const real *given)
{
    @{name}_init(&controller_of_@{name});
    if (given != NULL) {
        @{parameters}
    }
}

static unsigned advance_@{name}(const real *row, real *results, bool telemetry)
{
    const @{name}_measurement measurement = {@{measurement}};
    const @{name}_reference reference = {@{reference}};
    @{name}_command command;
    @{name}_telemetry seen = {0};
    @{name}_controller *const controller = &controller_of_@{name};
    const unsigned flag = @{name}_step(controller, measurement, reference, &command, telemetry ? &seen : NULL);
    @{results}
    return flag;
}
