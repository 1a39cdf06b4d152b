"""Rules of loops and branches: ``lax.while_loop``, ``lax.scan``, ``lax.cond`` and ``lax.switch``."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jax.extend.core import JaxprEqn

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
    """``lax.while_loop``: a loop that ends when no lane goes on; a lane that has ended keeps its state."""
    params = equation.params
    build = translator.build
    head = params["cond_jaxpr"]
    body = params["body_jaxpr"]
    first = params["cond_nconsts"]
    second = params["cond_nconsts"] + params["body_nconsts"]
    head_constants = operands[:first]
    constants = operands[first:second]
    initial_state = operands[second:]
    if translator.has_memory:
        initial_state = move_to_memory(build, initial_state, body.jaxpr, second - first)
    flags = [is_varying(value) for value in (*operands[:second], *initial_state)]
    varying, lanes_differ = translator.varying_results.of_while(head.jaxpr, body.jaxpr, flags, first, second)
    if lanes_differ and any(isinstance(value, Memory) for value in initial_state):
        raise Unsupported("an array in memory in a loop that lanes leave at different times")
    enter = translator.run(head, [*head_constants, *initial_state])[0]
    scalars = flatten(initial_state, build)
    differs = flags_of_components(varying, initial_state, build)
    guard = None if enter.operation == "constant" and enter.detail else build.add("any", enter)
    carried = list(scalars)
    if lanes_differ:  # the last state tells whether the lane still runs
        carried.append(enter)
        differs.append(True)
    loop = build.loop(carried, differs, guard)
    states = loop.states[: len(scalars)]
    next_state = translator.run(body, [*constants, *assemble(initial_state, states)])
    next_scalars = flatten(next_state, build)
    proceed = translator.run(head, [*head_constants, *next_state])[0]
    if lanes_differ:
        is_running = loop.states[-1]
        pairs = zip(next_scalars, states, strict=True)
        next_scalars = [build.add("select", is_running, new, old) for new, old in pairs]
        proceed = build.add("and", is_running, proceed)
        next_scalars.append(proceed)
        proceed = build.add("any", proceed)
    return assemble(initial_state, build.end_loop(loop, next_scalars, proceed)[: len(scalars)])


def scan_rule(translator: "Translator", equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """``lax.scan``: a loop of constant length over the rows of some arrays; the outputs that it stacks are recorded."""
    params = equation.params
    build = translator.build
    length = params["length"]
    body = params["jaxpr"]
    first, state_count = parts_of_scan(equation)
    second = first + state_count
    constants = operands[:first]
    initial_state = operands[first:second]
    rows = operands[second:]
    if translator.has_memory:
        initial_state = move_to_memory(build, initial_state, body.jaxpr, first)
    recorded_variables = equation.outvars[state_count:]
    if recorded_variables and (length == 0 or params["reverse"]):
        raise Unsupported("a loop that records nothing, or backwards")
    if length == 0:
        return initial_state
    recordings = [Recording(length, np.dtype(array_type(variable).dtype)) for variable in recorded_variables]
    if any(array_type(variable).shape != (length,) or is_key(array_type(variable)) for variable in recorded_variables):
        raise Unsupported("a loop that records arrays")
    flags = translator.varying_results.of_scan(
        body.jaxpr, [is_varying(value) for value in (*constants, *initial_state, *rows)], first, second
    )
    scalars = flatten(initial_state, build)
    index = np.dtype(np.int32)
    differs = flags_of_components(flags, initial_state, build)
    loop = build.loop([build.constant(0, index), *scalars], [False, *differs], None)
    turn, *states = loop.states
    at = build.add("sub", build.constant(length - 1, index), turn) if params["reverse"] else turn
    slices = [indexing.row(build, table, at) for table in rows]
    results = translator.run(body, [*constants, *assemble(initial_state, states), *slices])
    for recording, value in zip(recordings, results[state_count:], strict=True):
        build.record(recording, turn, *components(value, build))
    next_turn = build.add("add", turn, build.constant(1, index))
    proceed = build.add("lt", next_turn, build.constant(length, index))
    loop_results = build.end_loop(loop, [next_turn, *flatten(results[:state_count], build)], proceed)
    return [*assemble(initial_state, loop_results[1:]), *recordings]


def cond(translator: "Translator", equation: JaxprEqn, operands: list[Any]) -> list[Any]:
    """``lax.cond`` and ``lax.switch``: nested branches of two sides; each lane takes one side."""
    index, *remaining = operands
    refuse_recordings(remaining)
    build = translator.build
    branches = equation.params["branches"]
    condition = index.operands[0] if index.operation == "convert" and index.operands[0].dtype == BOOL else None

    def case(number: int) -> list[Any]:
        if number == len(branches) - 1:
            return translator.run(branches[number], remaining)
        if condition is not None:  # a truth value that JAX has made a number
            predicate = build.add("xor", condition, build.constant(True, BOOL))
        else:
            predicate = build.add("le", index, build.constant(number, index.dtype))
        kinds: list[list[Any]] = []

        def side(results: Callable[[], list[Any]]) -> Callable[[], list[Value]]:
            def scalars() -> list[Value]:
                kinds.append(results())
                return flatten(kinds[-1], build)

            return scalars

        sides = side(lambda: translator.run(branches[number], remaining)), side(lambda: case(number + 1))
        scalars = build.branch(predicate, sides)
        return assemble(kinds[0], scalars)

    return case(0)


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
"""Rules of loops and branches, which translate by the translator itself."""
