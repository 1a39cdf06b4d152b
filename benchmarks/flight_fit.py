"""``python -m benchmarks.flight_fit``: whether intervals of fitted flights cover the truth, for docs/flight.md.

Simulation-based calibration: the truth of each flight is drawn from the laws of the study, the flight is simulated with
measurement noise, and the intervals are counted that cover the truth.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy import stats

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.analyses.flight_fit import NotIdentifiable, fit_log
from dssc_jax.engine.sampling import draw
from dssc_jax.flight.replay import curves_of_draws
from dssc_jax.study.flight_logs import Column, FlightLog

PAGE = Path(__file__).parents[1] / "docs" / "flight.md"


def flight_study() -> dj.Study:
    """A PI loop of 10 s with a lag, a step of disturbance and noise on its measurements; four numbers have laws."""
    return dj.Study.from_table(
        {
            "name": "fit",
            "seed": 3,
            "draws": 1,
            "loop": {"duration": 10.0, "sample_time": 0.02},
            "plant": {
                "kind": "normal_form",
                "k_p": {"uniform": [0.8, 1.2]},
                "a_p": {"truncated_normal": [1.0, 0.1, 0.7, 1.3]},
                "initial": [0.5, 0.0],
            },
            "reference": {"kind": "sine", "amplitude": 0.5, "period": 2.0},
            "controller": {"kind": "pi", "k_p": 2.0, "k_i": 0.5, "l0": 1.0},
            "sensor": {"kind": "noisy", "position_std": 0.005, "velocity_std": 0.005},
            "unmodelled": {"kind": "lag", "mu": {"loguniform": [0.02, 0.2]}},
            "disturbance": {"kind": "step", "value": {"normal": [0.0, 0.3]}, "at": 3.0},
        }
    )


def covered(study: dj.Study, flights: int, colour: float = 0.0) -> tuple[dict[str, list[bool]], int]:
    """Whether the 90 % intervals cover the truth, by number; and how many flights told all.

    Args:
        study: The study.
        flights: Flights.
        colour: Autocorrelation at one sample of noise that is added to the logged outputs, of 0.005 m; 0: none.
    """
    truth, cache, told = draw(study, np.arange(flights)), {}, 0
    time = study.loop.sample_time * np.arange(study.loop.steps)
    random = np.random.default_rng(1)
    hits: dict[str, list[bool]] = {}
    for index, (curve,) in enumerate(curves_of_draws(study.override({"draws": flights}), study.loop.steps)):
        y = np.array(curve.y)
        if colour:
            shocks = random.normal(size=len(y)) * 0.005 * np.sqrt(1.0 - colour**2)
            own = np.zeros(len(y))
            for k in range(1, len(y)):
                own[k] = colour * own[k - 1] + shocks[k]
            y += own
        columns = {"y": Column(time, y), "u_total": Column(time, curve.u_total)}
        try:
            fitted = fit_log(study, FlightLog("flight", columns, 0.0), predictions=cache)
        except NotIdentifiable:
            continue
        told += 1
        for name, (low, high) in zip(fitted.names, fitted.interval(), strict=True):
            hits.setdefault(name, []).append(bool(low <= truth[name][index] <= high))
    return hits, told


def main() -> None:
    """Count covering intervals and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--flights", type=int, default=1000, help="flights with white noise; a fifth with coloured noise"
    )
    most = parser.parse_args().flights
    cases = {"white noise": (most, 0.0), "white and coloured noise": (most // 5, 0.9)}
    names = list(flight_study().laws)
    lines = [
        "| | " + " | ".join(f"`{name}`" for name in names) + " | by chance alone |",
        "|---" * (len(names) + 2) + "|",
    ]
    for label, (flights, colour) in cases.items():
        hits, identified = covered(flight_study(), flights, colour)
        cells = [f"{100 * np.mean(hits[name]):.1f} %" if name in hits else "-" for name in names]
        low, high = 100 * stats.binom.ppf([0.025, 0.975], flights, 0.9) / flights
        lines.append(
            f"| {label}: {identified} of {flights} flights | {' | '.join(cells)} | {low:.1f} to {high:.1f} % |"
        )
        print(lines[-1], flush=True)
    put("fit", "\n".join(lines), PAGE)


if __name__ == "__main__":
    main()
