"""Sections on the answer: outcome, sweep, metrics, causes, worst draws, chattering."""

from functools import partial
from typing import Any

import htpy as h
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.closed_loop.metrics import Measure
from dssc_jax.design import noise_warning
from dssc_jax.engine.reference import VERDICTS
from dssc_jax.plotting.draws import shown_laws
from dssc_jax.report.elements import (
    LEVEL,
    Section,
    counted,
    facts,
    figure,
    folded,
    interval,
    number,
    probability_text,
    table,
    with_unit,
)
from dssc_jax.report.subject import Subject
from dssc_jax.report.vector import inline
from dssc_jax.results.influence import by_influence, idle_text
from dssc_jax.results.result import Result, headline
from dssc_jax.results.schema import ENDINGS, outcome_codes
from dssc_jax.results.summary import most_violated
from dssc_jax.statistics.order import upper_quantiles
from dssc_jax.study import Described

MOST_ROWS, MOST_FACTORS = 400, 24
CERTIFIED_TEXT = {None: "-", True: "yes", False: "no"}
UNSHOWN = "They are not simulated again here, which would run code that is not part of dssc_jax: "
CHATTER = ("command_tv", "sampling_ratio", "sampling_ratio_above_1", "outside_sliding")


def outcome(about: Subject) -> Section:
    """How the draws ended, with intervals; for a sweep, its points, and how the draws ended at one of them."""
    if about.result.study.axes:
        return Section("outcome", "The outcome", [*points_section(about), *ways(about), integration(about)])
    certificate = about.result.certificate and h.p[h.strong[about.result.certificate], "."]
    return Section("outcome", "The outcome", [*ways(about), certificate, integration(about)])


def integration(about: Subject) -> h.Node:
    """The error of integration between the samples; none if it was not checked."""
    text = about.result.integration
    return text and h.p[f"Integration: {text}."]


def ways(about: Subject) -> list[h.Node]:
    """All outcomes of the draws, each requirement separately, and which requirements are violated together."""
    close, point = about.close, about.said
    ended, method, draws = close.dataset["outcome"].values, close.method, point["draws"]
    rows: list[tuple[h.Node, ...]] = []
    for code, words in ENDINGS.items():
        if code in outcome_codes(close.study):
            bounds, n = method.interval(ended == code).tolist(), int(np.count_nonzero(ended == code))
            rows.append((words, f"{n:,}", probability_text(n / draws, bounds), interval(bounds), ""))
    for each in point["requirements"]:
        rows.append((f"violates {each['text']}", *fails(each), f"{each['alone']:,}"))
    rows.append((h.strong["fails in any way"], *fails(point), ""))
    head = ("how a draw ended", "draws", "probability", f"{LEVEL} interval", "this alone")
    note = (
        "A draw counts for every requirement that it violates, and one that ended early for all of them "
        f"({counted(point['ended_early'], 'draw')} here). Intervals: {method.name}, each at {LEVEL} on its own. Where "
        f"none of the {draws:,} draws ended in a given way, the table shows the upper bound of its probability."
    )
    return [table(f"Outcomes of {counted(draws, 'draw')}{about.where}", head, rows), h.p[note], *together(point)]


def together(point: dict[str, Any]) -> list[h.Node]:
    """Pairs of requirements that the same draws violate, if there are at least two requirements."""
    if len(point["requirements"]) < 2:
        return []
    pairs = [pair for pair in point["overlaps"] if pair["draws"]]
    if not pairs:
        return [h.p["No draw that ran to its end violates two requirements."]]
    text = {each["name"]: each["text"] for each in point["requirements"]}
    rows = [(*(text[name] for name in pair["names"]), f"{pair['draws']:,}") for pair in pairs]
    caption = "Requirements that the same draws violate, without draws that ended early"
    return [table(caption, ("requirement", "and requirement", "draws"), rows, words=2)]


def fails(point: dict[str, Any]) -> tuple[str, str, str]:
    """Failures at a point, or of one requirement there, with their probability and its interval."""
    bounds = point["interval"]
    return f"{point['failures']:,}", probability_text(point["probability"], bounds), interval(bounds)


