"""``bench_channels.h``: the controllers as functions of arrays, which the bench calls."""

from dssc_jax.flight_code.controller import COMMAND, FlightCode, SampledController
from dssc_jax.flight_code.header import LARGEST_ANGLE, is_angle
from dssc_jax.flight_code.recording import row_names
from dssc_jax.flight_code.template_files import fill
from dssc_jax.lanes.c.names import c_string


def channels_text(code: FlightCode) -> str:
    """The text of ``bench_channels.h``: functions and names of each channel, and the choice among channels."""
    controllers = code.controllers
    prepare: list[str] = []  # cases of four switch statements in C, which choose the function of a channel
    restart: list[str] = []
    check: list[str] = []
    advance: list[str] = []
    names: list[str] = []
    for position, controller in enumerate(controllers):
        name = controller.prefix
        names += name_tables(controller)
        case = f"case {position}:"
        prepare += [case, f"    prepare_{name}(given);", "    break;"]
        restart += [case, f"    {name}_reset(&controller_of_{name});", "    break;"]
        check += [case, f"    return {name}_check(&controller_of_{name}.parameters);"]
        advance += [case, f"    return advance_{name}(row, results, telemetry);"]
    return fill(
        "bench_channels.h",
        study=code.name,
        real=controllers[0].c_real,
        precision=str(code.precision),
        limits="FLT" if code.precision == 32 else "DBL",
        channels=str(len(controllers)),
        most_parameters=str(max(1, *(len(controller.parameters) for controller in controllers))),
        signals=str(len(controllers[0].signals)),
        most_results=str(max(len(row_names(controller)) for controller in controllers)),
        functions="\n\n".join(channel_functions(controller) for controller in controllers),
        names=names,
        shapes=[channel_shape(code, controller) for controller in controllers],
        prepare=prepare,
        restart=restart,
        check=check,
        advance=advance,
    )


def channel_functions(controller: SampledController) -> str:
    """The functions in C by which the bench calls the controller of one channel."""
    variable = f"controller_of_{controller.prefix}"
    members = [f"command.{member}" for member in COMMAND]
    members += [f"{variable}.state.{state}" for state in controller.states]
    results = [f"results[{position}] = {member};" for position, member in enumerate(members)]
    if controller.infos:
        results.append("if (telemetry) {")
        for position, info in enumerate(controller.infos, start=len(members)):
            results.append(f"    results[{position}] = seen.{info};")
        results.append("}")
    parameters = []
    for position, parameter in enumerate(controller.parameters):
        parameters.append(f"{variable}.parameters.{parameter.name} = given[{position}];")
    first_reference = len(controller.measured_signals)
    return fill(
        "bench_channel.h",
        name=controller.prefix,
        parameters=parameters,
        results=results,
        measurement=", ".join(f"row[{position}]" for position in range(first_reference)),
        reference=", ".join(f"row[{position}]" for position in range(first_reference, len(controller.signals))),
    )


def name_tables(controller: SampledController) -> list[str]:
    """The tables in C with the names of a channel's results and parameters; C has no empty tables."""
    parameters = [parameter.name for parameter in controller.parameters]
    tables = {"results": row_names(controller), "numbers": parameters or [""]}
    lines = []
    for table, names in tables.items():
        quoted = ", ".join(c_string(name) for name in names)
        lines.append(f"static const char *const {table}_of_{controller.prefix}[] = {{{quoted}}};")
    return lines


def channel_shape(code: FlightCode, controller: SampledController) -> str:
    """The row of a channel in the bench's table: its label, counts, signals whose size is checked, and names.

    The signals whose size is checked are the measured and the desired y, with the limit of angles or without one.

    Args:
        code: The controllers.
        controller: The controller of the channel.
    """
    name = controller.prefix
    label = c_string(f"{controller.channel}: " if controller.channel else "")
    counts = f"{len(controller.parameters)}u, {len(controller.states)}u, {len(row_names(controller))}u"
    positions = [position for position, signal in enumerate(controller.signals) if signal.endswith(".y")]
    largest = f"{LARGEST_ANGLE:g}" if is_angle(code.study, controller) else "HUGE_VAL"
    checked = f"{', '.join(f'{position}u' for position in positions)}, {largest}"
    return f"{{{label}, {counts}, {checked}, results_of_{name}, numbers_of_{name}}},"
