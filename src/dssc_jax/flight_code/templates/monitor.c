@{definitions}
void @{name}_init(@{name} *monitor)
{
    monitor->current = 0;
    monitor->latched = 0;
    monitor->sample = 0;
    for (unsigned flag = 0; flag < @{flag_count}; flag++) {
        monitor->first[flag] = -1;
    }
    @{begin}
}

uint32_t @{name}_step(@{name} *monitor, const @{name}_sample *seen)
{
    const @{name} before = *monitor;
@{computation}
    return monitor->current;
}
