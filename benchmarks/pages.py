"""Regenerates docs/study-file.md and docs/commands.md from the schema, the registries and the command line.

Run it as ``make pages`` after a change of any of them; a test tells where a page is old.
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from pydantic import BaseModel

from dssc_jax.analyses.loading import KINDS, class_of
from dssc_jax.cli.application import app
from dssc_jax.console.kinds import HEADS, FieldRow, registries, rows_of
from dssc_jax.results.fields import field_meanings
from dssc_jax.study.available_metrics import PACKAGE_METRICS
from dssc_jax.study.laws import LAWS
from dssc_jax.study.parsed_values import AXES
from dssc_jax.study.schema import StudyTable
from dssc_jax.study.sections import FIXED_TABLES

DOCS = Path(__file__).parents[1] / "docs"
STUDY_FILE = """# The study file

Every table and field, generated from the schema (`make pages`). `dssc-jax info KIND` prints one kind in the terminal.
Numbers are in SI units and radians; y stands for the unit of the plant's output and u for that of its command. A law
may replace a number unless *admissible* excludes it. An expression of [parameters](parameters.md), as `"=1/(L*C)"`, may
replace any number.

A dotted name gives an entry of a list by its index from 0, as `--set plant.initial.0=0.5`. The list may be one that the
study leaves at its default, unless the default is empty.
"""
LAW_TEXT = """A law replaces a number: `k_p = { uniform = [0.8, 1.2] }`. Where its arguments are not known well, they
may be ranges: `k_p = { normal = [[0.9, 1.1], 0.1] }`. `dssc-jax laws` gives the failure probability over all these laws
([laws](laws.md#ranges-of-laws)), `explore` moves within them, and `prove` covers all of them. Other commands need
numbers, and say so."""
COMMANDS = """# Commands

Every command and option, generated from the command line (`make pages`). `dssc-jax COMMAND --help` prints one of them.
Exit codes: 0 success; 1 a check, proof, verification or replay fails, a tuning misses a limit, `falsify` finds a draw
that fails, a log does not support a fit, or a stopping rule is not met; 2 bad input; 129, 130 or 143 ended by a signal.
A warning changes no exit code: an answer was found, and the text tells why to doubt it. A script reads `warned` in the
JSON of `compare-log`.
"""


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> Iterator[str]:
    """A table in Markdown."""
    yield f"| {' | '.join(head)} |"
    yield "|---" * len(head) + "|"
    for row in rows:
        yield f"| {' | '.join(str(cell).replace('|', '&#124;') for cell in row)} |"
    yield ""


TYPE_WORDS = {float: "number", int: "whole number", str: "text", bool: "true or false", list: "list", tuple: "list"}


def type_name(annotation: Any) -> str:
    """An annotation as a reader of a study file takes it; one that may be absent is named without that."""
    arguments, origin = get_args(annotation), get_origin(annotation)
    if origin in (Union, UnionType, Annotated):
        return type_name(arguments[0])
    if origin is Literal:
        return " or ".join(map(repr, arguments))
    return TYPE_WORDS.get(origin or annotation, "table")


def fixed_rows(model: type[BaseModel]) -> Iterator[tuple[str, ...]]:
    """The fields of one of the tables that no registry knows."""
    for name, field in model.model_fields.items():
        limits = [str(limit) for limit in field.metadata if type(limit).__name__ in ("Gt", "Ge", "Lt", "Le")]
        bounds = ", ".join(limits).replace("Gt(gt=", "> ").replace("Ge(ge=", ">= ")
        bounds = bounds.replace("Lt(lt=", "< ").replace("Le(le=", "<= ").replace(")", "")
        default = "required" if field.is_required() else field.default
        default = "absent" if default in (None, {}, []) else default
        shown = default.get("kind", default) if isinstance(default, dict) else default
        shown = "see below" if isinstance(shown, BaseModel) else shown
        yield f"`{name}`", type_name(field.annotation), bounds, f"{shown}", field.description or ""


def summary(model: type[BaseModel]) -> str:
    """What a table is, from its docstring: ``[name]``: text."""
    text = " ".join((model.__doc__ or "").split()).partition(": ")[2].replace("``", "`")
    return f"{text[0].upper()}{text[1:]}"


def study_file() -> str:
    """The page of the study file."""
    head = ("field", "type", "admissible", "default", "meaning")
    lines = [STUDY_FILE, "## Top level", "", *table(head, fixed_rows(StudyTable))]
    for name, model in FIXED_TABLES.items():
        lines += [f"## [{name}]", "", summary(model), "", *table(head, fixed_rows(model))]
    lines += ["## Laws", "", LAW_TEXT, ""]
    rows = []
    for name, law in LAWS.items():
        rows.append((f"`{name}`", f"`{law.signature}`", law.rule.text, "yes" if law.log_density else "no"))
    lines += table(("law", "arguments", "rule", "may be ranges"), rows)
    lines += ["## Axes of a sweep", "", f"`[sweep]` gives, for a dotted name, one of {', '.join(AXES)}.", ""]
    metrics = [(f"`{name}`", metric.unit, metric.meaning) for name, metric in PACKAGE_METRICS.items()]
    lines += ["## Metrics", "", *table(("metric", "unit", "meaning"), metrics)]
    for slot, registry in registries().items():
        lines += [f"## [{HEADS.get(slot, slot)}]", ""]
        for kind, entry in registry.items():
            lines += [f'### kind = "{kind}"', "", f"{entry.summary}.", ""]
            rows = rows_of(entry)
            if rows:
                lines += table(FieldRow._fields, (row._replace(field=f"`{row.field}`") for row in rows))
    return "\n".join(lines).rstrip() + "\n"


def commands() -> str:
    """The page of the commands."""
    lines = [COMMANDS]
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        usage = " ".join(["dssc-jax", name, *(str(p.name).upper() for p in arguments), "[OPTIONS]"])
        lines += [f"## {name}", "", f"    {usage}", ""]
        lines += [" ".join(paragraph.split()) + "\n" for paragraph in (command.help or "").split("\n\n")]
        rows = []
        for option in command.params:
            if option.param_type_name == "option":
                flags = ", ".join(f"`{flag}`" for flag in option.opts)
                rows.append((flags, option.metavar or "", getattr(option, "help", "") or ""))
        lines += table(("option", "value", "meaning"), rows)
        for kind, case in {name: "", **ANSWERS.get(name, {})}.items():
            if kind in KINDS:
                lines += [f"Numbers{case} of `--json`, and of summary.json in the folder:", ""]
                meanings = field_meanings(class_of(kind).answer_type())
                lines += table(("key", "unit", "meaning"), ((f"`{key}`", unit, text) for key, unit, text in meanings))
    return "\n".join(lines).rstrip() + "\n"


ANSWERS = {
    "margin": {"margins": " of several controllers (`margins`)"},
    "compare-log": {"next-flight": " of several logs (`next-flight`)"},
    "laws": {"law-ranges": " of laws whose arguments are ranges (`law-ranges`)"},
}
"""Kinds of analysis that a command makes besides the one of its name, and when."""

PAGES = {"study-file.md": study_file, "commands.md": commands}


def main() -> int:
    for name, page in PAGES.items():
        (DOCS / name).write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
