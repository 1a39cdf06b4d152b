"""The measured output that a study predicts for the commands of a logged flight, and its derivatives."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.control import near_reference
from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.loop import Loop
from dssc_jax.closed_loop.plant_inputs import plant_input
from dssc_jax.closed_loop.sample import LoopState, held_between_samples, step
from dssc_jax.core.contracts import Controller, Disturbance
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Command, Measurement, Params, ReferencePoint, Scalar, State
from dssc_jax.engine import kernels
from dssc_jax.engine.evaluation import DIRECTION, require_steps_in_any_order
from dssc_jax.engine.kernels import Start
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_logs.fit.filtered_outputs import deterministic_sensors
from dssc_jax.flight_logs.hints.references import median_values
from dssc_jax.study import Study

RANDOM = ("std", "turbulence")
"""Fields of disturbances and winds that scale what is random."""
REPLICATES = 64  # simulations of random disturbances
NO_NUMBERS: Mapping[str, float] = MappingProxyType({})


class Outputs(Protocol):
    """The program that simulates the outputs."""

    def __call__(
        self, values: Sequence[Scalar], commands: jax.Array, index: jax.Array | int, forces: jax.Array | None = None
    ) -> tuple[Scalar, ...]:
        """The outputs of each channel, shape (samples,).

        Args:
            values: Values of the numbers.
            commands: Commands, shape (channels, samples).
            index: Index of the draw.
            forces: Forces, shape (samples,); None: there are none.
        """
        ...


class Prediction(Protocol):
    """The predicted output and its derivatives."""

    def __call__(
        self, values: np.ndarray, commands: np.ndarray, forces: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The output of each channel, shape (channels, samples), and its derivatives, shape (n, channels, samples).

        Args:
            values: Values of the n numbers. Values of further numbers, the presets of :func:`prediction`, may follow;
                without them, these numbers have the study's values.
            commands: Commands before the actuators, shape (channels, samples).
            forces: Further disturbances of a plant of one channel, each held over a sample, shape (samples,) [u]; None:
                there are none.
        """
        ...


class PushedState(NamedTuple):
    """State of a disturbance to which a given force is added.

    Args:
        disturbance: State of the disturbance.
        sample: Number of the next sample.
        force: The force over the present sample [u].
    """

    disturbance: State
    sample: Scalar
    force: Scalar


def playback(controller: Controller, commands: jax.Array) -> Controller:
    """A controller that gives the logged commands of its channel, shape (samples,), whatever is measured.

    Its state is the number of the present sample.
    """

    def first_sample(params: Params, measurement: Measurement, reference: ReferencePoint) -> Scalar:
        return jnp.zeros(())

    def logged_command(
        params: Params, sample: jax.Array, measurement: Measurement, reference: ReferencePoint, dt: Scalar
    ) -> tuple[Scalar, Command, tuple[()]]:
        return sample + 1.0, Command(commands[sample.astype(jnp.int32)], jnp.zeros(())), ()

    return controller._replace(init=first_sample, step=logged_command)


def pushed(disturbance: Disturbance, forces: jax.Array) -> Disturbance:
    """A disturbance plus given forces [u], each held over one sample, shape (samples,)."""

    def init(params: Params, key: jax.Array) -> PushedState:
        return PushedState(disturbance.init(params, key), jnp.zeros(()), jnp.zeros(()))

    def sample(params: Params, state: PushedState, key: jax.Array, t: Scalar, dt: Scalar) -> PushedState:
        next_state = disturbance.step(params, state.disturbance, key, t, dt)
        return PushedState(next_state, state.sample + 1.0, forces[jnp.asarray(state.sample).astype(jnp.int32)])

    def value(params: Params, state: PushedState, measurement: Measurement, sigma: Scalar, t: Scalar) -> Scalar:
        return disturbance.value(params, state.disturbance, measurement, sigma, t) + state.force

    return disturbance._replace(init=init, step=sample, value=value)


def quiet_values(study: Study) -> dict[str, float]:
    """Values of all numbers: the medians of their laws, but 0 for the strengths of random disturbances and winds."""
    values = median_values(study)
    for name in study.numbers:
        fields = name.split(".")
        if fields[0] in ("disturbance", "wind") and fields[-1] in RANDOM:
            values[name] = 0.0
    return values


def played_loop(loop: Loop, commands: jax.Array) -> Loop:
    """A loop whose controllers give logged commands, shape (channels, samples)."""
    controllers = [playback(*pair) for pair in zip(loop.controller, commands, strict=True)]
    return replace(loop, settled=None, controller=tuple(controllers))


