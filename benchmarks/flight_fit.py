"""``python -m benchmarks.flight_fit``: whether intervals of fitted flights cover the truth, for docs/log_fits.md.

Simulation-based calibration: the truth of each flight is drawn from the laws of the study, the flight is simulated, its
outputs are logged with noise at regular or irregular times, and the intervals are counted that cover the truth.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import interpolate, signal, special, stats

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.engine.sampling import draw
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.least_squares import fit_scale
from dssc_jax.flight_logs.fit.prediction import Prediction
from dssc_jax.flight_logs.fit.refusals import FitRefused
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import curves_of_draws

PAGE = Path(__file__).parents[1] / "docs" / "log_fits.md"
STD = 0.005  # of white noise, and of correlated noise [m]
LEVEL = 0.95  # of the intervals
HOVER = 4.0  # s of hover before the log of a vehicle begins
SAMPLE_TIME, FINE = 0.02, 20  # of the loop [s]; steps of correlated noise in a sample

Times = Callable[[np.random.Generator, float], np.ndarray]


class Case(NamedTuple):
    """How outputs are logged.

    Args:
        label: In words.
        times: (random numbers, duration [s]) -> times of the logged outputs [s].
        correlation: Time constant of correlated noise [s]; 0: there is none.
        order: Order of its filter: 1 or 2.
    """

    label: str
    times: Times
    correlation: float = 0.0
    order: int = 1


def regular(samples: int) -> Times:
    """Outputs at every so many samples."""
    return lambda random, duration: SAMPLE_TIME * np.arange(0, round(duration / SAMPLE_TIME), samples)


def irregular(random: np.random.Generator, duration: float) -> np.ndarray:
    """Outputs with gaps of 1 to 20 samples, off the loop's own instants."""
    gaps = SAMPLE_TIME * random.uniform(1.0, 20.0, size=round(duration / SAMPLE_TIME))
    times = np.cumsum(gaps)
    return times[times < duration - SAMPLE_TIME]


CASES = (
    Case("every sample, white noise", regular(1)),
    Case("every sample, noise of 0.2 s added", regular(1), 0.2),
    Case("one in 10, white noise", regular(10)),
    Case("one in 10, noise of 0.2 s added", regular(10), 0.2),
    Case("one in 10, noise of 1 s added", regular(10), 1.0),
    Case("irregular, noise of 1 s added", irregular, 1.0),
    Case("irregular, smooth noise of 0.5 s added", irregular, 0.5, 2),
)


def flight_study() -> dj.Study:
    """A PI loop of 10 s with a lag and a step of disturbance; four numbers have laws."""
    return dj.Study.from_table(
        {
            "name": "fit",
            "seed": 3,
            "draws": 1,
            "loop": {"duration": 10.0, "sample_time": SAMPLE_TIME},
            "plant": {
                "kind": "normal_form",
                "k_p": {"uniform": [0.8, 1.2]},
                "a_p": {"truncated_normal": [1.0, 0.1, 0.7, 1.3]},
                "initial": [0.5, 0.0],
            },
            "reference": {"kind": "sine", "amplitude": 0.5, "period": 2.0},
            "controller": {"kind": "pi", "k_p": 2.0, "k_i": 0.5, "l0": 1.0},
            "unmodelled": {"kind": "lag", "mu": {"loguniform": [0.02, 0.2]}},
            "disturbance": {"kind": "step", "value": {"normal": [0.0, 0.3]}, "at": 3.0},
        }
    )


def correlated_noise(random: np.random.Generator, case: Case, times: np.ndarray) -> np.ndarray:
    """White noise through one or two lags, of unit variance, at times; shape (n,)."""
    step = SAMPLE_TIME / FINE
    begin = round(10.0 * case.correlation / step)
    pole = np.exp(-step / case.correlation)
    shocks = random.normal(size=begin + round(times[-1] / step) + 2)
    for _ in range(case.order):
        shocks = signal.lfilter([1.0], [1.0, -pole], shocks)
    impulse = np.zeros(begin)
    impulse[0] = 1.0
    for _ in range(case.order):
        impulse = signal.lfilter([1.0], [1.0, -pole], impulse)
    return shocks[begin + np.round(times / step).astype(int)] / np.linalg.norm(impulse)


