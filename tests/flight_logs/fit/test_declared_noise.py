"""Fits of flights in gusts that the study declares: what a short residual does not show."""

import numpy as np
import pytest
from scipy import linalg, optimize, stats

from benchmarks.gust_fit import SAMPLES, gust_flight, gust_study
from dssc_jax.flight_logs.fit.declared_noise import larger_covariance
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.prediction import REPLICATES, NoiseProgram
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

STD = 0.1
CORRELATION_TIME = 1.0
GUST = {"kind": "filtered_noise", "std": STD, "correlation_time": CORRELATION_TIME}
LEVEL = {"kind": "constant", "value": {"normal": [0.0, 0.3]}}


def gust(random, samples):
    """Noise of the first order by its exact recursion."""
    decay = np.exp(-DT / CORRELATION_TIME)
    values = [STD * random.normal()]
    for _ in range(samples - 1):
        values.append(decay * values[-1] + STD * np.sqrt(1.0 - decay**2) * random.normal())
    return np.array(values)


def test_the_larger_covariance_is_at_least_both():
    random = np.random.default_rng(1)
    first, second = (root @ root.T for root in random.normal(size=(2, 3, 3)))
    larger = larger_covariance(first, second)
    for covariance in (first, second):
        assert np.linalg.eigvalsh(larger - covariance)[0] > -1e-12
    np.testing.assert_allclose(larger_covariance(first, 0.0 * second), first)
    np.testing.assert_allclose(larger_covariance(first, 4.0 * first), 4.0 * first)


@pytest.mark.long
def test_the_mean_of_a_declared_gust_widens_the_interval_of_a_constant_force():
    """6 flights of 8 s: the interval was 4 standard deviations beside the truth, and the sensor got the blame."""
    study = linear(
        disturbance=[LEVEL, GUST],
        sensor={"kind": "noisy", "position_std": 0.002},
        plant={"kind": "normal_form", "k_p": 1.0, "a_p": {"normal": [1.0, 0.2]}, "initial": [0.5, 0.0]},
    )
    random = np.random.default_rng(3)
    predictions = {}
    hits = []
    for _ in range(6):
        level = 0.3 * random.normal()
        a_p = 1.0 + 0.2 * random.normal()
        u = np.repeat(random.normal(size=40), 10)
        y = output(1.0, a_p, u + level + gust(random, len(u))) + 0.002 * random.normal(size=len(u))
        fitted = fit_log(study, log_of(y, u), predictions=predictions)
        assert fitted.doubts == ()
        (row,) = [row for row, name in enumerate(fitted.names) if name.endswith("value")]
        low, high = fitted.interval()[row]
        hits.append(low <= level <= high)
    assert stats.binom.cdf(sum(hits), len(hits), 0.9) > 1e-3


@pytest.mark.long
def test_the_shape_of_a_declared_gust_weights_flights_whose_commands_answer_it():
    """Other shapes of noise leave deviations of 0.1 of the gain, and hide the damping."""
    study = gust_study()
    predictions = {}
    scores = []
    deviations = []
    for seed in (0, 2, 4):  # flights that tell the gain
        log, truth = gust_flight(seed)
        fitted = fit_log(study, log, predictions=predictions)
        assert fitted.doubts == ()
        scores.extend((fitted.scaled - [truth[name] for name in fitted.names]) / fitted.deviations)
        deviations.append(fitted.deviations[fitted.names.index("plant.k_p")])
    assert stats.chi2.sf(np.sum(np.square(scores)), len(scores)) > 1e-3
    assert max(deviations) < 0.08


def test_plain_xla_simulates_the_same_noise(monkeypatch):
    """As many simulations as a batch holds, with the same keys."""
    study = gust_study()
    log, _ = gust_flight(0)
    names = tuple(study.laws)
    commands = log.columns["u_total"].value[None, :60]
    values = np.array([1.0, 1.0, 0.2])
    simulations = []
    for form in ("lanes", "scan"):
        monkeypatch.setenv("DSSC_JAX_KERNEL", form)
        program = NoiseProgram(study, names, commands, sensors=False)
        simulations.append(program.simulate(values, REPLICATES))
    assert simulations[0].shape == (REPLICATES, 1, 60)
    assert np.std(simulations[0][:, 0, -1]) > 1e-2
    np.testing.assert_allclose(simulations[1], simulations[0], rtol=1e-9, atol=1e-12)


def dense_estimates(log, rows):
    """The likeliest log k_p, a_p and force for readings at some rows: the gust's covariance in full, its size known."""
    y = log.columns["y"].value[rows]
    u = log.columns["u_total"].value
    lags = DT * np.abs(np.subtract.outer(np.arange(SAMPLES), np.arange(SAMPLES)))
    gust_covariance = 4.0 * STD**2 * np.exp(-lags / CORRELATION_TIME)

    def cost(numbers):
        log_k_p, a_p, force = numbers
        held = linalg.expm(DT * np.array([[0.0, 1.0, 0.0], [0.0, -a_p, np.exp(log_k_p)], [0.0, 0.0, 0.0]]))
        impulse, free = np.zeros(SAMPLES), np.zeros(SAMPLES)
        driven, undriven = held[:2, 2], np.array([0.5, 0.0])
        for row in range(SAMPLES):
            free[row] = undriven[0]
            undriven = held[:2, :2] @ undriven
            if row > 0:
                impulse[row] = driven[0]
                driven = held[:2, :2] @ driven
        response = np.tril(linalg.toeplitz(impulse))
        covariance = (response @ gust_covariance @ response.T)[np.ix_(rows, rows)] + 0.002**2 * np.eye(len(rows))
        root = np.linalg.cholesky(covariance)
        scaled = linalg.solve_triangular(root, y - (free + response @ (u + force))[rows], lower=True)
        return 0.5 * scaled @ scaled + np.log(np.diag(root)).sum()

    options = {"xatol": 1e-3, "fatol": 1e-3, "maxfev": 200}
    return optimize.minimize(cost, [0.0, 1.0, 0.0], method="Nelder-Mead", options=options).x


def test_a_sparse_log_in_gusts_has_the_likeliest_numbers():
    """Every third reading; the covariance of the gust in full is another way to the same numbers."""
    log, truth = gust_flight(5)
    rows = np.arange(0, SAMPLES, 3)
    y = log.columns["y"]
    sparse = log_of(log.columns["y"].value, log.columns["u_total"].value)
    sparse.columns["y"] = type(y)(y.time[rows], y.value[rows])
    fitted = fit_log(gust_study(), sparse)
    likeliest = dict(zip(truth, dense_estimates(log, rows), strict=True))
    differences = fitted.scaled - [likeliest[name] for name in fitted.names]
    assert set(fitted.names) == set(truth)
    assert (np.abs(differences) < 0.3 * fitted.deviations).all()


def test_a_late_output_in_gusts_is_told_without_its_residual():
    """The residual in gusts is mostly what these did: 441 m rms became 1.4 m by a delay of 0.06 s."""
    log, _ = gust_flight(0)
    y = log.columns["y"].value
    late = np.concatenate([np.full(3, y[0]), y[:-3]])
    fitted = fit_log(gust_study(), log_of(late, log.columns["u_total"].value))
    (warning,) = [doubt for doubt in fitted.doubts if doubt.code in ("delayed-output", "delayed-command")]
    assert "moved by that, " in warning.text
    assert "the residual falls" not in warning.text
