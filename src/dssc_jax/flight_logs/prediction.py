"""The measured output that a study predicts for the commands of a logged flight, and its derivatives."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.control import near_reference
from dssc_jax.closed_loop.sample import LoopState, held_between_samples, initial_state, step
from dssc_jax.core.contracts import Controller
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Command, Measurement, Params, ReferencePoint, Scalar
from dssc_jax.engine.evaluation import require_steps_in_any_order
from dssc_jax.engine.plain import plain_options
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_logs.replay import median_values
from dssc_jax.models.sensors import IDEAL
from dssc_jax.study import Study

RANDOM = ("std", "turbulence")
"""Fields of disturbances and winds that scale what is random."""

Outputs: TypeAlias = Callable[[jax.Array, jax.Array, jax.Array | int], jax.Array]
"""(Values of the numbers, shape (n,); commands, shape (channels, samples); index of the draw) -> outputs, shape
(channels, samples)."""

Prediction: TypeAlias = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""(Values of the numbers, shape (n,); commands, shape (channels, samples)) -> output of each channel, shape
(channels, samples), and its derivative by each number, shape (n, channels, samples)."""


def playback(controller: Controller, commands: jax.Array) -> Controller:
    """A controller that gives the logged commands of its channel, shape (samples,), to the plant."""

    def first_sample(params: Params, measurement: Measurement, reference: ReferencePoint) -> Scalar:
        return jnp.zeros(())

    def logged_command(
        params: Params, sample: jax.Array, measurement: Measurement, reference: ReferencePoint, dt: Scalar
    ) -> tuple[Scalar, Command, tuple[()]]:
        return sample + 1.0, Command(commands[sample.astype(jnp.int32)], jnp.zeros(())), ()

    return controller._replace(init=first_sample, step=logged_command)


def quiet_values(study: Study) -> dict[str, float]:
    """Medians of all laws, and 0 for what scales random disturbances and winds."""
    values = median_values(study)
    for name in study.numbers:
        fields = name.split(".")
        if fields[0] in ("disturbance", "wind") and fields[-1] in RANDOM:
            values[name] = 0.0
    return values


def simulated_outputs(study: Study, names: Sequence[str], samples: int, quiet: bool) -> Outputs:
    """The program that simulates the plant with logged commands: readings of each channel, angles near the reference.

    The plant starts as in the study. Numbers without a name here have the medians of their laws. ``quiet`` leaves out
    sensors, random disturbances and random winds.
    """
    fixed = quiet_values(study) if quiet else median_values(study)
    sensors = (IDEAL,) * len(study.loop.channels) if quiet else study.loop.sensor

    require_steps_in_any_order(study, "the prediction of a logged flight")

    def outputs(values: jax.Array, commands: jax.Array, index: jax.Array | int) -> jax.Array:
        controllers = [playback(*pair) for pair in zip(study.loop.controller, commands, strict=True)]
        loop = replace(study.loop, settled=None, sensor=sensors, controller=tuple(controllers))
        params = study.params({**fixed, **dict(zip(names, values, strict=True))})
        key = draw_key(study.config.seed, index)
        advance = held_between_samples(loop, params)

        def sample(carry: tuple[LoopState, Scalar], _: None) -> tuple[tuple[LoopState, Scalar], tuple[Scalar, ...]]:
            state, k = carry
            after, recorded = step(loop, params, key, state, k, advance)
            readings = []
            for i, (controlled, reference) in enumerate(zip(recorded.controlled, recorded.references, strict=True)):
                readings.append(near_reference(loop, i, controlled.reading, reference).y)
            return (after, k + 1), tuple(readings)

        initial = (initial_state(loop, params, key), jnp.zeros((), jnp.int32))
        _, readings = jax.lax.scan(sample, initial, length=samples)
        return jnp.stack(as_arrays(readings))

    return outputs


def prediction(study: Study, names: Sequence[str], samples: int) -> Prediction:
    """Compile the prediction: the output without noise and random disturbances, and its derivatives in forward mode."""
    outputs = simulated_outputs(study, names, samples, quiet=True)

    def with_slopes(values: jax.Array, commands: jax.Array) -> tuple[jax.Array, jax.Array]:
        def slope(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda x: outputs(x, commands, 0), (values,), (direction,))

        predicted, slopes = jax.vmap(slope)(jnp.eye(len(names)))
        return predicted[0], slopes

    compiled = jax.jit(with_slopes, compiler_options=plain_options())

    def predict(values: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with arithmetic(study.config.loop.precision):
            real = jnp.result_type(float)
            predicted, slopes = compiled(jnp.asarray(values, real), jnp.asarray(commands, real))
            return np.asarray(predicted, float), np.asarray(slopes, float)

    return predict


def study_noise(
    study: Study, names: Sequence[str], values: np.ndarray, commands: np.ndarray, replicates: int
) -> np.ndarray:
    """Outputs with sensors, random disturbances and winds less those without, shape (replicates, channels, samples)."""
    samples = commands.shape[1]
    quiet = simulated_outputs(study, names, samples, quiet=True)
    noisy = simulated_outputs(study, names, samples, quiet=False)

    def noise(values: jax.Array, commands: jax.Array) -> jax.Array:
        readings = jax.vmap(lambda index: noisy(values, commands, index))(jnp.arange(replicates))
        return readings - quiet(values, commands, 0)

    with arithmetic(study.config.loop.precision):
        real = jnp.result_type(float)
        compiled = jax.jit(noise, compiler_options=plain_options())
        return np.asarray(compiled(jnp.asarray(values, real), jnp.asarray(commands, real)), float)
