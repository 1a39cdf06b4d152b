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
CONTENT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""What a browser may load for the page: its own style and pictures within it, and nothing from elsewhere."""
"""Content security policy of the page: it loads nothing from elsewhere."""
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
"""Functions that make the sections of a result's report; they return None if they have no content."""


ANALYSIS_SECTIONS: tuple[Callable[[AnalysisSubject], Section | None], ...] = (
    analysis_sections.answer,
    analysis_sections.numbers,
    study_sections.loop,
    study_sections.laws,
    study_sections.expressions,
    analysis_sections.dataset,
    analysis_sections.analysis_provenance,
)
"""Functions that make the sections of an analysis' report."""


def html(result: Result | Analysis, worst: int = WORST_DRAWS) -> str:
    """The report of a result or an analysis as an HTML page.

    Args:
        result: A loaded or new result, or analysis.
        worst: Number of a result's worst draws that are simulated again and shown; 0 needs no simulator.
    """
    if isinstance(result, Analysis):
        return html_of_analysis(result)
    subject = Subject(result, worst)
    probability, sentence = result_sections.headline_verdict(subject)
    verdict = facts([("failure probability", [h.strong[probability], h.span[sentence]])], "verdict")
    sections = [make(subject) for make in SECTIONS]
    return report(result.study, "Robustness report", verdict, sections)


def html_of_analysis(analysis: Analysis) -> str:
    """The report of an analysis as an HTML page."""
    subject = AnalysisSubject(analysis)
    sections = [make(subject) for make in ANALYSIS_SECTIONS]
    return report(analysis.study, analysis.title, h.p(".lead")[analysis.headline], sections)


def report(study: Study, kind: str, verdict: h.Node, sections: Sequence[Section | None]) -> str:
    """A report as one HTML page.

    Args:
        study: The study of the report.
        kind: Kind of the report, which stands above the name of the study.
        verdict: The main finding, which stands below the name.
        sections: The sections in order; None is omitted.
    """
    head = [
        h.p(".kind")[kind],
        h.h1[study.name],
        study.config.description and h.p(".lead")[study.config.description],
        verdict,
    ]
    body = []
    contents = []
    for section in filter(None, sections):
        body.append(section_element(section))
        contents.append((section.key, section.heading))
    return page(f"{study.name}: {kind.lower()}", head, body, contents)


def section_element(section: Section) -> h.Element:
    """A section with its heading."""
    return h.section(aria_labelledby=section.key)[h.h2(id=section.key)[section.heading], section.body]


def page(title: str, head: h.Node, body: h.Node, contents: list[tuple[str, str]]) -> str:
    """A self-contained HTML page, which includes its style and loads nothing from elsewhere.

    Args:
        title: Title of the page.
        head: Content of the header.
        body: Content below the header.
        contents: Key and heading of each section, for the list of contents.
    """
    links = h.ul[(h.li[h.a(href=f"#{key}")[text]] for key, text in contents)]
    credit = f"Made by dssc_jax {version('dssc_jax')} on {datetime.now(UTC):%Y-%m-%d %H:%M} UTC."
    return str(
        h.html(lang="en")[
            h.head[
                h.meta(charset="utf-8"),
                h.meta(http_equiv="Content-Security-Policy", content=CONTENT_POLICY),
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
    """Write the report of a result or an analysis, and return the path of the file.

    Args:
        result: A loaded or new result, or analysis.
        path: The file.
        worst: Number of a result's worst draws that are shown, see :func:`html`.
    """
    target = Path(path)
    write_page(html(result, worst), target, result)
    return target


def write_page(text: str, path: Path, result: Result | Analysis | None = None) -> None:
    """Write a page.

    Characters that UTF-8 does not have, such as lone surrogates of damaged names, are replaced.

    Args:
        text: The page.
        path: The file.
        result: The result or analysis that the page shows. A comment at the end of the page identifies it for
            :func:`is_current`; None: no comment.
    """
    content = text.encode("utf-8", "replace")
    if result is not None:
        content += last_line(content, result)
    files.write_bytes(path, content)


def last_line(content: bytes, result: Result | Analysis) -> bytes:
    """The comment at the end of a report, with two digests.

    The digest of the page reveals a truncated file, and the digest of the result reveals a report that is out of date.

    Args:
        content: The page without this comment.
        result: The result that the page shows.
    """
    digest = hashlib.sha256(content).hexdigest()
    return f"\n<!-- dssc_jax: page {digest} of result {result_digest(result)} -->\n".encode()


def result_digest(result: Result | Analysis) -> str:
    """A digest of the content that a report shows."""
    if isinstance(result, Analysis):
        return hash_of({"kind": result.kind, "study": result.study.hash, "summary": result.summary()})
    return hash_of({"manifest": hash_of(result.manifest), "certificate": result.certificate})


def is_current(path: Path, result: Result | Analysis) -> bool:
    """Whether a file is the complete report of a result in its present state.

    The comment at the file's end must be the one that :func:`last_line` gives. A file that cannot be read is not
    current.
    """
    try:
        content = files.read_bytes(path)
    except OSError:
        return False
    text, _, _ = content.rpartition(b"\n<!-- dssc_jax: page ")
    return content == text + last_line(text, result)
