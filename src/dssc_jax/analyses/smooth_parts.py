"""Parts of a loop that are about to be linearised: what they declare, what is taken for them, and whether it is true.

Three steps guard a derivative. Every part declares where it is smooth, and an undeclared one is refused. A part that is
smooth nowhere is replaced by the substitute that it states, or refused. At every operating point each part is then
pushed to both sides at two sizes, so that a corner, a jump or a false declaration is found where it lies.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.sample import Loop, LoopParams, LoopState, actuate, as_arrays, measure, plant_input, step
from dssc_jax.core.contracts import Controller, Differentiator, Sensor, Unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import PlantInput, Scalar, tracking_error
from dssc_jax.core.smoothness import Extent, Smoothness, declared_smoothness
from dssc_jax.study import Study

CHANNEL_SLOTS = ("sensor", "differentiator", "controller", "unmodelled")
DISTURBANCE = "disturbance"
STEPS = {
    Controller: ("init", "step"),
    Sensor: ("init", "step"),
    Differentiator: ("init", "step"),
    Unmodelled: ("init", "step", "output", "sample"),
}
"""The functions of a part that a choice between two parts has to make."""

SMALL, LARGE = 1e-8, 1e-6  # pushes, relative to 1 + |x|
LADDER = tuple(10.0**power for power in range(-6, 2))  # pushes under which a staircase stands still, and then jumps
JUMP = 1e-7  # of an output that stood still under a tenth of the push, relative to 1 + |y|
DEVIATION = 1e-3  # of a difference from the derivative, relative to the largest derivative of the same output
SHRINKING = 0.5  # of that deviation from the large push to the small one, where a derivative exists
NOISE = 64.0 * float(np.finfo(np.float64).eps)  # of an output, relative to 1 + |y|
MOST_AXES = 32  # inputs that are pushed one by one
RANDOM = 4  # directions in which all inputs are pushed together, and all signals


class Place(NamedTuple):
    """One part of the loop with what it declares.

    Args:
        slot: Name of the field of :class:`Loop`.
        index: Of the channel; 0 for the plant.
        label: Slot, channel and kind in words.
        smoothness: Its declaration.
    """

    slot: str
    index: int
    label: str
    smoothness: Smoothness

    @property
    def replaced(self) -> bool:
        """Whether its substitute is always taken."""
        return self.smoothness.extent == Extent.NOWHERE

    @property
    def inner(self) -> bool:
        """Whether it has a substitute for operating points on its boundaries."""
        return self.smoothness.extent == Extent.PIECEWISE and self.smoothness.substitute is not None


class Finding(IntEnum):
    """What a part is at an operating point."""

    SMOOTH = 0
    CORNER = 1
    DEFECT = 2
    BEYOND = 3


class Chosen(NamedTuple):
    """Parameters of a part and of its substitute, and whether the substitute is taken."""

    part: Any
    substitute: Any
    taken: Scalar

    @property
    def l0(self) -> Scalar:
        """The error pole of a controller."""
        return self.part.l0


def declared_places(study: Study, moving: bool) -> tuple[Place, ...]:
    """Every part that a linearisation of the study differentiates.

    Args:
        study: The study.
        moving: Whether it is linearised along its flight, where disturbances matter.

    Raises:
        ConfigError: a part declares nothing, or that it is smooth nowhere without a substitute.
    """
    loop, template = study.loop, study.template
    slots = (*CHANNEL_SLOTS, DISTURBANCE) if moving else CHANNEL_SLOTS
    places = [declared_place(study, "plant", 0, loop.plant, template.plant)]
    for slot in slots:
        for index in range(len(loop.channels)):
            part, params = getattr(loop, slot)[index], getattr(template, slot)[index]
            places.append(declared_place(study, slot, index, part, params))
    return tuple(places)


def declared_place(study: Study, slot: str, index: int, part: Any, params: Any) -> Place:
    """A part with its declaration.

    Raises:
        ConfigError: as :func:`declared_places` says.
    """
    channel = study.loop.channels[index] if slot != "plant" else ""
    table = getattr(study.config, slot)
    kind = table.get(channel, {}).get("kind", table["kind"]) if channel else table["kind"]
    where = f"{study.source}: {slot}{'.' if channel else ''}{channel}.kind"
    try:
        smoothness = declared_smoothness(part, params)
    except ConfigError as error:
        raise ConfigError(where, f"'{kind}' {error.rule}") from None
    if smoothness.extent == Extent.NOWHERE and smoothness.substitute is None:
        raise ConfigError(where, f"'{kind}' {smoothness.meaning}")
    label = f"{slot} '{kind}'" if not channel else f"{slot} '{kind}' of {channel}"
    return Place(slot, index, label, smoothness)


def stated(places: Sequence[Place]) -> list[str]:
    """What is taken for the parts that are smooth nowhere, in words."""
    return list(dict.fromkeys(f"{place.label} {place.smoothness.meaning}" for place in places if place.replaced))


def part_of(loop: Loop, params: LoopParams, place: Place) -> tuple[Any, Any]:
    """The part in a place, and its parameters."""
    if place.slot == "plant":
        return loop.mimo_plant, params.plant
    return getattr(loop, place.slot)[place.index], getattr(params, place.slot)[place.index]


def with_part(loop: Loop, params: LoopParams, place: Place, part: Any, own: Any) -> tuple[Loop, LoopParams]:
    """The loop with another part in a channel's place."""
    models, values = list(getattr(loop, place.slot)), list(getattr(params, place.slot))
    models[place.index] = part
    values[place.index] = own
    return replace(loop, **{place.slot: tuple(models)}), params._replace(**{place.slot: tuple(values)})


