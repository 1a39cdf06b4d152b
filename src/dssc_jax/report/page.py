"""The page: its sections in order, and the file that holds it."""

from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import htpy as h
from markupsafe import Markup

from dssc_jax.report import result_sections, study_sections
from dssc_jax.report.elements import Section, facts
from dssc_jax.report.subject import WORST, Subject
from dssc_jax.results.result import Result

REPORT = "report.html"
STYLE = Path(__file__).with_name("style.css")
NOTHING_OUTSIDE = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
SECTIONS: tuple[Callable[[Subject], Section | None], ...] = (
    study_sections.question,
    study_sections.loop,
    study_sections.laws,
    result_sections.outcome,
    result_sections.sweep,
    result_sections.metrics,
    result_sections.causes,
    result_sections.worst,
    result_sections.chattering,
    study_sections.provenance,
)
"""A section is a function of the subject; None where it has nothing to say."""


def html(result: Result, worst: int = WORST) -> str:
    """The report of a result.

    Args:
        result: A loaded or fresh result.
        worst: How many of the worst draws are simulated again and shown; 0 needs no simulator.
    """
    about = Subject(result, worst)
    sections = [section for make in SECTIONS if (section := make(about)) is not None]
    study = result.study
    short, long = result_sections.verdict(about)
    contents = [(section.key, section.heading) for section in sections]
    head = [
        h.p(".kind")["Robustness report"],
        h.h1[study.name],
        study.config.description and h.p(".lead")[study.config.description],
        facts([("failure probability", [h.strong[short], h.span[long]])], "verdict"),
    ]
    body = [
        h.section(aria_labelledby=section.key)[h.h2(id=section.key)[section.heading], section.body]
        for section in sections
    ]
    return page(result_sections.title_of(study), head, body, contents)


def page(title: str, head: h.Node, body: h.Node, contents: list[tuple[str, str]]) -> str:
    """A page on its own: style inside, nothing from outside."""
    links = h.ul[(h.li[h.a(href=f"#{key}")[text]] for key, text in contents)]
    made = f"Made by dssc_jax {version('dssc_jax')} on {datetime.now(UTC):%Y-%m-%d %H:%M} UTC."
    return str(
        h.html(lang="en")[
            h.head[
                h.meta(charset="utf-8"),
                h.meta(http_equiv="Content-Security-Policy", content=NOTHING_OUTSIDE),
                h.meta(name="viewport", content="width=device-width, initial-scale=1"),
                h.meta(name="color-scheme", content="light dark"),
                h.title[title],
                h.style[Markup(STYLE.read_text(encoding="utf-8"))],
            ],
            h.body[
                h.a(".skip", href="#main")["Skip to the content"],
                h.header[head],
                contents and h.nav(aria_label="Contents")[links],
                h.main("#main")[body],
                h.footer[h.p[made]],
            ],
        ]
    )


def write(result: Result, path: str | Path, worst: int = WORST) -> Path:
    """Write the report of a result.

    Args:
        result: A loaded or fresh result.
        path: The file.
        worst: As for :func:`html`.
    """
    target = Path(path)
    save(html(result, worst), target)
    return target


def save(text: str, path: Path) -> None:
    """Write a page; characters that are none (lone surrogates of damaged names) are replaced."""
    path.write_text(text, encoding="utf-8", errors="replace")
