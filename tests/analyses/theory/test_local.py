"""Local margins: simulated growth, the sampled loop's eigenvalues, an independent oracle of them, continuous time."""

import numpy as np
import pytest
from scipy.linalg import expm

import dssc_jax as dj
from benchmarks.gain_sets import CONSTANT, SQUARE_ROOT, random_gains
from dssc_jax.analyses.theory import Time, at_rest, spectrum
from dssc_jax.engine.batching import values_of_draws

BOUNDS = (0.02, 10.0)
SAMPLE_TIME = 0.01
OPTIONS = {"over": "unmodelled.mu", "bounds": BOUNDS, "log": True, "points": 5, "bisections": 12}


def critical(found):
    """Critical values, every draw having one."""
    assert found.summary()["censored"] == 0.0
    assert found.summary()["non_monotone"] == 0.0
    return found.dataset["critical"].values


@pytest.mark.parametrize("order", [1, 2])
def test_simulated_growth_is_that_of_the_sampled_eigenvalues(order):
    """Constant functions, rho never reached, 200 random gain sets: within 0.2 %."""
    study = random_gains(order, CONSTANT)
    local = critical(dj.theory.local_margin(study, **OPTIONS))
    simulated = critical(dj.margin(study, **OPTIONS))
    assert np.ptp(np.log(local)) > 2.0
    assert simulated == pytest.approx(local, rel=2e-3)


def test_state_dependent_functions_by_growth_of_a_small_deviation():
    """The functions' values at the origin decide while the deviation stays under 1e-4 delta^2."""
    study = random_gains(2, SQUARE_ROOT, draws=40)
    local = critical(dj.theory.local_margin(study, **OPTIONS))
    assert critical(dj.margin(study, **OPTIONS)) == pytest.approx(local, rel=2e-3)


@pytest.mark.parametrize("order", [1, 2])
def test_continuous_time_is_met_to_first_order_in_the_sample_time(order):
    options = OPTIONS | {"bisections": 30}
    exact = critical(dj.theory.local_margin(random_gains(order, CONSTANT, draws=40), kind="continuous", **options))
    gaps = []
    for sample_time in (0.005, 0.0025):
        study = random_gains(order, CONSTANT, draws=40, sample_time=sample_time)
        gaps.append(critical(dj.theory.local_margin(study, **options)) / exact - 1.0)
    assert gaps[0] / gaps[1] == pytest.approx(2.0, abs=0.05)
    assert np.abs(gaps[1]).max() < 0.02


def oracle(lane, order, dt, nominal):
    """The sampled loop by a matrix exponential, written down apart: state (x1, x2, lags, last sigma, u_av)."""
    k_p, a_p, l0, mu = lane["plant.k_p"], lane["plant.a_p"], lane["controller.l0"], lane["unmodelled.mu"]
    k_o, tau_m = lane["controller.functions.k_o"], lane["controller.functions.tau_m"]
    n = 2 + order
    a, b = np.zeros((n, n)), np.zeros(n)
    a[0, 1], a[1, 1], a[1, n - 1] = 1.0, -a_p, k_p
    for i in range(order):
        a[2 + i, 2 + i] = -1.0 / mu
        if i:
            a[2 + i, 1 + i] = 1.0 / mu
    b[2] = 1.0 / mu
    hold = expm(dt * np.block([[a, b[:, None]], [np.zeros((1, n + 1))]]))
    sigma = np.concatenate([[l0, 1.0], np.zeros(order + 2)])
    e = np.eye(n + 2)[0]
    u_av = np.eye(n + 2)[-1] + ((1.0 + dt / tau_m) * sigma - np.eye(n + 2)[-2]) / (k_o * 0.05)
    u_n = -(nominal["a"] - l0) * l0 * e - (l0 - nominal["a"] + 1.0 / tau_m) * sigma if nominal else 0.0 * e
    after = np.zeros((n + 2, n + 2))
    after[:n, :n] = hold[:n, :n]
    after[:n] += np.outer(hold[:n, n], u_n - u_av)
    after[-2], after[-1] = sigma, u_av
    return np.linalg.eigvals(after)


