"""Sections on a result: outcome, sweep, metrics, causes, worst draws, chattering."""

from functools import partial

import htpy as h
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.design import noise_warning
from dssc_jax.engine.reference import VERDICTS
from dssc_jax.plotting.draws import drawable_laws
from dssc_jax.report.elements import (
    LEVEL,
    Section,
    collapsible,
    count_text,
    facts,
    figure,
    interval,
    number,
    probability_text,
    table,
    with_unit,
)
from dssc_jax.report.subject import Subject
from dssc_jax.report.vector import inline_svg
from dssc_jax.results.influence import idle_text, sorted_by_influence
from dssc_jax.results.missing import quantile_value, without_value_texts
from dssc_jax.results.result import Result, headline_measure
from dssc_jax.results.schema import ENDINGS, name_with_unit, outcome_codes
from dssc_jax.results.summary import SummaryRow, extreme_points, missing_value_texts, most_violated
from dssc_jax.statistics.order import upper_quantiles
from dssc_jax.study import Described, Study

MOST_ROWS = 400  # points of a sweep in a table
MOST_FACTORS = 24  # uncertain numbers with a figure
CERTIFIED_TEXT = {None: "-", True: "yes", False: "no"}
"""Text of a certificate; None: Theorem 1 does not cover the point."""
FOREIGN_CODE = "They are not simulated again here, which would run code that is not part of dssc_jax: "
CHATTERING_METRICS = ("command_tv", "sampling_ratio", "sampling_ratio_above_1", "outside_sliding")
"""Kinds of metrics of the section on chattering."""


def outcome(subject: Subject) -> Section:
    """Make the section on how the draws ended, with intervals.

    For a sweep, the section has tables of its points, and of the draws of the one point that is shown in detail.
    """
    if subject.result.study.axes:
        body = [*point_tables(subject), *outcome_tables(subject), integration(subject)]
        return Section("outcome", "The outcome", body)
    certificate = subject.result.certificate and h.p[h.strong[subject.result.certificate], "."]
    body = [*outcome_tables(subject), stated_errors(subject), certificate, integration(subject)]
    return Section("outcome", "The outcome", body)


def stated_errors(subject: Subject) -> h.Node:
    """Table of the failure probability under laws that are wrong by stated amounts; None if no amounts were stated."""
    amounts = subject.result.stated
    if not amounts:
        return None
    rows = []
    for error in subject.result.stated_errors(amounts):
        guaranteed = interval(error.interval) if error.interval else "none, the laws are correlated"
        weighted = interval(error.weighted_interval) if error.weighted_interval else error.weights_refused
        rows.append((error.text, guaranteed, weighted))
    head = ("laws wrong by", "whatever draws fail", "by the draws' weights")
    return table(f"The failure probability if the laws are wrong, {LEVEL} intervals", head, rows)


def integration(subject: Subject) -> h.Node:
    """Paragraph on the error of integration between the samples; empty if it was not checked."""
    text = subject.result.integration
    return text and h.p[f"Integration: {text}."]


def outcome_tables(subject: Subject) -> list[h.Node]:
    """Table of the outcomes and of violations of each requirement, a note, and the table of joint violations."""
    method = subject.point_result.method
    point = subject.point_summary
    draws = point["draws"]
    rows = [*ending_rows(subject), *violation_rows(subject)]
    rows.append((h.strong["fails in any way"], *failure_cells(point), "", "", ""))
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
        *(h.p[f"{text}."] for text in missing_value_texts(point)),
        *joint_violations(point, subject.point_result.study),
    ]


def ending_rows(subject: Subject) -> list[tuple[h.Node, ...]]:
    """Rows of the table of outcomes: how many draws ended in each way, without cells for requirements."""
    result = subject.point_result
    outcomes = result.dataset["outcome"].values
    rows: list[tuple[h.Node, ...]] = []
    for code, text in ENDINGS.items():
        if code in outcome_codes(result.study):
            bounds = result.method.interval(outcomes == code).tolist()
            count = int(np.count_nonzero(outcomes == code))
            probability = probability_text(count / subject.point_summary["draws"], bounds)
            rows.append((text, f"{count:,}", probability, interval(bounds), "", "", ""))
    return rows


