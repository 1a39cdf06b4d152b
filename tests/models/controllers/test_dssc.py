"""The implicit scheme: its two identities, its sampling limit, the analytic PI loop, and the table of Case 2."""

import jax
import numpy as np
import pytest
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.core.registry import Discretisation
from dssc_jax.core.signals import Measurement, ReferencePoint, tracking_error
from dssc_jax.models.controllers.dssc import DSSC
from dssc_jax.models.controllers.dssc_forms import (
    DsscGains,
    DsscState,
    PredictorStart,
    smoothed_remainder,
    smoothed_sign,
)
from dssc_jax.models.controllers.gain_functions import (
    GAIN_FUNCTIONS,
    ApproximateSta1,
    ApproximateSta2,
    Constant,
    Field,
    SquareRoot,
    StandardSta,
    Vgsta,
)
from dssc_jax.models.controllers.modulation import ConstantModulation
from tests.tolerances import IDENTITY, ROUNDING

IMPLICIT = DSSC.members[Discretisation.IMPLICIT]
AT_REST = ReferencePoint(0.0, 0.0, 0.0)


def random_functions(kind, rng):
    """A row of the table with random constants, given by k_o or by tau_av."""
    log = lambda low, high: float(np.exp(rng.uniform(np.log(low), np.log(high))))  # noqa: E731
    factor = {"k_o": log(1.0, 300.0)} if rng.random() < 0.5 else {"tau_av": log(1e-3, 0.3)}
    gains = {"kappa1": log(0.05, 10.0), "kappa2": log(0.05, 100.0)}
    delta = {"delta": log(1e-3, 2.0)}
    match kind:
        case "constant":
            return Constant(log(1.0, 300.0), log(1e-3, 0.3), log(1e-5, 10.0))
        case "sta":
            return StandardSta(**gains, **factor)
        case "approx_sta_1":
            return ApproximateSta1(**gains, **delta, **factor)
        case "approx_sta_2":
            return ApproximateSta2(**gains, **delta, **factor)
        case "square_root":
            return SquareRoot(log(10, 200), log(1e-3, 5), log(0.1, 2), log(0.1, 2), log(1e-3, 0.1))
        case "field":
            return Field(log(1.0, 50.0), gains["kappa1"], gains["kappa2"], delta["delta"])
        case "vgsta":
            kappas = [log(0.01, 2.0) for _ in range(4)]
            return Vgsta(log(0.01, 2), log(0.1, 20), *kappas, log(0.1, 1), log(0.1, 2), delta["delta"], **factor)
    raise AssertionError(kind)


@jax.jit
def sigma_seen(gains, sigma, e):
    """What the controller computes as sigma of the measurement that scheme_step makes."""
    return tracking_error(Measurement(e, sigma - gains.l0 * e), AT_REST, gains.l0).sigma


def scheme_step(gains, state, sigma, e, dt):
    """One controller step at given (sigma, e)."""
    return IMPLICIT.step(gains, state, Measurement(e, sigma - gains.l0 * e), AT_REST, dt)


@pytest.mark.parametrize("kind", GAIN_FUNCTIONS)
def test_implicit_identities_for_every_row(kind, record_property):
    """sigma_hat+ = sigma, and (22) in backward-Euler form, with new functions and states at every sample."""
    rng = np.random.default_rng(7)
    step = jax.jit(scheme_step)
    worst, checked = 0.0, 0
    for _ in range(60):
        dt = float(10 ** rng.uniform(-4, -1.5))
        state = DsscState(float(rng.normal()), float(rng.normal()), 0.0, ())
        held = False  # the sample before was not saturated, so that sigma_hat is its sigma
        previous = state.predictor
        for _ in range(6):
            gains = DsscGains(
                1.0, random_functions(kind, rng), ConstantModulation(1e9), predictor_start=PredictorStart.ZERO
            )
            sigma, e = (float(s * 10 ** rng.uniform(-6, 1)) for s in rng.choice([-1.0, 1.0], 2))
            after, command, info = jax.tree.map(float, step(gains, state, sigma, e, dt))
            sigma = float(sigma_seen(gains, sigma, e))
            sliding = info.sliding_margin > 0.0
            if sliding:
                increment = after.u_av - state.u_av
                product, ratio = info.k_o * info.tau_av, dt / info.tau_m
                scale = abs(state.u_av) + abs(increment)
                general = ((1.0 + ratio) * sigma - state.predictor) / product
                worst = max(worst, abs(info.sigma_hat - sigma) / max(abs(sigma), abs(state.predictor)))
                worst = max(worst, abs(increment - general) / scale)
                if held:
                    backward_euler = (sigma - previous + ratio * sigma) / product
                    worst = max(worst, abs(increment - backward_euler) / scale)
                assert command.robust == -after.u_av
                assert info.integral_gain == pytest.approx(1.0 / (product * info.tau_m), rel=1e-12)
                checked += 1
            held, previous, state = sliding, sigma, after
    record_property("worst", worst)
    print(f"\n{kind}: worst relative residual {worst:.1e} in {checked} samples")
    assert checked > 300
    assert worst < IDENTITY


