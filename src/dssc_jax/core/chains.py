"""Several actuators in series as one, whose properties follow from those of its elements.

The elements act on the command in their order. Those before the first element that moves between the samples act on the
sampled command, so their output is constant over a sample. Delays commute with everything that does not depend on time,
so they act there, too, wherever they stand. The linear elements at the end are one linear system, which the loop solves
exactly together with the plant. The elements between these two groups are integrated between the Gauss nodes of a step:
linear ones by their exact solution for the straight line with the mean and the first moment of their input, all others
as if their input were straight between the nodes. Behind a static element the error is of order 4 in the step where
signals are smooth. It is of order 2 where a signal passes a corner such as a limit, and behind an element with a state.
It is of order 1 at jumps.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import groupby
from typing import NamedTuple, TypeAlias

import jax

from dssc_jax.core.contracts import Moments, Mover, NoParams, Timing, Unmodelled
from dssc_jax.core.default_functions import ignore_sample
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import dot
from dssc_jax.core.sampled_linear import Forcing, LinearSystem, hold, series, spread
from dssc_jax.core.signals import Params, Scalar, State
from dssc_jax.core.smoothness import (
    SMOOTH,
    SmoothExtent,
    Smoothness,
    Substitution,
    declared_smoothness,
    not_smooth,
    piecewise,
)

HALF_DISTANCE = math.sqrt(3.0) / 6.0  # of the two Gauss nodes, in units of the step
NODES = (0.0, 0.5 - HALF_DISTANCE, 0.5 + HALF_DISTANCE, 1.0)
"""The start of a step, its Gauss nodes, and its end, in units of the step."""
ORDER = 2
"""Order of the error of elements that are not linear, behind elements that move between the samples."""


class Element(NamedTuple):
    """One actuator of a chain.

    Args:
        kind: Its kind in the registry, for messages.
        model: Its model.
    """

    kind: str
    model: Unmodelled


class Course(NamedTuple):
    """A signal over a step.

    Args:
        nodes: Values of the signal at :data:`NODES`.
        line: The straight line with the mean and the first moment of the signal.
    """

    nodes: tuple[Scalar, ...]
    line: Moments


States: TypeAlias = tuple[State, ...]
"""The state of each element, in the order of the study."""
Values: TypeAlias = tuple[Params, ...]
"""The parameters of each element."""
Stage: TypeAlias = Callable[[States, Course], tuple[dict[int, State], Course]]
"""``(states, input) -> (new states by index of the element, output)`` of one or several elements over a step."""


class Arrangement(NamedTuple):
    """The elements of a chain in the order in which they act, by index.

    Args:
        sampled: Elements that act on the sampled command.
        integrated: Elements that move between the samples and are integrated, except the linear ones at the end.
        linear: Linear elements directly before the plant.
    """

    sampled: tuple[int, ...]
    integrated: tuple[int, ...]
    linear: tuple[int, ...]

    @property
    def head(self) -> tuple[int, ...]:
        """All elements that act before the linear elements at the end."""
        return self.sampled + self.integrated


def arrange(elements: Sequence[Element]) -> Arrangement:
    """Sort the elements of a chain by how they act: at the samples, between them, or as linear elements at the end.

    Raises:
        ConfigError: An element that acts on the sampled command stands behind an element that moves between the
            samples, or an element does both.
    """
    sampled = []
    moving = []
    for index, (kind, model) in enumerate(elements):
        acts_at_samples = model.sample is not ignore_sample
        if model.advance is not None or (acts_at_samples and not model.held):
            raise ConfigError(f"{index}.kind", f"'{kind}' acts at the samples and between them; it stands alone")
        commutes = acts_at_samples and model.timing == Timing.INVARIANT
        if model.held and (not moving or commutes):
            sampled.append(index)
        elif model.held and acts_at_samples and model.timing == Timing.SAMPLED:
            first = elements[moving[0]].kind
            rule = f"'{kind}' acts on the sampled command; place it before '{first}', which moves between the samples"
            raise ConfigError(f"{index}.kind", rule)
        else:
            moving.append(index)
    integrated = list(moving)
    while integrated and elements[integrated[-1]].model.linear is not None:
        integrated.pop()
    linear = moving[len(integrated) :]
    return Arrangement(tuple(sampled), tuple(integrated), tuple(linear))


@lru_cache(maxsize=256)
def chain(elements: tuple[Element, ...]) -> Unmodelled:
    """Several actuators in series as one model of unmodelled dynamics.

    Its parameters and its state are tuples of the parameters and states of the elements, in their order.

    Raises:
        ConfigError: As for :func:`arrange`.
    """
    arrangement = arrange(elements)
    models = tuple(element.model for element in elements)
    is_moving = bool(arrangement.integrated)

    def init(params: Values) -> States:
        """The states of all elements at rest."""
        return tuple(model.init(p) for model, p in zip(models, params, strict=True))

    def sample(params: Values, states: States, command: Scalar, key: jax.Array, dt: Scalar) -> States:
        """The states once the elements that act at the samples have received the command in turn."""
        next_states = list(states)
        value = command
        for index in arrangement.sampled:
            element_key = jax.random.fold_in(key, index)
            next_states[index] = models[index].sample(params[index], states[index], value, element_key, dt)
            value = models[index].output(params[index], next_states[index], value)
        return tuple(next_states)

    def output_of(indices: Sequence[int], params: Values, states: States, command: Scalar) -> Scalar:
        """The command after some elements in turn, in their present states."""
        value = command
        for index in indices:
            value = models[index].output(params[index], states[index], value)
        return value

    def output(params: Values, states: States, command: Scalar) -> Scalar:
        """The command after all elements."""
        return output_of(arrangement.head + arrangement.linear, params, states, command)

    def linear_among_all(params: Values) -> LinearSystem:
        """The linear elements at the end as one system, in the states of all elements."""
        sizes = [len(jax.tree.leaves(state)) for state in init(params)]
        places = []  # index of each state of a linear element among all states
        for index in arrangement.linear:
            start = sum(sizes[:index])
            places += range(start, start + sizes[index])
        return spread(in_series(models, arrangement.linear, params), places, sum(sizes))

    def advance(params: Values, dt: Scalar) -> Mover:
        """Return the function that advances the elements before the linear ones by a step."""
        stages = stages_of(models, arrangement.integrated, params, dt)

        def move(states: States, command: Scalar) -> tuple[States, Moments]:
            """The states after the step, and the line that enters the linear elements or the plant."""
            value = output_of(arrangement.sampled, params, states, command)
            course = Course((value,) * len(NODES), Moments(value, rise=0.0))
            next_states = dict(enumerate(states))
            for stage in stages:
                stage_states, course = stage(states, course)
                next_states |= stage_states
            return tuple(next_states.values()), course.line

        return move

    def step(params: Values, states: States, command: Scalar, dt: Scalar) -> States:
        """The states of all elements after a step with the command held."""
        next_states, line = advance(params, dt)(states, command)
        if not arrangement.linear:
            return next_states
        stage = linear_stage(models, arrangement.linear, params, dt, constant=not is_moving)
        linear_states, _ = stage(next_states, Course((command,) * len(NODES), line))
        return tuple(linear_states.get(index, state) for index, state in enumerate(next_states))

    return Unmodelled(
        NoParams,
        init,
        step,
        output,
        sample=sample,
        linear=linear_among_all if arrangement.linear else None,
        held=not is_moving and bool(arrangement.sampled),
        smooth=lambda params: smoothness_of(elements, params),
        continuous=all(model.continuous for model in models),
        time_constant=time_constant_path(models),
        advance=advance if is_moving or (arrangement.sampled and arrangement.linear) else None,
        order=ORDER if is_moving else None,
        averages=lambda params: any(model.averages(part) for model, part in zip(models, params, strict=True)),
    )


def in_series(models: Sequence[Unmodelled], indices: Sequence[int], params: Values) -> LinearSystem:
    """Linear elements in series as one system, whose state is the sequence of their states.

    Args:
        models: The models of the chain.
        indices: The linear elements, at least one.
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


