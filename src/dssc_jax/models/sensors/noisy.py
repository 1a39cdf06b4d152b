"""A sensor with noise, constant errors, delay, sampling period, resolution, lost readings and jitter.

In units, y stands for the unit of the plant's output.
"""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.contracts import Sensor
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import is_zero, standard_normals, uniforms
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.core.smoothness import MEAN_GAIN, SMOOTH, Smoothness, not_smooth

EXTRA = 2  # index of the random numbers of losses and jitter; the noise has 0 and 1
MOST_DELAY = 200  # each sample of delay costs two scalars of the state, which are copied at every sample
POSITION_STD = Quantity("y", "standard deviation of the noise on y", at_least=0.0, leading=True)
VELOCITY_STD = Quantity("y/s", "standard deviation of the noise on y'", at_least=0.0)
POSITION_BIAS = Quantity("y", "constant error of y")
VELOCITY_BIAS = Quantity("y/s", "constant error of y'")
DELAY_SAMPLES = Quantity("1", "delay, in controller samples", at_least=0.0, at_most=float(MOST_DELAY), law=False)
READING_LOSS = Quantity("1", "probability that a reading is lost and the last one holds", at_least=0.0, below=1.0)
POSITION_RESOLUTION = Quantity("y", "readings of y are multiples of it", above=0.0)
VELOCITY_RESOLUTION = Quantity("y/s", "readings of y' are multiples of it", above=0.0)
JITTER = Quantity("s", "largest age of a reading; it is uniform between 0 and this, at most one sample", at_least=0.0)
PERIOD = Quantity("1", "controller samples from one reading to the next", at_least=1.0, law=False)


class NoisyParams(NamedTuple):
    """A sensor with white Gaussian noise, constant errors, a delay and its own sampling period.

    A reading may also be older than its sample by a random time (``jitter``), be rounded to a resolution, or be lost,
    so that the last reading stays. A number that is None leaves its effect out of the program.

    Delay and period are whole numbers of samples without laws, because they determine the shape of the state.
    """

    position_std: Annotated[Scalar, POSITION_STD] = 0.0
    velocity_std: Annotated[Scalar, VELOCITY_STD] = 0.0
    position_bias: Annotated[Scalar, POSITION_BIAS] = 0.0
    velocity_bias: Annotated[Scalar, VELOCITY_BIAS] = 0.0
    delay_samples: Annotated[Scalar, DELAY_SAMPLES] = 0.0
    period_samples: Annotated[Scalar, PERIOD] = 1.0
    position_resolution: Annotated[Scalar | None, POSITION_RESOLUTION] = None
    velocity_resolution: Annotated[Scalar | None, VELOCITY_RESOLUTION] = None
    loss: Annotated[Scalar | None, READING_LOSS] = None
    jitter: Annotated[Scalar | None, JITTER] = None


class NoisyState(NamedTuple):
    """What the sensor remembers from one sample to the next.

    Args:
        age: Number of controller samples since the last reading was due.
        held: The last reading that was received.
        queue: Readings that the delay holds back, oldest first.
        previous: A tuple with the true measurement at the last sample; () without jitter.
    """

    age: Scalar
    held: Measurement
    queue: tuple[Measurement, ...]
    previous: tuple[Measurement, ...] = ()


def sample_count(name: str, value: object) -> int:
    """The value of the field ``name`` as a whole number of samples.

    Raises:
        ConfigError: The value has a law or is swept, or is no whole number.
    """
    if not isinstance(value, int | float):
        raise ConfigError(name, "decides the shape of the state: must be a plain number, neither law nor swept")
    if not float(value).is_integer():
        raise ConfigError(name, f"must be a whole number of samples, got {float(value):g}")
    return int(value)


def prepare(params: NoisyParams) -> NoisyParams:
    """The parameters themselves, whose delay and period must be whole numbers of samples.

    Raises:
        ConfigError: One of them is not whole, or has a law.
    """
    sample_count("delay_samples", params.delay_samples)
    sample_count("period_samples", params.period_samples)
    return params


def reading(params: NoisyParams, measurement: Measurement, key: jax.Array) -> Measurement:
    """A new reading of a measurement: with constant errors and noise, rounded to the resolution.

    Args:
        params: Errors, noise and resolution.
        measurement: The true measurement.
        key: Random key of the sample.
    """
    position_noise, velocity_noise = standard_normals(key, 2)
    y = measurement.y + params.position_bias + params.position_std * position_noise
    y_dot = measurement.y_dot + params.velocity_bias + params.velocity_std * velocity_noise
    return Measurement(
        y=round_reading(y, params.position_resolution),
        y_dot=round_reading(y_dot, params.velocity_resolution),
    )


def round_reading(value: Scalar, resolution: Scalar | None) -> Scalar:
    """The nearest multiple of the resolution; the value itself if there is no resolution."""
    return value if resolution is None else resolution * jnp.round(value / resolution)


