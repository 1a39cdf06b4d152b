"""The measured output that a study predicts for the commands of a logged flight, and its derivatives."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.control import near_reference
from dssc_jax.closed_loop.loop import Loop
from dssc_jax.closed_loop.sample import held_between_samples, initial_state, step
from dssc_jax.core.contracts import Controller
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Command
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_logs.replay import median_values
from dssc_jax.lanes.plain import plain_options
from dssc_jax.models.sensors import IDEAL
from dssc_jax.study import Study

RANDOM = ("std", "turbulence")
"""Fields of disturbances and winds that scale what is random."""

Prediction = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def playback(commands: Any) -> Callable[[Controller], Controller]:
    """A controller in whose place the logged commands of a channel, shape (samples,), are given to the plant."""

    def started(params: Any, measurement: Any, reference: Any) -> Any:
        return jnp.zeros(())

    def played(params: Any, state: Any, measurement: Any, reference: Any, dt: Any) -> tuple[Any, Command, tuple[()]]:
        return state + 1.0, Command(commands[state.astype(jnp.int32)], jnp.zeros(())), ()

    return lambda controller: controller._replace(init=started, step=played)


def quiet_values(study: Study) -> dict[str, float]:
    """Medians of all laws, and 0 for what scales random disturbances and winds."""
    random = {
        name: 0.0
        for name in study.numbers
        if name.split(".")[0] in ("disturbance", "wind") and name.split(".")[-1] in RANDOM
    }
    return {**median_values(study), **random}


def played_outputs(study: Study, names: Sequence[str], samples: int, quiet: bool) -> Callable[[Any, Any, Any], Any]:
    """The program that simulates the plant with logged commands.

    The plant starts as in the study. Numbers that are not given have the medians of their laws.

    Args:
        study: The study, without a sweep.
        names: The numbers that are given.
        samples: Samples to simulate.
        quiet: Without sensors, random disturbances and random winds.

    Returns:
        (values of the numbers, shape (n,); commands, shape (channels, samples); index of the draw) -> readings of each
        channel's output, shape (channels, samples); an angle lies within pi of its reference.
    """
    fixed = quiet_values(study) if quiet else median_values(study)
    sensors = (IDEAL,) * len(study.loop.channels) if quiet else study.loop.sensor

    def outputs(values: Any, commands: Any, index: Any) -> Any:
        played = tuple(playback(row)(each) for row, each in zip(commands, study.loop.controller, strict=True))
        loop: Loop = replace(study.loop, settled=None, sensor=sensors, controller=played)
        params = study.params({**fixed, **dict(zip(names, values, strict=True))})
        key = draw_key(study.config.seed, index)
        advance = held_between_samples(loop, params)

        def sample(at: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], Any]:
            state, k = at
            after, recorded = step(loop, params, key, state, k, advance)
            readings = []
            for i, (controlled, reference) in enumerate(zip(recorded.controlled, recorded.references, strict=True)):
                readings.append(near_reference(loop, i, controlled.reading, reference).y)
            return (after, k + 1), tuple(readings)

        begin = initial_state(loop, params, key), jnp.zeros((), jnp.int32)
        return jnp.stack(as_arrays(jax.lax.scan(sample, begin, length=samples)[1]))

    return outputs


def prediction(study: Study, names: Sequence[str], samples: int) -> Prediction:
    """Compile the prediction.

    The plant starts as in the study. There is no noise and no random disturbance. Numbers that are not given have the
    medians of their laws.

    Args:
        study: The study, without a sweep.
        names: The numbers that are given.
        samples: Samples to simulate.

    Returns:
        (values of the numbers, shape (n,); commands, shape (channels, samples)) -> output of each channel, shape
        (channels, samples), and its derivative by each number, shape (n, channels, samples), in forward mode.
    """
    outputs = played_outputs(study, names, samples, quiet=True)

    def with_slopes(values: Any, commands: Any) -> tuple[Any, Any]:
        def along(direction: Any) -> tuple[Any, Any]:
            return jax.jvp(lambda at: outputs(at, commands, 0), (values,), (direction,))

        predicted, slopes = jax.vmap(along)(jnp.eye(len(names)))
        return predicted[0], slopes

    compiled = jax.jit(with_slopes, compiler_options=plain_options())

    def predict(values: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with arithmetic(study.config.loop.precision):
            real = jnp.result_type(float)
            predicted, slopes = compiled(jnp.asarray(values, real), jnp.asarray(commands, real))
            return np.asarray(predicted, float), np.asarray(slopes, float)

    return predict


def noise_of_study(
    study: Study, names: Sequence[str], values: np.ndarray, commands: np.ndarray, replicates: int
) -> np.ndarray:
    """What sensors, random disturbances and random winds of a study add to the output for logged commands.

    Args:
        study: The study, without a sweep.
        names: The numbers that are given.
        values: Their values, shape (n,).
        commands: Logged commands, shape (channels, samples).
        replicates: Number of independent noises.

    Returns:
        Readings less the output without all that, shape (replicates, channels, samples).
    """
    samples = commands.shape[1]
    quiet, noisy = (played_outputs(study, names, samples, quiet=each) for each in (True, False))

    def added(values: Any, commands: Any) -> Any:
        indices = jnp.arange(replicates)
        readings = jax.vmap(lambda index: noisy(values, commands, index))(indices)
        return readings - quiet(values, commands, 0)

    with arithmetic(study.config.loop.precision):
        real = jnp.result_type(float)
        compiled = jax.jit(added, compiler_options=plain_options())
        return np.asarray(compiled(jnp.asarray(values, real), jnp.asarray(commands, real)), float)
