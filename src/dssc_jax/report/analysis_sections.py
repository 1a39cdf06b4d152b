"""Sections on an analysis of any kind: its answer, numbers, dataset and provenance."""

from collections.abc import Iterator, Mapping
from typing import Any

import htpy as h

from dssc_jax.report.elements import Section, counted, facts, figure, number, table
from dssc_jax.report.study_sections import listing
from dssc_jax.report.subject import AnalysisSubject
from dssc_jax.report.vector import inline

LONGEST_TABLE = 3  # numbers that one cell holds; a longer list is in the dataset


def answer(about: AnalysisSubject) -> Section:
    """The answer in one line, and its figure."""
    analysis = about.result
    picture = inline(analysis.figure, f"{analysis.title}: {analysis.headline}.", "answer")
    return Section("answer", "The answer", figure(picture, f"{analysis.headline}."))


def numbers(about: AnalysisSubject) -> Section:
    """The summary as tables."""
    return Section("numbers", "In numbers", list(tables(about.result.title, about.summary)))


def tables(caption: str, content: Mapping[str, Any]) -> Iterator[h.Element]:
    """Tables of nested plain data: one for single values, and one for each group of similar rows."""
    single = [(name.replace("_", " "), text) for name, value in content.items() if (text := cell(value)) is not None]
    if single:
        yield table(caption, ("number", "value"), single, words=2)
    for name, value in content.items():
        rows = summary_rows(value)
        label = f"{caption}: {name.replace('_', ' ')}"
        columns = columns_of(rows)
        if columns:
            cells = [(key, *(cell(row.get(column)) or "" for column in columns)) for key, row in rows.items()]
            yield table(label, ("name", *(column.replace("_", " ") for column in columns)), cells)
        elif isinstance(value, Mapping):
            yield from tables(label, value)


def summary_rows(value: Any) -> dict[str, Mapping[str, Any]]:
    """The rows of a group: a mapping of mappings, or a list of them; empty if it is neither."""
    if isinstance(value, list):
        value = {str(place): row for place, row in enumerate(value, start=1)}
    like = isinstance(value, Mapping) and value and all(isinstance(row, Mapping) for row in value.values())
    return dict(value) if like else {}


def columns_of(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The columns with a value that fits a cell in at least one row."""
    names = dict.fromkeys(name for row in rows.values() for name in row)
    return [name for name in names if any(cell(row.get(name)) is not None for row in rows.values())]


def cell(value: Any) -> str | None:
    """The text of a cell; None if the value is missing or not a single one."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return number(value)
    if isinstance(value, list) and 0 < len(value) <= LONGEST_TABLE:
        parts = [cell(part) for part in value]
        return None if None in parts else ", ".join(map(str, parts))
    return value if isinstance(value, str) else None


def dataset(about: AnalysisSubject) -> Section:
    """The dataset's content, for further use."""
    rows = [
        (h.code[str(name)], one.attrs.get("long_name", ""), one.attrs.get("units", ""), ", ".join(map(str, one.dims)))
        for name, one in about.result.dataset.variables.items()
    ]
    head = ("variable", "meaning", "unit", "along")
    caption = "Variables of the dataset, which dssc_jax.load reads and dssc-jax export hands on"
    return Section("dataset", "The dataset", table(caption, head, rows, words=4))


def analysis_provenance(about: AnalysisSubject) -> Section:
    """The provenance of the numbers, and how to reproduce them."""
    analysis = about.result
    study, config = analysis.study, analysis.study.config
    pairs: list[tuple[str, h.Node]] = [
        ("study", f"{study.name}, from {study.source}"),
        ("hash of the study", h.code[study.hash]),
        ("seed", f"{config.seed}, {config.sampling} sampling"),
        ("size", counted(config.draws, "draw")),
        ("arithmetic", f"float{config.loop.precision}, {config.loop.integrator}"),
    ]
    again = ["Save it as a file and give it to ", h.code[f"dssc-jax {analysis.kind}"], "."]
    return Section("provenance", "Provenance", [facts(pairs, "facts wide"), listing(study, again)])
