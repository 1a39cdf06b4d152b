"""LQG, discrete controllers and feedback of the state, against python-control and loops written out in NumPy."""

import control
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from tests.study.test_signals import ACCELERATION, M_S, ROAD, STEPS, T_S, A, B, car, elapsed, held

Q = [100.0, 1.0, 10000.0, 0.5]
TYRE = {"kind": "lqg", "command_weight": 1e-6, "state_weights": Q, "signal_std": [0.001, 0.05]}
TYRE |= {"disturbance_std": [20.0, 0.1], "state_std": [1e-4, 1e-3, 1e-5, 1e-2]}
SENSOR = {"measures": ["travel", "acceleration"]}
C = np.array([[1.0, 0.0, 0.0, 0.0], ACCELERATION])
D = np.array([0.0, 1.0 / M_S])
SPACE = {"kind": "state_space", "a": [[-0.5, 2.0, 0.0], [-1.0, -0.2, 1.0], [0.3, 0.0, -2.0]], "b": [0.0, 0.0, 1.5]}
SPACE |= {"c": [1.0, 0.0, 0.2], "x0": [0.3, -0.1]}


def plain(controller, **changes):
    table = {"name": "loop", "loop": {"duration": 2.0, "sample_time": 0.01}, "plant": SPACE, "controller": controller}
    return dj.Study.from_table({**table, "reference": {"kind": "step", "size": 1.0}, **changes})


def matrices():
    """Sampled car, and the gains of python-control."""
    a, columns = held(A, np.column_stack([B, ROAD]), T_S)
    b = columns[:, :1]
    k, _, _ = control.dlqr(a, b, np.diag(Q), 1e-6 * np.eye(1))
    noise = columns @ np.diag([400.0, 0.01]) @ columns.T + np.diag(np.square(TYRE["state_std"]))
    _, p, _ = control.dlqe(a, np.eye(4), C, noise, np.diag([1e-6, 0.0025]))
    correction = p @ C.T @ np.linalg.inv(C @ p @ C.T + np.diag([1e-6, 0.0025]))
    return a, columns, k[0], correction


def test_the_gains_are_those_of_python_control():
    a, _, k, correction = matrices()
    gains = car(controller=TYRE, sensor=SENSOR).template.controller[0]
    assert np.allclose(gains.transition, a, rtol=0, atol=1e-12)
    assert np.allclose(gains.feedback, k, rtol=1e-9)
    assert np.allclose(gains.correction, correction, rtol=1e-9, atol=1e-12)


def test_the_loop_is_that_of_a_matrix_exponential():
    a, columns, k, correction = matrices()
    run = dj.simulate(car(controller=TYRE, sensor=SENSOR))
    x = np.array([0.01, 0.0, 0.0, 0.0])
    predicted, u, gust = np.zeros(4), 0.0, 0.0
    commands = []
    for i in range(STEPS):
        measured = C @ x + D * (u + gust)
        estimate = predicted + correction @ (measured - C @ predicted - D * u)
        u = -k @ estimate
        gust = 40.0 * elapsed(0.3, i)
        commands.append(u)
        predicted = a @ estimate + columns[:, 0] * u
        road = 0.1 * elapsed(0.5, i) - 0.3 * elapsed(0.7525, i)
        x = a @ x + columns @ [u + gust, road]
    assert np.max(np.abs(run["u"].values - commands)) <= 1e-9 * np.max(np.abs(commands))


def test_margins_of_lqg_are_those_of_its_transfer_function():
    """The loop broken at the command: u = -C(z) y with the filter written as a transfer matrix."""
    a, columns, k, correction = matrices()
    b = columns[:, 0]
    quiet = car(controller=TYRE, sensor=SENSOR, disturbance={"kind": "none"}, draws=1)
    found = float(dj.loop_margins(quiet).dataset["sensitivity_peak"].values.ravel()[0])
    keep = np.eye(4) - correction @ C
    worst = 0.0
    for w in np.geomspace(0.05, 0.999 * np.pi / T_S, 20000):
        z = np.exp(1j * w * T_S)
        plant = C @ np.linalg.solve(z * np.eye(4) - a, b) + D / z  # from u to the measured signals
        lhs = np.zeros((5, 5), complex)  # z p = A e + B u and u = -K e, where e = keep p + L (s - D u/z)
        lhs[:4, :4] = z * np.eye(4) - a @ keep
        lhs[:4, 4] = a @ correction @ D / z - b
        lhs[4, :4] = k @ keep
        lhs[4, 4] = 1.0 - k @ correction @ D / z
        rhs = np.concatenate([a @ correction @ plant, [-k @ correction @ plant]])
        loop_gain = -np.linalg.solve(lhs, rhs)[4]
        worst = max(worst, 1.0 / abs(1.0 + loop_gain))
    assert found == pytest.approx(worst, rel=1e-4)


