@{is_finite}

@{definitions}
static bool are_readings_valid(const @{name}_readings *seen)
{
    return @{readings_valid};
}

static unsigned keep(@{name} *inner_loop, const @{name} *kept)
{
    const @{name} updated = *kept;
    if (!(@{held_finite})) {
        return 2u;
    }
    *inner_loop = updated;
    return 0u;
}

void @{name}_init(@{name} *inner_loop)
{
    @{parameters}
    @{cleared}
    inner_loop->started = false;
}

unsigned @{name}_check(const @{name}_parameters *parameters)
{
    @{checks}
    return 0;
}

unsigned @{name}_start(@{name} *inner_loop, const @{name}_readings *seen)
{
    @{name} updated = *inner_loop;
    if (!are_readings_valid(seen)) {
        return 1u;
    }
@{start}
    updated.started = true;
    return keep(inner_loop, &updated);
}

@{transfer}
unsigned @{name}_sample(
    @{name} *inner_loop, const @{name}_readings *seen, const @{name}_commands *wanted)
{
    const @{name} held = *inner_loop;
    @{name} updated = held;
    if (!held.started) {
        return 3u;
    }
    if (!are_readings_valid(seen) || !(@{commands_finite})) {
        return 1u;
    }
@{sample}
    return keep(inner_loop, &updated);
}

unsigned @{name}_tick(@{name} *inner_loop, const @{name}_readings *seen)
{
    const @{name} held = *inner_loop;
    @{name} updated = held;
    if (!held.started) {
        return 3u;
    }
    if (!are_readings_valid(seen)) {
        return 1u;
    }
@{tick}
    return keep(inner_loop, &updated);
}