def substituted(loop: Loop, params: LoopParams, places: Sequence[Place]) -> tuple[Loop, LoopParams]:
    """The loop in which parts that are smooth nowhere are replaced by their substitutes."""
    for place in places:
        if place.replaced:
            _, own = part_of(loop, params, place)
            loop, params = with_part(loop, params, place, *place.smoothness.substitute(own))
    return loop, params


def chosen(loop: Loop, params: LoopParams, places: Sequence[Place], findings: jax.Array) -> tuple[Loop, LoopParams]:
    """The loop in which parts at one of their corners are replaced by their substitutes.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        places: The parts.
        findings: A :class:`Finding` for each of them; may be traced.
    """
    for place, finding in zip(places, findings, strict=True):
        if place.inner:
            part, own = part_of(loop, params, place)
            substitute, inner = place.smoothness.substitute(own)
            both = Chosen(own, inner, finding == Finding.CORNER)
            loop, params = with_part(loop, params, place, choice(part, substitute), both)
    return loop, params


def choice(part: Any, substitute: Any) -> Any:
    """A part that is one of two, as its parameters :class:`Chosen` decide."""

    def choosing(name: str) -> Callable[..., Any]:
        def run(params: Chosen, *arguments: Any) -> Any:
            inner = getattr(substitute, name)(params.substitute, *arguments)
            outer = getattr(part, name)(params.part, *arguments)
            return jax.tree.map(lambda taken, left: jnp.where(params.taken, taken, left), inner, outer)

        return run

    return part._replace(**{name: choosing(name) for name in STEPS[type(part)]})


class PartMap(NamedTuple):
    """A part as a function of its state and inputs, at one operating point.

    Args:
        apply: ``(part, params, (memory, signals)) -> outputs``.
        memory: The part's own state, which may hold counters.
        signals: Its inputs and, for the plant, its state.
    """

    apply: Callable[[Any, Any, Any], Any]
    memory: Any
    signals: Any


