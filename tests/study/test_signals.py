"""Named outputs, disturbances at places of their own, and metrics of signals, against a matrix exponential in NumPy."""

import numpy as np
import pytest
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.cli.warnings import warn_of_signals, warn_of_times
from dssc_jax.core.errors import ConfigError

T_S = 0.005
STEPS = 300
M_S, M_U, K_S, K_T, C_S = 250.0, 40.0, 16000.0, 160000.0, 1000.0
A = [
    [0.0, 1.0, 0.0, -1.0],
    [-K_S / M_S, -C_S / M_S, 0.0, C_S / M_S],
    [0.0, 0.0, 0.0, 1.0],
    [K_S / M_U, C_S / M_U, -K_T / M_U, -C_S / M_U],
]
B = [0.0, 1.0 / M_S, 0.0, -1.0 / M_U]
ROAD = [0.0, 0.0, -1.0, 0.0]
ACCELERATION = A[1]
HALF = {"kind": "step", "value": 0.1, "at": 0.5, "input": "road"}
LATER = {"kind": "step", "value": -0.3, "at": 0.7525, "input": "road"}
NAMED = ["rms_acceleration", "highest_travel", "mean_travel", "final_y", "variation_u"]
GUST = {"kind": "step", "value": 40.0, "at": 0.3}


def car(**changes):
    """A quarter car on a road, with a velocity feedback of its body."""
    outputs = {
        "acceleration": {"c": ACCELERATION, "d": 1.0 / M_S, "unit": "m/s^2", "meaning": "body acceleration"},
        "tyre_force": {"c": [0.0, 0.0, K_T, 0.0], "inputs": {"road": -20.0}, "unit": "N"},
        "travel": {"c": [1.0, 0.0, 0.0, 0.0], "unit": "m"},
    }
    table = {
        "name": "car",
        "loop": {"duration": STEPS * T_S, "sample_time": T_S},
        "plant": {
            "kind": "state_space",
            "a": A,
            "b": B,
            "c": [0.0, 1.0, 0.0, 0.0],
            "x0": [0.01],
            "inputs": {"road": {"column": ROAD, "unit": "m/s"}},
            "outputs": outputs,
        },
        "units": {"output": "m/s", "command": "N"},
        "controller": {"kind": "pid", "k_p": 800.0},
        "disturbance": [HALF, LATER, GUST],
        "requirement": [
            {"signal": "tyre_force", "metric": "max_abs", "max": 900.0},
            {"signal": "travel", "metric": "lowest", "min": -0.05},
        ],
        "metrics": {
            "names": ["rms_acceleration", "highest_travel", "mean_travel", "final_y", "variation_u", "error_rms"]
        },
    }
    return dj.Study.from_table({**table, **changes})


def held(a, columns, t):
    """The exact solution over t with constant inputs: transition and columns."""
    order, count = len(a), np.shape(columns)[1]
    block = np.zeros((order + count, order + count))
    block[:order, :order] = a
    block[:order, order:] = columns
    whole = expm(block * t)
    return whole[:order, :order], whole[:order, order:]


def elapsed(at, k):
    """Share of sample k after a time."""
    return np.clip(((k + 1) * T_S - at) / T_S, 0.0, 1.0)


def independent(feedback=800.0):
    """The car by its matrix exponential: for each sample the outputs, u and y."""
    transition, columns = held(A, np.column_stack([B, ROAD]), T_S)
    x = np.array([0.01, 0.0, 0.0, 0.0])
    rows = []
    for k in range(STEPS):
        u = -feedback * x[1]
        road = 0.1 * elapsed(0.5, k) - 0.3 * elapsed(0.7525, k)
        force = u + 40.0 * elapsed(0.3, k)
        acceleration = np.dot(ACCELERATION, x) + force / M_S
        rows.append((acceleration, x[0], K_T * x[2] - 20.0 * road, u, x[1]))
        x = transition @ x + columns @ [force, road]
    return np.array(rows).T


