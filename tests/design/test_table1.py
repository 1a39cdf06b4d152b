"""Table 1: the article's recipe reaches equality only (E2), the strict one holds on the whole interval (E3, E4)."""

import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.zero_dynamics import ZeroDynamics, companion
from dssc_jax.design import Bounds, Free, InequalityState, Parameters, Recipe, check, derive, synthesise
from dssc_jax.design.bounds import coupling
from dssc_jax.design.table1 import f, kappa_c_bound, kappa_d_bound
from tests.design.cases import BOUNDS, FREE, random_case


def states(certificate):
    return {inequality.name: inequality.state for inequality in certificate.inequalities}


def test_the_articles_recipe_reaches_only_equality_for_kappa_c_and_kappa_d():
    """(E2) at a known k_p: everything else is strict."""
    for bounds in (BOUNDS._replace(k_min=1.0, k_max=1.0), Bounds(1.0, 1.0, 0.0)):
        certificate = check(synthesise(bounds, FREE, Recipe.PRINTED), bounds)
        found = states(certificate)
        kappa_c = {found.pop("kappa_c (Lyapunov)"), found.pop("kappa_c (disturbance)")}
        assert InequalityState.BOUNDARY in kappa_c
        assert kappa_c <= {InequalityState.BOUNDARY, InequalityState.SATISFIED}
        assert found.pop("kappa_d") is InequalityState.BOUNDARY
        assert set(found.values()) == {InequalityState.SATISFIED}
        assert not certificate.certified


def test_f_is_one_plus_eps_1_at_k_min():
    parameters = synthesise(BOUNDS, FREE)
    assert f(BOUNDS.k_min, FREE.eps, parameters.gamma) == pytest.approx(1 + FREE.eps_1, rel=1e-14)


def test_synthesised_parameters_are_strict_over_the_whole_interval():
    """(E3) for 1,000 random bounds: certified, and strict at 10,001 values of k_p each."""
    rng = np.random.default_rng(5)
    for _ in range(1000):
        bounds, free = random_case(rng)
        p = synthesise(bounds, free)
        certificate = check(p, bounds)
        assert certificate.certified, states(certificate)
        assert all(i.printed_slack > 0 for i in certificate.inequalities)
        k_p = np.linspace(bounds.k_min, bounds.k_max, 10_001)
        assert np.all(f(k_p, p.eps, p.gamma) > 1.0)
        assert np.all(p.kappa_c > kappa_c_bound(k_p, p.eps, p.gamma))
        assert np.all(p.kappa_d > kappa_d_bound(k_p, p.eps, p.gamma))


def test_a_design_at_the_nominal_gain_fails_below_it():
    """(E3): at k_p = 1 for an interval that starts at 0.8."""
    nominal = synthesise(BOUNDS._replace(k_min=1.0), FREE._replace(eps_1=0.05))
    found = states(check(nominal, BOUNDS))
    assert found["f"] is InequalityState.VIOLATED
    assert found["kappa_c (Lyapunov)"] is InequalityState.NOT_EVALUABLE


@pytest.mark.parametrize(
    ("row", "changes"),
    [
        ("phi_b", {}),
        ("kappa_c (Lyapunov)", {}),
        ("kappa_c (disturbance)", {"k_d3": 1e3}),
        ("kappa_b", {}),
        ("kappa_a (disturbance)", {"c_isigma": 1e3}),
        ("kappa_a (kappa_b/l0)", {}),
        ("kappa_d", {}),
    ],
)
def test_one_per_cent_below_names_that_inequality(row, changes):
    """And no other: the parameter put 1 % below the row's bound, under bounds that make this the row that decides."""
    bounds = BOUNDS._replace(y_m=0.0, y_m_dot=0.0, **changes)
    p = synthesise(bounds, FREE._replace(eps_1=0.05))
    bound = next(i.bound for i in check(p, bounds).inequalities if i.name == row)
    p = p._replace(**{row.split(" ")[0]: 0.99 * bound})
    if row == "phi_b":  # the other inequalities divide by it
        p = p._replace(kappa_a=1e3, kappa_b=1.0, kappa_c=1e4)
    failing = {i.name for i in check(p, bounds).inequalities if i.state is not InequalityState.SATISFIED}
    assert failing == {row}


