unsigned @{name}_transfer(
    @{name} *inner_loop, const @{name}_readings *seen, const @{name}_driven *driven)
{
    @{name} updated = *inner_loop;
    if (!are_readings_valid(seen) || !(@{driven_finite})) {
        return 1u;
    }
@{transfer}
    return keep(inner_loop, &updated);
}

