"""Regenerate docs/tuning.md: what tuning and falsification do, and why DSSC, if at all. ``make pareto``.

``--quick`` takes budgets that show that it runs, and nothing else; ``--no-uav`` leaves the whole vehicle out.
"""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import dssc_jax as dj  # isort: skip  (sets compiler flags before anything starts JAX)
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from dssc_jax import plotting
from dssc_jax.comparison.rivals import controller_table
from dssc_jax.comparison.tuning import STATE_DEPENDENT
from dssc_jax.console import machine
from dssc_jax.falsification import Programs, hunt
from dssc_jax.statistics import clopper_pearson
from dssc_jax.tuning.gradients import check_gradients
from dssc_jax.tuning.plan import Plan
from dssc_jax.tuning.problem import Problem

ROOT = Path(__file__).parents[1]
DOCS, STUDIES = ROOT / "docs", ROOT / "studies"
CONTROLLERS = ("dssc", "ssc", "sta", "vgsta", "pi")
GAINS = {"pi": ("k_p", "k_i"), "sta": ("kappa1", "kappa2"), "vgsta": ("kappa_d", "gamma")}
FACTOR = 10.0  # ranges reach from a tenth to ten times the gain that corresponds to the article's
LIMITS = (0.5, 0.7, 1.0, 1.4, 2.0)  # of the command variation, in shares of what DSSC has at the article's gains
LAGS = (0.005, 2.0)  # s


class Budget(NamedTuple):
    """What every controller gets at every limit, and what decides."""

    steps: int
    train: int
    fresh: int
    limits: tuple[float, ...]
    planted: int
    points: int


FULL = Budget(40, 64, 512, LIMITS, 4_000_000, 1000)
QUICK = Budget(3, 8, 16, (1.0,), 20_000, 20)


class Trade(NamedTuple):
    """One tuned loop on fresh draws: CVaR of the error [m], mean command variation [m/s], lag margin [s]."""

    limit: float
    error: float
    variation: float
    margin: float | None


class Vehicle(NamedTuple):
    """A loop for the front: its study, objective, the metrics of command variation, and channels whose gains move."""

    study: dj.Study
    error: str
    variations: tuple[str, ...]
    channels: tuple[str, ...]


def tuned_names(study: dj.Study, channels: tuple[str, ...]) -> list[str]:
    """l0 and the two usual gains, in the channels that are tuned."""
    table = study.config.controller
    kind = table["kind"]
    usual = GAINS.get(kind) or STATE_DEPENDENT[table.get("functions", {}).get("kind", "constant")]
    found = []
    for name, value in study.leaves().items():
        parts = name.split(".")
        others = set(study.loop.channels) - set(channels) - {""}
        if parts[0] == "controller" and parts[-1] in ("l0", *usual) and not others & set(parts):
            assert isinstance(value, float)
            found.append(name)
    return found


def front(vehicle: Vehicle, kind: str, budget: Budget, reference: float) -> list[Trade]:
    """The least error at each limit of the command variation, for one controller."""
    base = vehicle.study.override({"controller": controller_table(vehicle.study, kind), "draws": budget.fresh})
    leaves = base.leaves()
    names = tuned_names(base, vehicle.channels)
    ranges = {name: [leaves[name] / FACTOR, leaves[name] * FACTOR] for name in names}  # type: ignore[operator]
    found = []
    for share in budget.limits:
        table: dict[str, Any] = {
            "parameters": ranges,
            "objective": {vehicle.error: 1.0},
            "limits": dict.fromkeys(vehicle.variations, share * reference),
            "steps": budget.steps,
            "draws": budget.train,
            "validation": budget.train,
        }
        tuned = dj.tune(base.override({"tune": table}))
        verdict = tuned.verdict
        variation = max(verdict.limits[name][2] for name in vehicle.variations)
        found.append(Trade(share, verdict.objective[1], variation, lag_margin(tuned.study)))
        print(f"{vehicle.study.name} {kind}: {found[-1]}, feasible {tuned.facts['feasible']}", flush=True)
    return found