def test_f_one_per_cent_below_takes_the_bound_of_kappa_c_along():
    """f = 0.99: that bound divides by f - 1 and has no meaning left; no other row fails."""
    p = synthesise(BOUNDS, FREE)
    k_p, eps = BOUNDS.k_min, p.eps
    p = p._replace(gamma=(0.99 / (4.0 * eps * k_p) + 4.0 * eps**2) / k_p, kappa_d=1e3)
    failing = {
        name: state for name, state in states(check(p, BOUNDS)).items() if state is not InequalityState.SATISFIED
    }
    assert failing == {"f": InequalityState.VIOLATED, "kappa_c (Lyapunov)": InequalityState.NOT_EVALUABLE}


def test_the_factor_two_eps():
    """(E4): eps = 1; a design that meets the printed bound of kappa_c, and misses the derived one by nearly half."""
    bounds = Bounds(k_min=1.0, k_max=1.0, a_max=1.0, k_d3=1000.0)
    free = Free(l0=1.0, phi_a=0.1, eps=1.0, delta=0.5, eps_1=0.5, eps_2=1.0, eps_3=1.0)
    printed = synthesise(bounds, free, Recipe.PRINTED)
    printed = printed._replace(kappa_c=1.01 * printed.kappa_c, kappa_d=1.01 * printed.kappa_d)
    row = next(i for i in check(printed, bounds).inequalities if i.name == "kappa_c (disturbance)")
    assert row.printed_slack > 0
    assert row.state is InequalityState.VIOLATED
    assert row.bound == pytest.approx(2 * row.printed_bound, rel=0.01)
    assert check(synthesise(bounds, free), bounds).certified


def test_constants():
    """Worked out by hand."""
    constants = derive(BOUNDS, 0.5)
    assert constants.kd1_bar == pytest.approx(1.3 * (0.05 + 0.5 * 0.02))
    assert constants.kd2_bar == pytest.approx(1.3 * 0.02)
    assert constants.csigma_bar == pytest.approx(1.3 * 0.4 + 0.5 + 1.2)
    assert constants.kd3_bar == pytest.approx(constants.csigma_bar + 1.3 * (0.05 * 20 + 0.02 * 3 + 0.1))
    assert constants.k_sigma == pytest.approx((0.5 + 1.2) * 0.5 + 1.3 * 0.2 + 1.3 * 0.3 + 0.2)
    assert constants.kappa_e == pytest.approx(0.5 * constants.k_sigma)
    assert constants.beta_m == pytest.approx((1.3 * 0.3 + 0.2) * 3.0)
    assert (constants.c_eta_a_eta, constants.c_eta_b_eta) == pytest.approx((0.2, 0.2))


def test_coupling_of_the_zero_dynamics():
    """|C A| and |C B| against the matrices."""
    dynamics = ZeroDynamics((2.0, 3.0, 4.0), (0.5, -0.7, 0.9))
    a, c = companion(dynamics.a), np.asarray(dynamics.c)
    assert coupling(dynamics) == pytest.approx((np.linalg.norm(c @ a), abs(c[-1])), rel=1e-14)


def test_bad_bounds():
    with pytest.raises(ConfigError, match=r"k_min: must be <= k_max"):
        check(synthesise(BOUNDS, FREE), BOUNDS._replace(k_min=2.0))
    with pytest.raises(ConfigError, match=r"Hurwitz"):
        synthesise(BOUNDS._replace(zero_dynamics=ZeroDynamics((-1.0,), (1.0,))), FREE)
    with pytest.raises(ConfigError, match=r"free.eps_1: eps_1.* must be > 0"):
        synthesise(BOUNDS, FREE._replace(eps_1=0.0))


def test_parameters_feed_the_controller():
    """The names of Table 1 are those of the study file's vgsta functions, eps being epsilon."""
    from dssc_jax.models.controllers.gain_functions import Vgsta

    assert {name.replace("eps", "epsilon") for name in Parameters._fields} - {"l0"} <= set(Vgsta._fields)