def points_section(about: Subject) -> list[h.Node]:
    """Points of a sweep: the best, the worst, the one shown in detail; and a collapsed table of all."""
    study, points = about.result.study, about.summary["points"]
    names = [(name, study.quantities[name].unit) for name in study.axes]
    swept = [name if unit == "1" else f"{name} [{unit}]" for name, unit in names]
    middle = f"median {headline(about.result).name}"
    violated = ["most violated"] if len(study.requirements) > 1 else []
    head = (*swept, "failures", "probability", f"{LEVEL} interval", *violated, middle, "certified")
    best, most = (pick(points, key=lambda point: point["probability"]) for pick in (min, max))
    picked = {"least failures": best, "nearest to half": about.said, "most failures": most}
    some = [(name, *point_cells(about, point)) for name, point in picked.items()]
    every = [point_cells(about, point) for point in points[:MOST_ROWS]]
    more = f"; the first {MOST_ROWS} of {len(points):,}, all are in summary.json" if len(points) > MOST_ROWS else ""
    caption = f"{counted(study.config.draws, 'draw')} at each point{more}"
    note = (
        f"Intervals: {about.result.method.name}, each at {LEVEL} on its own; the draws of all points are the same, "
        "so that differences between points are sharper than the intervals suggest."
    )
    return [
        table("Three points of the sweep", ("point", *head), some),
        h.p[note],
        folded(f"All {counted(len(points), 'point')}", table(caption, head, every)),
    ]


def point_cells(about: Subject, point: dict[str, Any]) -> tuple[h.Node, ...]:
    """A row for a sweep point: its values, failures with interval, the main failure, the median, the certificate."""
    where = (number(point[name]) for name in about.result.study.axes)
    middle = point["metrics"][headline(about.result).name]["q50"]
    main_failure = [most_violated(point)] if len(point["requirements"]) > 1 else []
    return *where, *fails(point), *main_failure, number(middle), CERTIFIED_TEXT[point["certified"]]


def sweep_section(about: Subject) -> Section | None:
    """Failure probability and the headline metric over the sweep."""
    result = about.result
    if not result.study.axes:
        return None
    shown = [name for name, values in result.study.axes.items() if len(values) > 1][:2]
    rest = [f"{name} = {values[0]:g}" for name, values in result.study.axes.items() if name not in shown]
    held = f" Held: {', '.join(rest)}." if rest else ""
    shares = [point["probability"] for point in about.summary["points"]]
    over = " and ".join(shown or result.study.axes)
    low, high = number(min(shares)), number(max(shares))
    text = f"Failure probability over {over}: from {low} to {high}. All points are in the table of the outcome."
    metric = headline(result).name
    hatched = " (hatched)" if "certified" in result.with_theorem().dataset else ""
    texts = (result.certificate and f"{result.certificate}{hatched}", idle_text(result))
    captions = (
        f"Failure probability. {''.join(f'{text}. ' for text in texts if text)}{held}".rstrip(),
        f"Median of {metric}: half of the draws are below.{held}",
    )
    pictures = (
        inline(lambda: plotting.probability(result), text, "probability"),
        inline(lambda: plotting.typical(result), f"Median of {metric} over {over}.", "typical"),
    )
    return Section("sweep", "The sweep", h.div(".pair")[map(figure, pictures, captions)])


def metrics(about: Subject) -> Section:
    """Quantiles of every metric."""
    study, close = about.result.study, about.close
    rows = []
    for measure in study.measures:
        quantiles = upper_quantiles(close.dataset[measure.name].values, (0.05, 0.5, 0.95))
        unit = unit_of(close, measure)
        bounding = [requirement for requirement in study.requirements if requirement.measure == measure]
        bounds = [f"{'≤' if r.maximum is not None else '≥'} {r.bound:g}" for r in bounding]
        meaning = close.dataset[measure.name].attrs["long_name"]
        rows.append((h.code[measure.name], meaning, unit, *map(number, quantiles), " ".join(bounds)))
    head = ("metric", "meaning", "unit", "5 %", "median", "95 %", "required")
    name = headline(about.result).name
    text = f"Share of draws at or below each value of {name}; its quantiles are in the table."
    picture = inline(lambda: plotting.distribution(close), text, "distribution")
    caption = f"Distribution of {name} with the interval of each share."
    body = [
        h.p[f"Quantiles over draws{about.where}. A draw that ended early counts as ∞."],
        table("Quantiles of the metrics", head, rows, words=3),
        h.div(".pair")[figure(picture, caption)],
    ]
    return Section("metrics", "What was measured", body)


def unit_of(result: Result, measure: Measure) -> str:
    """A metric's unit as text for a cell."""
    unit = result.dataset[measure.name].attrs["units"]
    return "" if unit == "1" else unit


def causes(about: Subject) -> Section | None:
    """Failures against each uncertain number."""
    close = about.close
    names = by_influence(close, shown_laws(close))[:MOST_FACTORS]
    failures = int(close.failed.sum())
    if not names or not 0 < failures < close.failed.size:
        return None
    pictures = []
    for i, name in enumerate(names):
        text = f"Failure probability against {name}, in bins of equal count, with intervals."
        picture = inline(partial(plotting.factor, close, name), text, f"cause{i}")
        pictures.append(figure(picture, [h.code[name], f": {close.study.quantities[name].meaning}"]))
    left = len(close.study.laws) - len(names)
    more = f" The most influential are shown; {counted(left, 'number')} more are in the dataset." if left > 0 else ""
    note = (
        f"Failure probability{about.where}, in bins of equal count of one uncertain number while all the others vary, "
        f"with {LEVEL} intervals. A slope shows that failures depend on the number.{more}"
    )
    return Section("causes", "What failures depend on", [h.p[note], h.div(".grid")[pictures]])


