unsigned @{name}_transfer(
    @{name} *inner_loop, const @{name}_readings *seen, const @{name}_driven *driven)
{
    @{name} updated = *inner_loop;
    if (!are_readings_valid(seen) || !(@{driven_finite})) {
        return 1u;
    }
@{transfer}
    updated.started = true;
    const unsigned flag = keep(inner_loop, &updated);
    return flag == 0u && carried == 0 ? 4u : flag;
}

