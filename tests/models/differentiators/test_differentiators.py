"""Differentiators: exactness, error against theory, noise, stability at any step; and the contract."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Measurement
from dssc_jax.models.differentiators import DIFFERENTIATORS, NO_DIFFERENTIATOR
from dssc_jax.models.differentiators.high_gain_observer import HIGH_GAIN_OBSERVER, HighGainParams
from dssc_jax.models.differentiators.lead_filter import LEAD_FILTER, LeadFilterParams
from dssc_jax.models.differentiators.levant import LEVANT, LevantParams
from dssc_jax.study.components import parse_component
from tests.contracts import assert_contract

TABLES = [
    {"kind": "none"},
    {"kind": "lead_filter", "tau_f": 0.05},
    {"kind": "high_gain_observer", "epsilon": 0.05},
    {"kind": "high_gain_observer", "epsilon": 0.05, "alpha1": 1.0, "alpha2": 2.0},
    {"kind": "levant", "lipschitz": 2.0},
]
LEAD = (LEAD_FILTER, LeadFilterParams(0.05))
OBSERVER = (HIGH_GAIN_OBSERVER, HighGainParams(0.05))
EXACT = (LEVANT, LevantParams(1.0))


def floats(tree):
    return jax.tree.map(lambda x: jnp.asarray(x, dtype=jnp.result_type(float)), tree)


def velocities(chosen, y, dt):
    """Estimates of y' for a sequence of samples; the first sample goes to init and to the first step."""
    model, params = chosen
    return np.asarray(estimates(model, floats(params), floats(y), floats(dt)))


@functools.partial(jax.jit, static_argnums=0)
def estimates(model, params, y, dt):
    def sample(state, present):
        state, seen = model.step(params, state, Measurement(present, jnp.nan), dt)
        return state, seen.y_dot

    return jax.lax.scan(sample, floats(model.init(params, Measurement(y[0], jnp.nan))), y)[1]


def times(duration, dt):
    return np.arange(round(duration / dt)) * dt


def amplitude(signal, t, omega):
    """Complex c of Im(c exp(i omega t)), by least squares."""
    basis = np.stack([np.cos(omega * t), np.sin(omega * t)], axis=1)
    imaginary, real = np.linalg.lstsq(basis, signal, rcond=None)[0]
    return real + 1j * imaginary


def test_every_kind_has_a_case():
    assert {table["kind"] for table in TABLES} == set(DIFFERENTIATORS)


@pytest.mark.parametrize("table", TABLES)
def test_contract(table):
    component = parse_component(table, DIFFERENTIATORS, "differentiator")
    model, params = component.model, component.params

    def two_steps(y, y_dot):
        state = model.init(params, Measurement(y, y_dot))
        state, _ = model.step(params, state, Measurement(y, y_dot), 0.01)
        return model.step(params, state, Measurement(0.9 * y, y_dot), 0.01)

    seen = assert_contract(two_steps, model.init(params, Measurement(1.0, 0.0)))[1]
    assert isinstance(seen, Measurement)
    assert float(seen.y) == 0.9  # y is passed on as measured


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("second", [1.0, 1.00022, 1.1, -3.0])
def test_gradients_are_finite(table, second):
    """With respect to parameters and samples: at rest, at the edge of sliding (1 + dt^2 lambda_0 L), and outside."""
    component = parse_component(table, DIFFERENTIATORS, "differentiator")
    numbers, tree = jax.tree.flatten(component.params)

    def estimate(numbers, first, second, dt):
        params = tree.unflatten(numbers)
        state = component.model.init(params, Measurement(first, 0.0))
        state, single = component.model.step(params, state, Measurement(first, 0.0), dt)
        state, two = component.model.step(params, state, Measurement(second, 0.0), dt)
        return two.y_dot + component.model.step(params, state, Measurement(first, 0.0), dt)[1].y_dot + single.y_dot

    floats = [float(x) for x in numbers]
    for leaf in jax.tree.leaves(jax.grad(estimate, argnums=(0, 1, 2, 3))(floats, 1.0, second, 0.01)):
        assert jnp.isfinite(leaf)


def test_none_passes_the_measured_velocity():
    assert NO_DIFFERENTIATOR.step(None, (), Measurement(1.0, -0.5), 0.01) == ((), Measurement(1.0, -0.5))


@pytest.mark.parametrize("chosen", [LEAD, OBSERVER, EXACT])
def test_starts_at_rest_whatever_the_position(chosen):
    np.testing.assert_array_equal(velocities(chosen, np.full(20, 7.3), 0.01), 0.0)


# Exactness


