"""The measured output that a study predicts for the commands of a logged flight, and its derivatives."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.backend.plain import plain_options
from dssc_jax.closed_loop.sample import Loop, as_arrays, held_between_samples, initial_state, step
from dssc_jax.core.contracts import Controller
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Command
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight.replay import median_values
from dssc_jax.models.environment.sensors import IDEAL
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
    quiet = quiet_values(study)

    def outputs(values: Any, commands: Any) -> Any:
        given = dict(zip(names, values, strict=True))
        played = tuple(playback(row)(each) for row, each in zip(commands, study.loop.controller, strict=True))
        sensors = (IDEAL,) * len(study.loop.channels)
        loop: Loop = replace(study.loop, settled=None, sensor=sensors, controller=played)
        params, key = study.params({**quiet, **given}), draw_key(study.config.seed, 0)
        advance = held_between_samples(loop, params)

        def sample(at: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], Any]:
            state, k = at
            after, recorded = step(loop, params, key, state, k, advance)
            return (after, k + 1), tuple(each.y for each in recorded.measurements)

        begin = initial_state(loop, params, key), jnp.zeros((), jnp.int32)
        return jnp.stack(as_arrays(jax.lax.scan(sample, begin, length=samples)[1]))

    def with_slopes(values: Any, commands: Any) -> tuple[Any, Any]:
        def along(direction: Any) -> tuple[Any, Any]:
            return jax.jvp(lambda at: outputs(at, commands), (values,), (direction,))

        predicted, slopes = jax.vmap(along)(jnp.eye(len(names)))
        return predicted[0], slopes

    compiled = jax.jit(with_slopes, compiler_options=plain_options())

    def predict(values: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with arithmetic(study.config.loop.precision):
            real = jnp.result_type(float)
            predicted, slopes = compiled(jnp.asarray(values, real), jnp.asarray(commands, real))
            return np.asarray(predicted, float), np.asarray(slopes, float)

    return predict
