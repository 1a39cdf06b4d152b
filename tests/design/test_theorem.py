"""Theorem 1 against independent calculations: eigenvalues, Lyapunov equations, comparison systems, searches."""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import minimize

from dssc_jax.core.zero_dynamics import ZeroDynamics, companion
from dssc_jax.design import (
    Bounds,
    Free,
    Parameters,
    Recipe,
    certified,
    check,
    derive,
    design,
    guarantee,
    small_gain,
    synthesise,
)
from dssc_jax.design.lyapunov import alpha_bounds, eigenvalues_of_p, kappa_1, q_coefficients, smallest_of_q, worst_of_q
from dssc_jax.design.practice import predictor_pole, proportional_gain, sample_time
from dssc_jax.design.small_gain import comparison_gains, error_dynamics, guarantee_at, worst_condition
from dssc_jax.models.controllers.gain_functions import Vgsta
from tests.design.cases import BOUNDS, FREE, random_case


def designs(count, seed=1):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        bounds, free = random_case(rng)
        yield synthesise(bounds, free), bounds


def matrices(p, k_p, gain, alpha_1, alpha_2):
    """P and Q - 2 eps I from their definitions (52)-(54)."""
    matrix_p = np.array([[p.gamma * k_p, -2 * p.eps], [-2 * p.eps, 1.0]])
    second = 2 * p.eps * gain + p.gamma
    matrix_a = np.array([[-(k_p * gain - alpha_1), 1.0], [-(k_p * second - alpha_2), 0.0]])
    return matrix_p, -(matrix_a.T @ matrix_p + matrix_p @ matrix_a) - 2 * p.eps * np.eye(2)


def test_eigenvalues_against_the_matrices():
    rng = np.random.default_rng(2)
    for p, bounds in designs(50):
        k_p, gain, a1, a2 = rng.uniform(bounds.k_min, bounds.k_max), 10 ** rng.uniform(-1, 3), *rng.normal(size=2)
        matrix_p, matrix_q = matrices(p, k_p, gain, a1, a2)
        assert list(eigenvalues_of_p(k_p, p.eps, p.gamma)) == pytest.approx(np.linalg.eigvalsh(matrix_p), rel=1e-8)
        smallest = np.linalg.eigvalsh(matrix_q)[0]
        assert smallest_of_q(p, k_p, gain, a1, a2) == pytest.approx(smallest, rel=1e-6, abs=1e-9 * abs(matrix_q).max())


def test_no_attack_makes_q_indefinite():
    """1,000 designs: 300 random (sigma, e, alpha, k_p) each; for 40 of them a descent from the worst point too."""
    rng = np.random.default_rng(3)
    for number, (p, bounds) in enumerate(designs(1000, seed=4)):
        assert check(p, bounds).lyapunov.q_proved
        scale = 10 ** rng.uniform(-3, 4, (2, 300)) * (rng.random((2, 300)) > 0.1)
        sigma, e = scale[0] * p.kappa_c / p.kappa_a, scale[1] * p.kappa_c / p.kappa_b
        k_p = rng.choice([bounds.k_min, bounds.k_max, rng.uniform(bounds.k_min, bounds.k_max)], 300)
        limit = alpha_bounds(p, bounds, derive(bounds, p.l0), sigma, e)
        shares = rng.choice([-1.0, 1.0, 0.3], (2, 300))
        gain = kappa_1(p, sigma, e)
        found = smallest_of_q(p, k_p, gain, shares[0] * limit.rho_1, shares[1] * limit.rho_2)
        worst = worst_of_q(p, bounds, k_p, sigma, e)
        assert worst.min() > 0.0
        assert np.all(found >= worst * (1 - 1e-9))
        if number % 25 == 0:
            at = int(np.argmin(worst))

            def smallest(x, k=k_p[at], p=p, bounds=bounds):
                return float(worst_of_q(p, bounds, k, x[0], x[1]))

            assert minimize(smallest, [sigma[at], e[at]], method="Nelder-Mead").fun > 0.0


