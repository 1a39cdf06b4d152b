"""The verifier of programs finds each rule that a pass could break; what is translated passes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.lanes.operations import Operation
from dssc_jax.lanes.passes.verify import InvalidProgram, verify
from dssc_jax.lanes.program import CodeLoop, Value
from dssc_jax.lanes.tracing.translate import translate

REAL = np.dtype(np.float64)


def oscillator(x, rate):
    """A loop with a branch, a table, a recording, and a loop within it."""
    table = jnp.array([1.0, 0.5, 0.25])

    def turn(state, k):
        inner = jax.lax.fori_loop(0, 3, lambda i, s: s + rate * table[i], state)
        bounded = jax.lax.cond(inner > 2.0, lambda s: jnp.sin(s), lambda s: -s, inner)
        return bounded, bounded * k

    return jax.lax.scan(turn, x, jnp.arange(4.0))


@pytest.fixture
def program():
    scalar = jax.ShapeDtypeStruct((), REAL)
    return translate(oscillator, scalar, scalar)[0]


def loop_of(program):
    return next(node for node in program.body.nodes if isinstance(node, CodeLoop))


def values_of(block):
    return [node for node in block.nodes if isinstance(node, Value)]


def test_a_translated_program_passes(program):
    verify(program)


def use_before_definition(program):
    block = loop_of(program).body
    late = values_of(block)[-1]
    block.nodes.insert(0, Value(Operation.NEG, late.dtype, (late,), varying=True, block=block))


def definition_twice(program):
    program.body.nodes.append(program.body.nodes[0])


def mixed_types(program):
    whole = Value(Operation.CONSTANT, np.dtype(np.int64), detail=np.int64(1))
    real = Value(Operation.CONSTANT, REAL, detail=np.float64(1.0))
    program.body.nodes.append(Value(Operation.ADD, REAL, (whole, real), block=program.body))


def missing_operand(program):
    real = Value(Operation.CONSTANT, REAL, detail=np.float64(1.0))
    program.body.nodes.append(Value(Operation.SELECT, REAL, (real, real), block=program.body))


def uniform_of_varying(program):
    varying = next(value for value in values_of(program.body) if value.varying)
    program.body.nodes.append(Value(Operation.NEG, varying.dtype, (varying,), block=program.body))


def incomplete_state(program):
    loop_of(program).next_states.pop()


def state_of_another_type(program):
    loop = loop_of(program)
    loop.initial_states[0] = Value(Operation.CONSTANT, np.dtype(np.float32), detail=np.float32(1.0))


def varying_condition(program):
    loop = loop_of(program)
    proceed = loop.proceed
    loop.proceed = Value(Operation.ANY, np.dtype(bool), (proceed,), varying=True, block=loop.body)
    loop.body.nodes.append(loop.proceed)


def unknown_operation(program):
    program.body.nodes[0].operation = "fma"


PLANTED = {
    use_before_definition: "is read by neg before it is set",
    definition_twice: "is defined twice",
    mixed_types: "operands and result must have one type",
    missing_operand: "takes 3 operands, got 2",
    uniform_of_varying: "is uniform, and an operand varies",
    incomplete_state: "states must be complete",
    state_of_another_type: "a state must keep its type",
    varying_condition: "condition must be a uniform truth value",
    unknown_operation: "is no operation",
}


@pytest.mark.parametrize("break_rule", PLANTED)
def test_each_broken_rule_is_found(program, break_rule):
    break_rule(program)
    with pytest.raises(InvalidProgram, match=PLANTED[break_rule]):
        verify(program)
