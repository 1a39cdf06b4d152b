"""Sections on a study: its question, its loop, its laws and expressions, and the provenance of a result."""

from collections.abc import Mapping
from datetime import datetime

import htpy as h
import numpy as np
import tomli_w

from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.report.diagram import diagram
from dssc_jax.report.elements import (
    Section,
    collapsible,
    count_text,
    facts,
    figure,
    number,
    number_with_meaning,
    scrollable,
    table,
    with_unit,
)
from dssc_jax.report.subject import AnySubject, Subject
from dssc_jax.results.manifest import Manifest
from dssc_jax.study import Law, Study
from dssc_jax.study.laws import RangedLaw

BINS = 36
"""Number of bins of a plotted density."""
BIN_LEVELS = 60
"""Average number of quantiles in a bin."""
DENSITY_SIZE = (132, 34)
"""Width and height of a plotted density [px]."""


def question(subject: Subject) -> Section:
    """Section with the study's question in sentences: draws, duration, requirements and sweep."""
    study = subject.result.study
    clock = study.config.loop
    axes = []
    for name, values in study.axes.items():
        low = number(min(values))
        high = with_unit(max(values), study.quantities[name].unit)
        axes.append(f"{name} over {count_text(len(values), 'value')} from {low} to {high}")
    body = [
        h.p[
            f"Does the loop meet what is required of it, over {count_text(study.config.draws, 'draw')} of "
            f"{count_text(len(study.written_laws), 'uncertain number')}? Each draw is simulated for "
            f"{clock.duration:g} s, sampled every {1e3 * clock.sample_time:g} ms."
        ],
        h.p["Required of each draw:"],
        h.ul[
            (h.li[requirement_text(requirement)] for requirement in study.requirements), h.li["the state stays finite"]
        ],
    ]
    if axes:
        body += [h.p["The same draws are simulated at every point of the sweep:"], h.ul[(h.li[text] for text in axes)]]
    return Section("question", "The question", body)


def requirement_text(requirement: Requirement) -> h.Node:
    """A requirement in words, or its formula."""
    if requirement.formula:
        return [f"{requirement.label}: ", h.code[requirement.formula]]
    side = "at most" if requirement.maximum is not None else "at least"
    channel = f" ({requirement.measure.channel_name})" if requirement.measure.channel_name else ""
    bound = with_unit(requirement.bound, requirement.measure.unit)
    return [f"{requirement.measure.meaning}{channel}{requirement.measure.window_text}: {side} ", h.strong[bound]]


def loop(subject: AnySubject) -> Section:
    """Section with the block diagram of the loop."""
    study = subject.result.study
    caption = "The loop that is simulated. ~ marks numbers that a law gives, ⇄ numbers that are swept."
    return Section("loop", "The loop", figure(scrollable("Block diagram", diagram(study)), caption))


def laws(subject: AnySubject) -> Section | None:
    """Section with the law of each uncertain number, its density and quantiles; None without laws."""
    study = subject.result.study
    if not study.written_laws:
        return None
    rows = [law_cells(study, name) for name in study.written_laws]
    head = ("number", "law", "density", "median", "5 to 95 %")
    caption = f"Laws of the uncertain numbers, {dependence(study)}"
    return Section("laws", "What is uncertain", table(caption, head, rows, text_columns=3))


def law_cells(study: Study, name: str) -> tuple[h.Node, ...]:
    """Cells of an uncertain number: its label, law, density, median, and 5 % and 95 % quantiles.

    If the arguments of the law are ranges, the density is that of the law in the middle of the ranges. The quantiles
    are then the lowest and the highest over the corners of the ranges.
    """
    law = study.written_laws[name]
    is_ranged = isinstance(law, RangedLaw)
    corners = law.corners if is_ranged else [law]
    low = min(float(corner.quantile(np.asarray(0.05))) for corner in corners)
    high = max(float(corner.quantile(np.asarray(0.95))) for corner in corners)
    quantity = study.quantities[name]
    label = number_with_meaning(h.code[name], quantity.meaning, quantity.unit)
    density = [
        density_plot(law.middle if is_ranged else law),
        law.logarithmic and h.span(".meaning")["logarithmic axis"],
    ]
    return label, str(law), density, number(law.median), f"{number(low)} to {number(high)}"


def expressions(subject: AnySubject) -> Section | None:
    """Section with the numbers that follow from parameters by an expression; None without any."""
    rows = []
    for name, record in subject.result.study.numbers.items():
        if record.expression is None:
            continue
        low, high = record.expression.support
        support = f"{number(low)} to {number(high)}" if low < high else "the same in every draw"
        label = number_with_meaning(h.code[name], record.quantity.meaning, record.quantity.unit)
        rows.append((label, h.code[record.expression.text], number(record.expression.median), support))
    if not rows:
        return None
    head = ("number", "expression", "at the medians", "all values")
    caption = "Numbers that follow from the study's parameters. A swept value replaces that of its parameter."
    return Section("expressions", "What follows from parameters", table(caption, head, rows, text_columns=2))