def driving_forces(study: Study, numbers: Mapping[str, float], commands: np.ndarray) -> np.ndarray:
    """The sum of actuator output and disturbance at the end of each sample, without noise, shape (samples,) [u].

    Args:
        study: A study of one channel.
        numbers: Values of numbers; the others have the medians of their laws.
        commands: The logged commands, shape (1, samples).
    """
    values = {**quiet_values(study), **numbers}

    def driven(logged: jax.Array) -> jax.Array:
        loop = replace(played_loop(study.loop, logged), sensor=deterministic_sensors(study))
        params = study.params(values)
        key = draw_key(study.config.seed, 0)
        advance = held_between_samples(loop, params)

        def sample(state: LoopState, k: jax.Array) -> tuple[LoopState, Scalar]:
            """Advance by sample k; return the state after it, and the force at its end."""
            after, _ = step(loop, params, key, state, k, advance)
            (channel,) = after.channels
            t = (k + 1) * loop.sample_time
            drive = plant_input(loop, params, after.disturbances, after.wind, after.plant, (channel.reaching,), t)
            return after, drive.command[0] + drive.disturbance[0]

        _, forces = jax.lax.scan(sample, initial_state(loop, params, key), jnp.arange(logged.shape[1]))
        return jnp.asarray(forces)

    with arithmetic(study.config.loop.precision):
        return np.asarray(jax.jit(driven)(np.asarray(commands, float)), float)


def simulated_outputs(
    study: Study, names: Sequence[str], samples: int, fixed: Mapping[str, float], sensors: bool
) -> Outputs:
    """The program that simulates the plant with logged commands: readings of each channel, angles near the reference.

    The plant starts as in the study.

    Args:
        study: The study.
        names: The numbers that are inputs of the program.
        samples: Number of samples.
        fixed: Values of all numbers; those of the inputs do not count.
        sensors: Whether readings are those of the study's sensors, or of their lags alone without noise.
    """
    channel_sensors = study.loop.sensor if sensors else deterministic_sensors(study)

    require_steps_in_any_order(study, "the prediction of a logged flight")

    def outputs(
        values: Sequence[Scalar], commands: jax.Array, index: jax.Array | int, forces: jax.Array | None = None
    ) -> tuple[Scalar, ...]:
        """The readings of each channel at all samples, with the logged commands in place of the controllers'.

        Args:
            values: The numbers ``names``.
            commands: Logged commands, shape (channels, samples).
            index: Index of the draw, which selects its noise.
            forces: Further disturbances of the only channel, shape (samples,); None: there are none.
        """
        loop = replace(played_loop(study.loop, commands), sensor=channel_sensors)
        if forces is not None:
            (disturbance,) = loop.disturbance
            loop = replace(loop, disturbance=(pushed(disturbance, forces),))
        params = study.params({**fixed, **dict(zip(names, values, strict=True))})
        key = draw_key(study.config.seed, index)
        advance = held_between_samples(loop, params)

        def sample(carry: tuple[LoopState, Scalar], _: None) -> tuple[tuple[LoopState, Scalar], tuple[Scalar, ...]]:
            """Advance by one sample; return the next state and sample number, and each channel's reading."""
            state, k = carry
            next_state, recorded = step(loop, params, key, state, k, advance)
            readings = []
            for i, (controlled, reference) in enumerate(zip(recorded.controlled, recorded.references, strict=True)):
                readings.append(near_reference(loop, i, controlled.reading, reference).y)
            return (next_state, k + 1), tuple(readings)

        initial = (initial_state(loop, params, key), jnp.zeros((), jnp.int32))
        _, readings = jax.lax.scan(sample, initial, length=samples)
        return as_arrays(readings)

    return outputs


