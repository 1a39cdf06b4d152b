"""Regenerate docs/tuning.md: what tuning and falsification do, and why DSSC, if at all. ``make pareto``.

``--quick`` takes budgets that show that it runs, and nothing else; ``--no-uav`` leaves the whole vehicle out.
"""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

import dssc_jax as dj
from dssc_jax import plotting
from dssc_jax.analyses.comparison.rivals import controller_table
from dssc_jax.analyses.falsification.falsify import search_worst_draw
from dssc_jax.analyses.falsification.search import SearchPrograms
from dssc_jax.analyses.tuning.gradients import check_gradients
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.problem import Problem
from dssc_jax.console.environment import machine
from dssc_jax.statistics import clopper_pearson

ROOT = Path(__file__).parents[1]
DOCS, STUDIES = ROOT / "docs", ROOT / "studies"
CONTROLLERS = ("dssc", "ssc", "sta", "vgsta", "pi")
FACTOR = 10.0  # ranges reach from a tenth to ten times the gain that corresponds to the article's
LIMITS = (1.0, 1.1, 1.25, 1.5)  # of the command variation, in shares of what DSSC has at the article's gains
LAGS = (0.005, 2.0)  # s
TICKS = (0.1, 0.2, 0.5, 1.0, 2.0)  # of their axis
MISSION = 40.0  # s, of the fronts: one period of the reference


class Budget(NamedTuple):
    """What every controller gets at most at every limit, and what decides.

    Args:
        steps: Of a search.
        train: Draws that train; three numbers of 42 draws fill two tiles of 64 lanes, one a core.
        validation: Draws that choose.
        fresh: Draws that decide.
        limits: How many of LIMITS.
        planted: Random draws for the probability of the planted failure.
        points: Of a gradient check.
    """

    steps: int
    train: int
    validation: int
    fresh: int
    limits: int
    planted: int
    points: int


FULL = Budget(100, 42, 128, 256, len(LIMITS), 4_000_000, 1000)
QUICK = Budget(2, 8, 8, 16, 1, 20_000, 20)


class Trade(NamedTuple):
    """One tuned loop on fresh draws.

    Args:
        limit: Share of the command variation that it was given.
        error: CVaR of the error [m].
        variation: Mean variation of the whole command, in the same shares.
        robust: Mean variation of the robust command [m/s].
        margin: Lag margin [s].
        within: Whether a point within the limits was found.
    """

    limit: float
    error: float
    variation: float
    robust: float
    margin: float | None
    within: bool


class Vehicle(NamedTuple):
    """A loop for the front.

    Args:
        study: It, with the article's gains.
        error: The metric that is made small.
        axes: Suffixes of the channels whose command variation is limited.
        channels: Those whose gains move.
        points: Of its gradient check at most.
        steps: Of a search of the front at most.
    """

    study: dj.Study
    error: str
    axes: tuple[str, ...]
    channels: tuple[str, ...]
    points: int
    steps: int

    @property
    def metrics(self) -> dict[str, list[str]]:
        """What the front needs."""
        return {"metrics.names": [self.error, "command_tv", "total_command_tv"]}

    def variation(self, study: dj.Study, kind: str) -> np.ndarray:
        """Mean over the draws of a variation, one a limited channel [m/s]."""
        data = dj.run(study).dataset
        return np.array([float(np.mean(data[kind + axis].values)) for axis in self.axes])


def tuned_names(study: dj.Study, channels: tuple[str, ...]) -> list[str]:
    """l0 and the two usual gains, in the channels that are tuned."""
    usual = study.loop.controller[0].tunable_gains(study.template.controller[0])
    found = []
    for name, value in study.leaves().items():
        parts = name.split(".")
        others = set(study.loop.channels) - set(channels) - {""}
        if (
            parts[0] == "controller"
            and parts[-1] in ("l0", *(name.rpartition(".")[2] for name in usual))
            and not others & set(parts)
        ):
            assert isinstance(value, float)
            found.append(name)
    return found


