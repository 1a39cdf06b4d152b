"""Sections on the answer: outcome, sweep, metrics, causes, worst draws, chattering."""

from functools import partial

import htpy as h
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.closed_loop.metrics import Measure
from dssc_jax.design import noise_warning
from dssc_jax.engine.reference import VERDICTS
from dssc_jax.plotting.draws import drawable_laws
from dssc_jax.report.elements import (
    LEVEL,
    Section,
    count_text,
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
from dssc_jax.results.summary import SummaryRow, extreme_points, most_violated, values_missing
from dssc_jax.statistics.order import upper_quantiles
from dssc_jax.study import Described, Study

MOST_ROWS = 400
MOST_FACTORS = 24
CERTIFIED_TEXT = {None: "-", True: "yes", False: "no"}
UNSHOWN = "They are not simulated again here, which would run code that is not part of dssc_jax: "
CHATTER = ("command_tv", "sampling_ratio", "sampling_ratio_above_1", "outside_sliding")


def outcome(subject: Subject) -> Section:
    """How the draws ended, with intervals; for a sweep, its points, and how the draws ended at one of them."""
    if subject.result.study.axes:
        return Section("outcome", "The outcome", [*points_section(subject), *ways(subject), integration(subject)])
    certificate = subject.result.certificate and h.p[h.strong[subject.result.certificate], "."]
    body = [*ways(subject), stated_errors(subject), certificate, integration(subject)]
    return Section("outcome", "The outcome", body)


def stated_errors(subject: Subject) -> h.Node:
    """Intervals of the failure probability if the laws are wrong by stated amounts; none if none were stated."""
    amounts = subject.result.stated
    if not amounts:
        return None
    rows = []
    for error in subject.result.stated_errors(amounts):
        always = interval(error.interval) if error.interval else "none, the laws are correlated"
        weighted = interval(error.weighted_interval) if error.weighted_interval else error.weights_refused
        rows.append((error.text, always, weighted))
    head = ("laws wrong by", "whatever draws fail", "by the draws' weights")
    return table(f"The failure probability if the laws are wrong, {LEVEL} intervals", head, rows)


def integration(subject: Subject) -> h.Node:
    """The error of integration between the samples; none if it was not checked."""
    text = subject.result.integration
    return text and h.p[f"Integration: {text}."]


def ways(subject: Subject) -> list[h.Node]:
    """All outcomes of the draws, each requirement separately, and which requirements are violated together."""
    result = subject.point_result
    point = subject.point_summary
    ended = result.dataset["outcome"].values
    method = result.method
    draws = point["draws"]
    rows: list[tuple[h.Node, ...]] = []
    for code, words in ENDINGS.items():
        if code in outcome_codes(result.study):
            bounds = method.interval(ended == code).tolist()
            n = int(np.count_nonzero(ended == code))
            rows.append((words, f"{n:,}", probability_text(n / draws, bounds), interval(bounds), "", "", ""))
    for rule, requirement in zip(result.study.requirements, point["requirements"], strict=True):
        time = requirement["violated_at"]
        timing = f"{requirement['first']:,}", "" if time is None else f"{time:.4g}"
        rows.append((f"violates {rule.short}", *fails(requirement), f"{requirement['alone']:,}", *timing))
    rows.append((h.strong["fails in any way"], *fails(point), "", "", ""))
    head = (
        "how a draw ended",
        "draws",
        "probability",
        f"{LEVEL} interval",
        "this alone",
        "this first",
        "median time of the violation [s]",
    )
    note = (
        "A draw counts for every requirement that it violates, and one that ended early for all of them "
        f"({count_text(point['ended_early'], 'draw')} here). Intervals: {method.name}, each at {LEVEL} on its own. "
        f"Where none of the {draws:,} draws ended in a given way, the table shows the upper bound of its probability."
    )
    return [
        table(f"Outcomes of {count_text(draws, 'draw')}{subject.point_phrase}", head, rows),
        h.p[note],
        *(h.p[f"{text}."] for text in values_missing(point)),
        *together(point, result.study),
    ]


def together(point: SummaryRow, study: Study) -> list[h.Node]:
    """Pairs of requirements that the same draws violate, if there are at least two requirements."""
    if len(point["requirements"]) < 2:
        return []
    pairs = [pair for pair in point["overlaps"] if pair["draws"]]
    if not pairs:
        return [h.p["No draw that ran to its end violates two requirements."]]
    text = {requirement.label: requirement.short for requirement in study.requirements}
    rows = []
    for pair in pairs:
        first, second = pair["names"]
        rows.append((text[first], text[second], f"{pair['draws']:,}"))
    caption = "Requirements that the same draws violate, without draws that ended early"
    return [table(caption, ("requirement", "and requirement", "draws"), rows, words=2)]


def fails(point: SummaryRow) -> tuple[str, str, str]:
    """Failures at a point, or of one requirement there, with their probability and its interval."""
    bounds = point["interval"]
    return f"{point['failures']:,}", probability_text(point["probability"], bounds), interval(bounds)


def points_section(subject: Subject) -> list[h.Node]:
    """Points of a sweep: the best, the worst, the one shown in detail; and a collapsed table of all."""
    study = subject.result.study
    points = subject.summary["points"]
    swept = []
    for name in study.axes:
        unit = study.quantities[name].unit
        swept.append(name if unit == "1" else f"{name} [{unit}]")
    middle = f"median {headline(subject.result).name}"
    violated = ["most violated"] if len(study.requirements) > 1 else []
    head = (*swept, "failures", "probability", f"{LEVEL} interval", *violated, middle, "certified")
    best, worst = extreme_points(points)
    three_points = {"least failures": best, "nearest to half": subject.point_summary, "most failures": worst}
    three_rows = [(name, *point_cells(subject, point)) for name, point in three_points.items()]
    rows = [point_cells(subject, point) for point in points[:MOST_ROWS]]
    caption = f"{count_text(study.config.draws, 'draw')} at each point"
    if len(points) > MOST_ROWS:
        caption += f"; the first {MOST_ROWS} of {len(points):,}, all are in summary.json"
    note = (
        f"Intervals: {subject.result.method.name}, each at {LEVEL} on its own; the draws of all points are the same, "
        "so that differences between points are sharper than the intervals suggest."
    )
    return [
        table("Three points of the sweep", ("point", *head), three_rows),
        h.p[note],
        folded(f"All {count_text(len(points), 'point')}", table(caption, head, rows)),
    ]


def point_cells(subject: Subject, point: SummaryRow) -> tuple[h.Node, ...]:
    """A row for a sweep point: its values, failures with interval, the main failure, the median, the certificate."""
    values = (number(point[name]) for name in subject.result.study.axes)
    middle = point["metrics"][headline(subject.result).name]["q50"]
    main_failure = [most_violated(point)] if len(point["requirements"]) > 1 else []
    return *values, *fails(point), *main_failure, number(middle), CERTIFIED_TEXT[point["certified"]]


def sweep_section(subject: Subject) -> Section | None:
    """Failure probability and the headline metric over the sweep."""
    result = subject.result
    if not result.study.axes:
        return None
    plotted_axes = [name for name, values in result.study.axes.items() if len(values) > 1][:2]
    held_values = [f"{name} = {values[0]:g}" for name, values in result.study.axes.items() if name not in plotted_axes]
    held_text = f" Held: {', '.join(held_values)}." if held_values else ""
    shares = [point["probability"] for point in subject.summary["points"]]
    over = " and ".join(plotted_axes or result.study.axes)
    span = f"from {number(min(shares))} to {number(max(shares))}"
    text = f"Failure probability over {over}: {span}. All points are in the table of the outcome."
    metric = headline(result).name
    hatched = " (hatched)" if "certified" in result.with_theorem().dataset else ""
    sentences = ""
    if result.certificate:
        sentences += f"{result.certificate}{hatched}. "
    idle = idle_text(result)
    if idle:
        sentences += f"{idle}. "
    captions = (
        f"Failure probability. {sentences}{held_text}".rstrip(),
        f"Median of {metric}: half of the draws are below.{held_text}",
    )
    pictures = (
        inline(lambda: plotting.probability(result), text, "probability"),
        inline(lambda: plotting.typical(result), f"Median of {metric} over {over}.", "typical"),
    )
    return Section("sweep", "The sweep", h.div(".pair")[map(figure, pictures, captions)])


def metrics(subject: Subject) -> Section:
    """Quantiles of every metric."""
    study = subject.result.study
    result = subject.point_result
    rows = []
    for measure in study.measures:
        quantiles = upper_quantiles(result.dataset[measure.name].values, (0.05, 0.5, 0.95), measure.metric.worst)
        unit = unit_of(result, measure)
        bounds_of_metric = [requirement for requirement in study.requirements if requirement.measure == measure]
        bounds = [f"{'≤' if r.maximum is not None else '≥'} {r.bound:g}" for r in bounds_of_metric]
        meaning = result.dataset[measure.name].attrs["long_name"]
        rows.append((h.code[measure.name], meaning, unit, *map(number, quantiles), " ".join(bounds)))
    head = ("metric", "meaning", "unit", "5 %", "median", "95 %", "required")
    name = headline(subject.result).name
    text = f"Share of draws at or below each value of {name}; its quantiles are in the table."
    picture = inline(lambda: plotting.distribution(result), text, "distribution")
    caption = f"Distribution of {name} with the interval of each share."
    body = [
        h.p[f"Quantiles over draws{subject.point_phrase}. A draw that ended early counts as ∞."],
        table("Quantiles of the metrics", head, rows, words=3),
        h.div(".pair")[figure(picture, caption)],
    ]
    return Section("metrics", "What was measured", body)


def unit_of(result: Result, measure: Measure) -> str:
    """A metric's unit as text for a cell."""
    unit = result.dataset[measure.name].attrs["units"]
    return "" if unit == "1" else unit


def causes(subject: Subject) -> Section | None:
    """Failures against each uncertain number."""
    result = subject.point_result
    names = by_influence(result, drawable_laws(result))[:MOST_FACTORS]
    failures = int(result.failed.sum())
    if not names or not 0 < failures < result.failed.size:
        return None
    pictures = []
    for i, name in enumerate(names):
        text = f"Failure probability against {name}, in bins of equal count, with intervals."
        picture = inline(partial(plotting.factor, result, name), text, f"cause{i}")
        pictures.append(figure(picture, [h.code[name], f": {result.study.quantities[name].meaning}"]))
    hidden_count = len(result.study.laws) - len(names)
    hidden = ""
    if hidden_count > 0:
        hidden = f" The most influential are shown; {count_text(hidden_count, 'number')} more are in the dataset."
    note = (
        f"Failure probability{subject.point_phrase}, in bins of equal count of one uncertain number while all the "
        f"others vary, with {LEVEL} intervals. A slope shows that failures depend on the number.{hidden}"
    )
    return Section("causes", "What failures depend on", [h.p[note], h.div(".grid")[pictures]])


def worst_draws_section(subject: Subject) -> Section | None:
    """The draws with the smallest slacks, over time."""
    if subject.worst and isinstance(subject.result.study, Described):
        names = ", ".join(subject.result.study.code)
        return Section("worst", "The worst draws", h.p[UNSHOWN, h.code[names], "."])
    if not subject.trajectories:
        return None
    laws = subject.result.study.laws
    body: list[h.Node] = [
        h.p[
            f"The draws with the smallest slack{subject.point_phrase}, simulated again. ",
            h.code["dssc-jax replay"],
            " simulates any draw again, given its index.",
        ]
    ]
    for rank, run in enumerate(subject.trajectories):
        number_facts = [(name, with_unit(run.attrs[name], subject.result.study.quantities[name].unit)) for name in laws]
        text = run_caption(run)
        picture = inline(partial(untitled, run), text, f"worst{rank}")
        agrees = f"Computed again, it {VERDICTS[run.attrs['agreement']].format(run.attrs['deviation'])}."
        body += [h.h3[f"Draw {run.attrs['draw']}"], figure(picture, f"{text} {agrees}"), facts(number_facts)]
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


def chattering_section(subject: Subject) -> Section | None:
    """How much the command moves, and whether sampling is fast enough for the gains; None if no metric tells."""
    study = subject.result.study
    result = subject.point_result
    measures = [measure for measure in study.measures if measure.kind in CHATTER]
    if not measures:
        return None
    rows = []
    for measure in measures:
        values = result.dataset[measure.name].values
        middle, high, largest = upper_quantiles(values, (0.5, 0.95, 1.0))
        unit = unit_of(result, measure)
        rows.append((h.code[measure.name], measure.meaning, unit, number(middle), number(high), number(largest)))
    head = ("metric", "meaning", "unit", "median", "95 %", "largest")
    body: list[h.Node] = [
        h.p[
            "A total variation of the command far above its range means that it switches. A sampling ratio above 1 "
            "means that the sampled loop chatters or diverges, since the hold is too slow for the gain.",
            sampling_ratio_sentence(subject),
            off_reference_sentence(subject),
        ],
        table(f"Chattering{subject.point_phrase}", head, rows, words=3),
    ]
    if study.axes and any(measure.name == "command_tv" for measure in measures):
        picture = inline(
            lambda: plotting.typical(subject.result, metric="command_tv"),
            "Median total variation of the command over the sweep.",
            "chattering",
        )
        body.append(h.div(".pair")[figure(picture, "Median total variation of the robust command.")])
    return Section("chattering", "Chattering", body)


def sampling_ratio_sentence(subject: Subject) -> str:
    """How many lanes have a sampling ratio above 1 at some time and in any channel; empty without that metric."""
    names = [measure.name for measure in subject.result.study.measures if measure.kind == "sampling_ratio"]
    if not names:
        return ""
    ratios = np.max([subject.result.dataset[name].values for name in names], axis=0)
    ended = np.count_nonzero(np.isfinite(ratios))
    exceeding_count = np.count_nonzero(ratios > 1.0)
    return f" Of {ended:,} simulated loops that ran to their end, {exceeding_count:,} have one at some time."


def off_reference_sentence(subject: Subject) -> str:
    """The warning that measurement noise moves the loop off its reference; empty unless that is predicted."""
    study = subject.result.study
    text = None if isinstance(study, Described) else noise_warning(study)
    return f" In this study, {text}." if text else ""


def headline_verdict(subject: Subject) -> tuple[str, str]:
    """The result in a few characters, and in one sentence."""
    points = subject.summary["points"]
    if not subject.result.study.axes:
        (point,) = points
        text = f"{point['failures']:,} of {point['draws']:,} draws fail; {LEVEL} interval {interval(point['interval'])}"
        return probability_text(point["probability"], point["interval"]), text
    best, worst = extreme_points(points)
    text = " to ".join(probability_text(point["probability"], point["interval"]) for point in (best, worst))
    return text, f"from the best to the worst of {count_text(len(points), 'point')}, {best['draws']:,} draws each"