def worst_draws_section(about: Subject) -> Section | None:
    """The draws with the smallest slacks, over time."""
    if about.worst and isinstance(about.result.study, Described):
        names = ", ".join(about.result.study.code)
        return Section("worst", "The worst draws", h.p[UNSHOWN, h.code[names], "."])
    if not about.trajectories:
        return None
    laws = about.result.study.laws
    body: list[h.Node] = [
        h.p[
            f"The draws with the smallest slack{about.where}, simulated again. ",
            h.code["dssc-jax replay"],
            " simulates any draw again, given its index.",
        ]
    ]
    for rank, run in enumerate(about.trajectories):
        drawn = [(name, with_unit(run.attrs[name], about.result.study.quantities[name].unit)) for name in laws]
        text = run_caption(run)
        picture = inline(partial(untitled, run), text, f"worst{rank}")
        agrees = f"Computed again, it {VERDICTS[run.attrs['agreement']].format(run.attrs['deviation'])}."
        body += [h.h3[f"Draw {run.attrs['draw']}"], figure(picture, f"{text} {agrees}"), facts(drawn)]
    return Section("worst", "The worst draws", body)


def untitled(run: xr.Dataset) -> Figure:
    """A trajectory without its title, which is in the page's text."""
    figure = plotting.trajectory(run)
    figure.suptitle("")
    return figure


def run_caption(run: xr.Dataset) -> str:
    """A sentence on how a draw ended."""
    at = "" if np.isnan(run.attrs["failed_at"]) else f" at {run.attrs['failed_at']:.4g} s"
    return f"Draw {run.attrs['draw']} over time: it {run.attrs['verdict']}{at}."


def chattering_section(about: Subject) -> Section | None:
    """How much the command moves, and whether the sampling is fast enough for the gains."""
    study, close = about.result.study, about.close
    measures = [measure for measure in study.measures if measure.kind in CHATTER]
    if not measures:
        return None
    rows = []
    for measure in measures:
        values = close.dataset[measure.name].values
        middle, high, largest = upper_quantiles(values, (0.5, 0.95, 1.0))
        unit = unit_of(close, measure)
        rows.append((h.code[measure.name], measure.meaning, unit, number(middle), number(high), number(largest)))
    head = ("metric", "meaning", "unit", "median", "95 %", "largest")
    body: list[h.Node] = [
        h.p[
            "A total variation of the command far above its range means that it switches. A sampling ratio above 1 "
            "means that the sampled loop chatters or diverges, since the hold is too slow for the gain.",
            above_one(about),
            off_reference(about),
        ],
        table(f"Chattering{about.where}", head, rows, words=3),
    ]
    if study.axes and any(measure.name == "command_tv" for measure in measures):
        picture = inline(
            lambda: plotting.typical(about.result, metric="command_tv"),
            "Median total variation of the command over the sweep.",
            "chattering",
        )
        body.append(h.div(".pair")[figure(picture, "Median total variation of the robust command.")])
    return Section("chattering", "Chattering", body)


def above_one(about: Subject) -> str:
    """The number of lanes whose sampling ratio exceeds 1 at some time; for a vehicle, in any channel."""
    names = [measure.name for measure in about.result.study.measures if measure.kind == "sampling_ratio"]
    if not names:
        return ""
    ratios = np.max([about.result.dataset[name].values for name in names], axis=0)
    ended, above = int(np.count_nonzero(np.isfinite(ratios))), int(np.count_nonzero(ratios > 1.0))
    return f" Of {ended:,} simulated loops that ran to their end, {above:,} have one at some time."


def off_reference(about: Subject) -> str:
    """The warning that measurement noise moves the loop off its reference, if it is predicted to."""
    study = about.result.study
    text = None if isinstance(study, Described) else noise_warning(study)
    return f" In this study, {text}." if text else ""


def headline_verdict(about: Subject) -> tuple[str, str]:
    """The result in a few characters, and in one sentence."""
    points = about.summary["points"]
    if not about.result.study.axes:
        (point,) = points
        said = f"{point['failures']:,} of {point['draws']:,} draws fail; {LEVEL} interval {interval(point['interval'])}"
        return probability_text(point["probability"], point["interval"]), said
    best, most = (pick(points, key=lambda point: point["probability"]) for pick in (min, max))
    text = " to ".join(probability_text(point["probability"], point["interval"]) for point in (best, most))
    return text, f"from the best to the worst of {counted(len(points), 'point')}, {best['draws']:,} draws each"
