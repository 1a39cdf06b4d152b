"""The source of a study's controllers, in C99 that is C++ as well."""

import re
from collections.abc import Sequence

import numpy as np

from dssc_jax.flight_code.c_files import (
    absolute_value,
    finite_condition,
    finite_function,
    joined_definitions,
    source_file,
)
from dssc_jax.flight_code.controller import COMMAND, FlightCode, SampledController, TracedFunction
from dssc_jax.flight_code.header import LARGEST_ANGLE, file_comment, is_angle
from dssc_jax.flight_code.library import description_text
from dssc_jax.flight_code.parameters import assignment_lines, check_lines
from dssc_jax.flight_code.template_files import fill
from dssc_jax.lanes.c.operations import c_literal
from dssc_jax.lanes.c.text import CText
from dssc_jax.lanes.program import Value

LOCAL_NAMES = {
    *("controller", "measurement", "reference", "command", "telemetry", "parameters", "p", "before", "state"),
    *("updated", "computed", "size", "T_s"),
}
"""Names in the template files, which no computed variable may have."""

COMPUTED = [f"computed.{member}" for member in COMMAND]
"""C's names of the parts of a command that is computed, but not yet returned."""


class FunctionText(CText):
    """The text in C of one function of a controller.

    The statements of the body are collected first. ``text``, the whole function, is empty until it is complete.

    Args:
        code: The controllers of the study.
        controller: The controller.
        traced: The traced function.
        inputs: C's expressions of the function's inputs that come after the parameters and before the signals.
    """

    def __init__(
        self, code: FlightCode, controller: SampledController, traced: TracedFunction, inputs: Sequence[str] = ()
    ) -> None:
        """Begin without statements; the sample time is written as T_s, unless other constants may equal it."""
        sample_time = code.study.loop.sample_time
        # a constant 0.5 in the program may be a factor of a formula and not T_s
        is_common_number = sample_time in (0.5, 1.0, 2.0)
        constants = {} if is_common_number else {float(controller.real.type(sample_time)): "T_s"}
        parameters = [f"p->{parameter.name}" for parameter in controller.parameters]
        expressions = [*parameters, *inputs, *controller.signals]
        super().__init__(traced.program, traced.origins, expressions, controller.real, LOCAL_NAMES, constants)
        self.outputs = [output for output in traced.program.outputs if isinstance(output, Value)]
        self.text = ""

    def assign(self, members: Sequence[str], outputs: Sequence[Value]) -> None:
        """Write assignments of outputs to members of a structure.

        Args:
            members: C's expressions of the members.
            outputs: The output for each member.
        """
        for member, output in zip(members, outputs, strict=True):
            self.line(f"{member} = {self.read(output)};")

    def reads(self, name: str) -> bool:
        """Whether the body so far reads a member of the structure ``name``; comments do not count."""
        for line in self.lines:
            statement, _, _ = line.partition("/*")
            if re.search(rf"\b{name}(->|\.)", statement):
                return True
        return False


def source_text(code: FlightCode) -> str:
    """The source file with the functions of all channels.

    Definitions that several functions need, such as tables and helpers, are written once, before all functions.
    """
    functions: list[str] = []
    helpers: dict[str, None] = {}  # a dictionary keeps the order, and each definition once
    tables: dict[str, None] = {}
    subroutines: dict[str, str] = {}
    for controller in code.controllers:
        functions.append(init_functions(controller))
        for function in computing_functions(code, controller):
            functions.append(function.text)
            helpers |= dict.fromkeys(function.notation.helpers())
            tables |= dict.fromkeys(function.tables)
            subroutines |= function.functions
    definitions = [*tables, *helpers, *subroutines.values()]
    if any("T_s" in function for function in functions):
        definitions.insert(0, sample_time_definition(code))
    body = fill(
        "controller.c",
        definitions=joined_definitions(definitions),
        is_finite=finite_function(code.controllers[0].real),
        functions="\n".join(functions),
        description=description_text(code),
    )
    return source_file("controller", f"{code.name}_controller.h", file_comment(code), body)


def computing_functions(code: FlightCode, controller: SampledController) -> list[FunctionText]:
    """The functions of a controller that compute: start if it has states, step, and transfer if it has one."""
    functions = [step_function(code, controller)]
    if controller.states:
        functions.insert(0, start_function(code, controller))
    if controller.transfer is not None:
        functions.append(transfer_function(code, controller, controller.transfer))
    return functions


def sample_time_definition(code: FlightCode) -> str:
    """The definition in C of the constant T_s, which all channels share."""
    controller = code.controllers[0]  # the numbers of all channels have one type
    sample_time = c_literal(controller.real.type(code.study.loop.sample_time), controller.real)
    return f"static const {controller.c_real} T_s = {sample_time};  /* s */"