def test_saturated_step():
    """u_0 = +-rho, and sigma_tilde+ = free -+ c rho."""
    gains = DsscGains(1.0, Constant(10.0, 0.1, 2.0), ConstantModulation(0.5), predictor_start=PredictorStart.ZERO)
    state = DsscState(0.1, 0.0, 0.0, ())
    dt = 0.01
    after, _, info = scheme_step(gains, state, 5.0, 0.0, dt)
    c = dt * 10.0 / ((1 + dt / 0.1) * (1 + dt / 2.0))
    assert float(info.u_0) == 0.5
    assert float(info.sliding_margin) < 0
    assert float(info.sigma_tilde) == pytest.approx(5.0 + c * 0.1 - c * 0.5, rel=ROUNDING)
    assert float(after.u_av) == pytest.approx((0.1 + (dt / 0.1) * 0.5) / (1 + dt / 0.1), rel=ROUNDING)


@pytest.mark.parametrize("width", [1e-9, 1e-3, 0.3, 10.0])
def test_the_smoothed_sign_is_solved_exactly(width):
    """u_0 = rho x/(|x| + width) at x = sigma_tilde+ of the sample, saturated or not."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        gains = DsscGains(
            1.0,
            Constant(10.0, 0.1, 2.0),
            ConstantModulation(0.5),
            predictor_start=PredictorStart.ZERO,
            sign_width=width,
        )
        state = DsscState(*rng.normal(size=2), 0.0, ())
        _, _, info = scheme_step(gains, state, float(rng.normal() * 10 ** rng.uniform(-3, 1)), 0.0, 0.01)
        x = float(info.sigma_tilde)
        assert float(info.u_0) == pytest.approx(0.5 * x / (abs(x) + width), rel=1e-6, abs=1e-9)


def test_a_vanishing_width_is_the_clip():
    """Exactly with width 0, and with finite derivatives there; nearly with a small one."""
    rng = np.random.default_rng(4)
    for _ in range(100):
        state = DsscState(*rng.normal(size=2), 0.0, ())
        sigma = float(rng.normal() * 10 ** rng.uniform(-3, 1))
        commands = []
        for width in (None, 0.0, 1e-10):
            gains = DsscGains(
                1.0,
                Constant(10.0, 0.1, 2.0),
                ConstantModulation(0.5),
                predictor_start=PredictorStart.ZERO,
                sign_width=width,
            )
            commands.append(float(scheme_step(gains, state, sigma, 0.0, 0.01)[1].robust))
        assert commands[1] == pytest.approx(commands[0], rel=1e-13)
        assert commands[2] == pytest.approx(commands[0], rel=1e-4)
    for free, width in ((0.0, 0.0), (0.05, 0.0), (-0.05, 0.0), (0.0, 0.1), (1.0, 0.0)):
        slopes = jax.grad(smoothed_remainder, argnums=(0, 1, 2))(free, 0.1, 0.5, width)  # a corner is at 0.05
        assert np.isfinite(slopes).all()
    assert np.isfinite(jax.grad(smoothed_sign)(0.0, 0.0))


def test_the_smoothed_explicit_sign():
    assert [float(smoothed_sign(x, 0.0)) for x in (-2.0, 0.0, 3.0)] == [-1.0, 0.0, 1.0]
    assert float(smoothed_sign(0.3, 0.1)) == pytest.approx(0.75)


def pure_integrator(k_o, tau_av, tau_m, dt, duration, rho=1e6, start="matched", initial=(0.0, 1e-3)):
    """sigma' = k_p u exactly: a_p = l0, no reference, no nominal control."""
    functions = {"kind": "constant", "k_o": k_o, "tau_av": tau_av, "tau_m": tau_m}
    return dj.Study.from_table(
        {
            "name": "integrator",
            "loop": {"duration": duration, "sample_time": dt},
            "plant": {"kind": "normal_form", "k_p": 1.3, "a_p": 0.7, "initial": list(initial)},
            "controller": {"kind": "ssc", "l0": 0.7, "rho": rho, "functions": functions, "predictor_start": start},
        }
    )


