"""The source of a study's controllers, in C99 that is C++ as well."""

import re
from collections.abc import Sequence

import numpy as np

from dssc_jax.flight_code.controller import COMMAND, SAMPLED_SIGNALS, Parameter, SampledController, Traced
from dssc_jax.flight_code.header_text import (
    INPUT_BROKEN,
    NOT_CARRIED,
    RESULT_BROKEN,
    STEP_ARGUMENTS,
    TRANSFER_ARGUMENTS,
    file_comment,
)
from dssc_jax.flight_code.names import identifier, prefix
from dssc_jax.lanes.c_operations import c_literal, c_type
from dssc_jax.lanes.c_text import CText
from dssc_jax.lanes.origins import Origin
from dssc_jax.lanes.program import Program, Value
from dssc_jax.study import Study


def source_text(study: Study, controllers: Sequence[SampledController], certificate: str) -> str:
    """The source: the functions of every channel."""
    real = controllers[0].real
    functions, helpers, tables, subroutines = [], {}, {}, {}
    for controller in controllers:
        written = [start_function(study, controller)] if controller.states else []
        written.append(step_function(study, controller))
        if controller.transfer is not None:
            written.append(bumpless_function(study, controller, controller.transfer))
        for _, text in written:
            helpers |= dict.fromkeys(text.notation.helpers())
            tables |= dict.fromkeys(text.tables)
            subroutines |= text.functions
        functions += [init_functions(study, controller), check_function(study, controller)]
        functions += [function for function, _ in written]
    kind, suffix = c_type(real), "F" if real.itemsize == 4 else ""
    largest = "FLT_MAX" if suffix else "DBL_MAX"
    finite = f"""static bool is_finite({kind} x)
{{
    return fabs{suffix.lower()}(x) <= {largest};
}}"""
    sample_time = f"static const {kind} T_s = {c_literal(real.type(study.loop.sample_time), real)};  /* s */"
    if not any("T_s" in function for function in functions):
        sample_time = ""
    parts = [
        file_comment(study, controllers, certificate),
        f'#include "{identifier(study.name)}_controller.h"\n\n'
        "#include <float.h>\n#include <math.h>\n#include <stddef.h>\n#include <stdint.h>",
        GUARDS,
        sample_time,
        *tables,
        *(helper for helper in helpers),
        *subroutines.values(),
        finite,
        *functions,
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


GUARDS = """#if defined(__FAST_MATH__) && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "fast arithmetic changes the controller: compile without -ffast-math"
#endif
#if FLT_EVAL_METHOD != 0 && !defined(DSSC_JAX_ANY_ARITHMETIC)
#error "numbers are kept with excess precision: on 32-bit x86 compile with -msse2 -mfpmath=sse"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif"""


def init_functions(study: Study, controller: SampledController) -> str:
    """``init`` and ``reset``."""
    name = prefix(study, controller)
    values = [
        f"    controller->parameters.{each.name} = {c_literal(controller.real.type(each.value), controller.real)};"
        for each in controller.parameters
    ]
    states = [f"    controller->state.{state} = 0;" for state in controller.states or ("unused",)]
    held = [f"    controller->last.{member} = 0;" for member in COMMAND]
    values = values or ["    controller->parameters.unused = 0;"]
    return "\n".join(
        [
            f"void {name}_init({name}_controller *controller)", "{", *values, *held,
            f"    {name}_reset(controller);", "}", "",
            f"void {name}_reset({name}_controller *controller)", "{", *states, "    controller->started = false;", "}",
        ]
    )  # fmt: skip


def conditions(parameter: Parameter, controller: SampledController) -> list[str]:
    """What must hold of a parameter; NaN holds of nothing."""
    member = f"parameters->{parameter.name}"
    quantity = parameter.quantity
    rules = [f"is_finite({member})"]
    if quantity is None:
        return rules
    for sign, bound in (
        (">", quantity.above),
        (">=", quantity.at_least),
        ("<", quantity.below),
        ("<=", quantity.at_most),
    ):
        if bound is not None:
            rules.append(f"{member} {sign} {c_literal(controller.real.type(bound), controller.real)}")
    return rules


def check_function(study: Study, controller: SampledController) -> str:
    """``check``: the number of the first parameter outside of its range."""
    name = prefix(study, controller)
    lines = [f"unsigned {name}_check(const {name}_parameters *parameters)", "{"]
    for number, parameter in enumerate(controller.parameters, start=1):
        lines += [
            f"    if (!({' && '.join(conditions(parameter, controller))})) {{",
            f"        return {number}u;",
            "    }",
        ]
    if not controller.parameters:
        lines.append("    (void)parameters;")
    return "\n".join([*lines, "    return 0;", "}"])


def emitter_of(
    controller: SampledController, program: Program, origins: dict[int, Origin], inputs: list[str], sample_time: float
) -> CText:
    """The emitter of a function of the controller."""
    taken = {
        "controller",
        "measurement",
        "reference",
        "command",
        "telemetry",
        "parameters",
        "p",
        "before",
        "state",
        "updated",
        "computed",
        "size",
        "T_s",
    }
    constants = {} if sample_time in (0.5, 1.0, 2.0) else {float(controller.real.type(sample_time)): "T_s"}
    return CText(program, origins, inputs, controller.real, taken, constants)


def ignored(names: Sequence[str], text: str) -> list[str]:
    """Statements that tell the compiler which arguments are not read."""
    return [f"    (void){name};" for name in names if not re.search(rf"\b{name}\b", text)]


def start_function(study: Study, controller: SampledController) -> tuple[str, CText]:
    """The state before the first step."""
    name = prefix(study, controller)
    inputs = [*(f"p->{each.name}" for each in controller.parameters), *SAMPLED_SIGNALS]
    traced = controller.start
    text = emitter_of(controller, traced.program, traced.origins, inputs, study.loop.sample_time)
    outputs = values_of(traced.program)
    text.compute(outputs)
    for state, output in zip(controller.states, outputs, strict=True):
        text.line(f"state->{state} = {text.read(output)};")
    body = "\n".join(text.lines)
    arguments = (
        f"const {name}_parameters *p, {name}_measurement measurement,\n"
        f"    {name}_reference reference, {name}_state *state"
    )
    unread = ignored(("p", "measurement", "reference"), body)
    head = [f"/* The state before the first step. */\nstatic void {name}_start({arguments})", "{", *unread]
    return "\n".join([*head, body, "}"]), text


def finite_condition(members: Sequence[str]) -> str:
    """The condition that numbers are finite."""
    return "\n        && ".join(f"is_finite({member})" for member in members)


def guard(members: Sequence[str], flag: int, held: bool) -> list[str]:
    """Leave a function with a flag if a number is not finite; with the last command, if it gives one."""
    lines = [f"    if (!({finite_condition(members)})) {{"]
    if held:
        lines.append("        *command = controller->last;")
    return [*lines, f"        return {flag}u;", "    }"]


def updated_states(controller: SampledController) -> list[str]:
    """The states after a function, before they are taken."""
    return [f"updated.{state}" for state in controller.states]


def step_function(study: Study, controller: SampledController) -> tuple[str, CText]:
    """One sample; what only telemetry needs is computed only for it. Nothing is kept unless all is finite."""
    name, traced = prefix(study, controller), controller.step
    inputs = [
        *(f"p->{each.name}" for each in controller.parameters),
        *(f"before.{state}" for state in controller.states),
        *SAMPLED_SIGNALS,
    ]
    text = emitter_of(controller, traced.program, traced.origins, inputs, study.loop.sample_time)
    outputs = values_of(traced.program)
    count = len(controller.states) + len(COMMAND)
    commands = [f"computed.{member}" for member in COMMAND]
    text.compute(outputs[:count])
    text.line("")
    for member, output in zip([*updated_states(controller), *commands], outputs, strict=False):
        text.line(f"{member} = {text.read(output)};")
    text.lines += guard([*commands, *updated_states(controller)], RESULT_BROKEN, held=True)
    if controller.states:
        text.line("controller->state = updated;")
    text.line("controller->last = computed;")
    text.line("controller->started = true;")
    text.line("*command = computed;")
    if controller.infos:
        text.line("if (telemetry != NULL) {")
        text.indented(1)
        text.compute(outputs[count:])
        for info, output in zip(controller.infos, outputs[count:], strict=True):
            text.line(f"telemetry->{info} = {text.read(output)};")
        text.indented(-1)
        text.line("}")
    else:
        text.line("(void)telemetry;")
    body = "\n".join(text.lines)
    head = [f"unsigned {name}_step({STEP_ARGUMENTS.format(name=name)})", "{"]
    head += guard(SAMPLED_SIGNALS, INPUT_BROKEN, held=True)
    local = [f"    {name}_command computed;"]
    if controller.states:
        local += [f"    {name}_state before = controller->state, updated;"]
        local += [
            "    if (!controller->started) {",
            f"        {name}_start(&controller->parameters, measurement, reference, &before);",
            "    }",
        ]
    if re.search(r"\bp->", body):
        local.append(f"    const {name}_parameters *const p = &controller->parameters;")
    return "\n".join([*head, *local, body, "    return 0;", "}"]), text


def bumpless_function(study: Study, controller: SampledController, traced: Traced) -> tuple[str, CText]:
    """The state that carries a command."""
    name, kind = prefix(study, controller), c_type(controller.real)
    inputs = [*(f"p->{parameter.name}" for parameter in controller.parameters), "command", *SAMPLED_SIGNALS]
    text = emitter_of(controller, traced.program, traced.origins, inputs, study.loop.sample_time)
    outputs = values_of(traced.program)
    commands = [f"computed.{member}" for member in COMMAND]
    text.compute(outputs)
    text.line("")
    for member, output in zip([*updated_states(controller), *commands], outputs, strict=True):
        text.line(f"{member} = {text.read(output)};")
    text.lines += guard([*updated_states(controller), *commands], RESULT_BROKEN, held=False)
    size = "fabsf" if controller.real.itemsize == 4 else "fabs"
    tolerance = c_literal(controller.real.type(np.sqrt(np.finfo(controller.real).eps)), controller.real)
    text.line("controller->state = updated;")
    text.line("controller->last = computed;")
    text.line("controller->started = true;")
    text.line(f"const {kind} size = {size}(computed.u) + {size}(computed.u_n) + {size}(command);")
    text.line(f"return {size}(computed.u_p - command) <= {tolerance} * size ? 0u : {NOT_CARRIED}u;")
    body = "\n".join(text.lines)
    head = [f"unsigned {name}_transfer({TRANSFER_ARGUMENTS.format(name=name, kind=kind)})", "{"]
    head += guard([*SAMPLED_SIGNALS, "command"], INPUT_BROKEN, held=False)
    local = [f"    {name}_state updated;", f"    {name}_command computed;"]
    if re.search(r"\bp->", body):
        local.append(f"    const {name}_parameters *const p = &controller->parameters;")
    return "\n".join([*head, *local, body, "}"]), text


def values_of(program: Program) -> list[Value]:
    """The results of a program without recorded arrays."""
    return [output for output in program.outputs if isinstance(output, Value)]
