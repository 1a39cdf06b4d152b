"""Writes the measured part of docs/wind.md: the worst winds found, beside random ones. Run it as ``make wind``."""

import time
from pathlib import Path

import numpy as np

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.plotting.style import write

DOCS = Path(__file__).parents[1] / "docs"
SIGNALS = ["error_max_x", "error_max_z", "tilt_max", "rotor_thrust_max", "rotor_thrust_min"]
CASES = (
    ("hover_wind", 3.0, None),
    ("hover_wind", 5.0, None),
    ("hover_wind", 5.0, 2.0),
    ("hover_wind", 8.0, None),
    ("hover_wind_tuned", 8.0, None),
    ("hover_wind_tuned", 8.0, 2.0),
)
"""Study, bound of the horizontal wind [m/s], bound of its rate [m/s^2]."""
RANDOM = 4096
"""Random winds beside each search."""
ADVERSARIES = 100_000


def study_of(name: str, speed: float, rate: float | None) -> dj.Study:
    """A packaged study with other bounds of its wind."""
    bounds = {"wind.speed": speed, "wind.vertical": 0.5 * speed}
    return dj.Study.load(name).override(bounds if rate is None else bounds | {"wind.rate": rate})


def row(name: str, speed: float, rate: float | None) -> str:
    """The worst winds of one case as a row of the table."""
    study = study_of(name, speed, rate)
    found = dj.worst_wind(study, signals=SIGNALS)
    worst = {answer.signal: answer.worst or np.inf for answer in found.answer.signals}
    winds = dj.switching_winds(study, RANDOM, seed=1)
    random = float(dj.fly_winds(study, winds, smooth=rate is not None)["error_max_x"].max())
    cells = (
        name,
        f"{speed:g}",
        "any" if rate is None else f"{rate:g}",
        f"{worst['error_max_x']:.3g}",
        f"{random:.3g}",
        f"{worst['error_max_z']:.3g}",
        f"{np.degrees(worst['tilt_max']):.2f}",
        f"{worst['rotor_thrust_min']:.2f} to {worst['rotor_thrust_max']:.2f}",
        f"{found.flights:,} + {found.slopes:,}",
    )
    print(*cells, flush=True)
    return f"| {' | '.join(cells)} |"


def adversaries() -> str:
    """How many random winds fly in which processor time, and how near they come to the worst wind."""
    study = dj.Study.load("hover_wind_tuned")
    worst = dj.worst_wind(study, signals=["error_max_x"]).answer.signals[0].worst or np.inf
    winds = dj.switching_winds(study, ADVERSARIES, seed=2)
    began = time.process_time()
    flown = dj.fly_winds(study, winds)["error_max_x"]
    seconds = time.process_time() - began
    rate = ADVERSARIES * study.loop.steps / seconds
    return (
        f"{ADVERSARIES:,} random winds of `hover_wind_tuned`, each of {study.loop.steps * study.loop.sample_time:g} s, "
        f"fly in {seconds:.0f} s of processor time ({rate / 1e6:.3g} million samples a second and core). The worst of "
        f"them drives |e_x| to {float(flown.max()):.4g} m, half of them stay below {float(flown.median()):.3g} m; the "
        f"search finds {worst:.4g} m."
    )


def measure_searches() -> None:
    """Search in all cases, and write the table and the figure."""
    head = ("study", "speed [m/s]", "rate [m/s^2]", "abs(e_x) [m]", f"of {RANDOM:,} random winds", "abs(e_z) [m]",
            "tilt [deg]", "rotor thrusts [N]", "flights + slopes")  # fmt: skip
    table = [f"| {' | '.join(head)} |", "|" + "---|" * len(head), *(row(*case) for case in CASES)]
    found = dj.worst_wind(dj.Study.load("hover_wind"), signals=SIGNALS[:3])
    write(found.figure(), DOCS / "figures" / "worst_wind.png")
    image = "![the worst wind found for three signals](figures/worst_wind.png)"
    put("searches", "\n\n".join(("\n".join(table), image)), DOCS / "wind.md")


def main() -> None:
    """Measure and write both parts."""
    measure_searches()
    put("adversaries", adversaries(), DOCS / "wind.md")


if __name__ == "__main__":
    main()
