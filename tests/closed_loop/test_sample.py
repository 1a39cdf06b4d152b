"""The closed loop of one draw: order of the integrators, agreement with an independent solver, freezing."""

from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.integrators import rk4, semi_implicit_euler
from dssc_jax.core.signals import PlantInput
from dssc_jax.core.zero_dynamics import ZeroDynamics, companion, is_hurwitz, kharitonov, norm_observer
from dssc_jax.models.plants.normal_form import NORMAL_FORM, NormalFormParams, NormalFormState
from dssc_jax.types import SMOOTH, Command, Controller

OPEN_LOOP = {
    "name": "order",
    "loop": {"duration": 2.0, "sample_time": 2.0, "substeps": 8},
    "plant": {
        "kind": "normal_form",
        "k_p": 1.4,
        "a_p": 0.6,
        "zero_dynamics": {"a": [2.0, 1.5], "c": [0.7, 0.3]},
        "initial": [1.0, 0.5, 0.2, -0.1],
    },
    "controller": {"kind": "pi", "l0": 0.5, "k_p": 0.8, "k_i": 0.0},
    "unmodelled": {"kind": "lag", "order": 2, "mu": 0.5},
    "disturbance": {"kind": "sine", "amplitude": 0.7, "period": 3.0},
}


def end_state(integrator, substeps):
    """y after two seconds, with one held command, by the loop; three samples so that two are complete."""
    study = dj.Study.from_table(OPEN_LOOP).override(
        {"loop.duration": 6.0, "loop.substeps": substeps, "loop.integrator": integrator}
    )
    return dj.simulate(study)["y"].values[1]


@pytest.fixture(scope="module")
def exact():
    """That state by diffrax at tolerance 1e-12, lag included as differential equations."""
    plant = OPEN_LOOP["plant"]
    a_eta, c_eta = companion(tuple(plant["zero_dynamics"]["a"])), np.array(plant["zero_dynamics"]["c"])
    u = -0.8 * (0.5 + 0.5 * 1.0)

    def field(t, x, _):
        v, eta, z = x[1], x[2:4], x[4:]
        d = 0.7 * jnp.sin(2 * jnp.pi / 3.0 * t)
        acceleration = -0.6 * v - c_eta @ eta + 1.4 * (z[1] + d)
        eta_dot = a_eta @ eta + jnp.array([0.0, 1.0]) * v
        lag = jnp.array([(u - z[0]) / 0.5, (z[0] - z[1]) / 0.5])
        return jnp.concatenate([jnp.array([v, acceleration]), eta_dot, lag])

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri8(),
        0.0,
        2.0,
        None,
        jnp.array([*plant["initial"], 0.0, 0.0]),
        stepsize_controller=diffrax.PIDController(rtol=1e-12, atol=1e-12),
        max_steps=100_000,
    )
    return float(solution.ys[-1, 0])


@pytest.mark.parametrize(
    ("integrator", "steps", "order", "band"), [("rk4", [24, 48, 96], 4, 0.2), ("euler", [192, 384, 768], 1, 0.1)]
)
def test_order_against_an_independent_solver(exact, integrator, steps, order, band):
    errors = [abs(end_state(integrator, n) - exact) for n in steps]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    print(f"\n{integrator}: errors {errors}, orders {orders}")
    assert np.all(np.abs(orders - order) < band)


def test_substeps_traced_once_are_those_traced_one_by_one(monkeypatch):
    monkeypatch.setattr("dssc_jax.closed_loop.between_samples.held_parts.UNROLLED", 4)
    one_by_one = end_state("rk4", 4)
    monkeypatch.setattr("dssc_jax.closed_loop.between_samples.held_parts.UNROLLED", 0)
    assert end_state("rk4", 4) == pytest.approx(one_by_one, rel=1e-14)


def test_semi_implicit_euler_does_not_gain_energy():
    """On an undamped oscillator, over 10,000 steps."""

    def field(state, _):
        return NormalFormState(state.x2, -state.x1, ())

    def energy_span(method):
        def body(state, _):
            after = method(field, state, 0.1, ("x2",))
            return after, after.x1**2 + after.x2**2

        _, energy = jax.lax.scan(body, NormalFormState(1.0, 0.0, ()), None, length=10_000)
        return float(energy.max())

    assert energy_span(semi_implicit_euler) < 1.2
    assert energy_span(rk4) <= 1.0