@pytest.mark.parametrize(("dt", "tau_m"), [(0.01, 1.0), (0.01, 0.005), (0.05, 0.02)])
def test_sampling_limit(dt, tau_m):
    """Stable just below sampling_ratio = 1, unstable just above; the metric tells which."""
    for ratio in (0.98, 1.02):
        product = 1.3 * dt * (1 + dt / (2 * tau_m)) / (2 * ratio)
        run = dj.simulate(pure_integrator(product / 0.02, 0.02, tau_m, dt, duration=600 * dt))
        sigma = np.abs(run["sigma"].values)
        assert run.attrs["sampling_ratio"] == pytest.approx(ratio, rel=1e-9)
        growth = sigma[-20:].max() / sigma[100:120].max()
        print(f"\nT_s={dt} tau_m={tau_m}: sampling ratio {ratio} grows by {growth:.2e} over 480 samples")
        assert (growth < 0.1) if ratio < 1 else (growth > 10.0)


def test_constant_functions_are_the_analytic_pi_loop():
    """Against the matrix exponential of the continuous loop under PI; halving T_s halves the difference."""
    k_p, a_p, l0 = 1.3, 0.7, 0.7
    k_o, tau_av, tau_m, end = 20.0, 0.05, 0.8, 4.0
    prop = 1.0 / (k_o * tau_av)
    integral = prop / tau_m
    row = [-k_p * prop * l0, -a_p - k_p * prop, -k_p * integral]
    matrix = np.array([[0.0, 1.0, 0.0], row, [l0, 1.0, 0.0]])  # y, y', int sigma
    exact = (expm(matrix * end) @ [1.0, 0.5, 0.0])[0]
    errors = []
    for dt in (0.02, 0.01, 0.005, 0.0025):
        study = pure_integrator(k_o, tau_av, tau_m, dt, end + dt, start="zero", initial=(1.0, 0.5))
        run = dj.simulate(study)
        assert run.attrs["outside_sliding"] == 0.0
        errors.append(abs(run["y"].values[-1] - exact))
        pi = study.override({"controller": {"kind": "pi", "l0": l0, "k_p": prop, "k_i": integral}})
        np.testing.assert_allclose(dj.simulate(pi)["y"], run["y"], rtol=1e-9, atol=1e-10)
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    print(f"\nerror against the analytic loop {errors}, ratios {ratios}")
    assert np.all(np.abs(ratios - 2.0) < 0.1)


@pytest.fixture(scope="module")
def table():
    """rms error over 40 to 80 s and total variation of u, by sample time and discretisation."""
    from tests.conftest import CASE_2

    study = dj.Study.from_table(CASE_2)
    cells = [(1e-5, "implicit"), *((dt, form) for dt in (1e-4, 1e-3, 5e-3) for form in ("implicit", "explicit"))]
    found = {}
    for dt, form in [*cells, (1e-2, "implicit")]:
        run = dj.run(study.override({"loop.sample_time": dt, "controller.discretisation": form}), devices=1)
        found[dt, form] = (run.dataset["error_rms_after_40"].item(), run.dataset["command_tv"].item())
        print(f"\nT_s = {dt:g} s, {form}: rms {found[dt, form][0]:.4f} m, TV {found[dt, form][1]:.2f} m/s", end="")
    return found