def front(vehicle: Vehicle, kind: str, budget: Budget, reference: np.ndarray) -> list[Trade]:
    """The least error at each limit of the command variation, for one controller; each limit starts where one ended."""
    changes = {"controller": controller_table(vehicle.study, kind), "draws": budget.fresh, **vehicle.metrics}
    base = vehicle.study.override(changes)
    leaves = base.leaves()
    names = tuned_names(base, vehicle.channels)
    ranges = {name: [leaves[name] / FACTOR, leaves[name] * FACTOR] for name in names}  # type: ignore[operator]
    found, start = [], {}
    for share in LIMITS[: budget.limits]:
        limits = {f"total_command_tv{axis}": share * own for axis, own in zip(vehicle.axes, reference, strict=True)}
        table: dict[str, Any] = {
            "parameters": ranges,
            "objective": {vehicle.error: 1.0},
            "limits": limits,
            "optimiser": "sqp",
            "steps": min(budget.steps, vehicle.steps),
            "draws": budget.train,
            "validation": budget.validation,
        }
        tuned = dj.tune(base.override({"tune": table, **start}))
        start = tuned.values
        means = [tuned.verdict.limits[name][2] for name in limits]
        variation = float(np.max(np.array(means) / reference))
        robust = float(np.max(vehicle.variation(tuned.tuned_study, "command_tv")))
        within = bool(tuned.facts.feasible)
        found.append(Trade(share, tuned.verdict.objective[1], variation, robust, lag_margin(tuned.tuned_study), within))
        print(f"{vehicle.study.name} {kind}: {found[-1]}, {tuned.facts.seconds:.0f} s, {start}", flush=True)
    return found


def lag_margin(study: dj.Study) -> float | None:
    """The lag that 95 % of all draws survive with their error below 5 m in the second half (confidence 95 %)."""
    half = 0.5 * study.config.loop.duration
    several = len(study.loop.channels) > 1
    metric = "position_error_max" if several else "error_max"
    unmodelled = {"kind": "lag", "order": 2, "mu": LAGS[0]}
    required = [{"metric": metric, "after": half, "max": 5.0}]
    lagged = study.override({"unmodelled": unmodelled, "requirement": required, "draws": min(study.config.draws, 64)})
    return dj.margin(lagged, over="unmodelled.mu", bounds=LAGS, log=True, points=9, bisections=6).lower_tolerance()


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
                finite = [trade for trade in trades if trade.within and np.isfinite(trade.error)]
                axes[0].plot([t.variation for t in finite], [t.error for t in finite], **looks[kind])
                axes[1].plot([t.margin or np.nan for t in finite], [t.error for t in finite], **looks[kind])
            axes[0].set(
                xlabel="variation of the whole command / DSSC's with the article's gains",
                ylabel="CVaR 95 % of the rms error [m]",
            )
            axes[1].set(xlabel="lag $\\mu$ that 95 % of the draws survive [s]", ylabel="CVaR 95 % of the rms error [m]")
            axes[0].set_title(name)
            axes[1].set_xscale("log")
            axes[1].set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
            axes[1].xaxis.set_minor_locator(NullLocator())
            for ax in axes:
                ax.legend(frameon=False)
        figure.suptitle("Every controller tuned on the same budget, judged on fresh draws")
        plotting.write(figure, DOCS / "figures" / "pareto.png")


def planted_lines(budget: Budget) -> list[str]:
    """A rare failure, and how soon it is found."""
    study = dj.Study.load(STUDIES / "falsify_corner.toml")
    failures = dj.run(study.override({"draws": budget.planted, "seed": 5})).summary()["points"][0]["failures"]
    low, high = clopper_pearson(failures, budget.planted)
    programs = SearchPrograms.of(study, 1000)
    found = [search_worst_draw(programs, 1000, seed) for seed in range(10)]
    first = sorted(each.first_failure for each in found if each.first_failure is not None)
    return [
        f"A planted failure in a box of five dimensions: {failures} of {budget.planted:,} random draws fail, a "
        f"probability of [{low:.2g}, {high:.2g}]. `falsify` finds it with {len(first)} of 10 seeds, the first failure "
        f"after {first[0] if first else '-'} to {first[-1] if first else '-'} simulations of 1,000.",
    ]