def prediction(
    study: Study, names: Sequence[str], samples: int, presets: Mapping[str, float] = NO_NUMBERS
) -> Prediction:
    """Compile the prediction: the output without noise and random disturbances, and its derivatives in forward mode.

    XLA fuses the few operations that a plant of one channel has in a sample into a few kernels.

    Args:
        study: The study, without a sweep.
        names: The numbers.
        samples: Number of samples of the simulation.
        presets: Values of numbers without laws that a call may add to its values, to get their derivatives as well.
            Only a plant of several channels uses them.
    """
    if len(study.loop.channels) > 1:
        return prediction_by_lanes(study, names, samples, presets)
    outputs = simulated_outputs(study, names, samples, quiet_values(study), sensors=False)

    def with_slopes(values: jax.Array, commands: jax.Array, forces: jax.Array) -> tuple[jax.Array, jax.Array]:
        def slope(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda x: jnp.stack(outputs(list(x), commands, 0, forces)), (values,), (direction,))

        predicted, slopes = jax.vmap(slope)(jnp.eye(len(names)))
        return predicted[0], slopes

    compiled = jax.jit(with_slopes)

    def predict(
        values: np.ndarray, commands: np.ndarray, forces: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        acting = np.zeros(samples) if forces is None else np.asarray(forces, float)
        with arithmetic(study.config.loop.precision):
            predicted, slopes = compiled(np.asarray(values, float), np.asarray(commands, float), acting)
            return np.asarray(predicted, float), np.asarray(slopes, float)

    return predict


def prediction_by_lanes(
    study: Study, names: Sequence[str], samples: int, presets: Mapping[str, float] = NO_NUMBERS
) -> Prediction:
    """The prediction of a plant of several channels, by the code of the lanes, with one lane for each derivative.

    A vehicle has thousands of operations in a sample, each of which XLA would call as a kernel. The commands are
    constants of the program, so that other commands compile it again. The arguments are those of :func:`prediction`.
    """
    # A call gives values of all its numbers (NaN here), but may leave out those of the presets.
    preset = [math.nan] * len(names) + list(presets.values())
    names = (*names, *presets)
    outputs = simulated_outputs(study, names, samples, quiet_values(study), sensors=False)
    programs: dict[bytes, Start] = {}

    def program(commands: np.ndarray) -> Start:
        def lane(values: dict[str, jax.Array], index: jax.Array) -> tuple[Scalar, ...]:
            numbers = [values[name] for name in names]
            tangent = [jnp.where(values[DIRECTION] == i, 1.0, 0.0) for i in range(len(names))]
            predicted, slopes = jax.jvp(lambda x: outputs(x, jnp.asarray(commands), 0), (numbers,), (tangent,))
            return (*predicted, *slopes)

        return kernels.compile_batches(kernels.requested_form(), lane, [*names, DIRECTION], len(names), None, None)

    def predict(
        values: np.ndarray, commands: np.ndarray, forces: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        assert forces is None  # forces are for plants of one channel only
        with arithmetic(study.config.loop.precision):
            key = commands.tobytes()
            if key not in programs:
                programs[key] = program(commands)
            count = len(values)
            extended = [*values, *preset[count:]]
            columns = {name: np.full(count, value) for name, value in zip(names, extended, strict=True)}
            columns[DIRECTION] = np.arange(count, dtype=float)
            results, _ = programs[key](columns, np.zeros(count, np.uint32))()
        channels = len(study.loop.channels)
        predicted = np.array([results[i][0] for i in range(channels)], float)
        slopes = np.array([results[channels + i] for i in range(channels)], float)
        return predicted, np.moveaxis(slopes, 1, 0)

    return predict


def declares_noise(study: Study) -> bool:
    """Whether a study has random disturbances or winds."""
    return quiet_values(study) != median_values(study)


class NoiseProgram:
    """Simulated outputs with random disturbances and winds less those without, compiled for the commands of a log.

    Args:
        study: The study, without a sweep.
        names: The numbers.
        commands: The commands, shape (channels, samples).
        sensors: Whether the noise of the sensors is included.
    """

    def __init__(self, study: Study, names: Sequence[str], commands: np.ndarray, sensors: bool) -> None:
        samples = commands.shape[1]
        self.study = study
        self.names = names
        quiet = simulated_outputs(study, names, samples, quiet_values(study), sensors=False)
        noisy = simulated_outputs(study, names, samples, median_values(study), sensors)

        def lane(lane_values: dict[str, jax.Array], index: jax.Array) -> tuple[Scalar, ...]:
            numbers = [lane_values[name] for name in names]
            logged = jnp.asarray(commands)
            return (*noisy(numbers, logged, index), *quiet(numbers, logged, 0))

        with arithmetic(study.config.loop.precision):
            self.start = kernels.compile_batches(kernels.requested_form(), lane, list(names), REPLICATES, None, None)

    def simulate(self, values: np.ndarray, replicates: int) -> np.ndarray:
        """The noise at values of the numbers, shape (replicates, channels, samples).

        Args:
            values: The values, shape (n,).
            replicates: Number of simulations, at most :data:`REPLICATES`.
        """
        with arithmetic(self.study.config.loop.precision):
            columns = {name: np.full(replicates, value) for name, value in zip(self.names, values, strict=True)}
            results, _ = self.start(columns, np.arange(replicates, dtype=np.uint32))()
        channels = len(self.study.loop.channels)
        readings = np.stack([np.asarray(result, float) for result in results], axis=1)
        return readings[:, :channels] - readings[:, channels:]


class DisturbanceNoise:
    """What random disturbances and winds add to the outputs of a log.

    Fits of the log with signals at other times share the program, because such a shift hardly changes the noise.
    """

    def __init__(self) -> None:
        self.program: NoiseProgram | None = None

    def simulate(
        self, study: Study, names: Sequence[str], values: np.ndarray, commands: np.ndarray
    ) -> np.ndarray | None:
        """Simulations of the noise, shape (replicates, channels, samples); None: the study has none.

        The first call compiles the program. Later calls use it with their values, and ignore their commands.

        Args:
            study: The study.
            names: The n numbers, the same in all calls.
            values: Values of these numbers, shape (n,).
            commands: The commands, shape (channels, samples).
        """
        if not declares_noise(study):
            return None
        if self.program is None:
            self.program = NoiseProgram(study, names, commands, sensors=False)
        return self.program.simulate(values, REPLICATES)