def test_case_2_table(table):
    """The table of docs/model.md, section 5."""
    limit = table[1e-5, "implicit"][0]
    assert limit == pytest.approx(4.3028, abs=2e-4)
    assert table[1e-2, "implicit"][0] == pytest.approx(limit, rel=3e-3)
    off = table[1e-3, "explicit"][0] / limit - 1.0
    assert off == pytest.approx(0.176, abs=0.01)
    assert table[1e-3, "explicit"][1] > 1000 * table[1e-3, "implicit"][1]
    assert table[1e-4, "explicit"][0] == pytest.approx(4.3741, abs=1e-3)
    assert table[5e-3, "explicit"][0] == pytest.approx(9.8435, abs=5e-2)


def test_both_forms_tell_the_sliding_condition_alike(case_2):
    """After the first seconds |d_0|/k_o of (20) stays below rho: explicit chatter is not loss of sliding."""
    study = case_2.override({"metrics.after": 5.0})
    for form in ("implicit", "explicit"):
        run = dj.simulate(study.override({"controller.discretisation": form}))
        assert run.attrs["outside_sliding"] == 0.0
    starved = dj.simulate(study.override({"controller.discretisation": "explicit", "controller.rho": 0.3}))
    assert starved.attrs["outside_sliding"] > 0.1


def test_predictor_start_matters(case_2):
    """The first samples leave an integration constant: rms 4.31 from zero, 3.08 matched."""
    matched = dj.run(case_2.override({"controller.predictor_start": "matched"}), devices=1)
    assert matched.dataset["error_rms_after_40"].item() == pytest.approx(3.0768, abs=1e-3)


def test_residual_scales_with_phi_b():
    """Theorem 1: the residual |sigma| falls as 1/phi_b^2."""
    from dssc_jax.plotting import fitted_slope
    from dssc_jax.study.library import find_study

    result = dj.run(dj.Study.load(find_study("residual_scaling")))
    phi_b = result.dataset["controller.functions.phi_b"].values
    slope, _ = fitted_slope(phi_b, result.dataset["sigma_max"].values[:, 0])
    print(f"\nresidual against phi_b: slope {slope:.3f}")
    assert slope == pytest.approx(-2.0, abs=0.1)
    assert float(result.dataset["sampling_ratio"].max()) < 0.1
    assert float(result.dataset["outside_sliding"].max()) == 0.0


def test_norm_bound_keeps_sliding_despite_zero_dynamics():
    """rho of (33)-(34) holds the sliding condition; a constant rho that is too small does not."""
    table = {
        "name": "norm-bound",
        "loop": {"duration": 10.0, "sample_time": 0.002},
        "plant": {
            "kind": "normal_form",
            "k_p": 1.1,
            "a_p": 0.9,
            "zero_dynamics": {"a": [1.0], "c": [0.5]},
            "initial": [2.0, 0.0],
        },
        "reference": {"kind": "sine", "amplitude": 1.0, "period": 6.0},
        "controller": {
            "kind": "dssc",
            "l0": 1.0,
            "predictor_start": "matched",
            "functions": {"kind": "approx_sta_2", "kappa1": 2.0, "kappa2": 2.0, "delta": 1.0, "tau_av": 0.05},
            "nominal": {"a": 1.0, "k": 1.0},
            "rho": {
                "kind": "norm_bound",
                "k_p_max": 1.2,
                "a_p_max": 1.2,
                "delta_rho": 0.1,
                "alpha_d": 0.5,
                "zero_dynamics": {"a": [1.0], "c": [0.5]},
            },
        },
        "disturbance": {"kind": "sine", "amplitude": 0.5, "period": 3.0},
    }
    run = dj.simulate(dj.Study.from_table(table))
    assert run.attrs["outside_sliding"] == 0.0
    assert float(np.abs(run["sigma_tilde"]).max()) < 1e-12
    assert float(run["sliding_margin"].min()) > 0.0
    starved = dj.simulate(dj.Study.from_table(table).override({"controller.rho": 0.05}))
    assert starved.attrs["outside_sliding"] > 0.1