def time_constant_path(models: Sequence[Unmodelled]) -> str:
    """Dotted path of the ``time_constant`` if exactly one element declares it, such as ``1.mu``; else empty."""
    names = [f"{index}.{model.time_constant}" for index, model in enumerate(models) if model.time_constant]
    return names[0] if len(names) == 1 else ""


def stages_of(models: Sequence[Unmodelled], indices: Sequence[int], params: Values, dt: Scalar) -> list[Stage]:
    """The stages of a step in order: consecutive linear elements are one stage, every other element is a stage.

    Args:
        models: The models of the chain.
        indices: The elements that move between the samples.
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
    """The stage of linear elements, by their exact solution at the nodes.

    Args:
        models: The models of the chain.
        indices: The linear elements.
        params: Parameters of each element of the chain.
        dt: Length of the step [s].
        constant: Whether the input is constant over the step.
    """
    system = in_series(models, indices, params)
    forcing = Forcing(system.b, 1 if constant else 2)
    transitions = [hold(system.a, (forcing,), share * dt).full for share in NODES[1:]]

    def stage(states: States, source: Course) -> tuple[dict[int, State], Course]:
        """The elements' states after the step, and their output, for the straight line of the input."""
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
    """The stage of an element that is not linear, by steps from node to node.

    Args:
        model: The element.
        index: Index of the element in the chain.
        params: Parameters of the element.
        dt: Length of the step [s].
        constant: Whether the input is constant over the step; then the element's own ``moments`` give the output.
    """
    follow = model.follow or follow_mean(model)

    def stage(states: States, source: Course) -> tuple[dict[int, State], Course]:
        """The element's state after the step, and its output, for an input that is straight between the nodes."""
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
    """Return the ``follow`` of a model that declares none: its step with the mean of the command, of order 2."""
    return lambda params, state, start, end, dt: model.step(params, state, 0.5 * (start + end), dt)