def violation_rows(subject: Subject) -> list[tuple[h.Node, ...]]:
    """Rows of the table of outcomes: how many draws violate each requirement, this one alone, and this one first.

    The last cell is the median time of violation [s].
    """
    rows: list[tuple[h.Node, ...]] = []
    pairs = zip(subject.point_result.study.requirements, subject.point_summary["requirements"], strict=True)
    for requirement, failures in pairs:
        time = failures["violated_at"]
        median_time = "" if time is None else f"{time:.4g}"
        counts = f"{failures['alone']:,}", f"{failures['first']:,}"
        rows.append((f"violates {requirement.short_text}", *failure_cells(failures), *counts, median_time))
    return rows


def joint_violations(point: SummaryRow, study: Study) -> list[h.Node]:
    """Table of the pairs of requirements that the same draws violate.

    If no draw violates two requirements, a remark says so. With a single requirement, there is nothing.
    """
    if len(point["requirements"]) < 2:
        return []
    pairs = [pair for pair in point["overlaps"] if pair["draws"]]
    if not pairs:
        return [h.p["No draw that ran to its end violates two requirements."]]
    texts = {requirement.label: requirement.short_text for requirement in study.requirements}
    rows = []
    for pair in pairs:
        first, second = pair["names"]
        rows.append((texts[first], texts[second], f"{pair['draws']:,}"))
    caption = "Requirements that the same draws violate, without draws that ended early"
    return [table(caption, ("requirement", "and requirement", "draws"), rows, text_columns=2)]


def failure_cells(row: SummaryRow) -> tuple[str, str, str]:
    """Cells with number, probability and interval of the failures at a point, or of one requirement's violations."""
    bounds = row["interval"]
    return f"{row['failures']:,}", probability_text(row["probability"], bounds), interval(bounds)


def point_tables(subject: Subject) -> list[h.Node]:
    """Make a table of three points of a sweep, and a collapsible table of all points.

    The three points are the best one, the worst one, and the one that is shown in detail.
    """
    study = subject.result.study
    points = subject.summary["points"]
    axes = [name_with_unit(name, study.quantities[name].unit) for name in study.axes]
    median = f"median {headline_measure(subject.result.study).name}"
    violated = ["most violated"] if len(study.requirements) > 1 else []
    head = (*axes, "failures", "probability", f"{LEVEL} interval", *violated, median, "certified")
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
        collapsible(f"All {count_text(len(points), 'point')}", table(caption, head, rows)),
    ]


def point_cells(subject: Subject, point: SummaryRow) -> tuple[h.Node, ...]:
    """Cells of a point of a sweep: its values, failures, most violated requirement, median, and verdict of Theorem 1.

    The median is that of the headline metric. With a single requirement, the cell of the most violated one is left out.
    """
    values = (number(point[name]) for name in subject.result.study.axes)
    measure = headline_measure(subject.result.study)
    median = quantile_value(point["metrics"][measure.name], "q50", measure.metric.worst)
    main_failure = [most_violated(point)] if len(point["requirements"]) > 1 else []
    return *values, *failure_cells(point), *main_failure, number(median), CERTIFIED_TEXT[point["certified"]]