def test_positive_coefficients_are_the_determinant():
    """The polynomial of the proof is det(Q - 2 eps I) at the vertex (rho_1, -rho_2) and k_min."""
    for p, bounds in designs(50, seed=6):
        sigma, e = 0.7 * p.kappa_c / p.kappa_a, 1.3 * p.kappa_c / p.kappa_b
        limit = alpha_bounds(p, bounds, derive(bounds, p.l0), sigma, e)
        _, q = matrices(p, bounds.k_min, kappa_1(p, sigma, e), limit.rho_1, -limit.rho_2)
        monomials = (sigma**2, sigma * e, e**2, sigma, e, 1.0)
        polynomial = sum(c * m for c, m in zip(q_coefficients(p, bounds), monomials, strict=True))
        assert polynomial == pytest.approx(np.linalg.det(q), rel=1e-9)


def test_the_printed_bounds_accept_an_indefinite_q():
    """(E4) eps = 1: a design with slack 1 % on the printed recipe, and smallest eigenvalue -3.3."""
    bounds = Bounds(k_min=1.0, k_max=1.0, a_max=1.0, k_d3=1000.0)
    free = Free(l0=1.0, phi_a=0.1, eps=1.0, delta=0.5, eps_1=0.5, eps_2=1.0, eps_3=1.0)
    p = synthesise(bounds, free, Recipe.PRINTED)
    p = p._replace(kappa_c=1.01 * p.kappa_c, kappa_d=1.01 * p.kappa_d)
    certificate = check(p, bounds)
    assert all(row.printed_slack > 0 for row in certificate.inequalities)
    assert certificate.lyapunov.q_smallest == pytest.approx(-3.3, abs=0.1)
    assert not certificate.lyapunov.q_proved
    assert not certificate.table


def test_nothing_is_promised_where_q_is_not_proved():
    """E4's design with a large phi_b and its kappa_c at the printed bound: the small gain holds, Q is indefinite."""
    bounds = Bounds(k_min=1.0, k_max=1.0, a_max=1.0, k_d3=1000.0, alpha_d3=0.1)
    free = Free(l0=1.0, phi_a=0.1, eps=1.0, delta=0.5, eps_1=0.5, eps_2=1.0, eps_3=30.0)
    p = synthesise(bounds, free, Recipe.PRINTED)
    certificate = check(p._replace(kappa_c=1.01 * p.kappa_c, kappa_d=1.01 * p.kappa_d), bounds)
    assert certificate.interconnected
    assert certificate.lyapunov.q_smallest < 0.0
    assert certificate.guarantee.e == np.inf
    assert np.isnan(certificate.practice.sample_time)


@pytest.mark.parametrize("change", [{"phi_a": -5.0}, {"delta": np.nan}, {"phi_b": np.inf}, {"kappa_a": 0.0}])
def test_numbers_out_of_range_are_not_certified(change):
    p = synthesise(BOUNDS, FREE)
    assert certified(p, BOUNDS)
    assert not certified(p._replace(**change), BOUNDS)
    assert not certified(p, BOUNDS._replace(alpha_d3=np.inf))
    assert not certified(p, BOUNDS._replace(k_d3=-1.0))


def test_a_singular_p_is_not_certified():
    """gamma k_min = 4 eps^2 exactly, in plain numbers."""
    p, b = design(BOUNDS, FREE), BOUNDS
    assert not certified(p._replace(gamma=4.0 * p.eps**2 / float(b.k_min)), b)
    assert not certified(p._replace(gamma=1.0, eps=0.5), b._replace(k_min=1.0, k_max=1.0))


def test_an_ill_conditioned_p_eta_is_not_certified():
    bounds = Bounds(1.0, 1.2, 1.0, alpha_d3=0.1, zero_dynamics=ZeroDynamics((1e-10, 1e-16), (1.0, 1.0)))
    assert not check(synthesise(BOUNDS, FREE), bounds).certified


def test_the_articles_recipe_keeps_q_positive():
    """(E2) although it reaches two inequalities with equality only."""
    certificate = check(synthesise(BOUNDS, FREE, Recipe.PRINTED), BOUNDS)
    assert not certificate.table
    assert certificate.lyapunov.q_proved
    assert certificate.lyapunov.q_smallest > 0.0