def logged_flight(study: dj.Study, case: Case, flight: int, y: np.ndarray, u: np.ndarray) -> FlightLog:
    """The log of a flight: its commands at every sample, and noisy outputs at the case's times."""
    random = np.random.default_rng([1, flight])
    samples = SAMPLE_TIME * np.arange(len(y))
    times = case.times(random, study.loop.sample_time * study.loop.steps)
    readings = interpolate.CubicSpline(samples, y)(times) + STD * random.normal(size=len(times))
    if case.correlation > 0.0:
        readings += STD * correlated_noise(random, case, times)
    return FlightLog("flight", {"y": Column(times, readings), "u_total": Column(samples, u)}, 0.0)


def covered(study: dj.Study, flights: int, case: Case) -> tuple[dict[str, list[float]], int]:
    """Errors of the estimates by number, in their standard deviations; and how many flights were fitted."""
    truth = draw(study, np.arange(flights))
    predictions: dict[tuple[str, ...], Prediction] = {}
    fits = 0
    scores: dict[str, list[float]] = {}
    for index, (curve,) in enumerate(curves_of_draws(study.override({"draws": flights}), study.loop.steps)):
        log = logged_flight(study, case, index, np.asarray(curve.y), np.asarray(curve.u_total))
        try:
            fitted = fit_log(study, log, predictions=predictions)
        except FitRefused:
            continue
        fits += 1
        for name, scaled, deviation in zip(fitted.names, fitted.scaled, fitted.deviations, strict=True):
            error = scaled - fit_scale(study.laws[name], truth[name][index])
            scores.setdefault(name, []).append(float(error / deviation))
    return scores, fits


def cascade_study() -> dj.Study:
    """An X500 on PX4's cascade, which flies 3 m to a point in an unknown wind; four numbers have laws."""
    return dj.Study.from_table(
        {
            "name": "cascade",
            "draws": 99,
            "loop": {"duration": 8.0, "sample_time": SAMPLE_TIME, "substeps": 16},
            "reference": {"kind": "hover", "position": [2.0, 1.0, 6.0]},
            "sensor": {"kind": "noisy", "position_std": 0.01, "velocity_std": 0.02},
            "controller": {"kind": "pid", "k_p": 0.95, "z": {"k_p": 1.0}, "psi": {"k_p": 2.8}},
            "wind": [{"kind": "constant", "x": {"uniform": [-4.0, 4.0]}, "y": 1.0, "z": 0.0}],
            "plant": {
                "kind": "uav",
                "position": [0.0, 0.0, 5.0],
                "inner_loop": {"kind": "px4", "thrust_hover": 0.5},
                "vehicle": {
                    "kind": "x500",
                    "mass": {"uniform": [1.8, 2.4]},
                    "motor_lag": {"uniform": [0.01, 0.06]},
                    "structure_drag": [{"uniform": [0.0, 0.1]}, 0.05, 0.05],
                },
                "believed": {"mass": 2.06},
            },
        }
    )


def hover_study(before: float) -> dj.Study:
    """An X500 on PX4's cascade that hovers in wind and then flies steps of 1 to 1.5 m.

    Args:
        before: Time that it has hovered when the log begins [s]; 0: the study of the fit, in which the numbers of the
            start have laws.
    """
    place, speed, lift = ({"normal": [0.0, width]} for width in (0.03, 0.05, 0.05))
    steps = {"x": (1.5, 0.5), "y": (-1.0, 3.5), "z": (1.0, 2.0)}
    plant = {
        "kind": "uav",
        "position": [0.0, 0.0, 5.0],
        "inner_loop": {"kind": "px4", "start": "settled"},
        "vehicle": {"kind": "x500", "mass": {"uniform": [1.8, 2.4]}},
        "believed": {"mass": 2.06},
    }
    if before == 0.0:
        plant |= {"position": [place, place, {"normal": [5.0, 0.03]}], "velocity": [speed, speed, speed]}
        plant["inner_loop"] = {**plant["inner_loop"], "velocity_integral": [lift, lift, lift]}
    reference = {"kind": "hover", "position": [0.0, 0.0, 5.0]}
    for axis, (size, at) in steps.items():
        offset = 5.0 if axis == "z" else 0.0
        reference |= {axis: {"kind": "step", "size": size, "at": before + at, "offset": offset}}
    wind = {"kind": "constant", "x": {"uniform": [-6.0, 6.0]}, "y": {"uniform": [-6.0, 6.0]}, "z": 0.0}
    return dj.Study.from_table(
        {
            "name": "hover",
            "draws": 99,
            "loop": {"duration": before + 8.0, "sample_time": SAMPLE_TIME, "substeps": 16},
            "reference": reference,
            "sensor": {"kind": "noisy", "position_std": 0.01, "velocity_std": 0.02},
            "controller": {"kind": "pid", "k_p": 0.95, "z": {"k_p": 1.0}, "psi": {"k_p": 2.8}},
            "wind": [wind],
            "plant": plant,
        }
    )