def from_inner_pi(k_p, k_i):
    """A velocity loop with a PI inner controller as an instance of the class (Appendix B); k_p [1/s], k_i [1/s^2]."""
    return NormalFormParams(
        k_p=k_p,
        a_p=(k_p**2 - k_i) / k_p,
        zero_dynamics=ZeroDynamics(a=(k_i / k_p,), c=((k_i / k_p) ** 2,)),
    )


def test_inner_pi_is_an_instance():
    """Appendix B: the transfer function of velocity from command is (k_p s + k_i)/(s^2 + k_p s + k_i)."""
    k_p, k_i = 3.0, 2.0
    params = from_inner_pi(k_p, k_i)
    a_eta, c_eta = -params.zero_dynamics.a[0], params.zero_dynamics.c[0]
    system = np.array([[-params.a_p, -c_eta], [1.0, a_eta]])
    for s in (0.3j, 1.0 + 0.5j, 4.0j):
        found = np.linalg.solve(s * np.eye(2) - system, np.array([params.k_p, 0.0]))[0]
        assert found == pytest.approx((k_p * s + k_i) / (s**2 + k_p * s + k_i), rel=1e-12)
    slope = NORMAL_FORM.derivative(params, NORMAL_FORM.init(params), PlantInput(1.0, 0.0), 0.0)
    assert float(slope.x2) == pytest.approx(k_p)


def test_kharitonov_finds_what_the_corners_of_one_pair_miss():
    low, high = (1.0, 2.0, 1.0), (6.0, 4.0, 2.0)
    rng = np.random.default_rng(0)
    sampled = all(is_hurwitz(tuple(rng.uniform(low, high))) for _ in range(2000))
    assert all(is_hurwitz(p) for p in kharitonov(low, high)) <= sampled
    assert not all(is_hurwitz(p) for p in kharitonov(low, high))  # 1*2 < 6
    assert all(is_hurwitz(p) for p in kharitonov((1.0, 2.0, 1.0), (1.9, 4.0, 2.0)))


def test_norm_observer_bounds_the_zero_dynamics():
    dynamics = ZeroDynamics((2.0, 1.5), (0.7, 0.3))
    rate, gain = norm_observer(dynamics)
    matrix, c = companion(dynamics.a), np.array(dynamics.c)
    rng = np.random.default_rng(1)
    dt, eta, bound = 1e-3, np.zeros(2), 0.0
    for k in range(20_000):
        if k % 500 == 0:
            v = rng.normal() * 3
        eta = eta + dt * (matrix @ eta + np.array([0.0, v]))
        bound = (bound + dt * gain * abs(v)) / (1 + dt * rate)
        assert abs(c @ eta) <= bound + 1e-9


def test_diverged_draw_is_frozen_with_its_time():
    """An unstable plant under a far too weak controller: an outcome, not an error."""
    study = dj.Study.from_table(
        {
            "name": "diverging",
            "draws": 4,
            "loop": {"duration": 400.0, "sample_time": 0.05},
            "plant": {"kind": "normal_form", "a_p": {"choice": [1.0, -3.0]}, "initial": [1.0, 1.0]},
            "controller": {"kind": "pi", "l0": 1.0, "k_p": 0.0, "k_i": 0.0},
            "requirement": [{"metric": "error_max", "max": 10.0}],
        }
    )
    result = dj.run(study)
    unstable = result.dataset["plant.a_p"].values == -3.0
    assert 0 < unstable.sum() < 4
    outcome = result.dataset["outcome"].values
    assert set(outcome[unstable]) == {1}
    assert set(outcome[~unstable]) == {0}
    failed_at = result.dataset["failed_at"].values
    # the state grows as exp(3 t), and exceeds 1e150 at t = ln(1e150)/3
    np.testing.assert_allclose(failed_at[unstable], 150 * np.log(10) / 3, atol=0.5)
    assert np.all(np.isnan(failed_at[~unstable]))
    assert np.all(np.isnan(result.dataset["error_rms"].values[unstable]))
    assert np.all(result.dataset["slack_error_max"].values[unstable] == -np.inf)
    assert result.summary()["points"][0]["failures"] == unstable.sum()
    draw = int(np.flatnonzero(unstable)[0])
    run = dj.replay(result, draw)
    assert run.attrs["outcome_meaning"] == "non_finite"
    assert run.attrs["failed_at"] == failed_at[draw]
    finite = np.isfinite(run["y"].values)
    np.testing.assert_array_equal(finite, run["t"].values < failed_at[draw])  # what follows was not flown


