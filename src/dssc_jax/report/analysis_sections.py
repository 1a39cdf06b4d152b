"""Sections on an analysis of any kind: its answer, numbers, dataset and provenance."""

from collections.abc import Iterator, Mapping
from typing import TypeAlias

import htpy as h

from dssc_jax.report.elements import Section, count_text, facts, figure, number, table
from dssc_jax.report.study_sections import listing
from dssc_jax.report.subject import AnalysisSubject
from dssc_jax.report.vector import inline
from dssc_jax.results.fields import FieldMeaning, field_meanings

LONGEST_LIST = 3  # numbers that one cell holds; a longer list is in the dataset
Meanings: TypeAlias = Mapping[str, FieldMeaning]
"""Unit and meaning of an answer's numbers by key, see :class:`FieldMeaning`."""


def answer(subject: AnalysisSubject) -> Section:
    """The answer in one line, and its figure."""
    analysis = subject.result
    picture = inline(analysis.figure, f"{analysis.title}: {analysis.headline}.", "answer")
    return Section("answer", "The answer", figure(picture, f"{analysis.headline}."))


def numbers(subject: AnalysisSubject) -> Section:
    """The summary as tables, with the unit and the meaning of each number."""
    analysis = subject.result
    meanings = {field.key: field for field in field_meanings(type(analysis).answer_type())}
    return Section("numbers", "In numbers", list(tables(analysis.title, subject.summary, meanings)))


def tables(caption: str, content: Mapping[str, object], meanings: Meanings, place: str = "") -> Iterator[h.Element]:
    """Tables of nested plain data: one for single values, and one for each group of similar rows.

    Args:
        caption: The first table's caption; those of the others start with it.
        content: The data.
        meanings: Unit and meaning of the summary's numbers by key.
        place: The key of ``content`` in the summary; empty for the summary itself.
    """
    single = []
    for name, value in content.items():
        text = cell(value)
        if text is not None:
            single.append((number_label(meanings, entry_key(meanings, place, name), name), text))
    if single:
        yield table(caption, ("number", "value"), single, words=2)
    for name, value in content.items():
        key = entry_key(meanings, place, name)
        label = f"{caption}: {name.replace('_', ' ')}"
        group = f"{key}[]" if isinstance(value, list) else f"{key}.NAME"
        rows = summary_rows(value)
        columns = columns_of(rows)
        if columns:
            head = [number_label(meanings, entry_key(meanings, group, column), column) for column in columns]
            cells = []
            for row_name, row in rows.items():
                cells.append((row_name, *(cell(row.get(column)) or "" for column in columns)))
            yield table(label, ("name", *head), cells)
        elif isinstance(value, Mapping):
            yield from tables(label, value, meanings, key)


def entry_key(meanings: Meanings, place: str, name: str) -> str:
    """The key by which an entry's meaning is found. The entry stands in a summary at ``place``.

    Entries of a mapping of numbers share a key. An entry without a meaning has the key of the part that it belongs to;
    outside of any part it has its own name.
    """
    for entry in (f"{place}.{name}".removeprefix("."), f"{place}.NAME".removeprefix(".")):
        if any(key == entry or key.startswith((f"{entry}.", f"{entry}[")) for key in meanings):
            return entry
    return place or name


def number_label(meanings: Meanings, key: str, name: str) -> h.Node:
    """The name of a number, and below it its meaning and unit, if it has them."""
    label = name.replace("_", " ")
    field = meanings.get(key)
    if field is None:
        return label
    unit = "" if field.unit in ("", "1") else f" [{field.unit}]"
    return [label, h.span(".meaning")[f"{field.meaning}{unit}"]]


def summary_rows(value: object) -> dict[str, Mapping[str, object]]:
    """The rows of a group: a mapping of mappings, or a list of them; empty if it is neither."""
    rows = {}
    if isinstance(value, list):
        rows = {str(rank): row for rank, row in enumerate(value, start=1)}
    elif isinstance(value, Mapping):
        rows = dict(value)
    return rows if all(isinstance(row, Mapping) for row in rows.values()) else {}


def columns_of(rows: Mapping[str, Mapping[str, object]]) -> list[str]:
    """The columns with a value that fits a cell in at least one row."""
    columns: dict[str, bool] = {}
    for row in rows.values():
        for name, value in row.items():
            columns[name] = columns.get(name, False) or cell(value) is not None
    return [name for name, has_cell in columns.items() if has_cell]


def cell(value: object) -> str | None:
    """The text of a cell; None if the value is missing or not a single one."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return number(value)
    if isinstance(value, list) and 0 < len(value) <= LONGEST_LIST:
        parts = [cell(part) for part in value]
        return None if None in parts else ", ".join(map(str, parts))
    return value if isinstance(value, str) else None


def dataset(subject: AnalysisSubject) -> Section:
    """The dataset's content, for further use."""
    rows = []
    for name, variable in subject.result.dataset.variables.items():
        meaning = variable.attrs.get("long_name", "")
        unit = variable.attrs.get("units", "")
        rows.append((h.code[str(name)], meaning, unit, ", ".join(map(str, variable.dims))))
    head = ("variable", "meaning", "unit", "along")
    caption = "Variables of the dataset, which dssc_jax.load reads and dssc-jax export hands on"
    return Section("dataset", "The dataset", table(caption, head, rows, words=4))


def analysis_provenance(subject: AnalysisSubject) -> Section:
    """The provenance of the numbers, and how to reproduce them."""
    analysis = subject.result
    study = analysis.study
    config = study.config
    pairs: list[tuple[str, h.Node]] = [
        ("study", f"{study.name}, from {study.source}"),
        ("hash of the study", h.code[study.hash]),
        ("seed", f"{config.seed}, {config.sampling} sampling"),
        ("size", count_text(config.draws, "draw")),
        ("arithmetic", f"float{config.loop.precision}, {config.loop.integrator}"),
    ]
    usage = ["Save it as a file and give it to ", h.code[f"dssc-jax {analysis.kind}"], "."]
    return Section("provenance", "Provenance", [facts(pairs, "facts wide"), listing(study, usage)])