def tuning_lines(budget: Budget, vehicle: Vehicle) -> list[str]:
    """A shipped study, as it is."""
    study = vehicle.study
    name = study.name.replace("-", "_")
    if budget is QUICK:
        small = {"tune.steps": budget.steps, "tune.draws": budget.train, "tune.validation": budget.validation}
        study = study.override({"draws": budget.fresh, **small})
    began = time.perf_counter()
    agreement = check_gradients(Problem(Plan.of(study)), min(budget.points, vehicle.points))
    checked = time.perf_counter()
    found = dj.tune(study)
    verdict = found.verdict
    low, high = verdict.reduction_interval
    plotting.write(plotting.tuning(found), DOCS / "figures" / f"{name}.png")
    limits = "; ".join(
        f"mean {metric} {after:.4g} where the start has {before:.4g} and the limit is {bound:.4g}"
        for metric, (bound, before, after) in verdict.limits.items()
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
        "",
    ]


def descent_lines(budget: Budget, study: dj.Study) -> list[str]:
    """The same by a descent."""
    steps = 80 if budget is FULL else budget.steps
    changes: dict[str, Any] = {"tune.optimiser": "adam", "tune.steps": steps}
    if budget is QUICK:
        changes |= {"draws": budget.fresh, "tune.draws": budget.train, "tune.validation": budget.validation}
    found = dj.tune(study.override(changes))
    return [
        f'`tune_case2` by `optimiser = "adam"`: {steps} steps on the same draws lower the objective by '
        f"{found.verdict.reduction:.1%} in "
        f"{found.facts.seconds:.0f} s.",
        "",
    ]


def front_lines(fronts: dict[str, dict[str, list[Trade]]]) -> list[str]:
    lines = []
    for name, controllers in fronts.items():
        lines += [f"### {name}", "", "| controller | limit | error [m] | whole | robust [m/s] | lag [s] |"]
        lines += ["|---|---|---|---|---|---|"]
        for kind, trades in controllers.items():
            for t in trades:
                margin = "none" if t.margin is None else f"{t.margin:.3g}"
                whole = f"{t.variation:.3g}" + ("" if t.within else " (exceeded)")
                lines.append(f"| {kind} | {t.limit:g} | {t.error:.4g} | {whole} | {t.robust:.3g} | {margin} |")
        lines += ["", *best_lines(controllers), ""]
    return lines


def best_lines(controllers: dict[str, list[Trade]]) -> list[str]:
    """Who is best at each limit, of those within it."""
    lines = []
    for trades in zip(*controllers.values(), strict=True):
        within = {kind: t for kind, t in zip(controllers, trades, strict=True) if t.within}
        if within:
            error = min(within, key=lambda kind: within[kind].error)
            robust = min(within, key=lambda kind: within[kind].robust)
            lags = {kind: t.margin for kind, t in within.items() if t.margin is not None}
            lag = max(lags, key=lags.__getitem__) if lags else None
            lines.append(
                f"* Limit {trades[0].limit:g}: least error {error} ({within[error].error:.3g} m), least variation of "
                f"the robust command {robust} ({within[robust].robust:.3g} m/s), "
                + (f"largest lag {lag} ({lags[lag]:.2g} s)." if lag else "no lag that enough draws survive.")
            )
    return lines


