"""Plants of one's own whose y' is another function, or that ignore a disturbance, are told before a run."""

from typing import Annotated, NamedTuple

import pytest

import dssc_jax as dj
from dssc_jax.core.contracts import Plant
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.sampled_linear import LinearDynamics
from dssc_jax.core.signals import Measurement
from dssc_jax.design.plant_checks import plant_warnings


class Tank(NamedTuple):
    """A tank with an outlet."""

    area: Annotated[float, Quantity("m^2", "area", above=0.0)] = 2.0


class Level(NamedTuple):
    """Its level."""

    h: float


def derivative(params, state, drive, t):
    (leak,) = drive.inputs
    return Level((drive.command + drive.disturbance - 0.3 * state.h**2 - leak) / params.area)


def tight(params, state, drive, t):
    return derivative(params, state, drive._replace(inputs=(0.0,)), t)


def measure(params, state, drive):
    return Measurement(state.h, derivative(params, state, drive, 0.0).h)


TANK = Plant(
    Tank,
    init=lambda params: Level(1.0),
    derivative=derivative,
    measure=measure,
    input_gain=lambda params: 1.0 / params.area,
    inputs=lambda params: (NamedSignal("leak", "m^3/s", "leak"),),
)
LYING = TANK._replace(measure=lambda params, state, drive: Measurement(state.h, 0.0))
TIGHT = TANK._replace(derivative=tight, measure=lambda p, s, drive: Measurement(s.h, tight(p, s, drive, 0.0).h))
DEAF = TANK._replace(
    derivative=lambda p, s, drive, t: derivative(p, s, drive._replace(disturbance=0.0), t),
    measure=lambda p, s, drive: Measurement(s.h, derivative(p, s, drive._replace(disturbance=0.0), 0.0).h),
)
LINEAR = TANK._replace(
    linear=lambda p: LinearDynamics([[-0.6 / p.area]], ((1.0 / p.area,),), ((1.0 / p.area,),), ((-1.0 / p.area,),)),
    remainder=lambda p, s, drive, t: Level((0.6 * s.h - 0.3 * s.h**2) / p.area),
)
WRONG_SIGN = LINEAR._replace(
    linear=lambda p: LinearDynamics([[-0.6 / p.area]], ((-1.0 / p.area,),), ((1.0 / p.area,),), ((-1.0 / p.area,),)),
)
LEAK = [{"kind": "constant", "value": 0.1, "input": "leak"}]


@pytest.mark.parametrize(
    ("plant", "disturbance", "told"),
    [
        ("TANK", LEAK, []),
        ("LYING", LEAK, ["the plant's y' is not the derivative of its y"]),
        ("TIGHT", LEAK, ["the disturbance at the input leak has no effect"]),
        ("TIGHT", {"kind": "none"}, []),
        ("DEAF", {"kind": "constant", "value": 0.1}, ["the disturbance at the command has no effect"]),
        ("TANK", {"kind": "constant", "value": 0.1}, []),
        ("LINEAR", LEAK, []),
        ("WRONG_SIGN", LEAK, ["the plant's `linear` and `remainder` give other slopes"]),
    ],
)
def test_what_contradicts_itself_is_told(plant, disturbance, told):
    study = dj.Study.from_table(
        {
            "name": "tank",
            "loop": {"duration": 1.0, "sample_time": 0.01},
            "plant": {"kind": f"tests.design.test_plant_checks:{plant}"},
            "controller": {"kind": "pid", "k_p": 1.0},
            "disturbance": disturbance,
        }
    )
    texts = plant_warnings(study)
    assert len(texts) == len(told)
    assert all(text.startswith(start) for text, start in zip(texts, told, strict=True))


def test_plants_of_the_package_are_not_looked_at():
    assert plant_warnings(dj.Study.load("studies/motor.toml")) == []