def line_through(nodes: Sequence[Scalar]) -> Moments:
    """Mean and rise of a signal over a step from its values at :data:`NODES`, exact for polynomials of degree 2."""
    _, first, second, _ = nodes
    return Moments(0.5 * (first + second), (0.5 / HALF_DISTANCE) * (second - first))


def smoothness_of(elements: tuple[Element, ...], params: Values) -> Smoothness:
    """The smoothness of a chain: it has a derivative where all its elements have one.

    Raises:
        ConfigError: An element does not declare its smoothness.
    """
    smoothness = []
    for (kind, model), values in zip(elements, params, strict=True):
        try:
            smoothness.append(declared_smoothness(model, values))
        except ConfigError as error:
            raise ConfigError("", f"contains '{kind}', which {error.rule}") from None
    nowhere = [index for index, smooth in enumerate(smoothness) if smooth.extent == SmoothExtent.NOWHERE]
    corners = [index for index, smooth in enumerate(smoothness) if smooth.extent == SmoothExtent.PIECEWISE]
    for index in nowhere:
        if smoothness[index].substitute is None:
            return not_smooth(f"contains '{elements[index].kind}', which {smoothness[index].meaning}")
    if nowhere:
        reasons = [f"contains '{elements[index].kind}', which {smoothness[index].meaning}" for index in nowhere]
        return not_smooth("; ".join(reasons), substitution(elements, smoothness, nowhere))
    if not corners:
        return SMOOTH
    meaning = ", or ".join(f"a boundary of '{elements[index].kind}', {smoothness[index].meaning}" for index in corners)
    for index in corners:
        substitute = smoothness[index].substitute
        if substitute is None or substitute(params[index])[0] is not elements[index].model:
            return piecewise(meaning)  # another model cannot be chosen by parameters alone
    return piecewise(meaning, substitution(elements, smoothness, corners))


def substitution(
    elements: tuple[Element, ...], smoothness: Sequence[Smoothness], indices: Sequence[int]
) -> Substitution:
    """Return the :data:`Substitution` of a chain by a chain in which the substitutes of some elements replace them.

    Args:
        elements: The elements of the chain.
        smoothness: The smoothness that each element declares.
        indices: Indices of the elements to replace, each of which has a substitute.
    """

    def substitute(params: Values) -> tuple[Unmodelled, Values]:
        """The chain with substitutes, and its parameters."""
        substitutes = list(elements)
        values = list(params)
        for index in indices:
            substitute_of = smoothness[index].substitute
            assert substitute_of is not None  # the caller gives only indices of elements with a substitute
            model, values[index] = substitute_of(params[index])
            substitutes[index] = Element(elements[index].kind, model)
        return chain(tuple(substitutes)), tuple(values)

    return substitute
