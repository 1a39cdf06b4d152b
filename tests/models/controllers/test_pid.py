"""PID and state feedback against independent simulations in NumPy, and closed forms."""

import numpy as np
import pytest
from scipy import signal

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError

T_S = 0.01
GAINS = {"kind": "pid", "k_p": 3.0, "k_i": 2.0, "k_d": 0.7, "filter": 0.05, "proportional_weight": 0.6,
         "derivative_weight": 0.2, "low": -0.8, "high": 1.1, "tracking": 0.3}  # fmt: skip


def study(controller, duration=6.0, **changes):
    return dj.Study.from_table(
        {
            "name": "pid",
            "loop": {"duration": duration, "sample_time": T_S, "substeps": 2},
            "plant": {"kind": "normal_form", "k_p": 2.0, "a_p": 0.5},
            "controller": controller,
            "reference": {"kind": "pulses", "size": 1.0, "period": 4.0, "width": 2.0, "at": 0.5},
            **changes,
        }
    )


def independent(law, steps=600):
    """y and u of the loop, by SciPy's exact discretisation of the plant and a law (y, y', r) -> u."""
    plant = np.array([[0.0, 1.0], [0.0, -0.5]]), np.array([[0.0], [2.0]]), np.eye(2), np.zeros((2, 1))
    a, b, *_ = signal.cont2discrete(plant, T_S)
    x, outputs, commands = np.zeros(2), [], []
    for k in range(steps):
        r = 1.0 if k >= 50 and (k - 50) % 400 < 200 else 0.0
        u = law(x[0], x[1], r)
        outputs.append(x[0])
        commands.append(u)
        x = a @ x + b[:, 0] * u
    return np.array(outputs), np.array(commands)


class Pid:
    """The textbook's difference equations (Astrom and Hagglund), with its own state."""

    def __init__(self, k_p, k_i, k_d=0.0, filter=0.0, b=1.0, c=0.0, low=-np.inf, high=np.inf, t_t=np.inf):
        self.__dict__.update(locals())
        self.i, self.d, self.old = 0.0, 0.0, None

    def __call__(self, y, y_dot, r):
        z = self.c * r - y
        if self.old is None:
            self.old = z
        self.d = self.filter / (self.filter + T_S) * self.d + self.k_d / (self.filter + T_S) * (z - self.old)
        self.old = z
        v = self.k_p * (self.b * r - y) + self.i + self.d
        u = min(max(v, self.low), self.high)
        self.i += T_S * (self.k_i * (r - y) + (u - v) / self.t_t)
        return u


def test_pid_is_the_textbooks():
    y, u = independent(Pid(3.0, 2.0, 0.7, 0.05, 0.6, 0.2, -0.8, 1.1, 0.3))
    run = dj.simulate(study(GAINS))
    np.testing.assert_allclose(run["y"], y, atol=1e-10)
    np.testing.assert_allclose(run["u"], u, atol=1e-9)
    assert u.max() == 1.1
    assert u.min() == -0.8


def test_without_tracking_the_integral_time_is_used():
    y, _ = independent(Pid(3.0, 2.0, high=0.4, low=-0.4, t_t=1.5))
    run = dj.simulate(study({"kind": "pid", "k_p": 3.0, "k_i": 2.0, "low": -0.4, "high": 0.4}))
    np.testing.assert_allclose(run["y"], y, atol=1e-10)


def test_anti_windup_reduces_the_overshoot():
    limits = {"kind": "pid", "k_p": 3.0, "k_i": 2.0, "low": -0.4, "high": 0.4}
    changes = {
        "duration": 12.0,
        "reference": {"kind": "step", "size": 1.0},
        "metrics": {"names": ["overshoot_percent"]},
    }
    wound = dj.simulate(study(limits | {"tracking": 1e9}, **changes)).attrs["overshoot_percent"]
    kept = dj.simulate(study(limits, **changes)).attrs["overshoot_percent"]
    assert kept < 0.6 * wound


def test_integral_action_leaves_no_error():
    """A constant disturbance at the plant's input is balanced by the integral."""
    changes = {"reference": {"kind": "zero"}, "disturbance": {"kind": "constant", "value": 0.7}, "duration": 40.0}
    for controller in (
        {"kind": "pid", "k_p": 3.0, "k_i": 2.0, "k_d": 1.0, "filter": 0.02},
        {"kind": "state_feedback", "k_1": 3.0, "k_2": 1.0, "k_i": 2.0},
    ):
        run = dj.simulate(study(controller, **changes))
        assert abs(float(run["y"][-1])) < 1e-6
        assert float(run["u"][-1]) == pytest.approx(-0.7, abs=1e-5)


def test_state_feedback_is_the_textbooks():
    state = {"i": 0.0}

    def law(y, y_dot, r):
        v = state["i"] - 4.0 * (y - r) - 1.5 * y_dot
        u = min(max(v, -1.0), 1.0)
        state["i"] += T_S * (-2.0 * (y - r) + (u - v) / 0.25)
        return u

    y, _ = independent(law)
    run = dj.simulate(study({"kind": "state_feedback", "k_1": 4.0, "k_2": 1.5, "k_i": 2.0, "low": -1.0, "high": 1.0,
                             "tracking": 0.25}))  # fmt: skip
    np.testing.assert_allclose(run["y"], y, atol=1e-10)


def test_state_feedback_places_the_poles():
    """s^2 + (a_p + k_p k_2) s + k_p k_1 = (s + 3)^2: the response to a step is 1 - (1 + 3 t) e^(-3 t)."""
    controller = {"kind": "state_feedback", "k_1": 4.5, "k_2": 2.75}
    table = study(controller, reference={"kind": "step", "size": 1.0}, duration=3.0).table
    fine = dj.Study.from_table(table | {"loop": {"duration": 3.0, "sample_time": 1e-4}})
    run = dj.simulate(fine, every=100)
    t = run["t"].values
    np.testing.assert_allclose(run["y"], 1.0 - (1.0 + 3.0 * t) * np.exp(-3.0 * t), atol=3e-4)


def test_limits_out_of_order_are_refused():
    with pytest.raises(ConfigError, match=r"controller.low: must be below high = 0.5, got up to 1"):
        study({"kind": "pid", "k_p": 1.0, "low": {"uniform": [0.0, 1.0]}, "high": 0.5})
