"""An index page of the results and analyses in a folder, each with its report."""

import os
from collections.abc import Callable, Iterable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import htpy as h

from dssc_jax.analyses.loading import KINDS, description, load
from dssc_jax.core.errors import ConfigError
from dssc_jax.report.elements import Section, count_text, interval, probability_text, table
from dssc_jax.report.page import REPORT, is_current, page, section_element, write, write_page
from dssc_jax.report.study_sections import time_text
from dssc_jax.results import store
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.summary import SummaryRow, extreme_points

INDEX = "index.html"
DESCRIPTIONS = {store.MANIFEST, *(f"{kind}.json" for kind in KINDS)}
"""Names of the files that describe a result or an analysis; one of them is in each folder of these."""


class IndexRow(NamedTuple):
    """The folder of a result or an analysis, as a row of the index.

    Args:
        folder: The folder.
        kind: Title of the analysis; empty for a result.
        answer: Answer of the analysis in one line.
        study: Name of the study.
        started: Time at which a run began, in ISO format.
        draws_text: Numbers of draws and points of a result, in words.
        probability: Failure probability of a run; failure probabilities of a sweep's best and worst point.
        interval: Interval of the failure probability of a run.
        worst_probability: Failure probability of the worst point, by which the index is sorted; -1 for an analysis.
        trouble: Reason why the folder cannot be shown; empty if it can be shown.
    """

    folder: Path
    kind: str = ""
    answer: str = ""
    study: str = ""
    started: str = ""
    draws_text: str = ""
    probability: str = ""
    interval: str = ""
    worst_probability: float = -1.0
    trouble: str = ""


def indexed_folders(root: Path) -> Iterator[Path]:
    """All folders that the index lists.

    These are the folders of results and analyses below a folder, and its direct subfolders that contain no such folder.
    """
    for child in sorted(path for path in root.iterdir() if path.is_dir()):
        result_folders = [] if child.is_symlink() else folders_with_results(child)
        yield from result_folders or [child]


def folders_with_results(top: Path) -> list[Path]:
    """Find the folders of results and analyses at and below a folder; a folder within a found one is left out."""
    result_folders = []
    for place, subfolders, file_names in os.walk(top):
        if not DESCRIPTIONS.isdisjoint(file_names):
            result_folders.append(Path(place))
            subfolders.clear()
        subfolders[:] = sorted(set(subfolders) - {store.DATA})  # os.walk visits these
    return result_folders


def index_row(folder: Path, on_report: Callable[[Path], None]) -> IndexRow:
    """Make the row of a folder; if its report is missing, damaged or out of date, the report is written first.

    Args:
        folder: The folder.
        on_report: Called with each report that was written.
    """
    row = IndexRow(folder)
    if folder.is_symlink():
        return row._replace(trouble="is a symbolic link, which the index does not follow")
    try:
        content = description(folder)
        row = row._replace(study=str(content["study"].get("name", "")), started=str(content.get("started", "")))
        result = load(folder)
        page = folder / REPORT
        if not is_current(page, result):
            on_report(write(result, page))
        if isinstance(result, Analysis):
            return row._replace(kind=result.title, answer=result.headline)
        return with_probability(row, result.summary()["points"])
    except ConfigError as error:
        return row._replace(trouble=error.rule)
    except OSError as error:
        return row._replace(trouble=f"{REPORT} cannot be written ({error.strerror})")
    except Exception as error:  # a report that cannot be made must not prevent the index
        return row._replace(trouble=f"its report cannot be made: {type(error).__name__}: {error}")


def with_probability(row: IndexRow, points: list[SummaryRow]) -> IndexRow:
    """Add size, failure probability and interval to the row of a result.

    Args:
        row: The row.
        points: Summaries of the result's points.
    """
    best, worst = extreme_points(points)
    row = row._replace(worst_probability=worst["probability"])
    lowest = probability_text(best["probability"], best["interval"])
    draws = count_text(best["draws"], "draw")
    if len(points) == 1:  # a run
        return row._replace(draws_text=draws, probability=lowest, interval=interval(best["interval"]))
    highest = probability_text(worst["probability"], worst["interval"])
    return row._replace(draws_text=f"{draws} at {len(points):,} points", probability=f"{lowest} to {highest}")