def test_lead_filter_is_exact_on_a_ramp_from_the_first_sample():
    dt, tau = 0.02, 0.05
    t = times(2.0, dt)
    np.testing.assert_allclose(velocities(LEAD, 4.0 + 3.0 * t, dt), -3.0 * np.expm1(-t / tau), rtol=0, atol=1e-12)


@pytest.mark.parametrize("dt", [1e-3, 0.05, 10.0])
@pytest.mark.parametrize("chosen", [LEAD, OBSERVER])
def test_linear_ones_are_exact_on_a_ramp_after_the_transient(chosen, dt):
    t = times(max(3.0, 60 * dt), dt)
    found = velocities(chosen, 4.0 + 3.0 * t, dt)
    np.testing.assert_allclose(found[t > t[-1] * 0.9], 3.0, rtol=1e-11)  # rounding of y over dt


@pytest.mark.parametrize("slope", [0.5, 3.0])
@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_levant_is_exact_in_finite_time_and_does_not_chatter(dt, slope):
    """With L = 1 the estimate can rise by lambda_0 L a second: a time of order slope/L."""
    t = times(10.0, dt)
    y = slope * t
    found = velocities(EXACT, y, dt)
    wrong = np.flatnonzero(np.abs(found - slope) > 1e-9)
    reached = t[wrong[-1]] + dt
    explicit = explicit_levant(y, dt)
    after = t > 6.0
    print(
        f"\nslope {slope}, dt {dt}: exact from {reached:.3f} s, error {np.abs(found[after] - slope).max():.1e}, ",
        end="",
    )
    print(f"explicit {np.abs(explicit[after] - slope).max():.1e}")
    assert reached < 1.3 * slope
    # y/dt rounds to eps y/dt
    assert np.abs(found[after] - slope).max() < 4 * np.finfo(float).eps * y[-1] / dt
    assert np.abs(np.diff(explicit[after])) == pytest.approx(1.1 * dt)  # lambda_0 L dt at every sample


def explicit_levant(y, dt, lipschitz=1.0):
    """Forward Euler, for comparison."""
    z0, z1, out = y[0], 0.0, []
    for present in y:
        s = np.sign(z0 - present)
        z0 += dt * (z1 - 1.5 * np.sqrt(lipschitz * abs(z0 - present)) * s)
        z1 -= dt * 1.1 * lipschitz * s
        out.append(z1)
    return np.array(out)


def test_levant_solves_its_inclusion():
    """The closed form against z0+ and z1+ put back into the implicit equations, inside and outside of sliding."""
    rng = np.random.default_rng(0)
    dt, params = 0.05, LevantParams(2.0, 1.7, 1.3)
    inside = 0
    for z0, z1, y in rng.normal(size=(200, 3)) * [0.003, 0.05, 0.003]:
        (p, v), _ = LEVANT.step(
            params, LEVANT.init(params, Measurement(z0, 0.0))._replace(z1=z1), Measurement(y, 0.0), dt
        )
        x, xi = float(p) - y, (z1 - float(v)) / (dt * 1.3 * 2.0)
        assert float(p) == pytest.approx(z0 + dt * (-1.7 * np.sqrt(2.0 * abs(x)) * np.sign(x) + float(v)), abs=1e-15)
        assert abs(xi) <= 1 + 1e-12
        assert abs(x) < 1e-15 or xi == pytest.approx(np.sign(x), abs=1e-12)
        inside += abs(x) < 1e-15
    assert 20 < inside < 180


# Sines, against theory


@pytest.mark.parametrize("omega", [0.5, 4.0, 20.0])
def test_lead_filter_gain_and_phase(omega):
    dt, tau = 1e-3, 0.05
    t = times(4 * np.pi / omega + 2.0, dt)
    found = velocities(LEAD, np.sin(omega * t), dt)
    steady = t > 2.0
    gain = amplitude(found[steady], t[steady], omega)
    z, decay = np.exp(1j * omega * dt), np.exp(-dt / tau)
    assert gain == pytest.approx((1 - decay) / dt * (z - 1) / (z - decay), rel=1e-9)
    # and that is the continuous filter but for the sine's curvature between samples
    continuous = 1j * omega / (1j * omega * tau + 1)
    curvature = omega * (omega + 1 / tau) * dt**2 / 10
    assert abs(gain) == pytest.approx(abs(continuous), rel=curvature)
    assert np.angle(gain) == pytest.approx(np.pi / 2 - np.arctan(omega * tau), abs=curvature)