def test_the_car_is_that_of_a_matrix_exponential():
    acceleration, travel, tyre_force, u, y = independent()
    run = dj.simulate(car())
    for name, expected in (("acceleration", acceleration), ("travel", travel), ("tyre_force", tyre_force), ("u", u)):
        assert np.max(np.abs(run[name].values - expected)) <= 1e-9 * np.max(np.abs(expected)), name
    assert run["tyre_force"].attrs == {"units": "N", "long_name": "tyre_force"}
    assert run["acceleration"].attrs == {"units": "m/s^2", "long_name": "body acceleration"}
    expected = {
        "max_abs_tyre_force": np.max(np.abs(tyre_force)),
        "lowest_travel": np.min(travel),
        "rms_acceleration": np.sqrt(np.mean(acceleration**2)),
        "highest_travel": np.max(travel),
        "mean_travel": np.mean(travel),
        "final_y": y[-1],
        "variation_u": np.sum(np.abs(np.diff(u))),
        "error_rms": np.sqrt(np.mean(y**2)),
    }
    result = dj.run(car()).dataset
    for name, value in expected.items():
        assert float(result[name][0]) == pytest.approx(value, rel=1e-9), name
    assert result["max_abs_tyre_force"].attrs["units"] == "N"
    assert float(result["slack_max_abs_tyre_force"][0]) == pytest.approx(900.0 - expected["max_abs_tyre_force"])


def test_one_table_may_have_a_place():
    """The one-element form gives the numbers of the list with one element."""
    single = dj.simulate(car(disturbance=HALF))
    listed = dj.simulate(car(disturbance=[HALF]))
    assert np.array_equal(single["tyre_force"], listed["tyre_force"])
    assert "disturbance.value" in car(disturbance=HALF).numbers
    number = car().numbers["disturbance.0.value"]
    assert number.quantity.unit == "m/s"
    assert car().numbers["disturbance.2.value"].quantity.unit == "N"


def test_a_number_of_a_listed_disturbance_may_be_swept():
    study = car(sweep={"disturbance.1.value": [-0.3, 0.0]})
    forces = dj.run(study).dataset["max_abs_tyre_force"].values[:, 0]
    assert forces[0] == pytest.approx(np.max(np.abs(independent()[2])), rel=1e-9)
    assert forces[1] < forces[0]


def test_a_disturbance_that_varies_within_the_sample_is_integrated():
    """A sine at the road against a fine solution."""
    sine = {"kind": "sine", "amplitude": 0.2, "period": 0.4, "input": "road"}
    run = dj.simulate(car(disturbance=sine))
    fine = 200
    transition, columns = held(A, np.column_stack([B, ROAD]), T_S / fine)
    x = np.array([0.01, 0.0, 0.0, 0.0])
    for k in range(100):
        u = -800.0 * x[1]
        for i in range(fine):
            t = (k + (i + 0.5) / fine) * T_S
            x = transition @ x + columns @ [u, 0.2 * np.sin(2.0 * np.pi * t / 0.4)]
    assert float(run["travel"][100]) == pytest.approx(x[0], abs=1e-8)


def test_measured_signals_reach_their_columns():
    sensor = {"measures": ["travel", "acceleration", "x4"], "travel": {"kind": "noisy", "position_bias": 0.25}}
    run = dj.simulate(car(sensor=sensor))
    assert np.allclose(run["measured_travel"], run["travel"] + 0.25, rtol=0, atol=1e-12)
    before = np.concatenate([[run["u"][0] * 0.0], run["u"][:-1]])  # a sample sees the command just before it
    gust = 40.0 * np.array([elapsed(0.3, k - 1) for k in range(STEPS)])
    seen = run["acceleration"] - (run["u"] - before) / M_S
    gust_now = 40.0 * np.array([elapsed(0.3, k) for k in range(STEPS)])
    assert np.allclose(run["measured_acceleration"], seen - (gust_now - gust) / M_S, rtol=0, atol=1e-10)
    assert run["measured_travel"].attrs == {"units": "m", "long_name": "measured travel"}
    assert np.array_equal(run["y_measured"], run["y"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"disturbance": [{**HALF, "input": "rode"}]}, "disturbance.0.input: .*did you mean 'road'"),
        (
            {"requirement": [{"signal": "tire", "metric": "rms", "max": 1.0}]},
            "'tire' is no signal",
        ),
        ({"requirement": [{"signal": "travel", "metric": "peak", "max": 1.0}]}, "requirement.0.metric: 'peak'"),
        ({"sensor": {"measures": ["trevel"]}}, "cannot be measured; did you mean 'travel'"),
        ({"sensor": {"measures": ["travel"], "travel": {"kind": "noisy", "velocity_std": 1.0}}}, "velocity_std: needs"),
        (
            {"controller": {"kind": "state_feedback", "signals": [1.0, 2.0]}},
            "takes 2 measured signals, and 0",
        ),
        ({"controller": {"kind": "state_feedback"}}, "nothing would be fed back"),
    ],
)
def test_what_is_wrong_gets_its_line(changes, message):
    with pytest.raises(ConfigError, match=message):
        car(**changes)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("plant.outputs.travel.c", [1.0], "plant.outputs.travel.c: must have 4 numbers"),
        ("plant.outputs.travel.unit", "m//s", "plant.outputs.travel.unit: must be a product of powers"),
        ("plant.outputs.travel.inputs", {"rode": 1.0}, "plant.outputs.travel.inputs.rode: is no input"),
        ("plant.inputs.road.column", [1.0], "plant.inputs.road.column: must have 4 numbers"),
        ("plant.outputs.a__b", {"c": [1.0, 0.0, 0.0, 0.0]}, "single _"),
        ("plant.outputs.and", {"c": [1.0, 0.0, 0.0, 0.0]}, "word of Python"),
        ("plant.outputs.x1", {"c": [1.0, 0.0, 0.0, 0.0]}, "plant.outputs.x1: has the name of the state 1"),
        ("plant.outputs.y", {"c": [1.0, 0.0, 0.0, 0.0]}, "plant.outputs.y: has the name of"),
        ("plant.outputs.t", {"c": [1.0, 0.0, 0.0, 0.0]}, "reports 't', which is another signal"),
        ("plant.outputs.u_total", {"c": [1.0, 0.0, 0.0, 0.0]}, "reports 'u_total', which is another signal"),
    ],
)
def test_a_wrong_plant_gets_its_line(path, value, message):
    with pytest.raises(ConfigError, match=message):
        car().override({path: value})