def test_decimated_trajectory_is_a_slice_of_the_full_one(case_2):
    full, coarse = dj.simulate(case_2), dj.simulate(case_2, every=7)
    np.testing.assert_allclose(coarse["y"], full["y"].values[::7], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(coarse["t"], full["t"].values[::7], rtol=1e-15)
    assert coarse.attrs["error_rms"] == pytest.approx(full.attrs["error_rms"], rel=1e-12)


@pytest.mark.parametrize("samples", [300, 301])
def test_every_sample_counts_once_whether_their_number_is_even_or_odd(uncertain, samples):
    """The batched loop may take two samples a turn; the trajectory takes them one by one."""
    study = uncertain.without_sweep().override({"loop.duration": samples * 0.01, "draws": 3})
    assert study.loop.steps == samples
    batched, alone = dj.run(study).dataset, dj.simulate(study, 2)
    for measure in study.measures:
        np.testing.assert_allclose(batched[measure.name].values[2], alone.attrs[measure.name], rtol=1e-11)
    np.testing.assert_allclose(batched["error_rms"].values[2], np.sqrt(np.mean(alone["e"].values ** 2)), rtol=1e-11)


class Gains(NamedTuple):
    """Gains of a controller that filters twice."""

    l0: float = 1.0


class Filters(NamedTuple):
    """Its state, as an array of shape (2,) or as a tuple of two numbers [y]."""

    x: object


def filtered(gains, state, measurement, reference, dt):
    """One step with either form of the state."""
    moved = [0.9 * x + 0.1 * c * (measurement.y - reference.y) for x, c in zip(state.x, (1.0, 2.0), strict=True)]
    x = jnp.stack(moved) if isinstance(state.x, jax.Array) else tuple(moved)
    return Filters(x), Command(-2.0 * (x[0] + x[1]) - 2.0 * measurement.y_dot, 0.0), ()


IN_ARRAY = Controller(Gains, lambda g, y, r: Filters(jnp.zeros(2)), filtered, smooth=SMOOTH)
IN_NUMBERS = IN_ARRAY._replace(init=lambda g, y, r: Filters((0.0, 0.0)))


def with_controller(name):
    """A study with one of these controllers."""
    return dj.Study.from_table(
        {
            "name": "filters",
            "draws": 4,
            "loop": {"duration": 1.0, "sample_time": 0.02},
            "plant": {"kind": "normal_form", "k_p": 1.0, "a_p": {"uniform": [0.5, 1.0]}, "initial": [1.0, 0.0]},
            "controller": {"kind": f"{__name__}:{name}"},
            "requirement": [{"metric": "error_max", "max": 2.0}],
        }
    )


@pytest.mark.parametrize("kernel", ["lanes", "scan"])
def test_a_state_may_be_an_array(kernel, monkeypatch):
    """As machine code and by plain XLA; the sum that tells whether it is finite had its shape."""
    monkeypatch.setenv("DSSC_JAX_KERNEL", kernel)
    in_array, in_numbers = (dj.run(with_controller(name)).dataset for name in ("IN_ARRAY", "IN_NUMBERS"))
    for name in ("outcome", "error_rms", "command_max"):
        np.testing.assert_allclose(in_array[name], in_numbers[name], rtol=1e-12)
    assert np.all(in_array["outcome"] == 0)


def test_a_loop_with_an_array_as_state_is_linearised():
    peaks = [dj.loop_margins(with_controller(name)).dataset["sensitivity_peak"] for name in ("IN_ARRAY", "IN_NUMBERS")]
    np.testing.assert_allclose(*peaks, rtol=1e-9)
