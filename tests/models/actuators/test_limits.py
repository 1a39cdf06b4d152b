"""Rate limit and saturation: against a hand-written loop, at any step."""

from typing import Annotated, NamedTuple

import jax
import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.study.components import parse_component
from dssc_jax.study.fields import in_order
from dssc_jax.study.laws import Law

COMMANDS = [0.5, 0.5, -2.0, -2.0, 0.1, 3.0, 3.0, 3.0, 0.0]


def parsed(**table):
    return parse_component(table, UNMODELLED, "unmodelled")


@pytest.mark.parametrize("dt", [0.01, 0.3, 100.0])
def test_rate_limit(dt):
    """The plant input goes straight to the held command and stays there: a loop of 1000 parts a sample."""
    part, z, rate = parsed(kind="rate_limit", rate=4.0), 0.0, 4.0
    state = part.model.init(part.params)
    for u in COMMANDS:
        state = part.model.step(part.params, state, u, dt)
        for _ in range(1000):
            room = rate * dt / 1000
            z = u if abs(u - z) <= room else z + (room if u > z else -room)
        assert float(part.model.output(part.params, state, u)) == pytest.approx(z, abs=1e-12)


def test_two_half_samples_are_one():
    part = parsed(kind="rate_limit", rate=4.0)
    for u in COMMANDS:
        single = part.model.step(part.params, (0.3,), u, 0.2)
        twice = part.model.step(part.params, part.model.step(part.params, (0.3,), u, 0.1), u, 0.1)
        np.testing.assert_allclose(single, twice, rtol=1e-15)


def test_saturation():
    part = parsed(kind="saturation", limit=1.5)
    state = part.model.init(part.params)
    for u in COMMANDS:
        state = part.model.step(part.params, state, u, 0.1)
        assert float(part.model.output(part.params, state, u)) == min(max(u, -1.5), 1.5)


def test_saturation_between_two_limits():
    """A duty cycle cannot be negative."""
    part = parsed(kind="saturation", low=0.0, limit=0.95)
    for u in COMMANDS:
        assert float(part.model.output(part.params, (), u)) == min(max(u, 0.0), 0.95)
    with pytest.raises(ConfigError, match=r"low: must be below limit = 0\.5, got up to 0\.7"):
        parsed(kind="saturation", low={"uniform": [0.0, 0.7]}, limit={"uniform": [0.5, 0.9]})


@pytest.mark.parametrize(("kind", "number"), [("rate_limit", "rate"), ("saturation", "limit")])
def test_gradients_are_finite(kind, number):
    """With respect to number and command, at the limit too."""
    model = parsed(kind=kind, **{number: 2.0}).model

    def after(value, u):
        params = model.params(value)
        return model.output(params, model.step(params, model.init(params), u, 0.5), u)

    for u in (0.0, 0.5, 1.0, 2.0, 5.0):
        assert np.all(np.isfinite(jax.grad(after, argnums=(0, 1))(2.0, u)))
    assert float(jax.grad(after)(2.0, 5.0)) == (0.5 if kind == "rate_limit" else 1.0)


@pytest.mark.parametrize(("kind", "number", "unit"), [("rate_limit", "rate", "u/s"), ("saturation", "limit", "u")])
def test_the_number_may_be_a_law_and_is_positive(kind, number, unit):
    part = parsed(kind=kind, **{number: {"uniform": [1.0, 2.0]}})
    assert isinstance(part.params[0], Law)
    assert {n.name: n for n in part.numbers}[number].quantity.unit == unit
    with pytest.raises(ConfigError, match=rf"unmodelled.{number}: largest .* must be > 0, got 0"):
        parsed(kind=kind, **{number: 0.0})
    with pytest.raises(ConfigError, match=f"unmodelled.{number}: is required and missing"):
        parsed(kind=kind)


class Misdeclared(NamedTuple):
    """A part of one's own whose quantity names a number that it does not have."""

    low: Annotated[float, Quantity("u", "lower limit", less_than="hihg")]
    high: Annotated[float, Quantity("u", "upper limit")]


def test_an_order_that_names_no_number_of_the_part_is_refused():
    with pytest.raises(ConfigError, match=r"low: its quantity has less_than = 'hihg', but the part has no such number"):
        in_order(Misdeclared(0.0, 1.0))
