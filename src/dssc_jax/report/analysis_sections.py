"""Sections on an analysis of any kind: its answer, numbers, dataset and provenance."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TypeAlias

import htpy as h

from dssc_jax.report.elements import Section, count_text, facts, figure, number, number_with_meaning, table
from dssc_jax.report.study_sections import study_file
from dssc_jax.report.subject import AnalysisSubject
from dssc_jax.report.vector import inline_svg
from dssc_jax.results.fields import FieldMeaning, field_meanings

LONGEST_LIST = 3
"""Largest number of values in a cell; longer lists are in the dataset only."""
Meanings: TypeAlias = Mapping[str, FieldMeaning]
"""Unit and meaning of the numbers of an answer, by :attr:`FieldMeaning.key`."""


def answer(subject: AnalysisSubject) -> Section:
    """Make the section with the figure of an analysis, whose caption is the answer in one line."""
    analysis = subject.result
    picture = inline_svg(analysis.figure, f"{analysis.title}: {analysis.headline}.", "answer")
    return Section("answer", "The answer", figure(picture, f"{analysis.headline}."))


def numbers(subject: AnalysisSubject) -> Section:
    """Section with the summary of an analysis as tables, with unit and meaning of each number."""
    analysis = subject.result
    meanings = {field.key: field for field in field_meanings(type(analysis).answer_type())}
    return Section("numbers", "In numbers", list(tables(analysis.title, subject.summary, meanings)))


def tables(caption: str, content: Mapping[str, object], meanings: Meanings, place: str = "") -> Iterator[h.Element]:
    """Make tables of nested plain data: one of all single values, and one for each group of similar rows.

    Args:
        caption: Caption of the first table; the captions of the other tables start with it.
        content: The data, a summary or a part of one.
        meanings: Unit and meaning of the numbers of the summary.
        place: Key of ``content`` in the summary; empty for the summary itself.
    """
    single_values = []
    for name, value in content.items():
        text = cell(value)
        if text is not None:
            single_values.append((entry_label(meanings, place, name), text))
    if single_values:
        yield table(caption, ("number", "value"), single_values, text_columns=2)
    for name, value in content.items():
        key = entry_key(meanings, place, name)
        group_caption = f"{caption}: {name.replace('_', ' ')}"
        rows = summary_rows(value)
        columns = columns_of(rows)
        if columns:
            key_of_rows = f"{key}[]" if isinstance(value, list) else f"{key}.NAME"
            labels = {column: entry_label(meanings, key_of_rows, column) for column in columns}
            yield row_table(group_caption, rows, labels)
        elif isinstance(value, Mapping):
            yield from tables(group_caption, value, meanings, key)


def row_table(caption: str, rows: Mapping[str, Mapping[str, object]], labels: Mapping[str, h.Node]) -> h.Element:
    """Make the table of a group of similar rows, with the name of each row in its first column.

    Args:
        caption: Caption of the table.
        rows: Values of each row by column. The cell stays empty if the row lacks the column, or if the value does not
            fit.
        labels: Header of each column.
    """
    cells = []
    for name, row in rows.items():
        cells.append((name, *(cell(row.get(column)) or "" for column in labels)))
    words = 1 + leading_words(list(labels), rows.values())
    return table(caption, ("name", *labels.values()), cells, text_columns=words)


def entry_key(meanings: Meanings, place: str, name: str) -> str:
    """Return the key under which the meaning of an entry is stored.

    All entries of a mapping from names to numbers share the key ``PLACE.NAME``. An entry without a meaning of its own
    has the key of the part of the summary that contains it; in the summary itself, it has its own name as key.

    Args:
        meanings: Unit and meaning of the numbers of the summary.
        place: Key of the part of the summary that contains the entry; empty for the summary itself.
        name: Name of the entry.
    """
    prefix = f"{place}." if place else ""
    for entry in (f"{prefix}{name}", f"{prefix}NAME"):
        is_known = any(key == entry or key.startswith((f"{entry}.", f"{entry}[")) for key in meanings)
        if is_known:
            return entry
    return place or name


def entry_label(meanings: Meanings, place: str, name: str) -> h.Node:
    """Make the label of an entry: its name and, below it, the meaning and unit if :func:`entry_key` finds any.

    Args:
        meanings: Unit and meaning of the numbers of the summary.
        place: Key of the part of the summary that contains the entry; empty for the summary itself.
        name: Name of the entry.
    """
    label = name.replace("_", " ")
    field = meanings.get(entry_key(meanings, place, name))
    return label if field is None else number_with_meaning(label, field.meaning, field.unit)


def summary_rows(value: object) -> dict[str, Mapping[str, object]]:
    """Find the rows in a value of a summary; empty if the value has none.

    A mapping of mappings has its rows by name, and a list of mappings has its rows by rank.
    """
    rows = {}
    if isinstance(value, list):
        rows = {str(rank): row for rank, row in enumerate(value, start=1)}
    elif isinstance(value, Mapping):
        rows = dict(value)
    are_rows = all(isinstance(row, Mapping) for row in rows.values())
    return rows if are_rows else {}


def columns_of(rows: Mapping[str, Mapping[str, object]]) -> list[str]:
    """List the names of the entries that fit into a cell in at least one row."""
    fits_in_a_row: dict[str, bool] = {}  # by name, in the order of the rows
    for row in rows.values():
        for name, value in row.items():
            fits = cell(value) is not None
            fits_in_a_row[name] = fits_in_a_row.get(name, False) or fits
    return [name for name, fits in fits_in_a_row.items() if fits]


def leading_words(columns: Sequence[str], rows: Collection[Mapping[str, object]]) -> int:
    """Count the leading columns that hold words in every row."""
    count = 0
    for column in columns:
        if not all(isinstance(row.get(column), str) for row in rows):
            break
        count += 1
    return count


def cell(value: object) -> str | None:
    """Format a single value or a short list; None if the value does not fit into a cell."""
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
    """Section that lists the variables of the dataset."""
    rows = []
    for name, variable in subject.result.dataset.variables.items():
        meaning = variable.attrs.get("long_name", "")
        unit = variable.attrs.get("units", "")
        rows.append((h.code[str(name)], meaning, unit, ", ".join(map(str, variable.dims))))
    head = ("variable", "meaning", "unit", "along")
    caption = "Variables of the dataset, which dssc_jax.load reads and dssc-jax export hands on"
    return Section("dataset", "The dataset", table(caption, head, rows, text_columns=4))


def analysis_provenance(subject: AnalysisSubject) -> Section:
    """Section on the provenance of an analysis, with the study file to reproduce it."""
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
    return Section("provenance", "Provenance", [facts(pairs, "facts wide"), study_file(study, usage)])