def part_maps(
    loop: Loop, params: LoopParams, key: jax.Array, state: LoopState, k: Scalar, places: Sequence[Place]
) -> list[PartMap]:
    """Every part with its inputs at sample k.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        key: The draw's random key.
        state: The loop's state before the sample.
        k: Index of the sample.
        places: The parts.
    """
    t, dt = k * loop.sample_time, loop.sample_time
    _, recorded = step(loop, params, key, state, k)
    references = recorded.references
    commands = tuple(sample.u_total for sample in recorded.instant.channels)
    zipped = zip(loop.unmodelled, params.unmodelled, state.channels, commands, strict=True)
    sampled = tuple(model.sample(own, channel.unmodelled, u, dt) for model, own, channel, u in zipped)
    drive = plant_input(loop, params, state, state.plant, actuate(loop, params, sampled, commands), t)

    def plant(part: Any, own: Any, inputs: Any) -> Any:
        _, (at, actuation) = inputs
        slope = part.derivative(own, at, PlantInput(actuation, drive.disturbance, drive.wind), t)
        return slope, measure(loop, params, at, references)

    def sensor(part: Any, own: Any, inputs: Any, i: int) -> Any:
        stream = jax.random.fold_in(loop.key(key, "sensor", loop.channels[i]), k + 1)
        return part.step(own, *inputs, stream, t, dt)

    def unmodelled(part: Any, own: Any, inputs: Any) -> Any:
        z, u = inputs
        begin = part.sample(own, z, u, dt)
        end = part.step(own, begin, u, dt)
        return end, part.output(own, begin, u), part.output(own, end, u)

    def of(place: Place) -> PartMap:
        i = place.index
        channel, controlled = state.channels[i], recorded.controlled[i]
        measurement = recorded.measurements[i]
        match place.slot:
            case "plant":
                return PartMap(plant, (), (state.plant, drive.command))
            case "sensor":
                return PartMap(lambda part, own, at: sensor(part, own, at, i), channel.sensor, measurement)
            case "differentiator":
                return PartMap(
                    lambda part, own, at: part.step(own, *at, dt), channel.differentiator, controlled.reading
                )
            case "controller":
                return PartMap(
                    lambda part, own, at: part.step(own, *at, references[i], dt)[:2],
                    channel.controller,
                    controlled.sensed,
                )
            case "unmodelled":
                return PartMap(unmodelled, channel.unmodelled, commands[i])
            case _:
                sigma = tracking_error(measurement, references[i], params.controller[i].l0).sigma
                return PartMap(
                    lambda part, own, at: part.value(own, channel.disturbance, *at[1], t), (), (measurement, sigma)
                )

    return [of(place) for place in places]


def examined(
    loop: Loop, params: LoopParams, key: jax.Array, state: LoopState, k: Scalar, places: Sequence[Place]
) -> jax.Array:
    """What every part is at an operating point: a :class:`Finding` each; shape (places,).

    Args:
        loop: The models and the clock, after :func:`substituted`.
        params: Their parameters.
        key: The draw's random key.
        state: The loop's state before the sample.
        k: Index of the sample.
        places: The parts.
    """
    findings = []
    for place, part_map in zip(places, part_maps(loop, params, key, state, k, places), strict=True):
        part, own = part_of(loop, params, place)
        findings.append(finding_of(place, part_map, part, own))
    return jnp.stack(findings)


