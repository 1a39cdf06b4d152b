"""Drag and friction that a study lacks: small ones move the damping and hardly show in the residual."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.missing_parts import friction, quadratic_drag
from tests.flight_logs.fit.test_fit import DT, linear, log_of

FINE = 20  # steps of integration in a sample
K_P = 1.1
A_P = 0.8


def flown(force, seed):
    """The log of x'' = -A_P x' + K_P u + force(x'), by the midpoint rule."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=40), 10)
    y, v = 0.5, 0.0
    outputs = []
    step = DT / FINE

    def acceleration(speed, command):
        return -A_P * speed + K_P * command + force(speed)

    for command in u:
        outputs.append(y)
        for _ in range(FINE):
            middle = v + 0.5 * step * acceleration(v, command)
            y += step * middle
            v += step * acceleration(middle, command)
    return log_of(np.array(outputs) + 0.001 * random.normal(size=len(u)), u)


@pytest.fixture(scope="module")
def predictions():
    """Compiled predictions, which all flights share."""
    return {}


@pytest.mark.parametrize(
    ("force", "word"),
    [(lambda v: -0.05 * v * abs(v), "drag"), (lambda v: -0.03 * np.tanh(v / 0.005), "friction")],
)
def test_a_small_force_against_the_speed_is_told_with_the_damping_that_it_hides(predictions, force, word):
    fitted = fit_log(linear(), flown(force, 1), predictions=predictions)
    assert abs(fitted.estimates[1] - A_P) > 5.0 * fitted.deviations[1]
    (text,) = [doubt.text for doubt in fitted.doubts if "would explain part of the residual of y" in doubt.text]
    assert f"({word}, " in text
    better = float(text.split(" is about ")[1].split()[0])
    number = fitted.names.index(text.split("with it, ")[1].split()[0])
    truth = (K_P, A_P)[number]
    assert abs(better - truth) < 0.3 * abs(fitted.estimates[number] - truth)


@pytest.mark.parametrize("seed", range(3))
def test_a_flight_without_such_a_force_has_no_warning(predictions, seed):
    assert fit_log(linear(), flown(lambda v: 0.0, seed), predictions=predictions).doubts == ()


def test_the_forces_act_against_the_speed():
    speed = np.array([-2.0, 0.0, 1.0])
    np.testing.assert_allclose(quadratic_drag(speed), [4.0, 0.0, -1.0])
    np.testing.assert_allclose(friction(speed), [1.0, 0.0, -1.0], atol=1e-3)
