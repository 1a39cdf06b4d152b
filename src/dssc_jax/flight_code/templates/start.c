/* The state before the first step. */
static void @{name}_start(const @{name}_parameters *p, @{name}_measurement measurement,
    @{name}_reference reference, @{name}_state *state)
{
    @{unread}
@{computation}
}