def lag_margin(study: dj.Study) -> float | None:
    """The lag that 95 % of all draws survive with their error below 5 m in the second half (confidence 95 %)."""
    half = 0.5 * study.config.loop.duration
    several = len(study.loop.channels) > 1
    metric = "position_error_max" if several else "error_max"
    unmodelled = {"kind": "lag", "order": 2, "mu": LAGS[0]}
    required = [{"metric": metric, "after": half, "max": 5.0}]
    lagged = study.override({"unmodelled": unmodelled, "requirement": required, "draws": min(study.config.draws, 128)})
    return dj.margin(lagged, over="unmodelled.mu", bounds=LAGS, log=True, points=9, bisections=6).lower_tolerance()


def reference_variation(vehicle: Vehicle, budget: Budget) -> float:
    """Mean command variation of DSSC at the article's gains: the unit of the limits."""
    data = dj.run(vehicle.study.override({"draws": budget.fresh})).dataset
    return float(max(np.mean(data[name].values) for name in vehicle.variations))


def draw(fronts: dict[str, dict[str, list[Trade]]]) -> None:
    palette = (plotting.BLUE, plotting.GREY, plotting.RED, plotting.ORANGE, plotting.GREEN)
    looks = {
        kind: {"marker": mark, "color": colour, "label": kind.upper()}
        for kind, mark, colour in zip(CONTROLLERS, "osv^D", palette, strict=True)
    }
    with rc_context(plotting.STYLE):
        figure = Figure(figsize=(plotting.SLIDE[0], plotting.SLIDE[1] * len(fronts)), layout="constrained")
        rows = np.atleast_2d(figure.subplots(len(fronts), 2))
        for axes, (name, controllers) in zip(rows, fronts.items(), strict=True):
            for kind, trades in controllers.items():
                finite = [trade for trade in trades if np.isfinite(trade.error)]
                axes[0].plot([t.variation for t in finite], [t.error for t in finite], **looks[kind])
                axes[1].plot([t.margin or np.nan for t in finite], [t.error for t in finite], **looks[kind])
            axes[0].set(xlabel="mean total variation of the command [m/s]", ylabel="CVaR 95 % of the rms error [m]")
            axes[1].set(xlabel="lag $\\mu$ that 95 % of the draws survive [s]", ylabel="CVaR 95 % of the rms error [m]")
            axes[0].set_title(name)
            for ax in axes:
                ax.set_xscale("log")
                ax.legend(frameon=False)
        figure.suptitle("Every controller tuned on the same budget, judged on fresh draws")
        plotting.write(figure, DOCS / "figures" / "pareto.png")


def planted_lines(budget: Budget) -> list[str]:
    """A rare failure, and how soon it is found."""
    study = dj.Study.load(STUDIES / "falsify_corner.toml")
    failures = dj.run(study.override({"draws": budget.planted, "seed": 5})).summary()["points"][0]["failures"]
    low, high = clopper_pearson(failures, budget.planted)
    programs = Programs.of(study, 1000)
    found = [hunt(programs, 1000, seed, lambda done, total, text: None) for seed in range(10)]
    first = sorted(each.first_failure for each in found if each.first_failure is not None)
    return [
        f"A planted failure in a box of five dimensions: {failures} of {budget.planted:,} random draws fail, a "
        f"probability of [{low:.2g}, {high:.2g}]. `falsify` finds it with {len(first)} of 10 seeds, the first failure "
        f"after {first[0] if first else '-'} to {first[-1] if first else '-'} simulations of 1,000.",
    ]


def tuning_lines(budget: Budget, name: str) -> list[str]:
    """A shipped study, as it is."""
    study = dj.Study.load(STUDIES / f"{name}.toml")
    if budget is QUICK:
        small = {"tune.steps": budget.steps, "tune.draws": budget.train, "tune.validation": budget.train}
        study = study.override({"draws": budget.fresh, **small})
    began = time.perf_counter()
    agreement = check_gradients(Problem(Plan.of(study)), budget.points)
    checked = time.perf_counter()
    found = dj.tune(study)
    verdict = found.verdict
    low, high = verdict.reduction_interval
    plotting.write(plotting.tuning(found), DOCS / "figures" / f"{name}.png")
    limits = "; ".join(
        f"mean {metric} {after:.4g} where the start has {before:.4g}"
        for metric, (_, before, after) in verdict.limits.items()
    )
    numbers = ", ".join(f"{key.rpartition('.')[2]} {found.start[key]:g} -> {v:.4g}" for key, v in found.values.items())
    return [
        f"`{name}`: {numbers}. On {verdict.draws} fresh draws the objective falls from {verdict.objective[0]:.4g} to "
        f"{verdict.objective[1]:.4g}, by {verdict.reduction:.1%} in [{low:.1%}, {high:.1%}] (95 %, bootstrap); "
        f"{limits}. {time.perf_counter() - checked:.0f} s.",
        "",
        f"Its derivatives at {agreement.points} random points: {agreement.text}; {agreement.ended} points ended early; "
        f"every one finite: {agreement.finite}; {checked - began:.0f} s.",
        "",
        f"![{name}](figures/{name}.png)",
    ]


