"""The conservative form: its law for every row, sums that telescope under noise, and no drift where it saturates."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.registry import Discretisation
from dssc_jax.core.signals import Measurement, ReferencePoint
from dssc_jax.models.controllers.dssc import DSSC
from dssc_jax.models.controllers.dssc_forms import DsscGains, PredictorStart
from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS, Constant
from dssc_jax.models.controllers.modulation import ConstantModulation
from tests.models.controllers.test_dssc import random_functions

CONSERVATIVE, IMPLICIT = (DSSC.members[form] for form in (Discretisation.CONSERVATIVE, Discretisation.IMPLICIT))
AT_REST = ReferencePoint(0.0, 0.0, 0.0)
OF_SIGMA = [kind for kind in GAIN_FUNCTIONS if kind not in ("vgsta", "sta")]


def fly(member, gains, sigma, dt):
    """Infos, states and integrated law over samples of sigma with e = 0."""

    def sample(state, sigma):
        after, _, info = member.step(gains, state, Measurement(0.0, sigma), AT_REST, dt)
        law = gains.functions.law(sigma, 0.0, gains.functions.at(sigma, 0.0, gains.l0))
        return after, (after.u_av, after.predictor, law.gain * sigma, law.rate * law.gain * sigma, info)

    start = member.init(gains, Measurement(0.0, sigma[0]), AT_REST)
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), start)
    return jax.lax.scan(sample, start, sigma)[1]


@partial(jax.jit, static_argnums=0)
def flights(member, gains, sigma, dt):
    """As :func:`fly`, over rows of samples."""
    return jax.vmap(lambda row: fly(member, gains, row, dt))(sigma)


def flown(member, gains, sigma, dt):
    """As :func:`fly`, compiled, as NumPy's arrays."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], flights(member, gains, sigma[None], dt))


@pytest.mark.parametrize("kind", GAIN_FUNCTIONS)
def test_the_law_is_what_22_synthesises(kind):
    """phi_1' = 1/(k_o tau_av) by automatic differentiation, and phi_2 what is then left of (22)."""

    def phi_1(sigma, e, row, l0):
        return row.law(sigma, e, row.at(sigma, e, l0)).gain * sigma

    @jax.jit
    def synthesised(sigma, e, row, l0):
        at = row.at(sigma, e, l0)
        return at, row.law(sigma, e, at), jax.grad(phi_1, (0, 1))(sigma, e, row, l0)

    rng = np.random.default_rng(5)
    for _ in range(20):
        row, l0 = random_functions(kind, rng), float(rng.uniform(0.2, 2.0))
        sigma, e = (float(s * 10 ** rng.uniform(-4, 1)) for s in rng.choice([-1.0, 1.0], 2))
        at, law, (by_sigma, by_e) = jax.tree.map(float, synthesised(sigma, e, row, l0))
        assert by_sigma == pytest.approx(1.0 / (at.k_o * at.tau_av), rel=1e-9)
        left = by_sigma * sigma / at.tau_m - by_e * (sigma - l0 * e)
        assert law.rate * law.gain * sigma == pytest.approx(left, rel=1e-7, abs=1e-9 * abs(by_e * (sigma - l0 * e)))


@pytest.mark.parametrize("kind", OF_SIGMA)
def test_sums_telescope_under_noise(kind):
    """u_av - phi_1 - T_s sum phi_2 is constant over 100,000 unsaturated noisy samples; the implicit form drifts."""
    gains = DsscGains(1.0, random_functions(kind, np.random.default_rng(2)), ConstantModulation(1e9))
    rng, dt = np.random.default_rng(1), 1e-3
    sigma = 0.3 * np.sin(np.arange(100_000) * dt) + 0.06 * rng.standard_normal(100_000)
    u_av, _, phi_1, phi_2, info = flown(CONSERVATIVE, gains, sigma, dt)
    assert np.all(info.sliding_margin > 0.0)
    np.testing.assert_array_equal(info.sigma_hat, sigma)
    gap = np.asarray(u_av - phi_1 - dt * np.cumsum(phi_2))
    size = np.abs(phi_1).max() + dt * np.abs(np.cumsum(phi_2)).max()
    print(f"\n{kind}: {np.abs(gap - gap[0]).max() / size:.1e} of {size:.2g} m/s")
    assert np.abs(gap - gap[0]).max() < 1e-12 * size
    if kind != "constant":
        u_av, _, phi_1, phi_2, _ = flown(IMPLICIT, gains, sigma, dt)
        assert np.ptp(np.asarray(u_av - phi_1 - dt * np.cumsum(phi_2))) > 1e-3 * size