def init_functions(controller: SampledController) -> str:
    """The functions ``init``, ``reset`` and ``check`` of a controller in C."""
    return fill(
        "init.c",
        name=controller.prefix,
        parameters=assignment_lines("controller->parameters", controller.parameters, controller.real),
        states=[f"controller->state.{state} = 0;" for state in controller.states or ("unused",)],
        checks=check_lines(controller.parameters, controller.real),
    )


def parameter_pointer(controller: SampledController, function: FunctionText) -> str:
    """The declaration of p, the pointer to the parameters; empty if the function does not read it."""
    if not function.reads("p"):
        return ""
    return f"const {controller.prefix}_parameters *const p = &controller->parameters;"


def start_function(code: FlightCode, controller: SampledController) -> FunctionText:
    """The function in C that computes the state before the first step.

    Its arguments are parameters, measurement and reference; an argument that the function does not read is cast to
    void.
    """
    function = FunctionText(code, controller, controller.start)
    function.compute(function.outputs)
    function.assign([f"state->{state}" for state in controller.states], function.outputs)
    unused_arguments = [f"(void){name};" for name in ("p", "measurement", "reference") if not function.reads(name)]
    function.text = fill("start.c", name=controller.prefix, unread=unused_arguments, computation=function.lines)
    return function


def valid_signals(code: FlightCode, controller: SampledController) -> str:
    """The condition in C that all signals are finite, and angles not so large that a turn is below their resolution.

    Args:
        code: The controllers of the study.
        controller: The controller.
    """
    conditions = [finite_condition(controller.signals)]
    if is_angle(code.study, controller):
        limit = c_literal(controller.real.type(LARGEST_ANGLE), controller.real)
        fabs = absolute_value(controller.real)
        conditions += [f"{fabs}({name}) <= {limit}" for name in controller.signals if name.endswith(".y")]
    return "\n        && ".join(conditions)


def step_function(code: FlightCode, controller: SampledController) -> FunctionText:
    """The function in C for one sample.

    It computes telemetry only if the caller asks for it, and stores no result unless all are finite.

    Args:
        code: The controllers of the study.
        controller: The controller.
    """
    name = controller.prefix
    function = FunctionText(code, controller, controller.step, [f"before.{state}" for state in controller.states])
    updated_members = [f"updated.{state}" for state in controller.states]
    first_info = len(updated_members) + len(COMMAND)
    results = function.outputs[:first_info]
    infos = function.outputs[first_info:]
    function.compute(results)
    function.line("")
    function.assign([*updated_members, *COMPUTED], results)
    computation = list(function.lines)
    if infos:
        function.line("if (telemetry != NULL) {")
        function.indent(1)
        function.compute(infos)
        function.assign([f"telemetry->{info}" for info in controller.infos], infos)
        function.indent(-1)
        function.line("}")
    else:
        function.line("(void)telemetry;")
    state_before = [
        f"{name}_state before = controller->state, updated;",
        "if (!controller->started) {",
        f"    {name}_start(&controller->parameters, measurement, reference, &before);",
        "}",
    ]
    function.text = fill(
        "step.c",
        name=name,
        signals_valid=valid_signals(code, controller),
        state_before=state_before if updated_members else "",
        parameters=parameter_pointer(controller, function),
        computation=computation,
        results_finite=finite_condition([*COMPUTED, *updated_members]),
        state_after="controller->state = updated;" if updated_members else "",
        telemetry=function.lines[len(computation) :],
    )
    return function


def transfer_function(code: FlightCode, controller: SampledController, traced: TracedFunction) -> FunctionText:
    """The function in C for a bumpless start: it sets the state with which the first step gives a wanted command.

    It computes that step, too, and returns the flag 4 if the step gives another command.

    Args:
        code: The controllers of the study.
        controller: The controller.
        traced: The traced transfer.
    """
    function = FunctionText(code, controller, traced, ["command"])
    updated_members = [f"updated.{state}" for state in controller.states]
    function.compute(function.outputs)
    function.line("")
    function.assign([*updated_members, *COMPUTED], function.outputs)
    tolerance = controller.real.type(np.sqrt(np.finfo(controller.real).eps))
    function.text = fill(
        "transfer.c",
        name=controller.prefix,
        real=controller.c_real,
        arguments_valid=f"{valid_signals(code, controller)}\n        && {finite_condition(['command'])}",
        parameters=parameter_pointer(controller, function),
        computation=function.lines,
        results_finite=finite_condition([*updated_members, *COMPUTED]),
        fabs=absolute_value(controller.real),
        tolerance=c_literal(tolerance, controller.real),
        smallest=c_literal(controller.smallest_difference, controller.real),
    )
    return function