def write_index(root: str | Path, made: Callable[[Path], None] = lambda page: None) -> tuple[Path, list[IndexRow]]:
    """Write ``index.html`` for the results below a folder; reports that are missing or out of date are written first.

    Args:
        root: A folder that contains folders of results and analyses.
        made: Called with each report that was written.

    Returns:
        Path of the index, and the row of each folder.

    Raises:
        ConfigError: ``root`` is not a folder.
    """
    top = Path(root)
    if not top.is_dir():
        raise ConfigError(str(top), "is not a folder of results")
    rows = [index_row(place, made) for place in indexed_folders(top)]
    target = top / INDEX
    write_page(index_html(top, rows), target)
    return target, rows


def sorted_rows(rows: Iterable[IndexRow]) -> list[IndexRow]:
    """Sort the rows by study, then by date with the newest first, then by the failure probability of the worst point.

    Sorting is stable: rows that are equal in one key keep their order. Therefore the last key is sorted first.
    """
    by_probability = sorted(rows, key=attrgetter("worst_probability"))
    by_date = sorted(by_probability, key=attrgetter("started"), reverse=True)
    return sorted(by_date, key=attrgetter("study"))


def index_html(root: Path, rows: list[IndexRow]) -> str:
    """Make the index as a page: runs, analyses, and the folders that cannot be shown, with the reason."""
    shown = sorted_rows(row for row in rows if not row.trouble)
    not_shown = [row for row in rows if row.trouble]
    runs = [row for row in shown if not row.kind]
    analyses = [row for row in shown if row.kind]
    body: list[h.Node] = []
    counts = []
    if runs:
        body.append(section_element(Section("runs", "Runs", run_table(root, runs))))
        counts.append(count_text(len(runs), "run"))
    if analyses:
        body.append(section_element(Section("analyses", "Analyses", analysis_table(root, analyses))))
        counts.append(f"{len(analyses):,} {'analysis' if len(analyses) == 1 else 'analyses'}")
    if not_shown:
        body.append(section_element(Section("damaged", "Not shown", trouble_table(root, not_shown))))
    lead = f"{' and '.join(counts) or 'No result'} in {root.resolve().name}"
    return page(f"Results in {root.resolve().name}", [h.h1["Results"], h.p(".lead")[lead]], body, [])


def run_table(root: Path, rows: list[IndexRow]) -> h.Element:
    """Make the table of runs and sweeps, with links to their reports."""
    cells = []
    for row in rows:
        link = report_link(root, row)
        folder = folder_code(root, row)
        cells.append((link, time_text(row.started), folder, row.draws_text, row.probability, row.interval))
    head = ("study", "started", "folder", "size", "failure probability", "95 % interval")
    return table("A sweep shows its best and its worst point", head, cells, text_columns=4)


def analysis_table(root: Path, rows: list[IndexRow]) -> h.Element:
    """Make the table of analyses, with links to their reports."""
    cells = [(report_link(root, row), row.kind, folder_code(root, row), row.answer) for row in rows]
    head = ("study", "analysis", "folder", "answer")
    return table("Each analysis with its answer", head, cells, text_columns=4)


def trouble_table(root: Path, rows: list[IndexRow]) -> h.Element:
    """Make the table of folders that cannot be shown, with the reasons."""
    cells = [(folder_code(root, row), row.study, row.trouble) for row in rows]
    return table("Folders without a result that can be shown", ("folder", "study", "why"), cells, text_columns=3)


def report_link(root: Path, row: IndexRow) -> h.Element:
    """Make the study's name as a link to the report of a row; the address is relative to the index."""
    return h.a(href=quote(os.fsencode((row.folder / REPORT).relative_to(root))))[row.study]


def folder_code(root: Path, row: IndexRow) -> h.Element:
    """Format the path of a folder relative to the index, set as code."""
    return h.code[str(row.folder.relative_to(root))]
