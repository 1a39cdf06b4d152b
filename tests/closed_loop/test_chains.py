"""Chains of actuators: against matrix exponentials of SciPy, their order, and what follows from their elements."""

import control
import jax
import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from scipy.optimize import brentq

import dssc_jax as dj
from dssc_jax.core.contracts import Unmodelled
from dssc_jax.engine.batching import Engine, lane_of_study, values_of_draws
from dssc_jax.engine.integration import integration_error
from tests.closed_loop.between_samples.test_hold import Pendulum
from tests.tolerances import COMPILER

T_S = 0.01
GAINS = {"kind": "pi", "l0": 4.0, "k_p": 10.0, "k_i": 5.0}
PLANT = {"kind": "normal_form", "k_p": 1.3, "a_p": 0.8, "initial": [1.0, 0.0]}
LAG = {"kind": "lag", "mu": 0.02}
SERVO = {"kind": "rational", "numerator": [0.01, 1.0], "denominator": [1e-4, 0.03, 1.0]}
RESONANCE = {"kind": "transfer_function", "mu": 0.03, "numerator": [1.0, -0.2, 0.5], "denominator": [1.0, 0.4, 1.0]}


def loop(actuators, duration=1.0, **changes):
    """A PI loop from a known start, whose actuators form a chain."""
    table = {"name": "chain", "loop": {"duration": duration, "sample_time": T_S}, "plant": PLANT, "controller": GAINS}
    return dj.Study.from_table(table | {"actuator": actuators} | changes)


def outputs(study):
    return dj.simulate(study)["y"].values


def realised(table):
    """A, b, c, d of a linear element, by SciPy's and python-control's conventions."""
    if table["kind"] == "lag":
        num, den = [1.0], np.poly([-1.0 / table["mu"]] * table.get("order", 1)) * table["mu"] ** table.get("order", 1)
    elif table["kind"] == "rational":
        num, den = table["numerator"], table["denominator"]
    else:
        mu = table["mu"]
        num, den = ([c * mu**i for i, c in enumerate(table[side])][::-1] for side in ("numerator", "denominator"))
    system = control.tf2ss(control.tf(num, den))
    return system.A, system.B[:, 0], system.C[0], system.D[0, 0]


def series(systems):
    """Elements in series, then the plant: matrices of the whole from the first input."""
    plant = (np.array([[0.0, 1.0], [0.0, -0.8]]), np.array([0.0, 1.3]), np.eye(2)[0], 0.0)
    a, b, c, d = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    for a_2, b_2, c_2, d_2 in [*systems, plant]:
        matrix = block_diag(a, a_2)
        matrix[len(a) :, : len(a)] = np.outer(b_2, c)
        a, b, c, d = matrix, np.concatenate([b, b_2 * d]), np.concatenate([d_2 * c, c_2]), d_2 * d
    return a, b


def simulated(systems, digital, steps=100):
    """y at the samples, by one exponential a sample; ``digital`` maps the list of all commands to what is held."""
    a, b = series(systems)
    n = len(a)
    held = np.zeros((n + 1, n + 1))
    held[:n, :n], held[:n, n] = a, b
    transition = expm(held * T_S)
    x, integral, commands, found = np.zeros(n), 0.0, [], []
    x[-2] = 1.0
    for _ in range(steps):
        y, slope = x[-2:]
        found.append(y)
        sigma = slope + GAINS["l0"] * y
        integral += T_S * sigma
        commands.append(-GAINS["k_p"] * sigma - GAINS["k_i"] * integral)
        x = (transition @ np.append(x, digital(commands)))[:n]
    return np.array(found)


def delayed(commands, count):
    return commands[-1 - count] if len(commands) > count else 0.0


def played(commands, half_width):
    """The play as a loop over its history."""
    z = 0.0
    for u in commands:
        z = max(u - half_width, min(u + half_width, z))
    return z


def last(commands):
    return commands[-1]


