"""Linear plants against SciPy's exact discretisation, normal form, and python-control's systems."""

import control
import numpy as np
import pytest
from scipy import signal

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import mark

T_S = 0.01
A, B, C = [[-0.5, 2.0, 0.0], [-1.0, -0.2, 1.0], [0.3, 0.0, -2.0]], [0.0, 0.0, 1.5], [1.0, 0.0, 0.2]
SPACE = {"kind": "state_space", "a": A, "b": B, "c": C, "x0": [0.3, -0.1]}
FUNCTION = {"kind": "transfer_function", "numerator": [2.0, 3.0], "denominator": [2.0, 1.0, 4.0, 0.5]}


def study(plant, **changes):
    return dj.Study.from_table(
        {
            "name": "linear",
            "loop": {"duration": 4.0, "sample_time": T_S, "substeps": 2},
            "plant": plant,
            "controller": {"kind": "pid", "k_p": 0.8, "k_i": 0.3},
            "reference": {"kind": "step", "size": 1.0},
            "disturbance": {"kind": "step", "value": 0.4, "at": 2.0},
            **changes,
        }
    )


def independent(a, b, c, x, steps=400):
    """The loop by SciPy's exact discretisation, with the PID law written out."""
    b = np.reshape(b, (-1, 1))
    a_d, b_d, *_ = signal.cont2discrete((np.array(a), b, np.atleast_2d(c), np.zeros((1, 1))), T_S)
    x, integral, outputs = np.array(x, float), 0.0, []
    for k in range(steps):
        y = float(np.dot(np.ravel(c), x))
        outputs.append(y)
        u = 0.8 * (1.0 - y) + integral
        integral += T_S * 0.3 * (1.0 - y)
        x = a_d @ x + b_d[:, 0] * (u + (0.4 if k >= 200 else 0.0))
    return np.array(outputs)


def test_state_space_is_that_of_scipy():
    run = dj.simulate(study(SPACE))
    np.testing.assert_allclose(run["y"], independent(A, B, C, [0.3, -0.1, 0.0]), atol=1e-10)


def test_transfer_function_is_that_of_scipy():
    run = dj.simulate(study(FUNCTION))
    a, b, c, _ = signal.tf2ss(FUNCTION["numerator"], FUNCTION["denominator"])
    np.testing.assert_allclose(run["y"], independent(a, b, c, [0.0] * 3), atol=1e-10)
    inside = slice(1, -1)  # the derivative, by central differences of second order
    np.testing.assert_allclose(
        run["y_dot"][inside], (run["y"][2:].values - run["y"][:-2].values) / (2 * T_S), atol=1e-3
    )


FIRST_ORDER = [
    {"kind": "state_space", "a": [[-20.0]], "b": [20.0], "c": [1.0], "x0": [0.3]},
    {"kind": "transfer_function", "numerator": [20.0], "denominator": [1.0, 20.0], "x0": [0.3 / 20.0]},
]


@pytest.mark.parametrize("plant", FIRST_ORDER, ids=["state space", "transfer function"])
def test_the_rate_of_a_first_order_plant_is_the_slope_of_its_output_before_the_sample(plant):
    run = dj.simulate(study(plant, disturbance={"kind": "none"}))
    y, u = run["y"].values, run["u_total"].values
    slope_at_start = -20.0 * y[:-1] + 20.0 * u[:-1]  # under the held command, it decays until the next sample
    np.testing.assert_allclose(run["y_dot"][1:], slope_at_start * np.exp(-20.0 * T_S), atol=1e-12)


@pytest.mark.parametrize("plant", FIRST_ORDER, ids=["state space", "transfer function"])
def test_feedback_of_this_rate_has_the_margins_of_the_loop_with_the_last_command(plant):
    k_1, k_2, decay = 1.0, 0.02, np.exp(-20.0 * T_S)
    z = np.exp(1j * np.geomspace(1e-3, np.pi, 20_000))
    loop = (k_1 - 20.0 * k_2) * (1.0 - decay) / (z - decay) + 20.0 * k_2 / z
    gains = {"kind": "state_feedback", "k_1": k_1, "k_2": k_2}
    found = dj.loop_margins(study(plant, controller=gains)).dataset["sensitivity_peak"].sel(loop="input")
    assert found.item() == pytest.approx(np.max(np.abs(1.0 / (1.0 + loop))), rel=1e-6)


def test_any_entry_may_be_a_law():
    plant = SPACE | {"a": [[{"uniform": [-0.6, -0.4]}, 2.0, 0.0], A[1], A[2]], "b": [0.0, 0.0, {"normal": [1.5, 0.1]}]}
    uncertain = study(plant, draws=3)
    assert set(uncertain.laws) == {"plant.a.0.0", "plant.b.2"}
    run = dj.simulate(uncertain, draw=2)
    a, b = np.array(A), np.array(B)
    a[0, 0], b[2] = run.attrs["plant.a.0.0"], run.attrs["plant.b.2"]
    np.testing.assert_allclose(run["y"], independent(a, b, C, [0.3, -0.1, 0.0]), atol=1e-10)
    assert "plant.a.1.0" in uncertain.override({"sweep": {"plant.a.1.0": [-1.0, -0.5]}}).axes