def test_lead_filter_is_the_first_order_hold_equivalent():
    """Against scipy's discretisation, on noise."""
    y = np.random.default_rng(1).normal(size=300)
    for dt in (1e-3, 0.05, 2.0):
        numerator, denominator, _ = scipy.signal.cont2discrete(([1.0, 0.0], [0.05, 1.0]), dt, "foh")
        expected = scipy.signal.lfilter(numerator.squeeze(), denominator, y - y[0])
        np.testing.assert_allclose(velocities(LEAD, y, dt), expected, rtol=0, atol=1e-11 / dt)


@pytest.mark.parametrize(("alpha1", "alpha2"), [(2.0, 1.0), (1.0, 2.0), (5.0, 1.5)])
def test_observer_is_backward_euler(alpha1, alpha2):
    """Against the matrix form, on noise."""
    y = np.random.default_rng(2).normal(size=300)
    for dt, eps in ((1e-3, 0.05), (0.05, 0.05), (2.0, 0.01)):
        a = np.array([[-alpha1 / eps, 1.0], [-alpha2 / eps**2, 0.0]])
        b = np.array([alpha1 / eps, alpha2 / eps**2])
        x, expected = np.array([y[0], 0.0]), []
        for present in y:
            x = np.linalg.solve(np.eye(2) - dt * a, x + dt * b * present)
            expected.append(x[1])
        found = velocities((HIGH_GAIN_OBSERVER, HighGainParams(eps, alpha1, alpha2)), y, dt)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_observer_error_is_proportional_to_epsilon():
    """On sin t the error tends to (alpha_1/alpha_2) epsilon; exactly it is the transfer function's."""
    dt, omega, errors = 1e-3, 1.0, []
    t = times(10.0, dt)
    steady = t > 3.0
    for eps in (0.1, 0.05, 0.025):
        found = velocities((HIGH_GAIN_OBSERVER, HighGainParams(eps)), np.sin(omega * t), dt)
        gain = amplitude(found[steady], t[steady], omega)
        s = (1 - np.exp(-1j * omega * dt)) / dt  # backward Euler
        assert gain == pytest.approx(s / (eps * s + 1) ** 2, rel=1e-9)
        errors.append(abs(gain - 1j * omega))
    print("\nobserver: error/epsilon on sin t", [e / eps for e, eps in zip(errors, (0.1, 0.05, 0.025), strict=True)])
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.02)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.02)
    assert errors[2] == pytest.approx(2 * 0.025 + dt / 2, rel=0.01)


def test_levant_error_on_a_sine_is_half_a_sample():
    """In sliding it is the backward difference of y, whose error L dt/2 no use of the samples can beat."""
    errors = {}
    for dt in (0.02, 0.01, 0.005):
        t = times(20.0, dt)
        found = velocities(EXACT, np.sin(t), dt)
        steady = t > 5.0
        np.testing.assert_allclose(found[1:][steady[1:]], (np.diff(np.sin(t)) / dt)[steady[1:]], rtol=0, atol=1e-13)
        errors[dt] = np.abs(found - np.cos(t))[steady].max()
    print("\nlevant: error/(L dt) on sin t", {dt: e / dt for dt, e in errors.items()})
    for dt, error in errors.items():
        assert error == pytest.approx(dt / 2, rel=1e-3)


# Noise


def test_levant_error_grows_with_the_root_of_noise_and_bound():
    """c (noise L)^(1/2) for bounded noise (Levant 1998), with one c over three decades of noise and two of L."""
    dt, duration = 2e-4, 16.0
    t = times(duration, dt)
    noise = np.random.default_rng(3).uniform(-1.0, 1.0, len(t))
    found = {}
    for size, lipschitz in ((1e-4, 1.0), (1e-3, 1.0), (1e-2, 1.0), (1e-1, 1.0), (1e-2, 0.1), (1e-2, 10.0)):
        y, y_dot = 0.9 * lipschitz * np.sin(t), 0.9 * lipschitz * np.cos(t)
        estimate = velocities((LEVANT, LevantParams(lipschitz)), y + size * noise, dt)
        found[size, lipschitz] = np.abs(estimate - y_dot)[t > 8.0].max() / np.sqrt(size * lipschitz)
    print("\nlevant: error/(noise L)^(1/2)", {k: round(v, 3) for k, v in found.items()})
    assert max(found.values()) < 2.0  # measured 1.2 to 1.5
    assert max(found.values()) / min(found.values()) < 1.5