def front_lines(fronts: dict[str, dict[str, list[Trade]]]) -> list[str]:
    lines = []
    for name, controllers in fronts.items():
        lines += [f"### {name}", "", "| controller | limit | CVaR of the error [m] | variation [m/s] | lag [s] |"]
        lines += ["|---|---|---|---|---|"]
        for kind, trades in controllers.items():
            for t in trades:
                margin = "none" if t.margin is None else f"{t.margin:.3g}"
                lines.append(f"| {kind} | {t.limit:g} | {t.error:.4g} | {t.variation:.4g} | {margin} |")
        lines.append("")
    return lines


GUIDE = """\
`dssc-jax tune STUDY` chooses the numbers that `[tune.parameters]` names, each inside its interval, so that the
aggregate of the draws' costs is small: their mean, the mean of the worst share (`cvar`), or a soft worst case. Limits
bound the mean of a metric; `"start"` is what the start has on the same draws. Requirements count as limits too. The
search descends on training draws, chooses on validation draws, and is judged on the study's own draws, which nothing
was tuned on. With `certified = true` the free parameters of Table 1 are varied instead, and every point is a certified
design that passes the strict check.

`dssc-jax falsify STUDY` hunts the worst draw within the support of the laws; the disturbance and wind of kind `spline`
make signals of bounded amplitude and slope a part of the draw. `tune --robust` adds the worst draw that it finds to
what must be met, and tunes again.

Derivatives are forward-mode, and exact almost everywhere: the implicit scheme's clip is differentiated as it is. They
are compared with central differences before every descent; where fewer than half agree, differential evolution takes
over.
"""


def main() -> None:
    began = time.perf_counter()
    budget = QUICK if "--quick" in sys.argv else FULL
    flat = dj.Study.load(STUDIES / "tune_case2.toml")
    vehicles = {"1-DOF: Case 2, x axis": Vehicle(flat, "error_rms", ("command_tv",), ())}
    names = ["tune_case2"]
    if "--no-uav" not in sys.argv:
        whole = dj.Study.load(STUDIES / "tune_uav.toml")
        moved = ("x", "y")
        vehicles["UAV: Case 1 in wind"] = Vehicle(
            whole, "position_error_rms", tuple(f"command_tv_{axis}" for axis in moved), moved
        )
        names.append("tune_uav")
    parts = [line for name in names for line in (*tuning_lines(budget, name), "")]
    planted = planted_lines(budget)
    fronts: dict[str, dict[str, list[Trade]]] = {}
    for name, vehicle in vehicles.items():
        reference = reference_variation(vehicle, budget)
        fronts[name] = {kind: front(vehicle, kind, budget, reference) for kind in CONTROLLERS}
    draw(fronts)
    size = "`make pareto`" if budget is FULL else "a quick trial, whose numbers mean nothing"
    lines = [
        "# Tuning, falsification, and why DSSC",
        "",
        f"Regenerated by {size} in {time.perf_counter() - began:.0f} s. Machine: {machine()}.",
        "",
        GUIDE,
        "## The article's gains, tuned",
        "",
        *parts,
        "## A rare failure",
        "",
        *planted,
        "",
        "## Error, command variation and lag margin",
        "",
        "Each controller starts from the gains that correspond to DSSC's at the article's (Table 2), and may move l0 "
        f"and its two usual gains by a factor of {FACTOR:g} either way: {budget.steps} steps on {budget.train} draws "
        "for each limit of the command variation, given as a share of DSSC's at the article's gains; "
        f"{budget.fresh} fresh draws decide. The lag is the one of order two that 95 % of all draws survive, with "
        "confidence 95 %, their error below 5 m in the second half.",
        "",
        *front_lines(fronts),
        "![error against command variation and lag margin](figures/pareto.png)",
        "",
    ]
    (DOCS / "tuning.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