def covered_by_vehicle(study: dj.Study, flights: int, fitting: dj.Study, start: float = 0.0) -> tuple[int, int, int]:
    """Numbers of 90 % intervals that cover the truth, of intervals, and of flights that are fitted.

    Args:
        study: That flies; what has a law there is the truth.
        flights: Number of flights.
        fitting: The study of the fit.
        start: Time of the flight at which it begins [s].
    """
    covering = 0
    intervals = 0
    fits = 0
    for flight in range(flights):
        run = dj.simulate(study, flight)
        columns = {}
        for channel in study.loop.channels:
            columns[f"{channel}_y"] = Column(run["t"].values, run[f"{channel}_y_measured"].values)
            columns[f"{channel}_u_total"] = Column(run["t"].values, run[f"{channel}_u_total"].values)
        try:
            fitted = fit_log(fitting, FlightLog("flight", columns, start))
        except FitRefused as refusal:
            print(f"flight {flight}: {refusal}", flush=True)
            continue
        fits += 1
        for name in fitted.names:
            if name not in study.laws:
                continue
            low, high = fitted.law(name).quantile(np.array([0.05, 0.95]))
            hit = low <= run.attrs[name] <= high
            covering += hit
            intervals += 1
            print(f"flight {flight}: {name} {run.attrs[name]:.5g} in [{low:.5g}, {high:.5g}]: {hit}", flush=True)
    return covering, intervals, fits


def inside(scores: list[float]) -> np.ndarray:
    """Which errors lie within the interval."""
    return np.abs(scores) <= special.ndtri(0.5 + 0.5 * LEVEL)


def main() -> None:
    """Count covering intervals and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=200, help="flights of each case")
    parser.add_argument("--case", type=int, action="append", help="number of a case; without, the page is written")
    parser.add_argument("--vehicle", type=int, help="flights of a vehicle on PX4's cascade; nothing else is done")
    parser.add_argument("--hover", action="store_true", help="these flights begin after 4 s of hover in wind")
    options = parser.parse_args()
    if options.vehicle:
        flown = hover_study(HOVER) if options.hover else cascade_study()
        fitting, start = (hover_study(0.0), HOVER) if options.hover else (flown, 0.0)
        covering, intervals, fits = covered_by_vehicle(flown, options.vehicle, fitting, start)
        print(
            f"{covering} of {intervals} intervals of 90 % cover the truth; {fits} of {options.vehicle} flights fitted"
        )
        return
    study, flights = flight_study(), options.flights
    lines = [
        "| outputs | " + " | ".join(f"`{name}`" for name in study.laws) + " | fitted | by chance alone |",
        "|---" * (len(study.laws) + 3) + "|",
    ]
    for place in options.case or range(len(CASES)):
        case = CASES[place]
        scores, fits = covered(study, flights, case)
        cells = []
        for name in study.laws:
            errors = scores.get(name, [])
            if errors:
                root_mean_square = np.sqrt(np.mean(np.square(errors)))
                cells.append(f"{100 * np.mean(inside(errors)):.1f} %, {root_mean_square:.2f}")
            else:
                cells.append("-")
        low, high = 100 * stats.binom.ppf([0.025, 0.975], flights, LEVEL) / flights
        chance = f"{fits} of {flights} | {low:.1f} to {high:.1f} %"
        lines.append(f"| {case.label} | {' | '.join(cells)} | {chance} |")
        print(lines[-1], flush=True)
    if not options.case:
        put("fit", "\n".join(lines), PAGE)


if __name__ == "__main__":
    main()