def finding_of(place: Place, part_map: PartMap, part: Any, own: Any) -> jax.Array:
    """What one part is at its operating point: differences to both sides at two sizes, against the derivative."""
    x, unravel = ravel_pytree(as_arrays((part_map.memory, part_map.signals)))
    memory = len(jax.tree.leaves(part_map.memory))
    pattern = directions(memory, x.size - memory)
    axes = pattern * (1.0 + jnp.abs(x))

    def function(model: Any, params: Any) -> Callable[[jax.Array], jax.Array]:
        return lambda at: ravel_pytree(as_arrays(part_map.apply(model, params, unravel(at))))[0]

    def slopes_of(of: Callable[[jax.Array], jax.Array]) -> jax.Array:
        return jax.vmap(lambda axis: jax.jvp(of, (x,), (axis,))[1])(axes)

    of = function(part, own)
    value, slopes = of(x), slopes_of(of)
    if not x.size or not value.size:
        return jnp.asarray(Finding.SMOOTH.value)
    noise, largest = NOISE * (1.0 + jnp.abs(value)), jnp.max(jnp.abs(slopes), axis=0)

    def sides(push: float) -> jax.Array:
        ahead, behind = jax.vmap(of)(x + push * axes), jax.vmap(of)(x - push * axes)
        return jnp.stack([ahead - value, value - behind]) / push

    def error(found: jax.Array, derivative: jax.Array, push: float) -> jax.Array:
        apart = jnp.maximum(jnp.abs(found - derivative) - noise / push, 0.0)
        return jnp.where(jnp.isfinite(apart), apart, jnp.inf)

    near, further = sides(SMALL), sides(LARGE)
    small, large = error(near, slopes, SMALL), error(further, slopes, LARGE)
    defect = jnp.any((small > DEVIATION * largest) & (small > SHRINKING * large))
    corner, beyond = jnp.asarray(False), jnp.asarray(False)
    if place.smoothness.extent != Extent.PIECEWISE:
        moves = jnp.stack([jnp.abs(sides(push)) * push for push in LADDER])
        signals = ~np.any(pattern[:, :memory], axis=1)[:, None]
        still = (moves[:-1] == 0.0) & (slopes == 0.0) & signals
        jumps = jnp.isfinite(moves[1:]) & (moves[1:] > JUMP * (1.0 + jnp.abs(value)))
        defect = defect | jnp.any(still & jumps)
    if place.inner:
        inner = slopes_of(function(*place.smoothness.substitute(own)))
        scale = DEVIATION * jnp.maximum(largest, jnp.max(jnp.abs(inner), axis=0))
        one_side = jnp.all(jnp.any(jnp.all(error(further, inner, LARGE) <= scale, axis=2), axis=0))
        cornered = jnp.any(large > scale)
        corner = cornered & one_side
        beyond = ~cornered & jnp.any(jnp.abs(inner - slopes) > scale)
    defect = defect & ~corner
    code = jnp.where(beyond, Finding.BEYOND.value, Finding.SMOOTH.value)
    return jnp.where(defect, Finding.DEFECT.value, jnp.where(corner, Finding.CORNER.value, code))


def directions(memory: int, signals: int) -> np.ndarray:
    """Directions in which a part is pushed, shape (directions, memory + signals): if few, one by one, and together."""
    random = np.random.default_rng(0)
    together = random.uniform(0.5, 1.5, (RANDOM, memory + signals)) * random.choice([-1.0, 1.0], (RANDOM, 1))
    together[: RANDOM // 2, ::2] *= -1.0
    alone = together.copy()
    alone[:, :memory] = 0.0
    parts = [together, alone] if memory and signals else [together]
    if memory + signals <= MOST_AXES:
        parts.append(np.eye(memory + signals))
    return np.concatenate(parts)


def require_smooth_there(study: Study, places: Sequence[Place], findings: np.ndarray) -> dict[str, int]:
    """Require that no part has a defect at any operating point.

    Args:
        study: The study.
        places: The parts.
        findings: A :class:`Finding` for each of them, shape (n, places).

    Returns:
        What is taken for the parts that lie at a corner or beyond it, in words, with the number of operating points.

    Raises:
        ConfigError: a part has no derivative there; either it lies on one of its boundaries, or it declares falsely.
    """
    notes, draws = {}, len(findings)
    for place, own in zip(places, findings.T, strict=True):
        defects, corners, beyond = (
            int(np.count_nonzero(own == finding)) for finding in (Finding.DEFECT, Finding.CORNER, Finding.BEYOND)
        )
        meaning = place.smoothness.meaning
        boundary = meaning.partition(";")[0]
        if defects and place.smoothness.extent == Extent.PIECEWISE:
            raise ConfigError(
                study.source,
                f"{place.label} has no derivative at {defects} of {draws} operating points, which lie on {boundary}; "
                "move the operating point or the boundary",
            )
        if defects:
            raise ConfigError(
                study.source,
                f"{place.label} declares that it is smooth, but at {defects} of {draws} operating points its "
                "derivative is not the effect of small deviations, as with a switch, a clip or rounding; declare "
                "piecewise(...) or not_smooth(...) in its field smooth (docs/extending.md)",
            )
        if corners:
            notes[f"{place.label} lies on {meaning}"] = corners
        if beyond:
            notes[f"{place.label} lies beyond {boundary}, where deviations do not pass"] = beyond
    return notes