EXACT = {
    "lag, delay, transfer function": ([LAG, {"kind": "delay", "samples": 2}, SERVO], lambda u: delayed(u, 2)),
    "two equal poles": ([LAG, LAG], last),
    "all-pass and integrator": (
        [
            {"kind": "rational", "numerator": [-0.02, 1.0], "denominator": [0.02, 1.0]},
            {"kind": "rational", "numerator": [1.0, 3.0], "denominator": [1.0, 0.0]},
        ],
        last,
    ),
    "a gain": ([{"kind": "rational", "numerator": [0.7], "denominator": [1.0]}, LAG], last),
    "saturation first": ([{"kind": "saturation", "limit": 5.0}, LAG, RESONANCE], lambda u: np.clip(u[-1], -5.0, 5.0)),
    "digital elements": (
        [
            {"kind": "dead_zone", "half_width": 0.3},
            {"kind": "backlash", "half_width": 0.2},
            {"kind": "delay", "samples": 1},
            RESONANCE,
        ],
        lambda u: delayed([played([v - np.clip(v, -0.3, 0.3) for v in u[: i + 1]], 0.2) for i in range(len(u))], 1),
    ),
}


@pytest.mark.parametrize("case", EXACT)
def test_a_chain_is_held_exactly(case):
    actuators, digital = EXACT[case]
    study = loop(actuators)
    expected = simulated(
        [realised(t) for t in actuators if t["kind"] in ("lag", "rational", "transfer_function")], digital
    )
    error = np.abs(outputs(study) - expected).max()
    print(f"\n{case}: {error:.1e}")
    assert error < 1e-9
    assert integration_error(study).exact


def test_a_delay_acts_first_wherever_it_stands():
    delay = {"kind": "delay", "samples": 2.4}
    behind, before = (outputs(loop(chain)) for chain in ([LAG, SERVO, delay], [delay, LAG, SERVO]))
    np.testing.assert_array_equal(behind, before)


def test_the_order_matters():
    """A saturation behind a lag lets the command's peak pass unless the lag has spread it."""
    limit = {"kind": "saturation", "limit": 5.0}
    first, second = outputs(loop([limit, LAG])), outputs(loop([LAG, limit]))
    assert np.abs(first - second).max() > 1e-3
    fine = loop([LAG, limit]).override({"loop.substeps": 64})
    assert np.abs(outputs(fine) - by_euler([("lag", 0.02), ("limit", 5.0)])).max() < 2e-4


def by_euler(elements, parts=2000):
    """The loop with many short explicit steps a sample, which knows of nothing else."""
    h = T_S / parts
    y, slope, integral = 1.0, 0.0, 0.0
    memory, found = [0.0] * len(elements), []
    for _ in range(100):
        found.append(y)
        sigma = slope + GAINS["l0"] * y
        integral += T_S * sigma
        command = -GAINS["k_p"] * sigma - GAINS["k_i"] * integral
        for _ in range(parts):
            u = command
            for i, (kind, number) in enumerate(elements):
                z = memory[i]
                if kind == "lag":
                    memory[i], u = z + h / number * (u - z), z
                elif kind == "limit":
                    u = max(-number, min(number, u))
                elif kind == "rate":
                    memory[i] = u = z + max(-number * h, min(number * h, u - z))
                else:
                    memory[i] = u = max(u - number, min(u + number, z))
            y, slope = y + h * slope, slope + h * (1.3 * u - 0.8 * slope)
    return np.array(found)


RATE = {"kind": "rate_limit", "rate": 100.0}
MIXED = {
    "rate limit between lags": ([LAG, RATE, LAG], [("lag", 0.02), ("rate", 100.0), ("lag", 0.02)]),
    "backlash behind a lag": ([LAG, {"kind": "backlash", "half_width": 0.5}], [("lag", 0.02), ("play", 0.5)]),
    "rate limit first": ([RATE, LAG], [("rate", 100.0), ("lag", 0.02)]),
}


@pytest.mark.parametrize("case", MIXED)
def test_elements_behind_dynamics_converge_to_the_continuous_chain(case):
    """The error falls with order 2 where limits are reached; the limit is that of many short explicit steps."""
    actuators, elements = MIXED[case]
    study = loop(actuators)
    final = {n: outputs(study.override({"loop.substeps": n})) for n in (1, 64, 512)}
    coarse, fine = (np.abs(final[n] - final[512]).max() for n in (1, 64))
    print(f"\n{case}: {coarse:.1e} and {fine:.1e}")
    assert fine < coarse / 64.0
    assert np.abs(final[512] - by_euler(elements)).max() < 1e-4
    error = integration_error(study)
    assert not error.exact
    assert error.order == 2
    assert "(order 2)" in error.text