@pytest.mark.parametrize("kind", OF_SIGMA)
def test_noise_does_not_drive_a_saturated_loop(kind):
    """Most samples saturate; the slope of u_av over time stays within three of its standard errors of 0."""
    row = random_functions(kind, np.random.default_rng(2))
    dt, runs = 2e-3, 24
    sigma = 0.2 * np.random.default_rng(8).standard_normal((runs, 5_000))
    wide = DsscGains(1.0, row, ConstantModulation(1e9))
    rho = 0.02 * float(np.abs(flights(CONSERVATIVE, wide, sigma, dt)[-1].u_0[0]).mean())
    gains = DsscGains(1.0, row, ConstantModulation(rho))
    u_av, _, _, _, info = flights(CONSERVATIVE, gains, sigma, dt)
    assert np.mean(np.asarray(info.sliding_margin) < 0.0) > 0.5
    slopes = np.polyfit(dt * np.arange(5_000), np.asarray(u_av).T, 1)[0]
    assert abs(slopes.mean()) < 3.0 * slopes.std(ddof=1) / np.sqrt(runs)


def test_constant_functions_give_the_implicit_form():
    gains = DsscGains(1.0, Constant(10.0, 0.1, 2.0), ConstantModulation(0.5), None, PredictorStart.MATCHED)
    sigma = np.random.default_rng(3).normal(size=2_000)
    u_av, _, _, _, info = flown(CONSERVATIVE, gains, sigma, 0.01)
    first, _, _, _, second = flown(IMPLICIT, gains, sigma, 0.01)
    np.testing.assert_allclose(u_av, first, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(info.sigma_tilde, second.sigma_tilde, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(info.sliding_margin, second.sliding_margin, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("kind", GAIN_FUNCTIONS)
def test_the_predictor_is_phi_1_of_sigma_hat(kind):
    """Saturated or not; sigma_hat is recorded only."""
    row = random_functions(kind, np.random.default_rng(6))
    sigma = np.random.default_rng(9).normal(size=300)
    gains = DsscGains(1.0, row, ConstantModulation(0.2))
    _, predictor, _, _, info = flown(CONSERVATIVE, gains, sigma, 0.005)
    assert np.sum(np.asarray(info.sliding_margin) < 0.0) > 0
    hat = np.asarray(info.sigma_hat)
    phi_1 = jax.vmap(lambda x: row.law(x, 0.0, row.at(x, 0.0, 1.0)).gain * x)(hat)
    np.testing.assert_allclose(phi_1, predictor, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kind", GAIN_FUNCTIONS)
def test_the_smoothed_sign_holds_for_the_predictors_lag(kind):
    """u_0 = rho x/(|x| + w) with x = (phi_1(sigma) - w+)/g, to first order sigma_tilde."""

    @jax.jit
    def after_one_sample(gains, sigma):
        state = CONSERVATIVE.init(gains, Measurement(0.0, 0.0), AT_REST)
        after, _, info = CONSERVATIVE.step(gains, state, Measurement(0.0, sigma), AT_REST, 0.01)
        at = gains.functions.at(sigma, 0.0, 1.0)
        phi_1 = gains.functions.law(sigma, 0.0, at).gain * sigma
        return (phi_1 - after.predictor) * at.k_o * at.tau_av, info.u_0

    rng = np.random.default_rng(4)
    for _ in range(50):
        row, width = random_functions(kind, rng), float(10 ** rng.uniform(-3, 0))
        gains = DsscGains(1.0, row, ConstantModulation(0.5), sign_width=width)
        x, u_0 = map(float, after_one_sample(gains, float(rng.normal())))
        assert u_0 == pytest.approx(0.5 * x / (abs(x) + width), rel=1e-5, abs=1e-8)


@pytest.mark.parametrize("kind", OF_SIGMA)
def test_the_start_midpoint_sums_to_the_middle_of_each_hold(kind):
    """u_av = phi_1(sigma_k) - phi_1(sigma_0) + T_s (phi_2(sigma_0)/2 + phi_2(sigma_1) + ... + phi_2(sigma_k))."""
    rng, dt = np.random.default_rng(8), 0.01
    row, sigma = random_functions(kind, rng), 2.0 + 0.5 * np.sin(np.linspace(0.0, 9.0, 400))
    gains = DsscGains(1.0, row, ConstantModulation(1e6), predictor_start=PredictorStart.MIDPOINT)
    u_av, _, phi_1, phi_2, _ = flown(CONSERVATIVE, gains, jnp.asarray(sigma), dt)
    expected = phi_1 - phi_1[0] + dt * (np.cumsum(phi_2) - 0.5 * phi_2[0])
    assert u_av == pytest.approx(expected, abs=1e-12 * np.abs(u_av).max())


@pytest.mark.parametrize("form", ["implicit", "conservative"])
@pytest.mark.parametrize("kind", ["square_root", "field"])
def test_the_start_midpoint_is_more_than_twice_as_exact(kind, form):
    """Largest distance of Case 2's e at T_s = 20 ms from the limit T_s -> 0, over 20 s."""
    from benchmarks.noise.forms import case

    def errors(start, sample_time):
        changes = {
            "controller.predictor_start": start,
            "loop.duration": 20.0,
            "disturbance.at": 10.0,
            "metrics.after": 0.0,
        }
        return dj.simulate(case(kind, form, sample_time, **changes), every=round(0.04 / sample_time))["e"].values[:490]

    limit = errors("midpoint", 0.00125)
    matched, midpoint = (np.abs(errors(start, 0.02) - limit).max() for start in ("matched", "midpoint"))
    print(f"\n{kind}, {form}: {matched:.4f} m matched, {midpoint:.4f} m midpoint")
    assert midpoint < 0.5 * matched


@pytest.mark.parametrize("member", [IMPLICIT, CONSERVATIVE], ids=["implicit", "conservative"])
@pytest.mark.parametrize("kind", ["vgsta", *OF_SIGMA])
def test_the_sampling_limit_is_that_of_the_functions_at_the_origin(kind, member):
    """sigma' = u from 1e-9 m/s shrinks 1 % below (T_s/(k_o tau_av))(1 + T_s/(2 tau_m)) = 2, and grows 1 % above."""
    row = random_functions(kind, np.random.default_rng(6))
    at = jax.tree.map(float, row.at(0.0, 0.0, 1.0))
    gain = at.k_o * at.tau_av
    limit = at.tau_m * (np.sqrt(1.0 + 4.0 * gain / at.tau_m) - 1.0)
    gains = DsscGains(1.0, row, ConstantModulation(10.0), predictor_start=PredictorStart.MATCHED)

    @jax.jit
    def delayed(dt):
        def sample(carry, _):
            sigma, state = carry
            state, command, _ = member.step(gains, state, Measurement(0.0, sigma), AT_REST, dt)
            return (sigma + dt * command.robust, jax.tree.map(lambda leaf: jnp.asarray(leaf, float), state)), sigma

        state = member.init(gains, Measurement(0.0, 1e-9), AT_REST)
        start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), (1e-9, state))
        return jnp.abs(jax.lax.scan(sample, start, length=4000)[1][-200:]).max()

    lower, upper = (float(delayed(factor * limit)) for factor in (0.99, 1.01))
    assert lower < 1e-10
    assert upper > 1e-9


def test_no_loop_stays_below_the_floor_of_the_noise():
    """std(e) = s (T_s/(2 l_0))^(1/2): constant functions, at rest, 64 draws of 200 s."""
    from benchmarks.noise.forms import STILL, case

    functions = {"kind": "constant", "k_o": 2.0, "tau_m": 10.0, "tau_av": 0.03}
    resting = {**STILL, "plant.initial": [0.0, 0.0], "reference": {"kind": "zero"}, "draws": 64, "loop.duration": 200.0}
    metrics = {"metrics": {"after": 40.0, "names": ["error_rms"]}}
    study = case("field", "implicit", 0.02, 0.06, **resting, **metrics, **{"controller.functions": functions})
    found = float(np.sqrt(np.mean(dj.run(study).dataset["error_rms"] ** 2)))
    floor = 0.06 * np.sqrt(0.02 / (2.0 * 0.2))
    print(f"\nstd(e) {found:.4f} m, floor {floor:.4f} m")
    assert found == pytest.approx(floor, rel=0.1)


@pytest.mark.parametrize("form", ["implicit", "conservative"])
def test_noise_does_not_move_case_2(form):
    """Largest |e| after 40 s at T_s = 5 ms, with and without noise of 0.06 m/s on the velocity."""
    functions = {"kind": "approx_sta_2", "kappa1": 0.6025, "kappa2": 0.15, "delta": 0.1, "tau_av": 0.03}
    study = dj.Study.load("studies/paper_case2.toml").override(
        {
            "draws": 4,
            "controller.discretisation": form,
            "controller.predictor_start": "matched",
            "controller.functions": functions,
            "metrics": {"after": 40.0, "names": ["error_max"]},
            "requirement": [],
        }
    )
    noisy = study.override({"sensor": {"kind": "noisy", "velocity_std": 0.06}})
    quiet, moved = (float(dj.run(draw).dataset["error_max"].median()) for draw in (study, noisy))
    print(f"\n{form}: {quiet:.3f} m without noise, {moved:.3f} m with it")
    assert (moved < 1.15 * quiet) == (form == "conservative")
    assert (moved > 10.0 * quiet) == (form == "implicit")