def test_integral_action_leaves_no_error():
    table = {"kind": "lqg", "command_weight": 0.1, "output_weight": 1.0, "integral_weight": 5.0, "signal_std": [0.01]}
    study = plain({**table, "disturbance_std": [1.0]}, disturbance={"kind": "constant", "value": 0.7})
    run = dj.simulate(study.override({"loop.duration": 30.0}))
    assert abs(float(run["e"][-1])) < 1e-6
    gains = study.template.controller[0]
    a, columns = held(SPACE["a"], np.reshape(SPACE["b"], (3, 1)), 0.01)
    c = np.array(SPACE["c"])
    wide = np.block([[a, np.zeros((3, 1))], [0.01 * c[None, :], np.ones((1, 1))]])
    weights = np.block([[np.outer(c, c), np.zeros((3, 1))], [np.zeros((1, 3)), 5.0 * np.ones((1, 1))]])
    k, _, _ = control.dlqr(wide, np.vstack([columns, [[0.0]]]), weights, 0.1 * np.eye(1))
    assert np.allclose([*gains.feedback, gains.integral_gain], k[0], rtol=1e-8)


def test_a_limit_does_not_wind_up():
    table = {"kind": "lqg", "command_weight": 0.1, "output_weight": 1.0, "integral_weight": 5.0, "signal_std": [0.01]}
    study = plain({**table, "disturbance_std": [1.0], "high": 0.6, "low": -0.6})
    run = dj.simulate(study.override({"loop.duration": 30.0, "reference.size": 20.0}))
    assert float(run["integral"][-1]) <= 2.0 * 0.6
    assert float(np.max(run["u"])) == 0.6


def test_laws_leave_the_design_at_the_nominal_plant():
    fixed = plain(
        {"kind": "lqg", "command_weight": 0.1, "output_weight": 1.0, "signal_std": [0.01], "state_std": [0.1] * 3}
    )
    spread = fixed.override({"plant.a.0.0": {"uniform": [-0.7, -0.3]}})
    assert fixed.template.controller[0].feedback == pytest.approx(spread.template.controller[0].feedback, rel=1e-12)
    with pytest.raises(ConfigError, match="must be a plain number here"):
        fixed.override({"controller.command_weight": {"uniform": [0.1, 0.2]}})


def test_the_transfer_function_is_python_controls():
    numerator, denominator = [2.0, -3.1, 1.2], [1.0, -1.5, 0.55]
    table = {"kind": "discrete_transfer_function", "numerator": numerator, "denominator": denominator}
    run = dj.simulate(plain(table, plant={**SPACE, "x0": []}))
    a, columns = held(SPACE["a"], np.reshape(SPACE["b"], (3, 1)), 0.01)
    part = control.ss(a, columns, np.atleast_2d(SPACE["c"]), 0.0, 0.01)
    law = control.ss(control.tf(numerator, denominator, 0.01))
    loop = control.feedback(control.series(law, part), 1)
    y = control.forced_response(loop, np.arange(200) * 0.01, np.ones(200)).outputs
    assert np.max(np.abs(run["y"].values - y)) < 1e-9


def test_a_state_space_is_the_transfer_function_it_realises():
    numerator, denominator = [2.0, -3.1, 1.2], [1.0, -1.5, 0.55]
    law = control.ss(control.tf(numerator, denominator, 0.01))
    table = {"kind": "discrete_state_space", "a": law.A.tolist(), "b": law.B.tolist(), "c": law.C[0].tolist()}
    space = dj.simulate(plain({**table, "d": law.D[0].tolist()}))
    fraction = dj.simulate(
        plain({"kind": "discrete_transfer_function", "numerator": numerator, "denominator": denominator})
    )
    assert np.max(np.abs(space["y"].values - fraction["y"].values)) < 1e-9


def test_feedback_of_the_whole_state():
    gains = [0.4, 0.9, 0.3]
    law = {"kind": "state_feedback", "signals": gains, "k_i": 0.8, "feedforward": 0.5}
    run = dj.simulate(plain(law, sensor={"measures": "state"}))
    a, columns = held(SPACE["a"], np.reshape(SPACE["b"], (3, 1)), 0.01)
    x, integral, outputs = np.array([0.3, -0.1, 0.0]), 0.0, []
    for _ in range(200):
        y = np.dot(SPACE["c"], x)
        outputs.append(y)
        u = integral - np.dot(gains, x) + 0.5
        integral -= 0.01 * 0.8 * (y - 1.0)
        x = a @ x + columns[:, 0] * u
    assert np.max(np.abs(run["y"].values - outputs)) < 1e-12


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        ({"kind": "lqg", "command_weight": 1.0, "signal_std": [0.1, 0.1]}, "signal_std: must have a number for each"),
        (
            {"kind": "lqg", "command_weight": 1.0, "signal_std": [0.1], "state_weights": [1.0]},
            "must have 3 numbers",
        ),
        ({"kind": "lqg", "command_weight": 0.0, "signal_std": [0.1]}, "must be > 0"),
        (
            {"kind": "discrete_transfer_function", "numerator": [1.0, 2.0], "denominator": [1.0]},
            "must have 1 to 1",
        ),
        (
            {"kind": "discrete_transfer_function", "numerator": [1.0], "denominator": [1.0], "sample_time": 0.02},
            "sample_time: must be the loop's",
        ),
        ({"kind": "discrete_state_space", "a": [[0.5]], "b": [[1.0, 2.0]], "c": [1.0], "d": [1.0]}, "b.0: must have 1"),
    ],
)
def test_what_is_wrong_gets_its_line(controller, message):
    with pytest.raises(ConfigError, match=message):
        plain(controller)