def test_noise_amplification():
    """Standard deviation of the estimate over that of white noise on y: theory for the linear ones, and the order."""
    dt, n = 5e-3, 200_000
    noise = 1e-3 * np.random.default_rng(4).normal(size=n)
    impulse = np.zeros(4000)
    impulse[1] = 1.0

    def gain(chosen):
        return velocities(chosen, noise, dt)[1000:].std() / 1e-3

    difference = (LEAD_FILTER, LeadFilterParams(1e-9))
    found = {"difference": gain(difference), "lead": gain(LEAD), "observer": gain(OBSERVER)}
    for name, chosen in (("difference", difference), ("lead", LEAD), ("observer", OBSERVER)):
        response = velocities(chosen, impulse, dt)
        assert found[name] == pytest.approx(np.sqrt(np.sum(response**2)), rel=0.02)
    decay = np.exp(-dt / 0.05)
    assert found["difference"] == pytest.approx(np.sqrt(2) / dt, rel=0.02)
    assert found["lead"] == pytest.approx((1 - decay) / dt * np.sqrt(2 / (1 + decay)), rel=0.02)
    for lipschitz in (0.1, 1.0, 10.0):
        found[f"levant {lipschitz}"] = gain((LEVANT, LevantParams(lipschitz)))
    print("\nnoise amplification [1/s]", {k: round(v, 2) for k, v in found.items()})
    assert found["difference"] > 10 * found["lead"] > 50 * found["observer"]
    assert found["difference"] > found["levant 10.0"] > found["levant 1.0"] > found["levant 0.1"]


# Any step


@pytest.mark.parametrize("chosen", [LEAD, OBSERVER, (HIGH_GAIN_OBSERVER, HighGainParams(0.05, 0.2, 4.0))])
def test_linear_ones_are_stable_at_any_step(chosen):
    """Eigenvalues of the step, for dt from 1e-4 to 1e6 time constants."""
    model, params = chosen
    kind = type(model.init(params, Measurement(0.0, 0.0)))

    def advance(x, dt):
        return jnp.stack(model.step(params, kind(*x), Measurement(0.3, 0.0), dt)[0])

    steps = 0.05 * jnp.logspace(-4, 6, 21)
    matrices = jax.jit(jax.vmap(jax.jacobian(advance), (None, 0)))(jnp.zeros(2), steps)
    assert np.abs(np.linalg.eigvals(matrices)).max() < 1.0


def test_far_longer_steps_give_the_backward_difference():
    y = np.random.default_rng(5).normal(size=200)
    for dt in (1e3, 1e6):
        for chosen in (LEAD, OBSERVER, EXACT):
            found = velocities(chosen, y, dt)
            np.testing.assert_allclose(found[1:], np.diff(y) / dt, rtol=0, atol=1e-3 / dt)


@pytest.mark.parametrize("dt", [1e-3, 0.1, 1.0, 10.0])
def test_levant_is_bounded_at_any_step(dt):
    """On noise of size 1, from L dt^2 far below to far above it, it stays below the backward difference."""
    y = np.random.default_rng(6).uniform(-1.0, 1.0, size=20_000)
    found = np.abs(velocities(EXACT, y, dt))
    assert found.max() <= 2.0 / dt


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"kind": "levent", "lipschitz": 1.0}, "differentiator.kind: unknown kind 'levent'; did you mean 'levant'"),
        ({"kind": "lead_filter"}, "differentiator.tau_f: is required and missing"),
        ({"kind": "lead_filter", "tau_f": 0.0}, "differentiator.tau_f: .* must be > 0, got 0"),
        (
            {"kind": "lead_filter", "tau_f": 0.1, "l": 1.0},
            "differentiator.l: unknown name; valid names are kind, tau_f",
        ),
        ({"kind": "high_gain_observer", "epsilon": -0.1}, "differentiator.epsilon: .* must be > 0, got -0.1"),
        ({"kind": "high_gain_observer", "epsilon": 0.1, "alpha2": 0.0}, "differentiator.alpha2: .* must be > 0"),
        ({"kind": "levant", "lipschitz": "2"}, "differentiator.lipschitz: must be a finite number .* got '2'"),
        (
            {"kind": "levant", "lipschitz": {"normal": [1.0, 0.1]}},
            "differentiator.lipschitz: .* must be > 0, .*support",
        ),
        ({"kind": "levant", "lipschitz": 1.0, "lambda0": 1.0}, "differentiator.lambda0: .* must be > 1, got 1"),
        ({"kind": "levant", "lipschitz": 1.0, "lambda1": 0.0}, "differentiator.lambda1: .* must be > 0"),
    ],
)
def test_bad_input_is_told_in_one_line(table, message):
    with pytest.raises(ConfigError, match=message) as caught:
        parse_component(table, DIFFERENTIATORS, "differentiator")
    assert "\n" not in str(caught.value)
