"""A plant whose output is an angle that it gives by its principal value, and the same plant with a continuous one."""

from typing import Annotated, NamedTuple

from dssc_jax.core.contracts import Plant
from dssc_jax.core.numerics import wrap_angle
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement
from dssc_jax.core.units import ChannelUnits


class HeadingParams(NamedTuple):
    """psi'' = -psi' + u."""

    start: Annotated[float, Quantity("rad", "initial heading")] = 0.0


class HeadingState(NamedTuple):
    psi: float
    rate: float


def derivative(params, state, drive, t):
    return HeadingState(state.rate, drive.command + drive.disturbance - state.rate)


CONTINUOUS = Plant(
    HeadingParams,
    init=lambda params: HeadingState(params.start, 0.0),
    derivative=derivative,
    measure=lambda params, state, drive: Measurement(state.psi, state.rate),
    input_gain=lambda params: 1.0,
    velocities=("rate",),
    units=(ChannelUnits("rad", "rad/s^2", "heading", "command"),),
)
WRAPPED = CONTINUOUS._replace(
    measure=lambda params, state, drive: Measurement(wrap_angle(state.psi), state.rate), angles=("",)
)


def heading(plant="WRAPPED", start=0.0, **sections):
    """The table of a study that steers the heading."""
    return {
        "name": "heading",
        "seed": 3,
        "draws": 2,
        "loop": {"duration": 3.0, "sample_time": 0.005},
        "plant": {"kind": f"tests.angles:{plant}", "start": start},
        "reference": {"kind": "zero"},
        "controller": {"kind": "pi", "l0": 0.5, "k_p": 4.0, "k_i": 1.0},
        **sections,
    }
