"""Sections on the question: the study, the loop, the laws; and the provenance of the answer."""

from collections.abc import Mapping
from datetime import datetime

import htpy as h
import numpy as np
import tomli_w

from dssc_jax.closed_loop.requirements import Requirement
from dssc_jax.report.diagram import diagram
from dssc_jax.report.elements import Section, count_text, facts, figure, folded, number, scrolled, table, with_unit
from dssc_jax.report.subject import StudySubject, Subject
from dssc_jax.results.manifest import Manifest
from dssc_jax.study import Law, Study
from dssc_jax.study.laws import RangedLaw

BINS = 36  # bins of a density's sketch
BIN_LEVELS = 60
SKETCH = (132, 34)


def question(subject: Subject) -> Section:
    """The study's question, in sentences."""
    study = subject.result.study
    clock = study.config.loop
    swept = [
        f"{name} over {count_text(len(values), 'value')} from {number(min(values))} to "
        f"{with_unit(max(values), study.quantities[name].unit)}"
        for name, values in study.axes.items()
    ]
    body = [
        h.p[
            f"Does the loop meet what is required of it, over {count_text(study.config.draws, 'draw')} of "
            f"{count_text(len(study.written_laws), 'uncertain number')}? Each draw is simulated for "
            f"{clock.duration:g} s, sampled every {1e3 * clock.sample_time:g} ms."
        ],
        h.p["Required of each draw:"],
        h.ul[(h.li[sentence(requirement)] for requirement in study.requirements), h.li["the state stays finite"]],
    ]
    if swept:
        body += [h.p["The same draws are simulated at every point of the sweep:"], h.ul[(h.li[text] for text in swept)]]
    return Section("question", "The question", body)


def sentence(requirement: Requirement) -> h.Node:
    """A requirement in words."""
    if requirement.formula:
        return [f"{requirement.label}: ", h.code[requirement.formula]]
    side = "at most" if requirement.maximum is not None else "at least"
    channel = f" ({requirement.measure.channel_name})" if requirement.measure.channel_name else ""
    bound = with_unit(requirement.bound, requirement.measure.unit)
    return [f"{requirement.measure.meaning}{channel}{requirement.measure.window_text}: {side} ", h.strong[bound]]


def loop(subject: StudySubject) -> Section:
    """The block diagram."""
    study = subject.result.study
    caption = "The loop that is simulated. ~ marks numbers that a law gives, ⇄ numbers that are swept."
    return Section("loop", "The loop", figure(scrolled("Block diagram", diagram(study)), caption))


def laws(subject: StudySubject) -> Section | None:
    """Every uncertain number with its law; of a ranged law, the middle one and the widest 5 to 95 % of its corners."""
    study = subject.result.study
    if not study.written_laws:
        return None
    rows = []
    for name, law in study.written_laws.items():
        members = law.corners if isinstance(law, RangedLaw) else [law]
        low = min(float(member.quantile(np.asarray(0.05))) for member in members)
        high = max(float(member.quantile(np.asarray(0.95))) for member in members)
        quantity = study.quantities[name]
        unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
        label = [h.code[name], h.span(".meaning")[f"{quantity.meaning}{unit}"]]
        density = [
            sketch(law.middle if isinstance(law, RangedLaw) else law),
            law.logarithmic and h.span(".meaning")["logarithmic axis"],
        ]
        rows.append((label, str(law), density, number(law.median), f"{number(low)} to {number(high)}"))
    head = ("number", "law", "density", "median", "5 to 95 %")
    caption = f"Laws of the uncertain numbers, {dependence(study)}"
    return Section("laws", "What is uncertain", table(caption, head, rows, words=3))


def expressions(subject: StudySubject) -> Section | None:
    """Every number that follows from parameters."""
    rows = []
    for name, record in subject.result.study.numbers.items():
        if record.expression is None:
            continue
        quantity = record.quantity
        unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
        low, high = record.expression.support
        ends = f"{number(low)} to {number(high)}" if low < high else "the same in every draw"
        label = [h.code[name], h.span(".meaning")[f"{quantity.meaning}{unit}"]]
        rows.append((label, h.code[record.expression.text], number(record.expression.median), ends))
    if not rows:
        return None
    head = ("number", "expression", "at the medians", "all values")
    caption = "Numbers that follow from the study's parameters. A swept value replaces that of its parameter."
    return Section("expressions", "What follows from parameters", table(caption, head, rows, words=2))