def test_the_normal_form_is_the_same_plant():
    """s^2 + 3 s with one stable zero, as a transfer function and in the class's own numbers."""
    from dssc_jax.core.normal_form import normal_form

    numerator, denominator = [1.5, 3.0], [1.0, 4.0, 3.0, 0.0]  # a pole at 0: no stiffness
    form = normal_form(numerator, denominator)
    assert form.stiffness == pytest.approx(0.0, abs=1e-12)
    plant = {"kind": "normal_form", "k_p": form.gain, "a_p": form.damping,
             "zero_dynamics": {"a": list(form.zero_a), "c": list(form.zero_c)}}  # fmt: skip
    first = dj.simulate(study({"kind": "transfer_function", "numerator": numerator, "denominator": denominator}))
    two = dj.simulate(study(plant))
    np.testing.assert_allclose(first["y"], two["y"], atol=1e-9)
    np.testing.assert_allclose(first["y_dot"], two["y_dot"], atol=1e-9)


@pytest.mark.parametrize(
    "system",
    [
        signal.StateSpace(A, np.reshape(B, (3, 1)), [C], [[0.0]]),
        control.ss(A, np.reshape(B, (3, 1)), [C], 0),
        signal.TransferFunction(FUNCTION["numerator"], FUNCTION["denominator"]),
        control.tf(FUNCTION["numerator"], FUNCTION["denominator"]),
        signal.ZerosPolesGain([-2.0], [-1.0, -3.0, 0.0], 2.0),
    ],
    ids=lambda system: f"{type(system).__module__.split('.')[0]}-{type(system).__name__}",
)
def test_systems_of_other_packages(system):
    table = dj.plant_table(system)
    if isinstance(system, signal.ZerosPolesGain):
        assert table["numerator"] == [2.0, 4.0]
        assert table["denominator"] == [1.0, 4.0, 3.0, 0.0]
    elif table["kind"] == "state_space":
        assert table == {"kind": "state_space", "a": A, "b": B, "c": C}
    else:
        for name in ("numerator", "denominator"):  # SciPy divides both by the leading coefficient
            scaled = np.array(table[name]) / table["denominator"][0]
            np.testing.assert_allclose(scaled, np.array(FUNCTION[name]) / FUNCTION["denominator"][0])
    assert np.isfinite(dj.simulate(study(table))["y"]).all()


@pytest.mark.parametrize(
    ("system", "complaint"),
    [
        (signal.TransferFunction([1.0], [1.0, 0.5], dt=0.1), "continuous time"),
        (control.tf([1.0], [1.0, 0.5], 0.1), "continuous time"),
        (control.ss([[-1.0]], [[1.0]], [[1.0]], 2.0), "D = 2"),
        (control.ss(-np.eye(2), np.eye(2), np.eye(2), 0), "one input and one output, got 2 and 2"),
        (control.tf([1.0, 2.0], [1.0, 3.0]), "more poles than zeros"),
        (3.0, "linear system of scipy.signal or control, got float"),
    ],
)
def test_what_is_no_plant_is_refused(system, complaint):
    with pytest.raises(ConfigError, match=complaint):
        dj.plant_table(system)


@pytest.mark.parametrize(
    ("plant", "complaint"),
    [
        (SPACE | {"a": [[1.0, 2.0], [3.0]]}, "plant.a.1: must have 2 numbers"),
        (SPACE | {"b": [1.0]}, "plant.b: must have 3 numbers, one for each state, got 1"),
        (SPACE | {"a": [1.0]}, "plant.a: must be a list of numbers"),
        (SPACE | {"b": [0.0, 0.0, 0.0]}, "the command does not reach the output"),
        (SPACE | {"x0": [0.0] * 4}, "plant.x0: must have at most 3 numbers"),
        (
            {"kind": "state_space", "a": [[-1.0]], "b": [1.0], "c": [1.0], "d": 0.5},
            "plant.d: must be 0, got 0.5: the command takes effect after the sample",
        ),
        (FUNCTION | {"numerator": [1.0, 2.0, 3.0, 4.0]}, "got 4: the command takes effect after the sample"),
        (FUNCTION | {"denominator": [0.0, 1.0, 2.0, 3.0]}, "plant.denominator.0: is the coefficient of the highest"),
    ],
)
def test_bad_plants_are_refused(plant, complaint):
    with pytest.raises(ConfigError, match=complaint):
        study(plant)


def test_theorem_1_recognises_its_class():
    """A transfer function with the certified study's k_p and a_p has its certificate, and says why others do not."""
    certified = dj.Study.load("studies/certified_margin.toml").without_sweep()
    normal = certified.override({"plant": {"kind": "normal_form", "k_p": 1.0, "a_p": 0.5}, "requirement": []})
    equal = {"kind": "transfer_function", "numerator": [2.0], "denominator": [2.0, 1.0, 0.0]}
    assert mark(normal).certified is not None
    assert mark(normal.override({"plant": equal})) == mark(normal)
    bounds = {"kind": "transfer_function", "numerator": [{"uniform": [1.8, 2.2]}], "denominator": [2.0, 1.0, 0.0]}
    law = normal.override({"plant": {"kind": "normal_form", "k_p": {"uniform": [0.9, 1.1]}, "a_p": 0.5}})
    assert mark(normal.override({"plant": bounds})) == mark(law)
    for denominator, reason in (([1.0, 1.0], "relative degree 1"), ([1.0, 1.0, 1.0, 1.0], "relative degree 3")):
        silent = mark(normal.override({"plant": equal | {"denominator": denominator}}))
        assert silent.certified is None
        assert reason in silent.reason
