"""Draws docs/figures/hover_wind*.png and writes the measured parts that are named after them: ``make hover``.

``python -m benchmarks.hover PART ..`` measures some of them. The figures belong to the parts ``hover map`` and
``hover gains``.
"""

import json
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax import plotting
from dssc_jax.plotting.standings import STANDINGS, standing_of
from dssc_jax.proofs.prove_vehicle import VehicleProved
from dssc_jax.results.proofs import SweepProofs

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "vehicle_proofs.md"
HOVER = "hover_wind_tuned"
SIGNAL = "error_max_x"
RANDOM = 24
"""Random winds whose flights are drawn."""
WALKS = (("hover_wind", (1.0, 14.0), None), (HOVER, (1.0, 14.0), None), (HOVER, (1.0, 14.0), 0.03))
"""Study, range of the wind [m/s], and lag of the rotors [s]."""


def path_of(study: dj.Study, draw: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The errors along x and y of one flight [m]."""
    flown = dj.simulate(study, draw=draw)
    return flown["x_e"].values, flown["y_e"].values


def draw_flights(ax: Axes, study: dj.Study, proved: VehicleProved) -> float:
    """Draw random flights and the worst one found in the square that is proved; the worst |e_x| found [m]."""
    bound = proved.largest_error
    square = Rectangle((-bound, -bound), 2.0 * bound, 2.0 * bound, fc="none", ec=plotting.BLUE, lw=2.5)
    square.set_label(f"proved for every wind: |e| ≤ {bound:.3g} m")
    ax.add_patch(square)
    for draw in range(RANDOM):
        label = f"{RANDOM} random winds" if draw == 0 else None
        ax.plot(*path_of(study, draw), color=plotting.GREY, linewidth=0.7, alpha=0.6, label=label)
    worst = dj.worst_wind(study, signals=[SIGNAL])
    ax.plot(*path_of(worst.flight(SIGNAL)), color=plotting.RED, linewidth=1.4, label="the worst wind found")
    found = worst.answer.signals[0].worst
    assert found is not None
    ax.set(xlabel="error along x [m]", ylabel="error along y [m]", aspect="equal")
    limit = 1.15 * bound
    ax.set(xlim=(-limit, limit), ylim=(-limit, limit))
    ax.set_title(f"hover in any wind up to {proved.problem.wind[0]:g} m/s")
    return found


def draw(result: dj.Result, hover: dj.Study, proved: VehicleProved) -> float:
    """Draw the figure: flights within the proved bound, and the map; the worst |e_x| found [m]."""
    with rc_context(plotting.STYLE):
        figure = Figure(figsize=(plotting.SLIDE[0], plotting.SLIDE[1] + 0.8), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
        found = draw_flights(left, hover, proved)
        plotting.standing(result, right)
        handles, _ = left.get_legend_handles_labels()
        legend = right.get_legend()
        assert legend is not None
        handles += legend.legend_handles
        legend.remove()
        figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
        plotting.write(figure, DOCS / "figures" / "hover_wind.png")
    return found


class ProvedMap(NamedTuple):
    """A sweep with its proofs, and the number of points of each kind in words."""

    result: dj.Result
    proofs: SweepProofs
    kinds: str


def proved_map(name: str) -> ProvedMap:
    """The map of a study, simulated and proved."""
    study = dj.Study.load(name)
    with tempfile.TemporaryDirectory() as folder:
        result = dj.run(study, Path(folder) / "map")
    proofs = dj.prove_sweep(study)
    share = result.failed.mean("draw").values
    kinds = standing_of(proofs.proved, share)
    counts = [f"{np.count_nonzero(kinds == kind)} ({text})" for kind, (_, text) in enumerate(STANDINGS)]
    text = (
        f"`dssc-jax sweep {name} --prove`: {share.size} points, {result.failed.sizes['draw']} draws at each; "
        f"{', '.join(counts)}. {int((proofs.proved & (share > 0.0)).sum())} proved points have a draw that fails."
    )
    return ProvedMap(result.with_proofs(proofs), proofs, text)


def map_text() -> str:
    """The map over wind and lag, and the figure."""
    result, proofs, kinds = proved_map("hover_wind_map")
    hover = dj.Study.load(HOVER)
    proved = dj.prove(hover)
    assert isinstance(proved, VehicleProved)
    found = draw(result, hover, proved)
    ratio = (proofs.bounds["|e_x|, |e_y|"] / result.dataset["error_max_x"].max("draw").values)[proofs.proved]
    lags, winds = result.study.axes.values()
    reach = []
    for lag, row in zip(lags, proofs.proved, strict=True):
        told = f"{max(np.array(winds)[row]):g} m/s" if row.any() else "none"
        reach.append(f"{lag:.3g} s: {told}")
    return (
        f"{kinds} The proved bound of |e_x| is {np.median(ratio):.2g} times the largest of the draws (median; at most "
        f"{ratio.max():.2g}). The strongest proved wind at each lag of the rotors: {'; '.join(reach)}. The proofs took "
        f"{proofs.seconds:.0f} s.\n\n"
        f"`dssc-jax prove {HOVER}`: {proved.statement()} `dssc-jax worst-wind` finds a wind that reaches "
        f"|e_x| = {found:.3g} m.\n\n"
        "![flights within the proved bound, and what is proved over wind and lag](figures/hover_wind.png)"
    )


def gains_text() -> str:
    """The map over two gains of x and y, and its figure."""
    result, proofs, kinds = proved_map("hover_wind_gains")
    plotting.write(plotting.sweep(result), DOCS / "figures" / "hover_wind_gains.png")
    best = np.unravel_index(int(np.nanargmin(proofs.error)), proofs.error.shape)
    pairs = zip(result.study.axes.items(), best, strict=True)
    at = ", ".join(f"{name.split('.')[-1]} = {values[i]:.3g}" for (name, values), i in pairs)
    return (
        f"{kinds} The smallest proved error is {float(proofs.error[best]):.3g} m, at {at}; the largest "
        f"{float(np.nanmax(proofs.error)):.3g} m.\n\n"
        "![what is proved over two gains](figures/hover_wind_gains.png)"
    )


def walks_text() -> str:
    """The strongest wind that is proved, from the safe end on."""
    rows = [
        "| study | lag of the rotors | proved up to [m/s] | abs(e_x), abs(e_y) [m] | tilt [deg] | time |",
        "|" + "---|" * 6,
    ]
    for name, bounds, lag in WALKS:
        study = dj.Study.load(name).override({} if lag is None else {"plant.vehicle.motor_lag": lag})
        began = time.perf_counter()
        reach = dj.proved_up_to(study, "wind.speed", bounds).summary()
        seconds = time.perf_counter() - began
        told = "none" if lag is None else f"{lag:g} s"
        largest = reach["bounds"]
        cells = (f"`{name}`", told, f"{reach['proved_up_to']:.3g}", f"{largest['x']['e']:.3g}",
                 f"{math.degrees(largest['tilt']):.3g}", f"{seconds:.0f} s")  # fmt: skip
        print(*cells, flush=True)
        rows.append(f"| {' | '.join(cells)} |")
    return "`dssc-jax prove STUDY --over wind.speed=1:14`:\n\n" + "\n".join(rows)


def tuning_text() -> str:
    """The smallest proved error, by three gains."""
    tuned = dj.tune(dj.Study.load("tune_hover_wind"))
    assert tuned.facts.aimed is not None
    assert dj.check_certificate(json.loads(json.dumps(tuned.certificate))).proved
    moves = tuned.values.items()
    gains = ", ".join(f"{name.split('.')[-1]} {tuned.start[name]:.3g} -> {value:.3g}" for name, value in moves)
    return (
        f"`dssc-jax tune tune_hover_wind`: {tuned.headline} by {gains}; {tuned.facts.stopped}; "
        f"{tuned.facts.seconds:.0f} s. The result: {tuned.facts.proof}"
    )


PARTS = {"hover map": map_text, "hover gains": gains_text, "hover walks": walks_text, "hover tuning": tuning_text}


def main() -> None:
    """Measure the parts that are named, or all, and write each into the page."""
    for name in sys.argv[1:] or PARTS:
        put(name, PARTS[name](), PAGE)


if __name__ == "__main__":
    main()