def sweep_section(subject: Subject) -> Section | None:
    """Section with the failure probability and the headline metric over the sweep; None for a run."""
    result = subject.result
    if not result.study.axes:
        return None
    plotted_axes = [name for name, values in result.study.axes.items() if len(values) > 1][:2]
    fixed_values = [f"{name} = {values[0]:g}" for name, values in result.study.axes.items() if name not in plotted_axes]
    fixed_text = f" Held: {', '.join(fixed_values)}." if fixed_values else ""
    shares = [point["probability"] for point in subject.summary["points"]]
    over = " and ".join(plotted_axes or result.study.axes)
    span = f"from {number(min(shares))} to {number(max(shares))}"
    text = f"Failure probability over {over}: {span}. All points are in the table of the outcome."
    metric = headline_measure(result.study).name
    hatched = " (hatched)" if "certified" in result.with_theorem().dataset else ""
    sentences = ""
    if result.certificate:
        sentences += f"{result.certificate}{hatched}. "
    idle = idle_text(result)
    if idle:
        sentences += f"{idle}. "
    captions = (
        f"Failure probability. {sentences}{fixed_text}".rstrip(),
        f"Median of {metric}: half of the draws are below.{fixed_text}",
    )
    pictures = (
        inline_svg(lambda: plotting.probability(result), text, "probability"),
        inline_svg(lambda: plotting.typical(result), f"Median of {metric} over {over}.", "typical"),
    )
    return Section("sweep", "The sweep", h.div(".pair")[map(figure, pictures, captions)])


def metrics(subject: Subject) -> Section:
    """Section with the quantiles of all metrics, and the distribution of the headline metric."""
    study = subject.result.study
    result = subject.point_result
    rows = []
    for measure in study.measures:
        quantiles = upper_quantiles(result.dataset[measure.name].values, (0.05, 0.5, 0.95), measure.metric.worst)
        unit = unit_of(result, measure)
        bounds = []
        for requirement in study.requirements:
            if requirement.measure == measure:
                bounds.append(f"{'≤' if requirement.maximum is not None else '≥'} {requirement.bound:g}")
        meaning = result.dataset[measure.name].attrs["long_name"]
        rows.append((h.code[measure.name], meaning, unit, *map(number, quantiles), " ".join(bounds)))
    head = ("metric", "meaning", "unit", "5 %", "median", "95 %", "required")
    name = headline_measure(subject.result.study).name
    text = f"Share of draws at or below each value of {name}; its quantiles are in the table."
    picture = inline_svg(lambda: plotting.distribution(result), text, "distribution")
    caption = f"Distribution of {name} with the interval of each share."
    without_value = without_value_texts(study, subject.point_summary, number)
    body = [
        h.p[" ".join([f"Quantiles over draws{subject.point_phrase}.", *(f"{text}." for text in without_value)])],
        table("Quantiles of the metrics", head, rows, text_columns=3),
        h.div(".pair")[figure(picture, caption)],
    ]
    return Section("metrics", "What was measured", body)


def unit_of(result: Result, measure: Measure) -> str:
    """The unit of a metric; empty if it is 1."""
    unit = result.dataset[measure.name].attrs["units"]
    return "" if unit == "1" else unit


def causes(subject: Subject) -> Section | None:
    """Section with the failure probability against each uncertain number; None if no draw fails, or all do."""
    result = subject.point_result
    names = sorted_by_influence(result, drawable_laws(result))[:MOST_FACTORS]
    failures = int(result.failed.sum())
    if not names or not 0 < failures < result.failed.size:
        return None
    pictures = []
    for index, name in enumerate(names):
        text = f"Failure probability against {name}, in bins of draws, with intervals."
        picture = inline_svg(partial(plotting.factor, result, name), text, f"cause{index}")
        pictures.append(figure(picture, [h.code[name], f": {result.study.quantities[name].meaning}"]))
    omitted_count = len(result.study.laws) - len(names)
    remark = ""
    if omitted_count > 0:
        remark = f" The most influential are shown; {count_text(omitted_count, 'number')} more are in the dataset."
    note = (
        f"Failure probability{subject.point_phrase}, in bins of equal count of one uncertain number, or at each of its "
        f"values if these are few, while all the others vary, with {LEVEL} intervals. A slope shows that failures "
        f"depend on the number.{remark}"
    )
    return Section("causes", "What failures depend on", [h.p[note], h.div(".grid")[pictures]])