def dependence(study: Study) -> str:
    """Tell which uncertain numbers are correlated, as the end of a phrase."""
    correlations = [f"{pair}: {number(rank)}" for pair, rank in study.config.correlation.items()]
    if not correlations:
        return "independent"
    return f"with rank correlations ({'; '.join(correlations)}), otherwise independent"


def density_plot(law: Law) -> h.Element:
    """A small plot of a law's density, with a logarithmic axis if the law is logarithmic."""
    levels = (np.arange(BINS * BIN_LEVELS) + 0.5) / (BINS * BIN_LEVELS)
    values = law.quantile(levels)
    low = float(values.min())
    high = float(values.max())
    positions = np.log(values) if law.logarithmic else values
    counts, _ = np.histogram(positions, bins=BINS)
    width, height = DENSITY_SIZE
    step = width / BINS
    tops = height - 1.0 - (height - 4.0) * counts / counts.max()  # y grows downwards
    outline = "".join(f"V{top:.1f}h{step:.2f}" for top in tops)  # of a path: vertically to the top, then one step right
    scale = ", logarithmic axis" if law.logarithmic else ""
    text = f"density of {law} from {number(low)} to {number(high)}{scale}"
    return h.svg(".sketch", role="img", aria_label=text, viewBox=f"0 0 {width} {height}", width=width, height=height)[
        h.title[text], h.path(d=f"M0 {height - 1}{outline}V{height - 1}z")
    ]


def provenance(subject: Subject) -> Section:
    """Section on the provenance of a result, with the study file to reproduce it."""
    manifest = subject.result.manifest
    study = subject.result.study
    device = manifest_table(manifest, "device")
    versions = "  ".join(f"{name} {version}" for name, version in manifest_table(manifest, "versions").items())
    sizes = [len(values) for values in study.axes.values()]
    pairs: list[tuple[str, h.Node]] = [
        ("study", f"{study.name}, from {manifest.get('source', study.source)}"),
        ("hash of the study", h.code[study.hash]),
        ("seed", f"{study.config.seed}, {study.config.sampling} sampling"),
        ("size", f"{count_text(study.config.draws, 'draw')} at {count_text(int(np.prod(sizes)), 'point')}"),
        ("arithmetic", f"float{study.config.loop.precision}, {study.config.loop.integrator}"),
        ("started", time_text(str(manifest.get("started", "")))),
        ("time", duration_text(manifest_table(manifest, "times"))),
        ("machine", f"{device.get('count', '?')} of {device.get('kind', '?')} ({device.get('platform', '?')})"),
        ("versions", versions),
    ]
    usage = ["Save it as a file and give it to ", h.code["dssc-jax run"], " or ", h.code["dssc-jax sweep"], "."]
    return Section("provenance", "Provenance", [facts(pairs, "facts wide"), study_file(study, usage)])


def study_file(study: Study, usage: h.Node) -> h.Element:
    """The study file as collapsible text, with a remark on its usage."""
    text = tomli_w.dumps(without_none(study.table))
    return collapsible("The study file", [h.p[usage], h.pre(tabindex="0")[h.code[text]]], on_paper=True)


def manifest_table(manifest: Manifest, name: str) -> Manifest:
    """A table of the manifest; empty if it is missing or damaged, because a report without it is still of use."""
    table = manifest.get(name)
    return table if isinstance(table, dict) else {}


def duration_text(times: Manifest) -> str:
    """Time and throughput of a run, from the times in its manifest."""
    try:
        rate = f", {times['rate'] / 1e6:.0f} million draw samples a second" if times.get("rate") else ""
        return f"{times['seconds']:.1f} s, of which {times['compile_seconds']:.1f} s compiling{rate}"
    except (KeyError, TypeError, ValueError):
        return "not recorded"


def time_text(text: str) -> str:
    """Format a time stamp in ISO format for people; other text is left as it is."""
    try:
        return f"{datetime.fromisoformat(text):%Y-%m-%d %H:%M UTC}"
    except ValueError:
        return text or "not recorded"


def without_none(table: Mapping[str, object]) -> dict[str, object]:
    """A table without its None values: TOML has no null, and leaving a name out means the same."""
    return {name: value_without_none(value) for name, value in table.items() if value is not None}


def value_without_none(value: object) -> object:
    """A value of a table, without None values in the tables that it contains."""
    if isinstance(value, dict):
        return without_none(value)
    if isinstance(value, list | tuple):
        return [value_without_none(element) for element in value]
    return value
