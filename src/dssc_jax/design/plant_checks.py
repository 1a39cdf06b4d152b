"""Checks of a user's own plant: its y', its linear part, and whether it uses the disturbances of the study."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.core.numerics import arithmetic, as_vector
from dssc_jax.core.signals import PlantInput
from dssc_jax.models.disturbances import NO_DISTURBANCE
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in
from dssc_jax.study.laws import nominal_params

POINTS = 4
"""Number of random points near its start at which a plant is examined."""
NEAR = 0.05
"""Standard deviation of the points' distance from the start x, relative to 0.1 + |x| in each state."""
PUSH = 0.1
"""Standard deviation of the random commands and disturbances at the points, in their own units."""
SAME_RATE = 1e-3
"""Relative tolerance of y' against the derivative of y, and of one slope against another."""


class PlantFindings(NamedTuple):
    """Properties of a plant at some points near its start.

    Args:
        wrong_rates: Mask of the channels whose y' differs from the derivative of y at every point, shape (channels,).
        effective_commands: Mask of the commands at which a disturbance has an effect at some point, shape (channels,).
        effective_inputs: Mask of the named inputs at which a disturbance has an effect at some point, shape (inputs,).
        is_inconsistent: Whether ``linear`` with ``remainder`` gives other slopes than ``derivative`` at some point.
    """

    wrong_rates: np.ndarray
    effective_commands: np.ndarray
    effective_inputs: np.ndarray
    is_inconsistent: bool


class PlantAtPoint(NamedTuple):
    """Values and derivatives of a plant's functions at one state, for one set of commands and disturbances.

    Args:
        along: Time derivative of y, as it follows from the slopes of the states, shape (channels,).
        rate: The y' that the plant measures, shape (channels,).
        effects: Derivatives of the slopes, of every y and of every y' with respect to the disturbances at the commands
            and at the named inputs, shape (states + 2 channels, channels + inputs).
        slopes: Slopes of the states, their time derivatives, by ``derivative``, shape (states,).
        slopes_of_parts: Slopes of the states by ``linear`` and ``remainder``, which a run uses, shape (states,); equal
            to ``slopes`` for a plant without these parts.
    """

    along: jax.Array
    rate: jax.Array
    effects: jax.Array
    slopes: jax.Array
    slopes_of_parts: jax.Array


def plant_warnings(study: Study) -> list[str]:
    """Warnings of a user's own plant that contradicts itself, or that ignores a disturbance of the study.

    A plant contradicts itself if its y' is not the derivative of its y, or if ``linear`` and ``remainder`` do not add
    up to ``derivative``. Derivatives at random points near the start show this. Plants of this package, plants with a
    state outside of JAX, and plants that fly in a wind are not examined.

    Args:
        study: The study; uncertain numbers have their nominal values.
    """
    loop = study.loop
    is_users_plant = ":" in str(study.config.plant.get("kind", ""))
    has_native_state = loop.mimo_plant.begin is not None
    has_wind = kind_in(study.config, "wind") != "none"
    if not is_users_plant or has_native_state or has_wind:
        return []
    findings = plant_findings(study)
    warnings = []
    if findings.is_inconsistent:
        warnings.append(
            "the plant's `linear` and `remainder` give other slopes than its `derivative`: a run takes the former, so "
            "that one of them is wrong"
        )
    for channel, wrong in zip(loop.channels, findings.wrong_rates, strict=True):
        if wrong:
            place = f" of {channel}" if channel else ""
            warnings.append(
                f"the plant's y'{place} is not the derivative of its y along its own slopes, so that whatever takes y' "
                "is misled: return it from `measure`, or take a [differentiator]"
            )
    for channel, model, acts in zip(loop.channels, loop.disturbance, findings.effective_commands, strict=True):
        if model != NO_DISTURBANCE and not acts:
            place = f" {channel}" if channel else ""
            warnings.append(
                f"the disturbance at the command{place} has no effect: the plant does not use it (`drive.disturbance`)"
            )
    for name, model, acts in zip(loop.input_names, loop.inputs, findings.effective_inputs, strict=True):
        if model != NO_DISTURBANCE and not acts:
            warnings.append(
                f"the disturbance at the input {name} has no effect: the plant does not use it (`drive.inputs`)"
            )
    return warnings


