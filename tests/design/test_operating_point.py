"""State feedback and LQG about an operating point other than 0, against loops that NumPy and SciPy integrate."""

import sys

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are

import dssc_jax as dj
from dssc_jax.design.first_gains import first_gains
from tests.test_own_parts import CUBE

T_S = 0.01
STEPS = 60


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    """x' = -k x^3 + u, which rests at x = 2 with u = 8 k, where its slope is -12 k."""
    folder = tmp_path_factory.mktemp("cube")
    (folder / "resting_cube.py").write_text(CUBE)
    sys.path.insert(0, str(folder))
    yield {
        "name": "cube",
        "draws": 1,
        "loop": {"duration": STEPS * T_S, "sample_time": T_S, "substeps": 4},
        "plant": {"kind": "resting_cube:CUBE"},
        "reference": {"kind": "step", "size": 0.5, "offset": 2.0, "at": 0.2},
        "controller": {"kind": "pid", "k_p": 3.0, "k_i": 5.0},
    }
    sys.path.remove(str(folder))
    sys.modules.pop("resting_cube", None)


def cube_rate(t, x, u):
    return -(x**3) + u


def flown(law):
    """The outputs of the cube under a law ``(y, y_m) -> u``, integrated by SciPy from sample to sample."""
    x = 2.0
    outputs = []
    for k in range(STEPS):
        outputs.append(x)
        u = law(x, 2.5 if k >= 20 else 2.0)
        x = solve_ivp(cube_rate, (0.0, T_S), [x], args=(u,), rtol=1e-10, atol=1e-12).y[0, -1]
    return np.array(outputs)


def test_state_feedback_starts_without_a_kick_where_the_plant_rests(cube):
    """u_0 = 8 and y_0 = 2; f = N - k_1, with N = 12 + k_1 from the slope."""
    table = first_gains(dj.Study.from_table(cube), "state_feedback", 8.0, 90.0).table
    assert (table["resting_output"], table["resting_command"]) == pytest.approx((2.0, 8.0))
    assert table["feedforward"] == pytest.approx(12.0, rel=1e-3)
    integral = 0.0

    def law(y, y_m):
        nonlocal integral
        u = 8.0 - table["k_1"] * (y - y_m) + table["feedforward"] * (y_m - 2.0) + integral
        integral -= T_S * table["k_i"] * (y - y_m)
        return u

    flight = dj.simulate(dj.Study.from_table(cube | {"controller": table}))
    expected = flown(law)
    assert np.abs(expected[:20] - 2.0).max() < 1e-9
    np.testing.assert_allclose(flight["y"].squeeze(), expected, atol=2e-6)


def test_lqg_takes_the_linearisation_as_its_model(cube):
    """Regulator, filter and loop in NumPy, of x' = -12 x + u in deviations from x = 2 and u = 8."""
    table = first_gains(dj.Study.from_table(cube), "lqg", 8.0, 90.0).table
    assert table["model"] == {"a": [[-12.0]], "b": [1.0], "c": [1.0], "disturbances": [[1.0]]}
    decay = np.exp(-12.0 * T_S)
    b = (1.0 - decay) / 12.0
    a = np.array([[decay, 0.0], [T_S, 1.0]])
    column = np.array([[b], [0.0]])
    weight = np.array([[table["command_weight"]]])
    p = solve_discrete_are(a, column, np.diag([table["output_weight"], table["integral_weight"]]), weight)
    k, k_i = np.linalg.solve(weight + column.T @ p @ column, column.T @ p @ a)[0]
    variance = table["signal_std"][0] ** 2
    q = float(solve_discrete_are([[decay]], [[1.0]], [[b**2]], [[variance]])[0, 0])
    correction = q / (q + variance)
    predicted = z = 0.0

    def law(y, y_m):
        nonlocal predicted, z
        estimate = predicted + correction * (y - 2.0 - predicted)
        deviation = -k * estimate - k_i * z + (12.0 + k) * (y_m - 2.0)
        predicted = decay * estimate + b * deviation
        z += T_S * (y - y_m)
        return 8.0 + deviation

    flight = dj.simulate(dj.Study.from_table(cube | {"controller": table}))
    expected = flown(law)
    assert np.abs(expected[:20] - 2.0).max() < 1e-9
    np.testing.assert_allclose(flight["y"].squeeze(), expected, atol=2e-6)


def test_measured_signals_count_from_their_values_at_rest(cube):
    """u = 8 - 0.25 (x^3 - 8) + 15 (y_m - 2) - 4 int (y - y_m) dt."""
    table = {"kind": "state_feedback", "signals": [0.25], "feedforward": 15.0, "k_i": 4.0}
    table |= {"resting_output": 2.0, "resting_command": 8.0, "resting_signals": [8.0]}
    measured = cube | {"controller": table, "sensor": {"measures": ["force"]}}
    integral = 0.0

    def law(y, y_m):
        nonlocal integral
        u = 8.0 - 0.25 * (y**3 - 8.0) + 15.0 * (y_m - 2.0) + integral
        integral -= T_S * 4.0 * (y - y_m)
        return u

    flight = dj.simulate(dj.Study.from_table(measured))
    np.testing.assert_allclose(flight["y"].squeeze(), flown(law), atol=2e-6)
    with pytest.raises(dj.ConfigError, match="resting_signals: must have a number for each of the 1 measured signals"):
        dj.Study.from_table(measured | {"controller": table | {"resting_signals": [8.0, 1.0]}})


def test_a_limit_below_the_holding_command_is_refused(cube):
    with pytest.raises(dj.ConfigError, match="`limit`: must be above the command 8 that holds the plant"):
        first_gains(dj.Study.from_table(cube), "state_feedback", 8.0, 7.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"b": [1.0, 0.0]}, r"model\.b: must have 1 numbers in a row, got 2"),
        ({"signals": [[1.0]]}, r"model\.signals: must have a row for each of the 0 measured signals, got 1"),
        (None, r"or a linear model of it in \[controller\.model\]"),
    ],
)
def test_lqg_without_a_fitting_model_is_refused(cube, change, message):
    table = {"kind": "lqg", "command_weight": 1.0, "output_weight": 1.0, "signal_std": [0.1], "disturbance_std": [1.0]}
    if change is not None:
        table["model"] = {"a": [[-12.0]], "b": [1.0], "c": [1.0]} | change
    with pytest.raises(dj.ConfigError, match=message):
        dj.Study.from_table(cube | {"controller": table})