SOFT = Unmodelled(
    Pendulum,
    init=lambda params: (),
    step=lambda params, state, command, dt: state,
    output=lambda params, state, command: command / (1.0 + 0.01 * command * command),
    held=True,
)
"""A static element without corners."""


def test_smooth_elements_behind_dynamics_are_of_order_four():
    actuators = [LAG, {"kind": "tests.closed_loop.test_chains:SOFT"}, LAG]
    study = loop(actuators, loop={"duration": 1.0, "sample_time": 0.1}, controller=GAINS | {"k_p": 2.0, "k_i": 0.5})
    final = {n: outputs(study.override({"loop.substeps": n})) for n in (16, 32, 64, 512)}
    errors = np.array([np.abs(final[n] - final[512]).max() for n in (16, 32, 64)])
    orders = np.log2(errors[:-1] / errors[1:])
    print(f"\nerrors {errors}, orders {orders}")
    assert np.all(orders > 3.5)


def test_a_fast_lag_before_a_limit_acts_as_none():
    limit = {"kind": "saturation", "limit": 5.0}
    fast, none = outputs(loop([{"kind": "lag", "mu": 1e-9}, limit])), outputs(loop([limit]))
    np.testing.assert_allclose(fast, none, atol=1e-6)


def test_margins_are_those_of_python_control():
    """Of the sampled loop: zero-order hold of plant and actuators, PI and delay in z."""
    actuators = [{"kind": "delay", "samples": 3}, LAG, SERVO]
    study = loop(actuators, duration=0.5)
    found = dj.loop_margins(study).summary()["loops"]["input"]
    a, b = series([realised(LAG), realised(SERVO)])
    c = np.zeros(len(a))
    c[-2:] = GAINS["l0"], 1.0
    held = control.sample_system(control.ss(a, b[:, None], c[None, :], 0.0), T_S, "zoh")

    def open_loop(w):
        z = np.exp(1j * w * T_S)
        return held(z) * (GAINS["k_p"] + GAINS["k_i"] * T_S * z / (z - 1.0)) / z**3

    turned = brentq(lambda w: np.imag(open_loop(w)), 12.0, 40.0)
    crossed = brentq(lambda w: abs(open_loop(w)) - 1.0, 5.0, 20.0)
    assert found["gain_upper"]["median"] == pytest.approx(1.0 / abs(open_loop(turned)), rel=1e-6)
    assert found["phase"]["median"] == pytest.approx(np.pi + np.angle(open_loop(crossed)), rel=1e-6)


def test_machine_code_has_the_numbers_of_plain_xla():
    """In strict arithmetic up to the contractions of products and sums that XLA makes."""
    actuators = [
        {"kind": "lost_command", "probability": 0.2},
        {"kind": "quantisation", "resolution": 0.01},
        {"kind": "lag", "mu": {"loguniform": [0.005, 0.05]}},
        {"kind": "rate_limit", "rate": {"uniform": [20.0, 90.0]}},
        {"kind": "delay", "samples": {"uniform": [0.0, 2.0]}, "memory": 2},
        {"kind": "backlash", "half_width": 0.05},
        {"kind": "rational", "numerator": [1.0], "denominator": [{"uniform": [0.01, 0.02]}, 1.0]},
    ]
    study = loop(actuators, draws=24)
    values = values_of_draws(study, slice(0, 24))
    results = [Engine(study, 24, kernel=kernel)(values, np.arange(24))() for kernel in ("scan", "strict", "lanes")]
    scan, strict, fast = results
    for name, column in scan.items():
        np.testing.assert_allclose(strict[name], column, rtol=1e-13, atol=1e-13, err_msg=name)
        np.testing.assert_allclose(fast[name], column, rtol=COMPILER, atol=1e-12, err_msg=name)