GUIDE = """\
`dssc-jax tune STUDY` tunes the numbers in `[tune.parameters]`, each within its interval. It minimises an aggregate of
the draws' costs: their mean, the mean of a worst share of the draws (`cvar`), or a smooth approximation of the largest
cost. Limits bound the mean of a metric; `"start"` sets the limit to the value of the initial gains on the same draws.
Requirements are limits too; the answer names each one that is still missed, by how many validation draws and by how
much. A draw with an infinite metric, such as one that never settles, counts as missing its bound tenfold. The search
uses training draws, selects on validation draws, and is judged on the study's own draws, which were not used for
tuning. With `certified = true` the free parameters of Table 1 are varied instead, and every point is a certified design
that passes the strict check.

`optimiser` selects the search. The descents of optax (default: `adam`) run under an augmented Lagrangian, with
mini-batches of `batch` draws and an optional learning-rate schedule. `sqp` needs far fewer steps, but each step uses
all training draws. The third choice is `differential_evolution`. With `slack = 0.05` the numbers of Table 1
themselves may be tuned: each inequality of Theorem 1 must then hold with a margin of 5 %, and every point passes the
strict check too.

`aim = "proved_error"` or `"proved_up_to"` optimises a number that is proved of the sampled loop instead of the draws'
objective: [proofs](proofs.md#tuning-under-proof).

Derivatives are exact almost everywhere: the implicit scheme's clip is differentiated without smoothing. Before every
search they are compared with central differences. If fewer than half agree, or fewer than half predict the effect of
a step of the search, differential evolution is used instead. If a loop chatters, `smoothing` [m/s] helps: the program
with derivatives uses x/(|x| + w) instead of the sign, the width w decreases from this value to 0, and only the exact
loop is used for validation and the final judgement. `derivatives = "forward"` simulates each draw once for each
number, with its tangent. `"reverse"` simulates it once, with one backward pass for each metric, and suits many
numbers. Its memory grows with the square root of the duration.

`dssc-jax falsify STUDY` searches for the worst draw within the support of the laws. With disturbance and wind of kind
`spline`, signals of bounded amplitude and slope are part of the draw. `tune --robust` adds the worst draw found to
the draws that must meet the requirements, and tunes again.

`--within-sigma K` searches among the draws within K sigma only: those whose independent standard normal scores z have
|z| <= K. The score of a value is the standard normal quantile at its level in its law; scores of correlated numbers are
made independent by the copula's factor. `--within-mass P` gives the probability of this set instead of K. The more
numbers are uncertain, the fewer draws lie near the median of all: 3 sigma hold 98.9 % of all draws of two numbers, but
16.9 % of those of fourteen. The worst draw and the likeliest failure found come with their distance, the density of
their scores relative to the mode, and the probability of all draws that lie nearer. In-loop noise is not part of the
likelihood. The distance of the likeliest failure found is an upper bound of that of the likeliest one of all.

Requirements are compared by their slacks in shares of their bounds. Where the bound is 0, as for an envelope, the slack
counts in shares of its median over the first draws. The answer tells what the worst draw violates first and when, and,
where it ends early, how and when. Nothing is worse than a draw that ends early or misses a bound by an infinite amount,
so the search stops there. A search that finds no failure proves nothing; a larger `--budget` searches longer.
"""


def main() -> None:
    began = time.perf_counter()
    budget = QUICK if "--quick" in sys.argv else FULL
    case2, uav = (dj.Study.load(STUDIES / f"tune_{name}.toml") for name in ("case2", "uav"))
    flat = Vehicle(case2, "error_rms", ("",), (), 1000, 20)
    whole = Vehicle(uav, "position_error_rms", ("_x", "_y"), ("x", "y"), 100, 8)
    vehicles = {"1-DOF: Case 2, x axis": flat}
    if "--no-uav" not in sys.argv:
        vehicles["UAV: Case 1 in wind"] = whole
    parts = [line for vehicle in vehicles.values() for line in tuning_lines(budget, vehicle)]
    parts += descent_lines(budget, case2)
    planted = planted_lines(budget)
    fronts: dict[str, dict[str, list[Trade]]] = {}
    for name, vehicle in vehicles.items():
        halved = vehicle.study.override({"loop.duration": MISSION})
        vehicle = vehicle._replace(study=halved)
        reference = vehicle.variation(halved.override({"draws": budget.fresh, **vehicle.metrics}), "total_command_tv")
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
        "Each controller starts from the gains that correspond to the article's gains of DSSC (Table 2). The search "
        f"may change l0 and its two usual gains by a factor of {FACTOR:g} in either direction: {flat.steps} steps "
        f"(UAV: {whole.steps}) at most of `sqp` on {budget.train} draws for each limit, where each search starts "
        "from the end of the previous one. The limits apply to the variation of the whole command u + u_n, so that "
        "no controller can hide variation in its nominal part. They are relative to the variation of DSSC with the "
        f"article's gains, and the variation includes the motion that the reference requires. {budget.fresh} fresh "
        f"draws are used for the evaluation over {MISSION:g} s. The error is the mean of the worst 5 % of its rms, "
        "'whole' is the relative variation of the whole command, and 'robust' is the variation of u alone. The lag "
        "is of order two; 95 % of all draws, with confidence 95 %, survive it with an error below 5 m in the second "
        "half.",
        "",
        *front_lines(fronts),
        "![error against command variation and lag margin](figures/pareto.png)",
        "",
    ]
    (DOCS / "tuning.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
