"""No reading of a log counts as more precise than the study's sensor has it."""

import numpy as np
import pytest
from scipy import signal

import dssc_jax as dj
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.reading_noise import reading_noise
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.statistics.noise_posterior import NoiseSearch

DT = 0.02
STD = 0.01


def study(sensor):
    """A plant of which one number has a law, with a sensor."""
    return dj.Study.from_table(
        {
            "name": "read",
            "draws": 1,
            "loop": {"duration": 8.0, "sample_time": DT},
            "plant": {"kind": "normal_form", "k_p": {"uniform": [0.5, 1.5]}, "a_p": 1.0, "initial": [0.5, 0.0]},
            "reference": {"kind": "sine", "amplitude": 0.5, "period": 2.0},
            "controller": {"kind": "pi", "k_p": 2.0, "k_i": 0.5, "l0": 1.0},
            "sensor": sensor,
        }
    )


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        ({"kind": "ideal"}, 0.0),
        ({"kind": "noisy", "position_std": STD}, STD),
        ({"kind": "noisy", "position_std": STD, "position_bias": 1.0}, STD),
        ({"kind": "noisy", "position_resolution": 0.01}, 0.01 / np.sqrt(12.0)),
        ({"kind": "lag", "mu": 0.1}, 0.0),
    ],
)
def test_noise_of_a_sensor(sensor, expected):
    """The standard deviation of white noise and of rounding; a constant error and a lag add next to nothing."""
    outputs = np.sin(DT * np.arange(2000))[None] * 3.0
    outputs[0, 500:520] = np.nan
    (found,) = reading_noise(study(sensor), outputs)
    assert found == pytest.approx(expected, rel=0.1, abs=3e-4)


def test_a_smooth_misfit_counts_at_most_as_the_sensor():
    """With a covariance S >= s^2 I of the noise the information of lines is at most J' J / s^2, for every noise."""
    times = DT * np.arange(400)
    lines = np.column_stack([np.ones(400), times, np.sin(3.0 * times)])
    columns = np.column_stack([1e-3 * np.sin(times), lines])
    most = lines.T @ lines / STD**2
    trusting = NoiseSearch(times, columns, 0.0).posterior()
    assert np.linalg.eigvalsh(most - trusting.fit.information)[0] < 0.0
    posterior = NoiseSearch(times, columns, 0.0, STD**2).posterior()
    for fit in (posterior.fit, *(candidate.fit for candidate in posterior.candidates)):
        assert np.linalg.eigvalsh(most - fit.information)[0] > -1e-9 * most.max()


def test_a_residual_that_a_limit_of_the_plant_leaves_is_told():
    """A limit that the study lacks biases the gain; it acts on one of 28 samples. Without it nothing is."""
    sensor = {"kind": "noisy", "position_std": STD}
    for size, is_told in ((3.25, True), (10.0, False)):
        limited = study(sensor).override({"unmodelled": {"kind": "saturation", "limit": size}})
        run = dj.simulate(limited, 0)
        noise = STD * np.random.default_rng(1).normal(size=len(run["t"]))
        columns = {
            "y": Column(run["t"].values, run["y"].values + noise),
            "u_total": Column(run["t"].values, run["u_total"].values),
        }
        fitted = fit_log(study(sensor), FlightLog("flight", columns, 0.0))
        codes = [doubt.code for doubt in fitted.doubts if doubt.signal == "y"]
        assert ("large-residual" in codes) == is_told, (size, codes)


def test_readings_without_noise_count_as_the_sensor():
    """Exact readings give the interval of least squares with the sensor's noise; without one nearly none."""
    run = dj.simulate(study({"kind": "ideal"}), 0)
    commands = run["u_total"].values
    system = tuple(map(np.array, ([[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])))
    _, response, _ = signal.dlsim(signal.cont2discrete(system, DT), commands)  # of the output to the gain
    columns = {"y": Column(run["t"].values, run["y"].values), "u_total": Column(run["t"].values, commands)}
    log = FlightLog("flight", columns, 0.0)
    fitted = fit_log(study({"kind": "noisy", "position_std": STD}), log)
    assert fitted.deviations[0] == pytest.approx(STD / np.linalg.norm(response), rel=0.1)
    assert fit_log(study({"kind": "ideal"}), log).deviations[0] < 1e-3 * fitted.deviations[0]