def plant_findings(study: Study) -> PlantFindings:
    """Examine the plant of a study at random points near its start.

    The y' of a channel counts as wrong if it differs from the derivative of y at every point where both are finite.
    """
    channel_count = len(study.loop.channels)
    input_count = len(study.loop.input_names)
    mismatch_counts = np.zeros(channel_count, int)  # points at which y' is wrong
    finite_counts = np.zeros(channel_count, int)
    has_effect = np.zeros(channel_count + input_count, bool)
    is_inconsistent = False
    random = np.random.default_rng(0)
    with arithmetic():
        start, examine = plant_examination(study)
        for _ in range(POINTS):
            x = start + NEAR * (0.1 + jnp.abs(start)) * random.normal(size=start.shape)
            signals = PUSH * random.normal(size=2 * channel_count + input_count)
            along, rate, effects, slopes, slopes_of_parts = map(np.asarray, examine(x, signals))
            tolerance = SAME_RATE * np.abs(slopes).max(initial=0.0)
            is_inconsistent |= not np.allclose(slopes, slopes_of_parts, rtol=SAME_RATE, atol=tolerance, equal_nan=True)
            is_finite = np.isfinite(along) & np.isfinite(rate)
            finite_counts += is_finite
            differs = np.abs(along - rate) > SAME_RATE * np.maximum(np.abs(along), np.abs(rate))
            mismatch_counts += is_finite & differs
            has_effect |= np.any(effects != 0.0, axis=0)
    return PlantFindings(
        wrong_rates=(finite_counts > 0) & (mismatch_counts == finite_counts),
        effective_commands=has_effect[:channel_count],
        effective_inputs=has_effect[channel_count:],
        is_inconsistent=is_inconsistent,
    )


class PlantExamination(NamedTuple):
    """A compiled function that examines a plant at a point, and the plant's start.

    Args:
        start: The plant's state at the start as a vector, shape (states,).
        examine: (state, signals) -> values and derivatives at this point. The signals are the commands, the
            disturbances at the commands, and those at the named inputs, shape (2 channels + inputs,).
    """

    start: jax.Array
    examine: Callable[[jax.Array, np.ndarray], PlantAtPoint]


def plant_examination(study: Study) -> PlantExamination:
    """Make the function that examines a study's plant; the plant's numbers have their nominal values."""
    plant = study.loop.mimo_plant
    channel_count = len(study.loop.channels)
    params = nominal_params(study.template).plant
    start, unravel = as_vector(plant.init(params))

    def drive_of(signals: jax.Array) -> PlantInput:
        """The plant's input with these signals, without wind."""
        commands, matched, inputs = jnp.split(signals, [channel_count, 2 * channel_count])
        return PlantInput(tuple(commands), disturbance=tuple(matched), wind=None, inputs=tuple(inputs))

    def slope(x: jax.Array, signals: jax.Array) -> jax.Array:
        """Slopes of the states x by ``derivative``, shape (states,), for the given signals."""
        slopes, _ = ravel_pytree(plant.derivative(params, unravel(x), drive_of(signals), 0.0))
        return slopes

    def measured_outputs(x: jax.Array, signals: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The outputs y, then the rates y', of all channels, each of shape (channels,)."""
        measurements = plant.measure(params, unravel(x), drive_of(signals))
        outputs = jnp.stack([jnp.asarray(measurement.y) for measurement in measurements])
        return outputs, jnp.stack([jnp.asarray(measurement.y_dot) for measurement in measurements])

    def slope_of_parts(x: jax.Array, signals: jax.Array) -> jax.Array:
        """Slopes of the states by ``linear`` and ``remainder``; by ``derivative`` if the plant has no linear part."""
        if plant.linear is None:
            return slope(x, signals)
        linear = plant.linear(params)
        columns = jnp.array([*linear.command, *linear.disturbance, *linear.inputs], float)
        total = jnp.array(linear.a, float) @ x + signals[: len(columns)] @ columns
        if plant.remainder is None:
            return total
        return total + jnp.array(jax.tree.leaves(plant.remainder(params, unravel(x), drive_of(signals), 0.0)))

    @jax.jit
    def examine(x: jax.Array, signals: jax.Array) -> PlantAtPoint:
        """Examine the plant at a state and for these signals."""

        def outputs_at(state: jax.Array) -> jax.Array:
            """The outputs y of all channels, shape (channels,), at a state."""
            outputs, _ = measured_outputs(state, signals)
            return outputs

        _, along = jax.jvp(outputs_at, (x,), (slope(x, signals),))
        _, rate = measured_outputs(x, signals)
        slope_effects = jax.jacfwd(slope, argnums=1)(x, signals)
        output_effects, rate_effects = jax.jacfwd(measured_outputs, argnums=1)(x, signals)
        effects = jnp.concatenate([slope_effects, output_effects, rate_effects])
        return PlantAtPoint(
            along=along,
            rate=rate,
            effects=effects[:, channel_count:],  # without the commands
            slopes=slope(x, signals),
            slopes_of_parts=slope_of_parts(x, signals),
        )

    return PlantExamination(start, examine)