def test_the_theorem_refuses_a_disturbance_at_an_input():
    from dssc_jax.design.loop_bounds import NotCovered, require_no_inputs

    with pytest.raises(NotCovered, match="acts at the input 'road'"):
        require_no_inputs(car().loop)
    require_no_inputs(car(disturbance=GUST).loop)


def test_formulas_and_metrics_name_signals_as_columns_do():
    """With the channel before the signal: `x_e` everywhere, and `e_x` nowhere."""
    signals = ("x_y", "x_y_dot", "x_y_ref", "x_e", "x_e_dot", "x_sigma", "x_u", "x_u_total")
    table = {
        "name": "names", "draws": 1, "loop": {"duration": 0.1, "sample_time": 0.01}, "plant": {"kind": "uav"},
        "reference": {"kind": "hover"}, "controller": dj.Study.load("uav_robustness").table["controller"],
    }  # fmt: skip
    required = [{"signal": name, "metric": "max_abs", "max": 1e6} for name in signals]
    required += [{"formula": f"always {name} < 1e6"} for name in signals]
    assert len(dj.Study.from_table(table | {"requirement": required}).requirements) == 2 * len(signals)
    for wrong in ({"signal": "e_x", "metric": "max_abs", "max": 1.0}, {"formula": "always e_x < 1"}):
        with pytest.raises(ConfigError, match=r"e_x.*x_e"):
            dj.Study.from_table(table | {"requirement": [wrong]})


@pytest.mark.parametrize(
    ("controller", "warns"),
    [
        ({"kind": "pid", "k_p": 800.0}, True),
        ({"kind": "state_feedback", "k_1": 800.0, "k_2": 0.0, "signals": [100.0]}, False),
    ],
)
def test_a_sensor_of_a_signal_that_the_controller_does_not_read_is_told(controller, warns, capsys):
    """An engineer gave the output's sensor as that of the signal y, and PID saw the exact output."""
    sensor = {"measures": ["travel"], "travel": {"kind": "noisy", "position_resolution": 0.01}}
    warn_of_signals(car(sensor=sensor, controller=controller))
    assert ("[sensor.travel] act on signals that it does not read" in capsys.readouterr().err) == warns


def test_a_sensor_of_a_signal_that_is_not_measured_is_refused():
    with pytest.raises(ConfigError, match=r"sensor.travel: is the sensor of a signal .* list it in measures"):
        car(sensor={"kind": "ideal", "travel": {"kind": "noisy", "position_std": 0.01}})


@pytest.mark.parametrize("common", ["ideal", "noisy"])
def test_a_sensor_of_y_that_the_error_is_not_read_through_is_told(common, capsys):
    """The integral of LQG reads the error through [sensor]: a bias of [sensor.y] alone did not reach it."""
    sensor = {"kind": common, "measures": ["y"], "y": {"kind": "noisy", "position_bias": 0.05}}
    warn_of_signals(car(sensor=sensor, controller={"kind": "state_feedback", "k_1": 800.0, "signals": [100.0]}))
    assert ("the error, such as that of an integral, is read" in capsys.readouterr().err) == (common == "ideal")