@pytest.mark.parametrize("nominal", [None, {"a": 1.0, "k": 1.0}])
@pytest.mark.parametrize("order", [1, 2])
def test_sampled_eigenvalues_against_a_matrix_exponential(order, nominal):
    study = random_gains(order, CONSTANT, draws=20)
    if nominal:
        study = study.override({"controller.nominal": nominal})
    rest = at_rest(study).override({"sweep": {"unmodelled.mu": [0.05, 1.0]}})
    values = values_of_draws(rest, slice(0, 20)) | {"unmodelled.mu": np.geomspace(0.05, 1.0, 20)}
    found = spectrum(rest, Time.SAMPLED).eigenvalues(values)
    for draw in range(20):
        expected = oracle({name: column[draw] for name, column in values.items()}, order, SAMPLE_TIME, nominal)
        assert np.abs(found[draw]).max() == pytest.approx(np.abs(expected).max(), rel=1e-7)
        for eigenvalue in expected:  # the loop's own step has more states, whose eigenvalues are 0
            assert np.abs(found[draw] - eigenvalue).min() < 1e-5


def test_routh():
    """PI through a lag of order 1 on 1/(s (s + a)): s^2 (s + a)(mu s + 1) + k (s + l)(K_P s + K_I)."""
    k, a, l, k_p, k_i = 1.2, 0.7, 1.5, 4.0, 6.0  # noqa: E741  (l_0)
    c1, c0 = k * (k_p * l + k_i), k * k_i * l

    def routh(mu):
        c4, c3, c2 = mu, 1.0 + mu * a, a + k * k_p
        return (c3 * c2 - c4 * c1) * c1 - c3**2 * c0

    low, high = 1e-3, 10.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if routh(middle) > 0.0 else (low, middle)
    study = dj.Study.from_table(
        {
            "name": "routh",
            "loop": {"duration": 1.0, "sample_time": 0.01},
            "plant": {"kind": "normal_form", "k_p": k, "a_p": a},
            "controller": {"kind": "pi", "l0": l, "k_p": k_p, "k_i": k_i},
            "unmodelled": {"kind": "lag", "order": 1, "mu": 0.1},
        }
    )
    options = {"over": "unmodelled.mu", "bounds": (1e-3, 10.0), "log": True, "bisections": 40}
    found = dj.theory.local_margin(study, kind="continuous", **options)
    assert found.dataset["critical"].item() == pytest.approx(low, rel=1e-9)


@pytest.mark.parametrize("kind", ["sampled", "continuous"])
@pytest.mark.parametrize("order", [1, 2])
def test_a_transfer_function_has_the_margin_of_the_same_lag(order, kind):
    study = random_gains(order, CONSTANT, draws=20)
    shape = {"numerator": [1], "denominator": [1, 1] if order == 1 else [1, 2, 1]}
    same = study.override({"unmodelled": {"kind": "transfer_function", "mu": 0.1, **shape}})
    known, found = (critical(dj.theory.local_margin(one, **OPTIONS, kind=kind)) for one in (study, same))
    assert found == pytest.approx(known, rel=1e-9)


def test_resonance_in_continuous_time():
    """PI through 1/((mu s)^2 + c mu s + 1) + feedthrough b (mu s)^2: the margin from the roots of the polynomial."""
    k, a, pole, k_p, k_i, c, b = 1.2, 0.7, 1.5, 4.0, 6.0, 0.6, 0.4

    def stable(mu):
        plant = np.polymul([1.0, 0.0, 0.0], np.polymul([1.0, a], [mu**2, c * mu, 1.0]))
        through = k * np.polymul(np.polymul([1.0, pole], [k_p, k_i]), [b * mu**2, 0.0, 1.0])
        return np.roots(np.polyadd(plant, through)).real.max() < 0.0

    low, high = 1e-3, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    study = dj.Study.from_table(
        {
            "name": "resonance",
            "loop": {"duration": 1.0, "sample_time": 0.01},
            "plant": {"kind": "normal_form", "k_p": k, "a_p": a},
            "controller": {"kind": "pi", "l0": pole, "k_p": k_p, "k_i": k_i},
            "unmodelled": {
                "kind": "transfer_function",
                "mu": 0.1,
                "numerator": [1.0, 0.0, b],
                "denominator": [1.0, c, 1.0],
            },
        }
    )
    options = {"over": "unmodelled.mu", "bounds": (1e-3, 1.0), "log": True, "points": 60, "bisections": 40}
    found = dj.theory.local_margin(study, kind="continuous", **options)
    assert found.dataset["critical"].item() == pytest.approx(low, rel=1e-8)


@pytest.mark.parametrize(
    ("unmodelled", "kinds"),
    [
        ({"kind": "rate_limit", "rate": 10.0}, ["sampled"]),
        ({"kind": "saturation", "limit": 10.0}, ["sampled", "continuous"]),
    ],
)
def test_small_deviations_do_not_notice_a_limit(unmodelled, kinds):
    """Its local margin is beyond every walk."""
    study = random_gains(1, CONSTANT, draws=5).override({"unmodelled": unmodelled})
    name = f"unmodelled.{'limit' if unmodelled['kind'] == 'saturation' else 'rate'}"
    for kind in kinds:
        found = dj.theory.local_margin(study, over=name, bounds=(10.0, 0.01), log=True, points=3, kind=kind)
        assert found.summary()["pass_to_end"] == 1.0


