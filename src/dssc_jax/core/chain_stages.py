"""The steps of a chain's actuators between two samples: each element, or group of linear elements, is a stage.

A signal over a step is described by its values at the start, the two Gauss nodes and the end of the step, and by the
straight line that has the mean and the first moment of the signal. Linear elements advance by their exact solution for
that line, all other elements by steps from node to node.
"""

import math
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import NamedTuple, TypeAlias

import jax

from dssc_jax.core.contracts import Moments, Unmodelled
from dssc_jax.core.numerics import dot
from dssc_jax.core.sampled_linear import Forcing, LinearSystem, hold, series
from dssc_jax.core.signals import Params, Scalar, State

HALF_DISTANCE = math.sqrt(3.0) / 6.0  # of the two Gauss nodes, in units of the step
NODES = (0.0, 0.5 - HALF_DISTANCE, 0.5 + HALF_DISTANCE, 1.0)
"""The start of a step, its Gauss nodes, and its end, in units of the step."""


class Course(NamedTuple):
    """A signal over a step.

    Args:
        nodes: Values of the signal at :data:`NODES`.
        line: The straight line that has the mean and the first moment of the signal over the step.
    """

    nodes: tuple[Scalar, ...]
    line: Moments


States: TypeAlias = tuple[State, ...]
"""The state of each element, in the order of the study."""
Values: TypeAlias = tuple[Params, ...]
"""The parameters of each element."""
Stage: TypeAlias = Callable[[States, Course], tuple[dict[int, State], Course]]
"""``(states, input) -> (new states by index of the element, output)`` of one or several elements over a step."""


def in_series(models: Sequence[Unmodelled], indices: Sequence[int], params: Values) -> LinearSystem:
    """Return linear elements in series as one system, whose state is the sequence of the elements' states.

    Args:
        models: The models of the chain.
        indices: Indices of the linear elements, at least one.
        params: Parameters of each element of the chain.
    """
    systems = []
    for index in indices:
        system = models[index].linear
        assert system is not None  # the caller gives only indices of linear elements
        systems.append(system(params[index]))
    total = systems[0]
    for system in systems[1:]:
        total = series(total, system)
    return total


def stages_of(models: Sequence[Unmodelled], indices: Sequence[int], params: Values, dt: Scalar) -> list[Stage]:
    """Return the stages of a step in order; consecutive linear elements are one stage, any other element is its own.

    Args:
        models: The models of the chain.
        indices: Indices of the elements that move between the samples.
        params: Parameters of each element of the chain.
        dt: Length of the step [s].
    """
    stages: list[Stage] = []  # only the input of the first one, the held command, is constant
    for is_linear, group in groupby(indices, key=lambda index: models[index].linear is not None):
        if is_linear:
            stages.append(linear_stage(models, tuple(group), params, dt, constant=not stages))
            continue
        for index in group:
            stages.append(stepped_stage(models[index], index, params[index], dt, constant=not stages))
    return stages


def linear_stage(
    models: Sequence[Unmodelled], indices: Sequence[int], params: Values, dt: Scalar, constant: bool
) -> Stage:
    """Return the stage of linear elements, which computes their exact solution at the nodes.

    Args:
        models: The models of the chain.
        indices: Indices of the linear elements.
        params: Parameters of each element of the chain.
        dt: Length of the step [s].
        constant: Whether the input is constant over the step.
    """
    system = in_series(models, indices, params)
    forcing = Forcing(system.b, 1 if constant else 2)
    transitions = [hold(system.a, (forcing,), share * dt).full for share in NODES[1:]]

    def stage(states: States, source: Course) -> tuple[dict[int, State], Course]:
        """Return the elements' states after the step, and the last one's output, for the straight line of the input."""
        leaves, structure = jax.tree.flatten([states[index] for index in indices])
        line = source.line
        solutions = [tuple(leaves)]
        for share, transition in zip(NODES[1:], transitions, strict=True):
            terms = (line.mean,) if constant else (line.mean - 0.5 * line.rise, share * line.rise)
            solutions.append(transition.apply(leaves, (terms,)))
        row = (*system.c, system.d)
        nodes = tuple(dot(row, (*x, value)) for x, value in zip(solutions, source.nodes, strict=True))
        next_states = dict(zip(indices, structure.unflatten(list(solutions[-1])), strict=True))
        return next_states, Course(nodes, line_through(nodes))

    return stage


def stepped_stage(model: Unmodelled, index: int, params: Params, dt: Scalar, constant: bool) -> Stage:
    """Return the stage of an element that is not linear, which advances by steps from node to node.

    Args:
        model: The element.
        index: Index of the element in the chain.
        params: Parameters of the element.
        dt: Length of the step [s].
        constant: Whether the input is constant over the step; then the element's own ``moments`` give the output.
    """
    follow = model.follow or follow_mean(model)

    def stage(states: States, source: Course) -> tuple[dict[int, State], Course]:
        """Return the element's state after the step, and its output, for an input that is straight between the nodes.

        For a constant input, each node is reached by one step from the start, and the output gets the element's own
        ``moments`` if it declares them.
        """
        begin = states[index]
        start = source.nodes[0]
        state = model.step(params, begin, start, 0.0)  # after a time of 0: an element may react at once
        nodes = [model.output(params, state, start)]
        for i, value in enumerate(source.nodes[1:]):
            if constant:
                state = model.step(params, begin, value, NODES[i + 1] * dt)
            else:
                state = follow(params, state, source.nodes[i], value, (NODES[i + 1] - NODES[i]) * dt)
            nodes.append(model.output(params, state, value))
        if constant and model.moments is not None:
            line = model.moments(params, begin, start, dt)
        else:
            line = line_through(nodes)
        return {index: state}, Course(tuple(nodes), line)

    return stage


def follow_mean(model: Unmodelled) -> Callable[[Params, State, Scalar, Scalar, Scalar], State]:
    """Return a ``follow`` for a model that declares none: its ``step`` with the mean of the command, of order 2."""
    return lambda params, state, start, end, dt: model.step(params, state, 0.5 * (start + end), dt)


def line_through(nodes: Sequence[Scalar]) -> Moments:
    """Return mean and rise of a signal over a step from its values at :data:`NODES`.

    Only the two Gauss nodes count. The result is exact for polynomials of degree 2.
    """
    _, first, second, _ = nodes
    return Moments(0.5 * (first + second), (0.5 / HALF_DISTANCE) * (second - first))
