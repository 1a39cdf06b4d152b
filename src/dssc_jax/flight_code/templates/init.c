void @{name}_init(@{name}_controller *controller)
{
    @{parameters}
    controller->last.u = 0;
    controller->last.u_n = 0;
    controller->last.u_p = 0;
    @{name}_reset(controller);
}

void @{name}_reset(@{name}_controller *controller)
{
    @{states}
    controller->started = false;
}

unsigned @{name}_check(const @{name}_parameters *parameters)
{
    @{checks}
    return 0;
}
