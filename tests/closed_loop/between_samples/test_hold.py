"""Between the samples: the whole loop against matrix exponentials in NumPy, and the orders of what is not linear."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.closed_loop.between_samples.held_parts import make_mover
from dssc_jax.core.contracts import LinearDynamics, Moments, Plant, Unmodelled
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurement
from dssc_jax.engine.integration import integration_error
from dssc_jax.models.actuators.rate_limit import RATE_LIMIT, RateLimitParams
from tests.exponentials import exponential

T_S = 0.01
GAINS = {"kind": "pi", "l0": 4.0, "k_p": 60.0, "k_i": 30.0}


def loop(unmodelled, plant=None, duration=1.0, **controller):
    """A PI loop from a known start, as a study's table."""
    return {
        "name": "held",
        "loop": {"duration": duration, "sample_time": T_S},
        "plant": plant or {"kind": "normal_form", "k_p": 1.3, "a_p": 0.8, "initial": [1.0, 0.0]},
        "controller": GAINS | controller,
        "unmodelled": unmodelled,
    }


def chain(poles):
    """Matrices of y = u/((s/p_1 + 1) ... (s/p_n + 1)) as lags in series."""
    n = len(poles)
    a = np.zeros((n, n))
    for i, pole in enumerate(poles):
        a[i, i] = -pole
        if i:
            a[i, i - 1] = pole
    b = np.zeros(n)
    b[0] = poles[0]
    return a, b


def simulated(poles, delay=0.0, plant=None, steps=100, gains=GAINS):
    """y at the samples of the PI loop by one matrix exponential a sample, in NumPy alone.

    Args:
        poles: Poles of the lags between command and plant [rad/s].
        delay: Delay [samples], a whole number.
        plant: A, b, c and the initial state.
        steps: Number of samples.
        gains: Gains of the PI controller.
    """
    a_p, b_p, c, x_p = plant or (np.array([[0.0, 1.0], [0.0, -0.8]]), np.array([0.0, 1.3]), np.eye(2)[0], [1.0, 0.0])
    n, m = len(a_p), len(poles)
    matrix = np.zeros((n + m + 1, n + m + 1))
    matrix[:n, :n] = a_p
    if m:
        a, b = chain(poles)
        matrix[:n, n + m - 1] = b_p
        matrix[n : n + m, n : n + m] = a
        matrix[n : n + m, -1] = b
    else:
        matrix[:n, -1] = b_p
    transition = exponential(matrix * T_S)
    x = np.concatenate([x_p, np.zeros(m)])
    integral, commands, found = 0.0, [0.0] * int(delay), []
    for _ in range(steps):
        y, slope = c @ x[:n], c @ a_p @ x[:n]
        found.append(y)
        sigma = slope + gains["l0"] * y
        integral += T_S * sigma
        commands.append(-gains["k_p"] * sigma - gains["k_i"] * integral)
        x = (transition @ np.append(x, commands[-1 - int(delay)]))[: n + m]
    return np.array(found)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("ratio", [0.0, 1e-9, 1e-3, 0.1, 0.2, 0.3, 1.0, 10.0])
