"""What every actuator declares about the time between the samples, against its own step in many parts.

A new kind is taken from the registry: it need not be named here.
"""

import jax
import numpy as np
import pytest

from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.study.components import parse_component
from tests.test_protocols import example

PARTS = 2000
LENGTHS = (0.003, 0.03)
"""Of a sample: an example's rate limit is far from the command at the end of the first, and meets it in the second."""
COMMANDS = (0.4, 0.9, -1.0)


def actuator(kind):
    return parse_component(example(UNMODELLED, kind), UNMODELLED, "unmodelled")


def begin(part, command, length):
    """A state that is not at rest, at the time of a command that is held from now on."""
    state = part.model.init(part.params)
    for earlier in (0.2, -0.6):
        state = part.model.sample(part.params, state, earlier, jax.random.key(0), length)
        state = part.model.step(part.params, state, earlier, length)
    return part.model.sample(part.params, state, command, jax.random.key(1), length)


def course(part, state, commands, dt):
    """The states and outputs at the end of parts of length dt, one for each command."""

    def advanced(at, command):
        after = part.model.step(part.params, at, command, dt)
        return after, part.model.output(part.params, after, command)

    state = jax.tree.map(lambda leaf: jax.numpy.asarray(leaf, float), state)
    return jax.lax.scan(advanced, state, jax.numpy.asarray(commands, float))


@pytest.mark.parametrize("kind", UNMODELLED)
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("length", LENGTHS)
def test_a_step_is_exact(kind, command, length):
    """One step over a sample gives the state of many short ones, and its moments are those of their outputs."""
    part = actuator(kind)
    model = part.model
    with jax.enable_x64(True):
        start = begin(part, command, length)
        whole = model.step(part.params, start, command, length)
        parts, outputs = course(part, start, np.full(PARTS, command), length / PARTS)
        np.testing.assert_allclose(jax.tree.leaves(whole), jax.tree.leaves(parts), rtol=1e-9, atol=1e-12)
        if model.held:
            np.testing.assert_array_equal(outputs, model.output(part.params, start, command))
        if model.moments is not None:
            first = model.output(part.params, start, command)
            values = np.concatenate([[first], outputs])
            middles = 0.5 * (values[1:] + values[:-1])
            times = (np.arange(PARTS) + 0.5) / PARTS - 0.5
            mean, rise = model.moments(part.params, start, command, length)
            assert float(mean) == pytest.approx(middles.mean(), abs=2e-6)
            assert float(rise) == pytest.approx(12.0 * np.mean(times * middles), abs=2e-5)


@pytest.mark.parametrize("kind", [kind for kind in UNMODELLED if actuator(kind).model.follow is not None])
@pytest.mark.parametrize(("start", "end"), [(0.4, 0.9), (0.9, -1.0), (-1.0, -0.9)])
@pytest.mark.parametrize("length", LENGTHS)
def test_a_straight_command_is_followed(kind, start, end, length):
    """As by many short steps, each with the command in its middle."""
    part = actuator(kind)
    with jax.enable_x64(True):
        state = begin(part, start, length)
        followed = part.model.follow(part.params, state, start, end, length)
        shares = (np.arange(PARTS) + 0.5) / PARTS
        parts, _ = course(part, state, start + shares * (end - start), length / PARTS)
        np.testing.assert_allclose(jax.tree.leaves(followed), jax.tree.leaves(parts), atol=2e-3 * abs(end - start))
