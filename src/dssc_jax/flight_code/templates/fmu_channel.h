{
    const @{name}_measurement measurement = {@{measurement}};
    const @{name}_reference reference = {@{reference}};
    @{name}_command command;
    @{name}_telemetry telemetry = {0};
    @{flag} = (int)@{name}_step(&all->@{name}, measurement, reference, &command, &telemetry);
    @{results}
}
