"""Several actuators in series as one actuator, whose properties follow from those of its elements.

The elements act on the command in their order, in three groups. The elements before the first one that moves between
the samples act on the sampled command, so their output is constant over a sample. Delays belong to this first group
wherever they stand, because they commute with everything that does not depend on time. The linear elements at the end
are one linear system, which the loop solves exactly together with the plant.

The elements between these two groups are integrated between the Gauss nodes of a step: linear ones by their exact
solution for the straight line with the mean and the first moment of their input, all others as if their input were
straight between the nodes. Behind a static element, the error is of order 4 in the step where signals are smooth. The
error is of order 2 where a signal passes a corner such as a limit, and behind an element with a state. The error is of
order 1 at jumps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import jax

from dssc_jax.core.chain_stages import NODES, Course, States, Values, in_series, linear_stage, stages_of
from dssc_jax.core.contracts import Moments, Mover, NoParams, Timing, Unmodelled
from dssc_jax.core.default_functions import ignore_sample
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.sampled_linear import LinearSystem, spread
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import (
    SMOOTH,
    SmoothExtent,
    Smoothness,
    Substitution,
    declared_smoothness,
    not_smooth,
    piecewise,
)

ORDER = 2
"""Order of the error of elements that are not linear, behind elements that move between the samples."""


class Element(NamedTuple):
    """One actuator of a chain.

    Args:
        kind: Kind of the actuator in the registry, for messages.
        model: Model of the actuator.
    """

    kind: str
    model: Unmodelled


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
            samples, or one element acts both at the samples and between them.
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


@dataclass(frozen=True)
class Chain:
    """The functions of several actuators in series, from which :func:`chain` makes one model.

    Parameters and states are tuples with an element for each actuator, in the order of the study.

    Args:
        elements: The actuators.
        arrangement: Groups of the actuators, in the order in which the groups act.
    """

    elements: tuple[Element, ...]
    arrangement: Arrangement

    @property
    def models(self) -> tuple[Unmodelled, ...]:
        """The model of each actuator."""
        return tuple(element.model for element in self.elements)

    @property
    def is_moving(self) -> bool:
        """Whether an actuator moves between the samples and is integrated."""
        return bool(self.arrangement.integrated)

    def init(self, params: Values) -> States:
        """Return the states of all actuators at rest."""
        return tuple(model.init(p) for model, p in zip(self.models, params, strict=True))

    def sample(self, params: Values, states: States, command: Scalar, key: jax.Array, dt: Scalar) -> States:
        """Return the states after a sample, at which each actuator of the first group receives its command in turn.

        Each actuator draws its own random numbers, from the key folded with the actuator's index.
        """
        models = self.models
        next_states = list(states)
        value = command
        for index in self.arrangement.sampled:
            element_key = jax.random.fold_in(key, index)
            next_states[index] = models[index].sample(params[index], states[index], value, element_key, dt)
            value = models[index].output(params[index], next_states[index], value)
        return tuple(next_states)

    def output(self, params: Values, states: States, command: Scalar) -> Scalar:
        """Return the command that leaves the last actuator, with all actuators in their present states."""
        return self.output_behind(self.arrangement.head + self.arrangement.linear, params, states, command)

    def output_behind(self, indices: Sequence[int], params: Values, states: States, command: Scalar) -> Scalar:
        """Return the command that leaves the last of some actuators, which act in the order of ``indices``."""
        models = self.models
        value = command
        for index in indices:
            value = models[index].output(params[index], states[index], value)
        return value

    def linear(self, params: Values) -> LinearSystem:
        """Return the linear actuators at the end as one system.

        The state of this system lists the states of all actuators; those of the others are constant and without effect.
        """
        sizes = [len(jax.tree.leaves(state)) for state in self.init(params)]
        places: list[int] = []  # index of each state of a linear actuator among all states
        for index in self.arrangement.linear:
            start = sum(sizes[:index])
            places += range(start, start + sizes[index])
        return spread(in_series(self.models, self.arrangement.linear, params), places, sum(sizes))

    def advance(self, params: Values, dt: Scalar) -> Mover:
        """Return the function that advances the actuators before the linear ones by a step."""
        stages = stages_of(self.models, self.arrangement.integrated, params, dt)

        def move(states: States, command: Scalar) -> tuple[States, Moments]:
            """Return the states after the step, and the signal that enters the linear actuators or the plant.

            The signal is given as the straight line with its mean and first moment.
            """
            value = self.output_behind(self.arrangement.sampled, params, states, command)
            course = Course((value,) * len(NODES), Moments(value, rise=0.0))
            next_states = dict(enumerate(states))
            for stage in stages:
                stage_states, course = stage(states, course)
                next_states |= stage_states
            return tuple(next_states.values()), course.line

        return move

    def step(self, params: Values, states: States, command: Scalar, dt: Scalar) -> States:
        """Return the states of all actuators after a step of length dt [s] with the command held."""
        move = self.advance(params, dt)
        next_states, line = move(states, command)
        if not self.arrangement.linear:
            return next_states
        stage = linear_stage(self.models, self.arrangement.linear, params, dt, constant=not self.is_moving)
        linear_states, _ = stage(next_states, Course((command,) * len(NODES), line))
        return tuple(linear_states.get(index, state) for index, state in enumerate(next_states))

    def smoothness(self, params: Values) -> Smoothness:
        """Return where the chain has a derivative; see :func:`smoothness_of`."""
        return smoothness_of(self.elements, params)

    def averages(self, params: Values) -> bool:
        """Whether the output of an actuator may change within a sample, and then acts through its mean."""
        return any(model.averages(p) for model, p in zip(self.models, params, strict=True))


@lru_cache(maxsize=256)
def chain(elements: tuple[Element, ...]) -> Unmodelled:
    """Return several actuators in series as one model of unmodelled dynamics.

    The model's parameters and state are tuples of the parameters and states of the elements, in the elements' order.

    Raises:
        ConfigError: The elements cannot stand in this order; see :func:`arrange`.
    """
    arrangement = arrange(elements)
    functions = Chain(elements, arrangement)
    is_moving = functions.is_moving
    # without moving elements, the sampled ones still act before the linear ones: `advance` gives their constant output
    has_advance = is_moving or (arrangement.sampled and arrangement.linear)
    return Unmodelled(
        NoParams,
        functions.init,
        functions.step,
        functions.output,
        sample=functions.sample,
        linear=functions.linear if arrangement.linear else None,
        held=not is_moving and bool(arrangement.sampled),
        smooth=functions.smoothness,
        continuous=all(model.continuous for model in functions.models),
        time_constant=time_constant_path(functions.models),
        advance=functions.advance if has_advance else None,
        order=ORDER if is_moving else None,
        averages=functions.averages,
    )


def time_constant_path(models: Sequence[Unmodelled]) -> str:
    """Return the dotted path of the ``time_constant``, such as ``1.mu``, if exactly one element has one; else ""."""
    names = [f"{index}.{model.time_constant}" for index, model in enumerate(models) if model.time_constant]
    return names[0] if len(names) == 1 else ""


def smoothness_of(elements: tuple[Element, ...], params: Values) -> Smoothness:
    """Return the smoothness of a chain, which has a derivative where all its elements have one.

    Args:
        elements: The elements of the chain.
        params: Parameters of each element.

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
    """Return the :data:`Substitution` of a chain by the chain in which some elements are replaced by their substitutes.

    Args:
        elements: The elements of the chain.
        smoothness: The smoothness that each element declares.
        indices: Indices of the elements to replace, each of which has a substitute.
    """

    def substitute(params: Values) -> tuple[Unmodelled, Values]:
        """Return the chain with the substitutes, and its parameters."""
        substitutes = list(elements)
        values = list(params)
        for index in indices:
            substitute_of = smoothness[index].substitute
            assert substitute_of is not None  # the caller gives only indices of elements with a substitute
            model, values[index] = substitute_of(params[index])
            substitutes[index] = Element(elements[index].kind, model)
        return chain(tuple(substitutes)), tuple(values)

    return substitute