def aged_reading(present: Measurement, previous: Measurement, age: Scalar, dt: Scalar) -> Measurement:
    """The measurement at a time ``age`` before the present sample [s], by cubic Hermite interpolation.

    The error is of order dt^4 in y and dt^3 in y' if the plant's output is smooth.

    Args:
        present: Measurement at the present sample.
        previous: Measurement at the sample before.
        age: Age in [0, dt] [s].
        dt: Length of a sample [s].
    """
    # y = previous.y + linear s + quadratic s^2 + cubic s^3, with s from 0 at the sample before to 1 at the present one
    s = 1.0 - age / dt
    rise = present.y - previous.y
    linear = dt * previous.y_dot  # dy/ds at s = 0
    end_slope = dt * present.y_dot  # dy/ds at s = 1
    quadratic = 3.0 * rise - 2.0 * linear - end_slope
    cubic = linear + end_slope - 2.0 * rise
    y = previous.y + s * (linear + s * (quadratic + s * cubic))
    return Measurement(y, (linear + s * (2.0 * quadratic + 3.0 * s * cubic)) / dt)


def noisy_init(params: NoisyParams, measurement: Measurement, key: jax.Array) -> NoisyState:
    """The state at the first measurement.

    A reading of this measurement fills the queue, and the first sample takes a new reading.
    """
    first = reading(params, measurement, key)
    period = sample_count("period_samples", params.period_samples)
    return NoisyState(
        age=float(period),
        held=first,
        queue=(first,) * sample_count("delay_samples", params.delay_samples),
        previous=() if params.jitter is None else (measurement,),
    )


def noisy_step(
    params: NoisyParams, state: NoisyState, measurement: Measurement, key: jax.Array, t: Scalar, dt: Scalar
) -> tuple[NoisyState, Measurement]:
    """The next state, and the reading that the controller gets, which was taken ``delay_samples`` ago.

    A new reading is taken at a sample if one is due there and is not lost; else the last reading stays. The time ``t``
    is not used.
    """
    is_due = state.age > sample_count("period_samples", params.period_samples) - 0.5  # age is a whole number
    measured = measurement  # what a new reading measures
    is_received = is_due
    if params.loss is not None or params.jitter is not None:
        loss_number, age_share = uniforms(jax.random.fold_in(key, EXTRA), 2)
        if params.jitter is not None:
            (previous_measurement,) = state.previous
            measured = aged_reading(measurement, previous_measurement, params.jitter * age_share, dt)
        if params.loss is not None and not is_zero(params.loss):
            is_received = is_due & (loss_number >= params.loss)
    new_reading = reading(params, measured, key)
    held_reading = Measurement(
        y=jnp.where(is_received, new_reading.y, state.held.y),
        y_dot=jnp.where(is_received, new_reading.y_dot, state.held.y_dot),
    )
    readings = (*state.queue, held_reading)  # the oldest first
    next_state = NoisyState(
        age=jnp.where(is_due, 1.0, state.age + 1.0),
        held=held_reading,
        queue=readings[1:],
        previous=() if params.jitter is None else (measurement,),
    )
    return next_state, readings[0]


def largest_value(number: Scalar | None) -> float:
    """The largest value of a parameter's law; 0 if the parameter is None."""
    return 0.0 if number is None else extent(number)[1]


def noisy_smoothness(params: NoisyParams) -> Smoothness:
    """Declare where the sensor has a derivative: everywhere without a period, losses, jitter and a resolution.

    With a period of its own or with losses, the sensor has no derivative that is of use. With jitter or a resolution,
    the sensor without resolution is linearised, and the age of its readings counts as constant.
    """
    if params.period_samples != 1.0:
        return not_smooth(
            f"has period_samples = {params.period_samples:g}, which must be 1 for a frequency response: the loop is "
            "periodic otherwise"
        )
    if largest_value(params.loss) > 0.0:
        return not_smooth("loses readings at random, so that no derivative holds from sample to sample; leave loss out")
    assumptions = []
    if params.jitter is not None:
        assumptions.append("counts the age of its readings as constant in each draw, at most the jitter")
    if params.position_resolution is not None or params.velocity_resolution is not None:
        assumptions.append(f"counts its resolution as {MEAN_GAIN}")
    return not_smooth("; ".join(assumptions), with_mean_gain) if assumptions else SMOOTH


def with_mean_gain(params: NoisyParams) -> tuple[Sensor, NoisyParams]:
    """The part that is linearised in place of a sensor with a resolution: the sensor without resolution.

    It stands for a sensor whose signals are large compared with the resolution.
    """
    return NOISY, params._replace(position_resolution=None, velocity_resolution=None)


def is_transparent(params: NoisyParams) -> bool:
    """Whether every reading is one of the present sample: the sensor has no delay, period, losses or jitter."""
    is_timely = largest_value(params.delay_samples) == 0.0 and largest_value(params.period_samples) <= 1.0
    return is_timely and largest_value(params.loss) == 0.0 and largest_value(params.jitter) == 0.0


def position_resolution(params: NoisyParams) -> Scalar | None:
    """The step of which readings of y are multiples; None: they are not rounded."""
    return params.position_resolution


NOISY = Sensor(NoisyParams, noisy_init, noisy_step, prepare, noisy_smoothness, is_transparent, position_resolution)
