"""Whether a plant of one's own is consistent: its y', its linear part, and the disturbances that it has to use."""

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
from dssc_jax.study.fitting import nominal_params

POINTS = 4
NEAR = 0.05  # distance of these points from the start, relative to 0.1 + |x|
PUSH = 0.1  # size of commands and disturbances there
SAME_RATE = 1e-3  # relative difference of y' from the derivative of y that counts as none


class PlantFindings(NamedTuple):
    """Properties of a plant at some points near its start.

    Args:
        wrong_rates: Mask of the channels whose y' is not the derivative of y at any point, shape (channels,).
        effective_commands: Mask of the commands at which a disturbance has an effect at some point, shape (channels,).
        effective_inputs: Mask of the named inputs at which one has, shape (inputs,).
        is_inconsistent: Whether ``linear`` with ``remainder`` gives other slopes than ``derivative`` at some point.
    """

    wrong_rates: np.ndarray
    effective_commands: np.ndarray
    effective_inputs: np.ndarray
    is_inconsistent: bool


class PlantAtPoint(NamedTuple):
    """What a plant's functions give at one state and for one set of signals.

    Args:
        along: Derivative of y along the slopes of the states, shape (channels,).
        rate: The y' that the plant measures, shape (channels,).
        effects: Derivatives of slopes and measurements by matched disturbances and named inputs, shape
            (..., channels + inputs).
        slopes: Slopes of the states by ``derivative``, shape (states,).
        slopes_of_parts: Slopes by ``linear`` and ``remainder``, which a run takes; without these parts, ``slopes``.
    """

    along: jax.Array
    rate: jax.Array
    effects: jax.Array
    slopes: jax.Array
    slopes_of_parts: jax.Array


def plant_warnings(study: Study) -> list[str]:
    """Warnings of a user's own plant that contradicts itself, or that ignores an input with a disturbance.

    It contradicts itself if its y' is not the derivative of its y, or if its linear part is not that of its slopes.
    This follows from derivatives at some points near its start. A plant of this package, one with a state outside of
    JAX, and one that flies in a wind are not examined.

    Args:
        study: The study; uncertain numbers have their median values.
    """
    loop = study.loop
    foreign = ":" in str(study.config.plant.get("kind", ""))
    if not foreign or loop.mimo_plant.begin is not None or kind_in(study.config, "wind") != "none":
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
    """Examine the plant of a study at some points near its start."""
    channel_count = len(study.loop.channels)
    input_count = len(study.loop.input_names)
    mismatch_counts = np.zeros(channel_count, int)
    finite_counts = np.zeros(channel_count, int)
    has_effect = np.zeros(channel_count + input_count, bool)
    is_inconsistent = False
    random = np.random.default_rng(0)
    with arithmetic():
        start, examine = start_and_examination(study)
        for _ in range(POINTS):
            x = start + NEAR * (0.1 + jnp.abs(start)) * random.normal(size=start.shape)
            signals = PUSH * random.normal(size=2 * channel_count + input_count)
            along, rate, effects, slopes, slopes_of_parts = map(np.asarray, examine(x, signals))
            scale = SAME_RATE * np.abs(slopes).max(initial=0.0)
            is_inconsistent |= not np.allclose(slopes, slopes_of_parts, SAME_RATE, scale, equal_nan=True)
            is_finite = np.isfinite(along) & np.isfinite(rate)
            finite_counts += is_finite
            mismatch_counts += is_finite & (np.abs(along - rate) > SAME_RATE * np.maximum(np.abs(along), np.abs(rate)))
            has_effect |= np.any(effects != 0.0, axis=0)
    return PlantFindings(
        (finite_counts > 0) & (mismatch_counts == finite_counts),
        has_effect[:channel_count],
        has_effect[channel_count:],
        is_inconsistent,
    )


def start_and_examination(
    study: Study,
) -> tuple[jax.Array, Callable[[jax.Array, np.ndarray], PlantAtPoint]]:
    """The plant's state at the start as a vector, and a compiled function that examines the plant at a point.

    The function takes a state and the signals: the commands, the matched disturbances and the named inputs.
    """
    plant = study.loop.mimo_plant
    channel_count = len(study.loop.channels)
    params = nominal_params(study.template).plant
    start, unravel = as_vector(plant.init(params))

    def drive_of(signals: jax.Array) -> PlantInput:
        commands, matched, inputs = jnp.split(signals, [channel_count, 2 * channel_count])
        return PlantInput(tuple(commands), tuple(matched), None, tuple(inputs))

    def slope(x: jax.Array, signals: jax.Array) -> jax.Array:
        return ravel_pytree(plant.derivative(params, unravel(x), drive_of(signals), 0.0))[0]

    def measured_outputs(x: jax.Array, signals: jax.Array) -> tuple[jax.Array, jax.Array]:
        measurements = plant.measure(params, unravel(x), drive_of(signals))
        outputs = jnp.stack([jnp.asarray(measurement.y) for measurement in measurements])
        return outputs, jnp.stack([jnp.asarray(measurement.y_dot) for measurement in measurements])

    def slope_of_parts(x: jax.Array, signals: jax.Array) -> jax.Array:
        """The sum of ``linear`` and ``remainder``; that of ``derivative`` if the plant has no linear part."""
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
        _, along = jax.jvp(lambda state: measured_outputs(state, signals)[0], (x,), (slope(x, signals),))
        effects = jnp.concatenate([jax.jacfwd(slope, 1)(x, signals), *jax.jacfwd(measured_outputs, 1)(x, signals)])
        return PlantAtPoint(
            along=along,
            rate=measured_outputs(x, signals)[1],
            effects=effects[:, channel_count:],
            slopes=slope(x, signals),
            slopes_of_parts=slope_of_parts(x, signals),
        )

    return start, examine