def test_derivatives_go_through_every_element():
    """Forward, reverse, and differences of the whole loop agree."""
    actuators = [
        {"kind": "dead_zone", "half_width": 0.02},
        LAG,
        {"kind": "rate_limit", "rate": 60.0},
        {"kind": "backlash", "half_width": 0.05},
        {"kind": "rational", "numerator": [1.0], "denominator": [0.01, 1.0]},
    ]
    study = loop(actuators, duration=0.3)
    names = [name for name in study.numbers if name.startswith("actuator.") and not name.endswith("denominator.1")]
    values = {name: float(study.numbers[name].value) for name in names}
    uncertain = study.override({name: {"uniform": [0.9 * value, 1.1 * value]} for name, value in values.items()})
    lane = lane_of_study(uncertain, axis_name=None)
    with jax.enable_x64(True):
        size = jax.jit(lambda values: lane(values, np.uint32(0))["error_rms"])
        forward, reverse = jax.jacfwd(size)(values), jax.grad(size)(values)
        for name, value in values.items():
            h = 1e-6 * value
            differences = (size(values | {name: value + h}) - size(values | {name: value - h})) / (2.0 * h)
            assert float(forward[name]) == pytest.approx(float(differences), rel=1e-4, abs=1e-8), name
            assert float(reverse[name]) == pytest.approx(float(forward[name]), rel=1e-9), name


def test_a_vehicle_has_the_chain_in_each_channel_that_it_names():
    table = {
        "name": "vehicle",
        "loop": {"duration": 0.2, "sample_time": 0.01},
        "plant": {"kind": "uav"},
        "controller": {"kind": "pid", "k_p": 0.5, "k_i": 0.0, "k_d": 0.5},
        "reference": {"x": {"kind": "step", "size": 1.0}, "psi": {"kind": "step", "size": 0.3}},
    }
    bus = {"kind": "delay", "samples": 4, "memory": 4, "name": "bus"}
    study = dj.Study.from_table(table | {"actuator": [bus, {"kind": "lag", "mu": 0.05, "channel": "x"}]})
    assert [len(dj.Study.from_table(table).loop.channels), *map(bool, study.loop.unmodelled)] == [4] + [True] * 4
    assert study.numbers["actuator.bus.samples"].paths == tuple(
        f"unmodelled.{i}{'.0' if i == 0 else ''}.samples" for i in range(4)
    )
    assert study.numbers["actuator.1.mu"].paths == ("unmodelled.0.1.mu",)
    alone = dj.Study.from_table(table | {"unmodelled": {"kind": "delay", "samples": 4, "memory": 4}})
    chained, plain = dj.simulate(study), dj.simulate(alone)
    np.testing.assert_allclose(chained["psi_y"].values, plain["psi_y"].values, rtol=1e-8, atol=1e-12)
    assert np.abs(chained["x_y"].values - plain["x_y"].values).max() > 1e-6


BEFORE_PENDULUM = {
    "sampled, then linear": [{"kind": "saturation", "limit": 1.5}, {"kind": "delay", "samples": 1}, LAG | {"mu": 0.1}],
    "rate limit, then linear": [{"kind": "rate_limit", "rate": 3.0}, LAG | {"mu": 0.1}],
    "limit behind a lag": [LAG | {"mu": 0.1}, {"kind": "saturation", "limit": 1.5}],
}


@pytest.mark.parametrize("case", BEFORE_PENDULUM)
def test_a_nonlinear_plant_behind_a_chain(case):
    """Integrated as a whole and as a linear part with a remainder: both tend to the same, with order 4 where exact."""

    def swung(plant, substeps):
        clock = {"sample_time": 0.25, "duration": 3.0, "substeps": substeps}
        controller = GAINS | {"l0": 1.0, "k_p": 2.0, "k_i": 0.5}
        plant = {"kind": f"tests.closed_loop.between_samples.test_hold:{plant}"}
        return outputs(loop(BEFORE_PENDULUM[case], loop=clock, plant=plant, controller=controller))

    finest = swung("PENDULUM", 256)
    split = swung("SPLIT", 256)
    np.testing.assert_allclose(split, finest, atol=2e-5 if case == "limit behind a lag" else 1e-8)
    errors = np.array([np.abs(swung(plant, 4) - finest).max() for plant in ("PENDULUM", "SPLIT")])
    finer = np.array([np.abs(swung(plant, 16) - finest).max() for plant in ("PENDULUM", "SPLIT")])
    print(f"\n{case}: {errors} and {finer}")
    assert np.all(finer < errors / (4.0 if case == "limit behind a lag" else 100.0))