def test_delay_margin():
    """Proportional control of an integrator through n samples of delay: k_p K T_s = 2 sin(pi/(2 (2 n + 1)))."""
    study = dj.Study.from_table(
        {
            "name": "delay",
            "loop": {"duration": 1.0, "sample_time": 0.01},
            "plant": {"kind": "normal_form", "a_p": 1.0},  # l0 = a_p cancels it: sigma' = k_p u
            "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 1e-6},
            "unmodelled": {"kind": "delay", "samples": 3},
        }
    )
    for samples in (0, 3, 7):
        found = dj.theory.local_margin(
            study.override({"unmodelled.samples": samples}), over="controller.k_p", bounds=(1.0, 300.0), bisections=40
        )
        gain = 2.0 * np.sin(np.pi / (2.0 * (2 * samples + 1))) / 0.01
        assert found.dataset["critical"].item() == pytest.approx(gain, rel=1e-5), samples


@pytest.mark.parametrize(
    ("changes", "options", "rule"),
    [
        ({"controller": {"kind": "sta", "l0": 1.0, "kappa1": 1.0, "kappa2": 1.0}}, {}, "'sta' switches at the origin"),
        ({"controller.discretisation": "explicit"}, {}, "'dssc' in its explicit form switches"),
        ({"sensor": {"kind": "noisy", "position_bias": 0.1}}, {}, "is not at rest"),
        (
            {"unmodelled": {"kind": "delay", "samples": 1}},
            {"kind": "continuous", "over": "plant.k_p"},
            "covers .*got 'delay'",
        ),
        (
            {"unmodelled": {"kind": "rate_limit", "rate": 1.0}},
            {"kind": "continuous", "over": "plant.k_p"},
            "covers .*got 'rate_limit'",
        ),
        ({}, {"over": "loop.sample_time"}, "clock is fixed"),
        ({}, {"bounds": (1.0, 1.0)}, "two different finite numbers"),
    ],
)
def test_bad_input(changes, options, rule):
    study = random_gains(1, CONSTANT, draws=2).override(changes)
    with pytest.raises(dj.ConfigError, match=rule):
        dj.theory.local_margin(study, **({"over": "unmodelled.mu", "bounds": (0.1, 1.0)} | options))


def test_no_origin_for_several_channels():
    uav = dj.Study.load("studies/paper_case1.toml")
    with pytest.raises(dj.ConfigError, match="one channel"):
        dj.theory.local_margin(uav, over="controller.l0", bounds=(0.1, 1.0))


@pytest.mark.parametrize(
    ("changes", "left_out"),
    [
        ({}, None),
        ({"sensor": {"kind": "noisy", "position_std": 0.01, "jitter": 0.0}}, None),
        ({"sensor": {"kind": "lag", "mu": 0.2}}, "the sensor left out"),
        ({"sensor": {"kind": "noisy", "delay_samples": 20}}, "the sensor left out"),
        ({"differentiator": {"kind": "levant", "lipschitz": 3.0}}, "the differentiator left out"),
        (
            {"sensor": {"kind": "lag", "mu": 0.2}, "differentiator": {"kind": "levant", "lipschitz": 3.0}},
            "the sensor and the differentiator left out",
        ),
    ],
)
def test_the_continuous_criterion_names_what_it_leaves_out(changes, left_out):
    study = random_gains(1, CONSTANT, draws=2).override(changes)
    criterion = dj.theory.local_margin(study, **OPTIONS, kind="continuous").summary()["criterion"]
    assert criterion[0].startswith("every eigenvalue of the loop with (22)")
    notes = [text for text in criterion if "left out" in text]
    assert notes == ([] if left_out is None else [f"plant, unmodelled dynamics and controller alone: {left_out}"])
    sampled = dj.theory.local_margin(study.override({"sensor": {"kind": "ideal"}}), **OPTIONS).summary()["criterion"]
    assert not any("left out" in text for text in sampled)


def test_continuous_time_has_no_margin_of_a_sensor():
    study = random_gains(1, CONSTANT, draws=2).override({"sensor": {"kind": "lag", "mu": 0.2}})
    with pytest.raises(
        dj.ConfigError, match=r"sensor\.mu: has no effect in continuous time, which leaves the sensor out"
    ):
        dj.theory.local_margin(study, over="sensor.mu", bounds=(0.01, 1.0), kind="continuous")