def worst_draws_section(subject: Subject) -> Section | None:
    """Section with the draws of the smallest slacks over time; None if no draws are to be simulated again."""
    if subject.worst and isinstance(subject.result.study, Described):
        names = ", ".join(subject.result.study.code)
        return Section("worst", "The worst draws", h.p[FOREIGN_CODE, h.code[names], "."])
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
        picture = inline_svg(partial(trajectory_without_title, run), text, f"worst{rank}")
        agreement = f"Computed again, it {VERDICTS[run.attrs['agreement']].format(run.attrs['deviation'])}."
        body += [h.h3[f"Draw {run.attrs['draw']}"], figure(picture, f"{text} {agreement}"), facts(number_facts)]
    return Section("worst", "The worst draws", body)


def trajectory_without_title(run: xr.Dataset) -> Figure:
    """Plot a trajectory without a title, because the caption in the report says the same."""
    figure = plotting.trajectory(run)
    figure.suptitle("")
    return figure


def run_caption(run: xr.Dataset) -> str:
    """A sentence on how a draw ended."""
    time = "" if np.isnan(run.attrs["failed_at"]) else f" at {run.attrs['failed_at']:.4g} s"
    return f"Draw {run.attrs['draw']} over time: it {run.attrs['verdict']}{time}."


def chattering_section(subject: Subject) -> Section | None:
    """Section on the variation of the command and on the sampling ratio; None if the study measures neither."""
    study = subject.result.study
    result = subject.point_result
    measures = [measure for measure in study.measures if measure.kind in CHATTERING_METRICS]
    if not measures:
        return None
    rows = []
    for measure in measures:
        values = result.dataset[measure.name].values
        quantiles = upper_quantiles(values, (0.5, 0.95, 1.0))
        rows.append((h.code[measure.name], measure.meaning, unit_of(result, measure), *map(number, quantiles)))
    head = ("metric", "meaning", "unit", "median", "95 %", "largest")
    body: list[h.Node] = [
        h.p[
            "A total variation of the command far above its range means that it switches. A sampling ratio above 1 "
            "means that the sampled loop chatters or diverges, since the hold is too slow for the gain.",
            sampling_ratio_sentence(subject),
            off_reference_sentence(subject),
        ],
        table(f"Chattering{subject.point_phrase}", head, rows, text_columns=3),
    ]
    if study.axes and any(measure.name == "command_tv" for measure in measures):
        picture = inline_svg(
            lambda: plotting.typical(subject.result, metric="command_tv"),
            "Median total variation of the command over the sweep.",
            "chattering",
        )
        body.append(h.div(".pair")[figure(picture, "Median total variation of the robust command.")])
    return Section("chattering", "Chattering", body)


def sampling_ratio_sentence(subject: Subject) -> str:
    """Tell how many lanes have a sampling ratio above 1 at some time in any channel; empty without that metric."""
    names = [measure.name for measure in subject.result.study.measures if measure.kind == "sampling_ratio"]
    if not names:
        return ""
    ratios = np.max([subject.result.dataset[name].values for name in names], axis=0)
    complete_count = np.count_nonzero(np.isfinite(ratios))
    exceeding_count = np.count_nonzero(ratios > 1.0)
    return f" Of {complete_count:,} simulated loops that ran to their end, {exceeding_count:,} have one at some time."


def off_reference_sentence(subject: Subject) -> str:
    """Warn that measurement noise moves the loop off its reference; empty unless that is predicted."""
    study = subject.result.study
    text = None if isinstance(study, Described) else noise_warning(study)
    return f" In this study, {text}." if text else ""


def headline_verdict(subject: Subject) -> tuple[str, str]:
    """The failure probability in a few characters, and the counts and the interval behind it in one sentence."""
    points = subject.summary["points"]
    if not subject.result.study.axes:
        point = points[0]  # a run has one
        text = f"{point['failures']:,} of {point['draws']:,} draws fail; {LEVEL} interval {interval(point['interval'])}"
        return probability_text(point["probability"], point["interval"]), text
    best, worst = extreme_points(points)
    text = " to ".join(probability_text(point["probability"], point["interval"]) for point in (best, worst))
    return text, f"from the best to the worst of {count_text(len(points), 'point')}, {best['draws']:,} draws each"