def test_functions_are_positive_everywhere():
    """k_o tau_av and tau_m of the controller itself, at 2,000 points of each of 100 designs, kinks included."""
    rng = np.random.default_rng(7)
    with jax.enable_x64(True):
        for p, bounds in designs(100, seed=8):
            assert check(p, bounds).lyapunov.functions_proved
            fields = {("epsilon" if name == "eps" else name): value for name, value in p._asdict().items()}
            l0 = fields.pop("l0")
            scale = 10 ** rng.uniform(-6, 4, (2, 2000)) * rng.choice([-1.0, 0.0, 1.0], (2, 2000))
            sigma, e = scale[0] * p.kappa_c / p.kappa_a, scale[1] * p.kappa_c / p.kappa_b
            at = Vgsta(**fields, k_o=1.0).at(sigma, e, l0)
            assert np.all(np.asarray(at.tau_av) > 0)
            assert np.all(np.asarray(at.tau_m) > 0)
            assert np.all(1.0 / np.asarray(at.tau_m) <= predictor_pole(p) * (1 + 1e-12))
            assert np.all(1.0 / np.asarray(at.tau_av) <= proportional_gain(p, abs(sigma), abs(e)) * (1 + 1e-12))


def test_error_dynamics_against_scipy():
    """P_eta of orders two to five."""
    rng = np.random.default_rng(9)
    for m in range(4):
        roots = -(10 ** rng.uniform(-0.5, 0.5, m))
        a = tuple(np.poly(roots)[:0:-1]) if m else ()
        l0 = 0.7
        matrix = np.zeros((m + 1, m + 1))
        if m:
            matrix[:m, :m] = companion(a)
            matrix[m - 1, m] = -l0
        matrix[m, m] = -l0
        expected = solve_continuous_lyapunov(matrix.T, -2 * np.eye(m + 1))
        bounds = Bounds(1.0, 1.0, 1.0, zero_dynamics=ZeroDynamics(a, tuple(rng.normal(size=m))) if m else None)
        found = error_dynamics(bounds, l0)
        b_m = np.eye(m + 1)[m - 1] if m else np.zeros(1)
        b_sigma = np.eye(m + 1)[m] + b_m
        assert list(found.eigenvalues) == pytest.approx(np.linalg.eigvalsh(expected)[[0, -1]], rel=1e-9)
        assert found.by_sigma == pytest.approx(np.linalg.norm(expected @ b_sigma), rel=1e-9)
        assert found.by_reference == pytest.approx(np.linalg.norm(expected @ b_m), abs=1e-12)


def test_the_worst_k_p_is_an_end_of_its_interval():
    """Residuals, decay rate and condition number over 301 values of k_p for 300 designs."""
    for p, bounds in designs(300, seed=10):
        k_p = np.linspace(bounds.k_min, bounds.k_max, 301)
        inner_guarantee = guarantee_at(p, bounds, derive(bounds, p.l0), error_dynamics(bounds, p.l0), k_p)
        worst = guarantee(p, bounds)
        assert inner_guarantee.decay_rate.min() >= worst.decay_rate * (1 - 1e-12)
        assert inner_guarantee.e.max() <= worst.e * (1 + 1e-12)
        assert inner_guarantee.x_eta.max() <= worst.x_eta * (1 + 1e-12)
        assert eigenvalues_of_p(k_p, p.eps, p.gamma).condition.max() <= worst_condition(p, bounds) * (1 + 1e-12)


def test_guarantees_against_the_comparison_system():
    """Rate and residual set against eigenvalues and the long run of (61), (62) at each end of k_p."""
    for p, bounds in designs(20, seed=11):
        p = p._replace(phi_b=2.0 * p.phi_b)
        c, eta = derive(bounds, p.l0), error_dynamics(bounds, p.l0)
        for k_p in (bounds.k_min, bounds.k_max):
            spread = eigenvalues_of_p(k_p, p.eps, p.gamma)
            k = comparison_gains(p, c, eta, spread)
            matrix = np.array([[-k.k_eta1, k.k_eta2], [k.k_v2, -k.k_v1]])
            drive = np.array([k.k_eta3 * bounds.y_m_dot, k.k_v3 * c.beta_m])
            found = guarantee_at(p, bounds, c, eta, k_p)
            assert found.decay_rate == pytest.approx(-np.linalg.eigvals(matrix).real.max(), rel=1e-9)
            w_eta, w_v = np.linalg.solve(-matrix, drive)
            assert found.zeta == pytest.approx(w_v / np.sqrt(spread.low), rel=1e-9)
            assert found.x_eta == pytest.approx(w_eta / np.sqrt(eta.eigenvalues.low), rel=1e-9)
            assert found.e == pytest.approx(found.zeta / p.phi_b / p.l0, rel=1e-12)


