"""Parts of one's own that vary within a sample although they declare that they do not are refused."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import pytest

import dssc_jax as dj
from dssc_jax.core.contracts import Disturbance, Unmodelled, Variation
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity

TABLE = {
    "name": "own",
    "draws": 1,
    "loop": {"duration": 0.5, "sample_time": 0.1},
    "plant": {"kind": "normal_form", "k_p": 1.0, "a_p": 1.0, "initial": [1.0, 0.0]},
    "controller": {"kind": "state_feedback", "k_1": 4.0, "k_2": 1.5},
}


class Gain(NamedTuple):
    a: Annotated[float, Quantity("u", "amplitude")] = 1.0


class Lag(NamedTuple):
    mu: Annotated[float, Quantity("s", "time constant", above=0.0)] = 0.1


def disturbance(value, variation):
    return Disturbance(Gain, lambda p, key: 0.0, lambda p, s, key, t, dt: p.a * t, value, variation=variation)


def feedback(p, s, m, sigma, t):
    return -p.a * m.y


def sine(p, s, m, sigma, t):
    return p.a * jnp.sin(t)


def state_alone(p, s, m, sigma, t):
    return s


def failing(p, s, m, sigma, t):
    raise ZeroDivisionError


def lag_step(p, z, u, dt):
    return u + (z - u) * jnp.exp(-dt / p.mu)


HELD_FEEDBACK = disturbance(feedback, Variation.HELD)
TIME_FEEDBACK = disturbance(feedback, Variation.TIME)
HELD_SINE = disturbance(sine, Variation.HELD)
FEEDBACK = disturbance(feedback, Variation.STATE)
SINE = disturbance(sine, Variation.TIME)
HELD = disturbance(state_alone, Variation.HELD)
FAILING = disturbance(failing, Variation.HELD)
LAG = Unmodelled(Lag, lambda p: 0.0, step=lag_step, output=lambda p, z, u: z)
HELD_LAG = LAG._replace(held=True)
SAMPLED_LAG = HELD_LAG._replace(step=lambda p, z, u, dt: z, sample=lambda p, z, u, key, dt: lag_step(p, z, u, dt))


def part(slot, name):
    return {slot: {"kind": f"{__name__}:{name}"}}


REFUSED = [
    ("disturbance", "HELD_FEEDBACK", r"HELD, but its `value` depends on y within a sample; declare .*STATE"),
    ("disturbance", "TIME_FEEDBACK", r"Variation\.TIME, but its `value` depends on y within"),
    ("disturbance", "HELD_SINE", r"depends on t within a sample; compute it in `step`.*Variation\.TIME"),
    (
        "unmodelled",
        "HELD_LAG",
        r"held = True, but its `step` changes the output within a sample; .* in `sample`",
    ),
]


@pytest.mark.parametrize(("slot", "name", "rule"), REFUSED)
def test_a_part_that_varies_more_than_it_declares_is_refused(slot, name, rule):
    with pytest.raises(ConfigError, match=rf"{slot}\.kind: '{__name__}:{name}' declares .*{rule}"):
        dj.Study.from_table(TABLE | part(slot, name))


def test_one_of_several_disturbances_is_examined():
    parts = [{"kind": "constant", "value": 0.1}, part("disturbance", "HELD_FEEDBACK")["disturbance"]]
    with pytest.raises(ConfigError, match=r"disturbance\.1\.kind: .* depends on y within a sample"):
        dj.Study.from_table(TABLE | {"disturbance": parts})


@pytest.mark.parametrize(
    ("slot", "name"),
    [
        ("disturbance", "FEEDBACK"),
        ("disturbance", "SINE"),
        ("disturbance", "HELD"),
        ("unmodelled", "LAG"),
        ("unmodelled", "SAMPLED_LAG"),
    ],
)
def test_a_right_declaration_passes(slot, name):
    dj.Study.from_table(TABLE | part(slot, name) | {"draws": 2})


def test_a_failing_part_is_named_with_its_line():
    with pytest.raises(ConfigError, match=r"disturbance: `value` fails in line \d+ .*ZeroDivisionError"):
        dj.Study.from_table(TABLE | part("disturbance", "FAILING"))