def dependence(study: Study) -> str:
    """Which uncertain numbers depend on each other, as the end of a phrase."""
    pairs = [f"{pair}: {number(rank)}" for pair, rank in study.config.correlation.items()]
    return f"with rank correlations ({'; '.join(pairs)}), otherwise independent" if pairs else "independent"


def sketch(law: Law) -> h.Element:
    """A small plot of a law's density, with a logarithmic axis if the law is logarithmic."""
    values = law.quantile((np.arange(BINS * BIN_LEVELS) + 0.5) / (BINS * BIN_LEVELS))
    low = float(values.min())
    high = float(values.max())
    positions = np.log(values) if law.logarithmic else values
    counts, _ = np.histogram(positions, bins=BINS)
    width, height = SKETCH
    step = width / BINS
    tops = height - 1.0 - (height - 4.0) * counts / counts.max()
    outline = "".join(f"V{top:.1f}h{step:.2f}" for top in tops)
    scale = ", logarithmic axis" if law.logarithmic else ""
    text = f"density of {law} from {number(low)} to {number(high)}{scale}"
    return h.svg(".sketch", role="img", aria_label=text, viewBox=f"0 0 {width} {height}", width=width, height=height)[
        h.title[text], h.path(d=f"M0 {height - 1}{outline}V{height - 1}z")
    ]


def provenance(subject: Subject) -> Section:
    """The provenance of the numbers, and how to reproduce them."""
    manifest = subject.result.manifest
    study = subject.result.study
    device = part(manifest, "device")
    versions = "  ".join(f"{name} {version}" for name, version in part(manifest, "versions").items())
    sizes = [len(values) for values in study.axes.values()]
    pairs: list[tuple[str, h.Node]] = [
        ("study", f"{study.name}, from {manifest.get('source', study.source)}"),
        ("hash of the study", h.code[study.hash]),
        ("seed", f"{study.config.seed}, {study.config.sampling} sampling"),
        ("size", f"{count_text(study.config.draws, 'draw')} at {count_text(int(np.prod(sizes)), 'point')}"),
        ("arithmetic", f"float{study.config.loop.precision}, {study.config.loop.integrator}"),
        ("started", moment(str(manifest.get("started", "")))),
        ("time", duration_text(part(manifest, "times"))),
        ("machine", f"{device.get('count', '?')} of {device.get('kind', '?')} ({device.get('platform', '?')})"),
        ("versions", versions),
    ]
    usage = ["Save it as a file and give it to ", h.code["dssc-jax run"], " or ", h.code["dssc-jax sweep"], "."]
    return Section("provenance", "Provenance", [facts(pairs, "facts wide"), listing(study, usage)])


def listing(study: Study, usage: h.Node) -> h.Element:
    """The study file, and how to use it."""
    text = tomli_w.dumps(without_none(study.table))
    return folded("The study file", [h.p[usage], h.pre(tabindex="0")[h.code[text]]], on_paper=True)


def part(manifest: Manifest, name: str) -> Manifest:
    """A table of the manifest; empty if it is damaged, which affects only the entries shown from it."""
    table = manifest.get(name)
    return table if isinstance(table, dict) else {}


def duration_text(times: Manifest) -> str:
    """Time and throughput of the run."""
    try:
        rate = f", {times['rate'] / 1e6:.0f} million draw samples a second" if times.get("rate") else ""
        return f"{times['seconds']:.1f} s, of which {times['compile_seconds']:.1f} s compiling{rate}"
    except (KeyError, TypeError, ValueError):
        return "not recorded"


def moment(text: str) -> str:
    """A time stamp in readable form."""
    try:
        return f"{datetime.fromisoformat(text):%Y-%m-%d %H:%M UTC}"
    except ValueError:
        return text or "not recorded"


def without_none(table: Mapping[str, object]) -> dict[str, object]:
    """A table without its None values, since TOML has no null; an absent name means the same."""
    return {name: value_without_none(value) for name, value in table.items() if value is not None}


def value_without_none(value: object) -> object:
    """A value of a table; the tables in it have no None values."""
    if isinstance(value, dict):
        return without_none(value)
    if isinstance(value, list | tuple):
        return [value_without_none(element) for element in value]
    return value
