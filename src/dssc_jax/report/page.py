"""The page: its sections in order, and the file it is written to."""

import hashlib
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import htpy as h
from markupsafe import Markup

from dssc_jax.analyses.defaults import WORST_DRAWS
from dssc_jax.core import files
from dssc_jax.report import analysis_sections, proof_section, result_sections, study_sections
from dssc_jax.report.elements import Section, facts
from dssc_jax.report.subject import AnalysisSubject, Subject
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import Result
from dssc_jax.study import Study, hash_of

REPORT = "report.html"
STYLE_SHEET = Path(__file__).with_name("style.css")
NOTHING_OUTSIDE = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
SECTIONS: tuple[Callable[[Subject], Section | None], ...] = (
    study_sections.question,
    study_sections.loop,
    study_sections.laws,
    study_sections.expressions,
    result_sections.outcome,
    result_sections.sweep_section,
    proof_section.proofs,
    result_sections.metrics,
    result_sections.causes,
    result_sections.worst_draws_section,
    result_sections.chattering_section,
    study_sections.provenance,
)
"""The sections as functions of the subject, which return None if they have no content."""


ANALYSIS_SECTIONS: tuple[Callable[[AnalysisSubject], Section | None], ...] = (
    analysis_sections.answer,
    analysis_sections.numbers,
    study_sections.loop,
    study_sections.laws,
    study_sections.expressions,
    analysis_sections.dataset,
    analysis_sections.analysis_provenance,
)
"""The sections of an analysis."""


def html(result: Result | Analysis, worst: int = WORST_DRAWS) -> str:
    """The report of a result, or of an analysis.

    Args:
        result: A loaded or new one.
        worst: Number of a result's worst draws that are simulated again and shown; 0 needs no simulator.
    """
    if isinstance(result, Analysis):
        return html_of_analysis(result)
    subject = Subject(result, worst)
    short, long = result_sections.headline_verdict(subject)
    verdict = facts([("failure probability", [h.strong[short], h.span[long]])], "verdict")
    sections = [make(subject) for make in SECTIONS]
    return report(result.study, "Robustness report", verdict, sections)


def html_of_analysis(analysis: Analysis) -> str:
    """The report of an analysis."""
    subject = AnalysisSubject(analysis)
    sections = [make(subject) for make in ANALYSIS_SECTIONS]
    return report(analysis.study, analysis.title, h.p(".lead")[analysis.headline], sections)


def report(study: Study, kind: str, verdict: h.Node, sections: Sequence[Section | None]) -> str:
    """A report as one HTML page.

    Args:
        study: The study that it is on.
        kind: Kind of the report, which stands above the study's name.
        verdict: What it finds, below the name.
        sections: Its sections in order; those that are None are omitted.
    """
    present_sections = [section for section in sections if section is not None]
    head = [
        h.p(".kind")[kind],
        h.h1[study.name],
        study.config.description and h.p(".lead")[study.config.description],
        verdict,
    ]
    body = []
    contents = []
    for section in present_sections:
        heading = h.h2(id=section.key)[section.heading]
        body.append(h.section(aria_labelledby=section.key)[heading, section.body])
        contents.append((section.key, section.heading))
    return page(f"{study.name}: {kind.lower()}", head, body, contents)


def page(title: str, head: h.Node, body: h.Node, contents: list[tuple[str, str]]) -> str:
    """A self-contained page: the style is included, and nothing is loaded from elsewhere."""
    links = h.ul[(h.li[h.a(href=f"#{key}")[text]] for key, text in contents)]
    credit = f"Made by dssc_jax {version('dssc_jax')} on {datetime.now(UTC):%Y-%m-%d %H:%M} UTC."
    return str(
        h.html(lang="en")[
            h.head[
                h.meta(charset="utf-8"),
                h.meta(http_equiv="Content-Security-Policy", content=NOTHING_OUTSIDE),
                h.meta(name="viewport", content="width=device-width, initial-scale=1"),
                h.meta(name="color-scheme", content="light dark"),
                h.title[title],
                h.style[Markup(files.read_text(STYLE_SHEET))],
            ],
            h.body[
                h.a(".skip", href="#main")["Skip to the content"],
                h.header[head],
                contents and h.nav(aria_label="Contents")[links],
                h.main("#main")[body],
                h.footer[h.p[credit]],
            ],
        ]
    )


def write(result: Result | Analysis, path: str | Path, worst: int = WORST_DRAWS) -> Path:
    """Write the report of a result, or of an analysis.

    Args:
        result: A loaded or new one.
        path: The file.
        worst: See :func:`html`.
    """
    target = Path(path)
    write_page(html(result, worst), target, result)
    return target


def write_page(text: str, path: Path, result: Result | Analysis | None = None) -> None:
    """Write a page; invalid characters (lone surrogates of damaged names) are replaced.

    Args:
        text: The page.
        path: The file.
        result: The result or analysis that the page shows. The last line names it, with a digest of the page; None: the
            page has no such line.
    """
    content = text.encode("utf-8", "replace")
    if result is not None:
        content += mark_of(content, result)
    files.write_bytes(path, content)


def mark_of(content: bytes, result: Result | Analysis) -> bytes:
    """The last line of a page: the digest of the page, which a truncated page lacks, and that of its result."""
    digest = hashlib.sha256(content).hexdigest()
    return f"\n<!-- dssc_jax: page {digest} of result {identity_of(result)} -->\n".encode()


def identity_of(result: Result | Analysis) -> str:
    """A digest of what a report shows."""
    if isinstance(result, Analysis):
        return hash_of({"kind": result.kind, "study": result.study.hash, "summary": result.summary()})
    return hash_of({"manifest": hash_of(result.manifest), "certificate": result.certificate})


def is_current(path: Path, result: Result | Analysis) -> bool:
    """Whether a file is the complete report of this result, as :func:`write_page` wrote it; its last line tells."""
    try:
        content = files.read_bytes(path)
    except OSError:
        return False
    text, _, _ = content.rpartition(b"\n<!-- dssc_jax: page ")
    return content == text + mark_of(text, result)