def test_the_small_gain_is_where_the_comparison_system_turns_unstable():
    """Just above the derived phi_b it is stable at both ends of k_p, just below at one of them it is not (E11)."""
    for p, bounds in designs(100, seed=12):
        edge = small_gain(p, bounds).derived
        above, below = (guarantee(p._replace(phi_b=factor * edge), bounds) for factor in (1.0001, 0.9999))
        assert above.decay_rate > 0.0
        assert np.isfinite(above.e)
        assert below.decay_rate == 0.0
        assert np.isinf(below.e)


def test_sampling_periods_meet_half_the_limit():
    for p, bounds in designs(20, seed=13):
        gain, pole = proportional_gain(p, 0.0, 0.0), predictor_pole(p)
        period = sample_time(bounds.k_max, gain, pole)
        assert bounds.k_max * period * gain * (1 + 0.5 * period * pole) / 2 == pytest.approx(0.5, rel=1e-12)


def test_the_residual_holds_in_the_sliding_dynamics():
    """(47)-(49) integrated with beta terms at their bounds: |sigma| and |e| end within the guarantee, not at zero."""
    bounds = Bounds(0.9, 1.1, 1.0, alpha_d3=0.3)
    p = synthesise(bounds, Free(0.5, 0.1, 0.3, 0.5, 2.0, 0.1, 6.0))
    promised, c = guarantee(p, bounds), derive(bounds, p.l0)
    for k_p in (0.9, 1.1):

        def flow(t, x, k_p=k_p):
            e, sigma, z = x
            r = np.sqrt(abs(sigma))
            phi = (p.phi_a / (r + p.delta) + p.phi_b) * sigma
            slope = p.phi_a * (r + 2 * p.delta) / (2 * (r + p.delta) ** 2) + p.phi_b
            gain = kappa_1(p, sigma, e)
            drive = c.kappa_e * abs(e) + c.beta_m
            return [
                sigma - p.l0 * e,
                -k_p * gain * phi + c.csigma_bar * sigma + z,
                -k_p * (2 * p.eps * gain + p.gamma) * phi * slope + c.k_sigma * sigma + drive,
            ]

        end = solve_ivp(flow, (0.0, 120.0), [0.2, 0.0, 0.0], method="LSODA", rtol=1e-8, atol=1e-12).y[:, -1]
        assert 0.0 < abs(end[0]) <= promised.e
        assert 0.0 < abs(end[1]) <= promised.sigma


def test_many_designs_at_once():
    """100,000 designs vmapped give what single checks say."""
    rng = np.random.default_rng(14)
    base = synthesise(BOUNDS, FREE)
    designs = Parameters(*(value * rng.uniform(0.9, 1.1, 100_000) for value in base))
    with jax.enable_x64(True):
        batch = jax.jit(jax.vmap(lambda p: certified(p, BOUNDS)))
        found = np.asarray(batch(designs))
    assert 0.01 < found.mean() < 0.99
    assert np.array_equal(found, certified(designs, BOUNDS))
    for i in range(100):
        design = Parameters(*(float(value[i]) for value in designs))
        assert check(design, BOUNDS).certified == found[i]


def test_the_certificate_has_gradients():
    """The guaranteed residual can be differentiated with respect to the parameters."""
    p = synthesise(BOUNDS, FREE)._replace(phi_b=20.0)
    with jax.enable_x64(True):
        slope = jax.grad(lambda phi_b: guarantee(p._replace(phi_b=phi_b), BOUNDS).e)(20.0)
    step = 1e-4
    ends = [guarantee(p._replace(phi_b=20.0 + s), BOUNDS).e for s in (-step, step)]
    assert slope == pytest.approx((ends[1] - ends[0]) / (2 * step), rel=1e-5)