def test_every_lag_is_held_exactly(ratio, order):
    """Whatever its ratio to the sample, down to none; so the peak, which decides a requirement, is exact, too."""
    mu = ratio * T_S
    unmodelled = {"kind": "lag", "order": order, "mu": mu} if ratio else {"kind": "none"}
    y = dj.simulate(dj.Study.from_table(loop(unmodelled)))["y"].values
    expected = simulated([1.0 / mu] * order if ratio else [])
    np.testing.assert_allclose(y, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


def test_a_lag_tends_to_none():
    ideal, short = (
        dj.simulate(dj.Study.from_table(loop(table)))["y"].values
        for table in ({"kind": "none"}, {"kind": "lag", "order": 1, "mu": 1e-16})
    )
    np.testing.assert_allclose(short, ideal, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("substeps", [1, 20])
def test_a_loop_that_is_unstable_without_lag_fails_with_a_small_one(substeps):
    """A gain of 230 is beyond the exact margin of the sampled loop, whatever the substeps."""
    table = loop({"kind": "lag", "order": 1, "mu": 1e-4}, k_p=230.0, duration=4.0) | {"draws": 40}
    table["plant"] = table["plant"] | {"k_p": {"uniform": [0.9, 1.1]}}
    table["loop"] = table["loop"] | {"substeps": substeps}
    result = dj.run(dj.Study.from_table(table | {"requirement": [{"metric": "error_max", "max": 2.0}]}))
    gains = result.dataset["plant.k_p"].values
    expected = []
    for gain in gains:
        plant = (np.array([[0.0, 1.0], [0.0, -0.8]]), np.array([0.0, gain]), np.eye(2)[0], [1.0, 0.0])
        with np.errstate(all="ignore"):
            expected.append(np.abs(simulated([1e4], plant=plant, steps=400, gains=GAINS | {"k_p": 230.0})).max() > 2.0)
    assert sum(expected) == 40
    np.testing.assert_array_equal(result.failed.values, expected)


@pytest.mark.parametrize("delay", [1, 3])
def test_a_delay_is_held_exactly(delay):
    y = dj.simulate(dj.Study.from_table(loop({"kind": "delay", "samples": float(delay)}, k_p=20.0)))["y"].values
    expected = simulated([], delay=delay, gains=GAINS | {"k_p": 20.0})
    np.testing.assert_allclose(y, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


def test_a_transfer_function_is_held_exactly():
    """Two unequal poles, 1/((s/50 + 1)(s/3000 + 1))."""
    mu = 1.0 / 50.0
    table = {"kind": "transfer_function", "mu": mu, "numerator": [1.0], "denominator": [1.0, 61 / 60, 1 / 60]}
    y = dj.simulate(dj.Study.from_table(loop(table, k_p=10.0)))["y"].values
    expected = simulated([50.0, 3000.0], gains=GAINS | {"k_p": 10.0})
    np.testing.assert_allclose(y, expected, rtol=1e-9, atol=1e-10)


STIFF = [(500.0, 5000.0), (1.0, 1e4), (1.0, 1e6), (1e8, 1e8)]


@pytest.mark.parametrize("kind", ["transfer_function", "state_space"])
@pytest.mark.parametrize("poles", STIFF)
def test_a_stiff_stable_plant_stays_stable(poles, kind):
    """Poles up to 1e6 over the sample time, with one substep."""
    product, total = poles[0] * poles[1], poles[0] + poles[1]
    a = np.array([[0.0, 1.0], [-product, -total]])
    b, c = np.array([0.0, 1.0]), np.array([product, 0.0])
    table = {"kind": "state_space", "a": a.tolist(), "b": b.tolist(), "c": c.tolist(), "x0": [1.0 / product, 0.0]}
    if kind == "transfer_function":
        table = {"kind": kind, "numerator": [product], "denominator": [1.0, total, product], "x0": [1.0 / product, 0.0]}
    controller = {"kind": "pid", "k_p": 0.2, "k_i": 0.0, "k_d": 0.0}
    study = dj.Study.from_table(loop({"kind": "none"}, table) | {"controller": controller})
    found = dj.simulate(study)["y"].values
    held = np.zeros((3, 3))
    held[:2, :2], held[:2, 2] = a, b
    transition = exponential(held * T_S)
    x, expected = np.array([1.0 / product, 0.0]), []
    for _ in found:
        expected.append(c @ x)
        x = (transition @ np.append(x, -0.2 * expected[-1]))[:2]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert integration_error(study).exact


@pytest.mark.parametrize(
    ("kind", "ratio"), [("lag", 1e-3), ("lag", 0.1), ("lag", 0.2), ("lag", 0.3), ("second", 0.15), ("delay", 1.0)]
)
def test_the_gain_margin_is_that_of_the_exact_loop(kind, ratio):
    """By the spectral radius of the sampled matrices, bisected over the gain of the command."""
    mu = ratio * T_S
    order = {"lag": 1, "second": 2, "delay": 0}[kind]
    unmodelled = {"kind": "delay", "samples": 1.0} if kind == "delay" else {"kind": "lag", "order": order, "mu": mu}
    gains = GAINS | {"k_p": 40.0}
    study = dj.Study.from_table(loop(unmodelled, k_p=40.0, duration=0.5))
    found = dj.loop_margins(study).summary()
    margin = gain_margin([1.0 / mu] * order, 1 if kind == "delay" else 0, gains)
    assert found["loops"]["input"]["gain_upper"]["median"] == pytest.approx(margin, rel=1e-6)


def gain_margin(poles, delay, gains):
    """The factor of the command at which the largest eigenvalue of the sampled loop reaches the unit circle."""
    n = 2 + len(poles)
    held = np.zeros((n + 1, n + 1))
    held[:2, :2] = [[0.0, 1.0], [0.0, -0.8]]
    if poles:
        a, b = chain(poles)
        held[1, n - 1] = 1.3
        held[2:n, 2:n] = a
        held[2:n, n] = b
    else:
        held[1, n] = 1.3
    transition = exponential(held * T_S)
    sigma = np.zeros(n + 1 + delay)
    sigma[:2] = gains["l0"], 1.0

    def radius(factor):
        # states: plant, lags, the integral before the sample, delayed commands
        integral = np.zeros_like(sigma)
        integral[n] = 1.0
        command = -factor * (gains["k_p"] * sigma + gains["k_i"] * (integral + T_S * sigma))
        closed = np.zeros((n + 1 + delay, n + 1 + delay))
        closed[:n, :n] = transition[:n, :n]
        applied = command
        if delay:
            applied = np.zeros_like(sigma)
            applied[n + 1] = 1.0
            closed[n + 1] = command
        closed[:n] += np.outer(transition[:n, n], applied)
        closed[n] = integral + T_S * sigma
        return np.abs(np.linalg.eigvals(closed)).max()

    low, high = 1.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    return low


class Pendulum(NamedTuple):
    damping: Annotated[float, Quantity("1/s", "damping", at_least=0.0)] = 0.3


class PendulumState(NamedTuple):
    angle: float
    rate: float


def swing(params, state, drive, t):
    return PendulumState(
        state.rate, -9.0 * jnp.sin(state.angle) - params.damping * state.rate + drive.command + drive.disturbance
    )


def measured(params, state, drive):
    return Measurement(state.angle, state.rate)


PENDULUM = Plant(Pendulum, lambda params: PendulumState(1.0, 0.0), swing, measured, lambda params: 1.0, ("rate",))
SPLIT = PENDULUM._replace(
    linear=lambda params: LinearDynamics(((0.0, 1.0), (-9.0, -params.damping)), ((0.0, 1.0),), ((0.0, 1.0),)),
    remainder=lambda params, state, drive, t: PendulumState(0.0, 9.0 * (state.angle - jnp.sin(state.angle))),
)
"""The same pendulum, split into its linear part and a remainder."""

OF_STATE = {"kind": "partition", "k_d4": 0.4, "k_d5": 3.0, "alpha_d2": 4.0, "period": 1.4}
LINEAR = {"kind": "normal_form", "k_p": 1.3, "a_p": 0.8, "initial": [1.0, 0.0]}
CASES = {
    "disturbance of time": (
        LINEAR,
        {"kind": "lag", "order": 2, "mu": 0.03},
        {"kind": "sine", "amplitude": 9.0, "period": 0.2},
    ),
    "disturbance of the state": (LINEAR, {"kind": "lag", "order": 1, "mu": 0.03}, OF_STATE),
    "pendulum": ("PENDULUM", {"kind": "none"}, OF_STATE),
    "pendulum behind a lag": ("PENDULUM", {"kind": "lag", "order": 2, "mu": 0.04}, {"kind": "constant", "value": 2.0}),
    "pendulum behind a fast zero": (
        "PENDULUM",
        {"kind": "transfer_function", "mu": 0.05, "numerator": [1.0, 2.0], "denominator": [1.0, 1.0]},
        {"kind": "none"},
    ),
    "split pendulum behind a lag": ("SPLIT", {"kind": "lag", "order": 2, "mu": 0.04}, OF_STATE),
    "split pendulum behind a rate limit": ("SPLIT", {"kind": "rate_limit", "rate": 0.5}, {"kind": "none"}),
    "pendulum behind a rate limit": ("PENDULUM", {"kind": "rate_limit", "rate": 0.5}, {"kind": "none"}),
}


def with_substeps(case, substeps, **changes):
    """A study of a case with slow sampling, so that the integration between the samples is seen."""
    plant, unmodelled, disturbance = CASES[case]
    plant = {"kind": f"tests.closed_loop.between_samples.test_hold:{plant}"} if isinstance(plant, str) else plant
    table = loop(unmodelled, plant, duration=3.0, k_p=2.0, k_i=0.5, l0=1.0) | {"disturbance": disturbance}
    clock = {"sample_time": 0.5, "duration": 3.0, "substeps": substeps}
    return dj.Study.from_table(table | {"loop": clock | changes})


@pytest.mark.parametrize("case", CASES)
def test_the_order_of_every_form_is_four(case):
    """Against 256 substeps: of plants integrated as a whole, and of the rule on top of what is held exactly."""
    final = {n: dj.simulate(with_substeps(case, n))["y"].values for n in (8, 16, 32, 256)}
    errors = np.array([np.abs(final[n] - final[256]).max() for n in (8, 16, 32)])
    orders = np.log2(errors[:-1] / errors[1:])
    print(f"\n{case}: errors {errors}, orders {orders}")
    assert np.all((orders > 3.5) | (errors[1:] < 1e-13))


@pytest.mark.parametrize("case", ["pendulum behind a lag", "split pendulum behind a lag"])
def test_a_lag_before_a_nonlinear_plant_tends_to_none(case):
    """With one step of Runge-Kutta in each sample, to rounding: no share of the old command stays."""
    study = with_substeps(case, 1)
    short = dj.simulate(study.override({"unmodelled.mu": 1e-14}))["y"].values
    ideal = dj.simulate(study.override({"unmodelled": {"kind": "none"}}))["y"].values
    np.testing.assert_allclose(short, ideal, rtol=1e-10, atol=1e-11)


def test_both_forms_of_the_pendulum_agree():
    complete, split = (
        dj.simulate(
            dj.Study.from_table(
                with_substeps("pendulum", 128).table
                | {"plant": {"kind": f"tests.closed_loop.between_samples.test_hold:{name}"}}
            )
        )["y"].values
        for name in ("PENDULUM", "SPLIT")
    )
    np.testing.assert_allclose(split, complete, rtol=1e-8)


@pytest.mark.parametrize(("command", "rate"), [(1.0, 4.0), (-1.0, 1e9), (1.0, 0.1), (0.0, 1.0), (1.0, np.inf)])
def test_moments_of_a_rate_limit_are_those_of_its_integral(command, rate):
    dt, start = 0.5, 0.25
    times = (np.arange(2_000_000) + 0.5) / 2_000_000
    slope = np.sign(command - start) * min(rate, 1e12)
    ramp = np.where(np.abs(slope) * dt * times < abs(command - start), start + slope * dt * times, command)
    found = RATE_LIMIT.moments(RateLimitParams(rate), (start,), command, dt)
    assert float(found.mean) == pytest.approx(ramp.mean(), abs=1e-6)
    assert float(found.rise) == pytest.approx(12.0 * np.mean((times - 0.5) * ramp), abs=1e-5)


def test_an_actuator_that_declares_nothing_acts_through_its_values():
    """Simpson's rule for its moments; here they are exact, since its output is a parabola."""
    drifting = Unmodelled(
        Pendulum,
        init=lambda params: (0.0,),
        step=lambda params, z, command, dt: (z[0] + dt,),
        output=lambda params, z, command: z[0] ** 2,
    )

    _, line = make_mover(drifting, Pendulum(), 0.5)((0.2,), 0.0)
    assert line.mean == pytest.approx((0.7**3 - 0.2**3) / 1.5)
    assert line.rise == pytest.approx(0.7**2 - 0.2**2)
    assert isinstance(line, Moments)


def test_the_integration_error_is_told_with_its_remedy():
    """A pendulum sampled much too slowly: verdicts of the check against many substeps, and the remedy works."""
    study = with_substeps("pendulum", 1).override({"requirement": [{"metric": "error_rms", "max": 0.2}]})
    coarse = integration_error(study)
    assert not coarse.exact
    assert coarse.matters
    assert f"loop.substeps = {coarse.remedy}" in coarse.warning
    first, two = (dj.run(study.override({"loop.substeps": n}), check=False).dataset["error_rms"].values for n in (1, 2))
    assert coarse.change == pytest.approx(np.abs(first - two).max() / 0.2, rel=1e-9)
    assert "diverges" not in coarse.warning
    assert "diverges: look at the plant's signs" in coarse._replace(change=1e9).warning
    mended = integration_error(study.override({"loop.substeps": coarse.remedy}))
    assert not mended.matters
    assert mended.warning == ""


@pytest.mark.parametrize(("samples", "told"), [(1.5, True), (2.0, False)])
def test_the_fraction_of_a_delay_is_told_whatever_else_is_integrated(samples, told):
    delay = {"unmodelled": {"kind": "delay", "samples": samples}}
    assert (
        "a delay's fraction of a sample" in integration_error(with_substeps("pendulum", 8).override(delay)).text
    ) == told


def test_a_changed_verdict_is_told():
    study = with_substeps("pendulum", 1)
    first, two = (
        dj.run(study.override({"loop.substeps": n}), check=False).dataset["error_rms"].values[0] for n in (1, 2)
    )
    halfway = study.override({"requirement": [{"metric": "error_rms", "max": float(0.5 * (first + two))}]})
    assert integration_error(halfway).verdicts == 1
    assert "1 verdicts change" in dj.run(halfway).summary()["integration"]["warning"]
    assert dj.run(halfway, check=False).summary()["integration"] is None


@pytest.mark.parametrize(
    ("samples", "averaged"),
    [(2.0, False), (1.5, True), ({"uniform": [1.0, 3.0]}, True), ({"uniform": [0.0, 1.0]}, True)],
)
def test_the_fraction_of_a_delay_is_told(samples, averaged):
    found = integration_error(dj.Study.from_table(loop({"kind": "delay", "samples": samples})))
    assert found.exact
    assert ("but for the fraction of a delay" in found.text) == averaged
