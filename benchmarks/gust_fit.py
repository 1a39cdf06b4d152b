"""``python -m benchmarks.gust_fit``: intervals of fitted flights whose commands answer gusts, for docs/log_fits.md.

The flights are those of a PID loop with a gust that the study declares, by an exact recursion that uses nothing of the
package. The truth of each flight is drawn from the laws of the study.
"""

import argparse

import numpy as np
from scipy import linalg, special

import dssc_jax as dj
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import FitRefused
from dssc_jax.flight_logs.reading.reader import Column, FlightLog

DT = 0.02  # s
SAMPLES = 400
GUST = 0.2  # m/s^2, standard deviation
CORRELATION_TIME = 1.0  # s, of the gust
SENSOR = 0.002  # m
LEVEL = 0.9  # of the intervals


def gust_study() -> dj.Study:
    """A loop of 8 s in a gust; gain, damping and a constant force have laws."""
    return dj.Study.from_table(
        {
            "name": "gusts",
            "loop": {"duration": SAMPLES * DT, "sample_time": DT},
            "plant": {
                "kind": "normal_form",
                "k_p": {"lognormal": [0.0, 0.15]},
                "a_p": {"normal": [1.0, 0.2]},
                "initial": [0.5, 0.0],
            },
            "disturbance": [
                {"kind": "constant", "value": {"normal": [0.0, 0.3]}},
                {"kind": "filtered_noise", "std": GUST, "correlation_time": CORRELATION_TIME},
            ],
            "sensor": {"kind": "noisy", "position_std": SENSOR},
            "reference": {"kind": "sine", "amplitude": 0.5, "period": 2.0},
            "controller": {"kind": "pi", "k_p": 2.0, "k_i": 0.5, "l0": 1.0},
        }
    )


def gust_flight(seed: int) -> tuple[FlightLog, dict[str, float]]:
    """The log of a PID loop in a gust, and its numbers on the scale of the fit, by name."""
    random = np.random.default_rng(seed)
    log_k_p = 0.15 * random.normal()
    a_p = 1.0 + 0.2 * random.normal()
    force = 0.3 * random.normal()
    held = linalg.expm(DT * np.array([[0.0, 1.0, 0.0], [0.0, -a_p, np.exp(log_k_p)], [0.0, 0.0, 0.0]]))
    decay = np.exp(-DT / CORRELATION_TIME)
    steps = 0.5 * random.choice([-1.0, 1.0], size=SAMPLES // 200)
    gust = GUST * random.normal()
    state = np.array([0.5, 0.0])
    integral = 0.0
    outputs, commands = [], []
    for reference in np.repeat(steps, 200):
        y = state[0] + SENSOR * random.normal()
        integral += (reference - y) * DT
        u = 4.0 * (reference - y) + 2.0 * integral - 2.5 * state[1]
        outputs.append(y)
        commands.append(u)
        state = held[:2, :2] @ state + held[:2, 2] * (u + force + gust)
        gust = decay * gust + GUST * np.sqrt(1.0 - decay**2) * random.normal()
    times = DT * np.arange(SAMPLES)
    columns = {"y": Column(times, np.array(outputs)), "u_total": Column(times, np.array(commands))}
    return FlightLog("flight", columns, 0.0), {"plant.k_p": log_k_p, "plant.a_p": a_p, "disturbance.0.value": force}


def main() -> None:
    """Count covering intervals and warnings, and print the deviations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    flights = parser.parse_args().flights
    study = gust_study()
    predictions = {}
    scores: dict[str, list[float]] = {}
    deviations: dict[str, list[float]] = {}
    warned = 0
    for seed in range(flights):
        log, truth = gust_flight(seed)
        try:
            fitted = fit_log(study, log, predictions=predictions)
        except FitRefused as refusal:
            print(f"flight {seed}: {refusal}", flush=True)
            continue
        warned += bool(fitted.doubts)
        for name, scaled, deviation in zip(fitted.names, fitted.scaled, fitted.deviations, strict=True):
            scores.setdefault(name, []).append((scaled - truth[name]) / deviation)
            deviations.setdefault(name, []).append(deviation)
    for name, errors in scores.items():
        hits = int(np.sum(np.abs(errors) <= special.ndtri(0.5 + 0.5 * LEVEL)))
        print(
            f"{name}: {hits} of {len(errors)} intervals of {100 * LEVEL:g} % cover the truth; mean error "
            f"{np.mean(errors):.2f} standard deviations, of {np.median(deviations[name]):.3g} in the median"
        )
    print(f"{warned} of {flights} flights with a warning")


if __name__ == "__main__":
    main()