@pytest.mark.parametrize(
    ("sensor", "warns"),
    [
        ({"kind": "noisy", "position_std": 0.01, "measures": ["y", "travel"]}, True),
        ({"kind": "noisy", "position_std": 0.01, "measures": ["travel"]}, False),
        ({"kind": "ideal", "measures": ["y", "travel"]}, False),
        ({"kind": "noisy", "position_std": 0.01, "measures": ["y"], "y": {"kind": "noisy"}}, False),
    ],
)
def test_a_y_that_is_exact_beside_a_noisy_sensor_is_told(sensor, warns, capsys):
    """LQG filtered an exact y, though the study's sensor had noise."""
    gains = {"kind": "state_feedback", "k_1": 800.0, "k_2": 0.0, "signals": [100.0] * len(sensor["measures"])}
    warn_of_signals(car(sensor=sensor, controller=gains))
    assert ("y in [sensor] measures is exact" in capsys.readouterr().err) == warns


@pytest.mark.parametrize(("at", "warns"), [(50.0, True), ({"uniform": [50.0, 60.0]}, True), (0.5, False)])
def test_a_disturbance_after_the_end_is_told(at, warns, capsys):
    warn_of_times(car(disturbance=[{**HALF, "kind": "step", "at": at}]))
    assert ("disturbance.0.at = 50 s is not before the end" in capsys.readouterr().err) == warns


VECTORS = {
    "name": "vectors", "draws": 1, "loop": {"duration": 0.2, "sample_time": 0.02}, "plant": {"kind": "uav"},
    "reference": {"kind": "hover", "position": [0.2, 0.0, 0.0]}, "controller": {"kind": "pid", "k_p": 0.9},
}  # fmt: skip


@pytest.mark.parametrize("name", ["rotor_1", "rotor_speed_4", "wind_x", "rate_y", "attitude_w"])
def test_components_of_a_vehicles_vectors_are_signals(name):
    """By the name of the column: requirements and formulas of a rotor's speed or a body rate crashed."""
    required = [{"signal": name, "metric": "max_abs", "max": 1e9}, {"formula": f"always {name} < 1e9"}]
    study = dj.Study.from_table(VECTORS | {"requirement": required})
    draw = dj.simulate(study)
    assert float(draw.attrs[f"max_abs_{name}"]) == pytest.approx(np.abs(draw[name].values).max(), rel=1e-12)
    vector = name.rpartition("_")[0]
    for wrong in ({"signal": vector, "metric": "max_abs", "max": 1.0}, {"formula": f"always {vector} < 1"}):
        with pytest.raises(ConfigError, match=rf"{vector}.*did you mean"):
            dj.Study.from_table(VECTORS | {"requirement": [wrong]})


def test_components_of_a_vehicles_vectors_are_measured():
    measured = dj.simulate(dj.Study.from_table(VECTORS | {"sensor": {"measures": ["rate_y", "wind_z"]}}))
    np.testing.assert_array_equal(measured["measured_rate_y"], measured["rate_y"])
    assert measured["measured_rate_y"].attrs["units"] == "rad/s"
    for name in ("rate", "rotor", "rotor_1"):
        with pytest.raises(ConfigError, match=f"'{name}' cannot be measured"):
            dj.Study.from_table(VECTORS | {"sensor": {"measures": [name]}})


def test_a_metric_of_a_channel_that_its_controller_does_not_report_says_what_it_needs():
    wrong = VECTORS | {"requirement": [{"metric": "sampling_ratio_x", "max": 1.0}]}
    with pytest.raises(
        ConfigError, match="'sampling_ratio_x' needs integral_gain, tau_m, which this loop does not have"
    ):
        dj.Study.from_table(wrong)


@pytest.mark.parametrize("output_meaning", ["speed", "state of charge"])
def test_the_whole_state_is_measured_whatever_outputs_mean(output_meaning):
    """An output whose meaning begins with the word state was measured as a state."""
    units = {"output": "m/s", "command": "N", "output_meaning": output_meaning}
    outputs = {"travel": {"c": [1.0, 0.0, 0.0, 0.0], "unit": "m", "meaning": "state of the spring"}}
    plant = car().table["plant"] | {"outputs": outputs}
    study = car(
        plant=plant, units=units, sensor={"measures": "state"}, metrics={"names": ["error_rms"]}, requirement=[]
    )
    assert [signal.name for signal in study.loop.measures] == ["x1", "x2", "x3", "x4"]
