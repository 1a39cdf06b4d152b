"""Rules of loops and branches: ``lax.while_loop``, ``lax.scan``, ``lax.cond`` and ``lax.switch``."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jax.extend.core import JaxprEqn

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import BOOL, Recording, Value
from dssc_jax.lanes.tracing import indexing
from dssc_jax.lanes.tracing.memory import Memory, move_to_memory
from dssc_jax.lanes.tracing.specification import any_value, array_type, rule
from dssc_jax.lanes.tracing.states import (
    assemble,
    components,
    flags_of_components,
    flatten,
    is_varying,
    refuse_recordings,
)
from dssc_jax.lanes.tracing.varying import is_key, parts_of_scan
from dssc_jax.lanes.unsupported import Unsupported

if TYPE_CHECKING:
    from dssc_jax.lanes.tracing.translate import Translator


def while_rule(translator: "Translator", equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """``lax.while_loop``: a loop that ends when no lane continues; a lane that has ended keeps its state.

    Raises:
        Unsupported: The loop carries an array in memory, and lanes may leave the loop at different times.
    """
    params = equation.params
    build = translator.build
    head = params["cond_jaxpr"]
    body = params["body_jaxpr"]
    first_body_constant = params["cond_nconsts"]
    first_state = first_body_constant + params["body_nconsts"]
    head_constants = operands[:first_body_constant]
    body_constants = operands[first_body_constant:first_state]
    initial_state = operands[first_state:]
    if translator.has_memory:
        initial_state = move_to_memory(build, initial_state, body.jaxpr, len(body_constants))
    operands_vary = [is_varying(value) for value in (*head_constants, *body_constants, *initial_state)]
    states_vary, lanes_differ = translator.varying_results.of_while(
        head.jaxpr, body.jaxpr, operands_vary, first_body_constant, first_state
    )
    if lanes_differ and any(isinstance(value, Memory) for value in initial_state):
        raise Unsupported("an array in memory in a loop that lanes leave at different times")
    enter = translator.run(head, [*head_constants, *initial_state])[0]
    scalars = flatten(initial_state, build)
    scalars_vary = flags_of_components(states_vary, initial_state, build)
    enters_always = enter.operation == "constant" and enter.detail
    guard = None if enters_always else build.add("any", enter)
    carried = list(scalars)
    if lanes_differ:  # the last state tells whether the lane still runs
        carried.append(enter)
        scalars_vary.append(True)
    loop = build.loop(carried, scalars_vary, guard)
    states = loop.states[: len(scalars)]
    next_state = translator.run(body, [*body_constants, *assemble(initial_state, states)])
    next_scalars = flatten(next_state, build)
    proceed = translator.run(head, [*head_constants, *next_state])[0]
    if lanes_differ:
        is_running = loop.states[-1]
        pairs = zip(next_scalars, states, strict=True)
        next_scalars = [build.add("select", is_running, new, old) for new, old in pairs]
        still_runs = build.add("and", is_running, proceed)
        next_scalars.append(still_runs)
        proceed = build.add("any", still_runs)
    results = build.end_loop(loop, next_scalars, proceed)
    return assemble(initial_state, results[: len(scalars)])


def scan_rule(translator: "Translator", equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """``lax.scan``: a loop of constant length over the rows of some arrays; the stacked outputs become recordings."""
    params = equation.params
    build = translator.build
    length = params["length"]
    body = params["jaxpr"]
    first_state, state_count = parts_of_scan(equation)
    first_row = first_state + state_count
    constants = operands[:first_state]
    initial_state = operands[first_state:first_row]
    tables = operands[first_row:]  # a turn gets one row of each
    refuse_recordings(tables)
    if translator.has_memory:
        initial_state = move_to_memory(build, initial_state, body.jaxpr, len(constants))
    recordings = recordings_of_scan(equation, state_count)
    if length == 0:
        return initial_state
    operands_vary = [is_varying(value) for value in (*constants, *initial_state, *tables)]
    states_vary = translator.varying_results.of_scan(body.jaxpr, operands_vary, first_state, first_row)
    scalars = flatten(initial_state, build)
    scalars_vary = flags_of_components(states_vary, initial_state, build)
    index_type = np.dtype(np.int32)
    # the number of the turn is the first state, and uniform
    loop = build.loop([build.constant(0, index_type), *scalars], [False, *scalars_vary], guard=None)
    turn, *states = loop.states
    row_index = build.add("sub", build.constant(length - 1, index_type), turn) if params["reverse"] else turn
    rows = [indexing.row(build, table, row_index) for table in tables]
    results = translator.run(body, [*constants, *assemble(initial_state, states), *rows])
    next_state = results[:state_count]
    for recording, value in zip(recordings, results[state_count:], strict=True):
        build.record(recording, turn, *components(value, build))
    next_turn = build.add("add", turn, build.constant(1, index_type))
    proceed = build.add("lt", next_turn, build.constant(length, index_type))
    _, *final_states = build.end_loop(loop, [next_turn, *flatten(next_state, build)], proceed)
    return [*assemble(initial_state, final_states), *recordings]


def recordings_of_scan(equation: JaxprEqn, state_count: int) -> list[Recording]:
    """Return a recording for each output that a scan stacks: each result after the first ``state_count`` ones.

    Raises:
        Unsupported: A stacked output is not one number for each turn, the scan runs backwards, or it has no turn.
    """
    length = equation.params["length"]
    types = [array_type(variable) for variable in equation.outvars[state_count:]]
    if types and (length == 0 or equation.params["reverse"]):
        raise Unsupported("a loop that records nothing, or backwards")
    if any(is_key(stacked) or stacked.shape != (length,) for stacked in types):
        raise Unsupported("a loop that records arrays")
    return [Recording(length, np.dtype(stacked.dtype)) for stacked in types]


def cond(translator: "Translator", equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """``lax.cond`` and ``lax.switch``: nested branches of two sides, case 0 or later, case 1 or later, and so on."""
    index, *arguments = operands
    refuse_recordings(arguments)
    build = translator.build
    programs = equation.params["branches"]
    last = len(programs) - 1

    def cases_from(number: int) -> list[Any]:
        """Build case ``number`` and all later cases; return the results of the case that a lane takes."""
        if number == last:
            return translator.run(programs[number], arguments)
        results: list[list[Any]] = []  # of both sides, as values of the trace

        def this_case() -> list[Value]:
            """Build case ``number``; return the scalars of its results."""
            results.append(translator.run(programs[number], arguments))
            return flatten(results[-1], build)

        def later_cases() -> list[Value]:
            """Build the later cases; return the scalars of their results."""
            results.append(cases_from(number + 1))
            return flatten(results[-1], build)

        scalars = build.branch(is_at_most(build, index, number), (this_case, later_cases))
        return assemble(results[0], scalars)

    return cases_from(0)


def is_at_most(build: Builder, index: Value, number: int) -> Value:
    """Return the truth value whether the index of a case is at most ``number``.

    For ``lax.cond``, the index is a truth value that JAX has converted to 0 or 1, and the result its negation.
    """
    is_condition = index.operation == "convert" and index.operands[0].dtype == BOOL  # JAX has made it a number
    if is_condition and number == 0:
        condition = index.operands[0]
        return build.add("xor", condition, build.constant(True, BOOL))
    return build.add("le", index, build.constant(number, index.dtype))


LOOPS = {
    "while": rule(
        while_rule, None, cond_jaxpr=any_value, body_jaxpr=any_value, cond_nconsts=any_value, body_nconsts=any_value
    ),
    "scan": rule(
        scan_rule, None, jaxpr=any_value, length=any_value, reverse=any_value, unroll=any_value, num_consts=any_value,
        num_carry=any_value, ft_in=any_value, ft_out=any_value,
    ),
    "cond": rule(cond, None, branches=any_value),
}  # fmt: skip
"""Rules of loops and branches. Their translations are called as ``(translator, equation, operands) -> results``."""
