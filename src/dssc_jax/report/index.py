"""An index page of the results and analyses in a folder, each with its report."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import htpy as h

from dssc_jax.analyses.loading import KINDS, description, load
from dssc_jax.core.errors import ConfigError
from dssc_jax.report.elements import count_text, interval, probability_text, table
from dssc_jax.report.page import REPORT, is_current, page, write, write_page
from dssc_jax.report.study_sections import moment
from dssc_jax.results import store
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.summary import SummaryRow, extreme_points

INDEX = "index.html"
MARKS = {store.MANIFEST, *(f"{kind}.json" for kind in KINDS)}
"""Files that identify a folder's content."""


class IndexRow(NamedTuple):
    """The folder of a result or an analysis; ``trouble`` gives the reason if its numbers cannot be shown."""

    folder: Path
    kind: str = ""
    answer: str = ""
    study: str = ""
    started: str = ""
    size: str = ""
    probability: str = ""
    interval: str = ""
    worst: float = -1.0
    trouble: str = ""


def folders(root: Path) -> Iterator[Path]:
    """Every folder of a result or an analysis below ``root``, and the folders directly in it that contain none."""
    for child in sorted(path for path in root.iterdir() if path.is_dir()):
        places = []
        if child.is_symlink():
            yield child
            continue
        for place, inner, files in os.walk(child):
            has_result = not MARKS.isdisjoint(files)
            if has_result:
                places.append(Path(place))
            inner[:] = [] if has_result else sorted(set(inner) - {store.DATA})
        yield from places or [child]


def index_row(folder: Path, on_report: Callable[[Path], None]) -> IndexRow:
    """The index row of a folder; its report is written first unless it is whole and shows what the folder holds."""
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
        return point_numbers(row, result.summary()["points"])
    except ConfigError as error:
        return row._replace(trouble=error.rule)
    except OSError as error:
        return row._replace(trouble=f"{REPORT} cannot be written ({error.strerror})")
    except Exception as error:  # one report that cannot be made must not take the index with it
        return row._replace(trouble=f"its report cannot be made: {type(error).__name__}: {error}")


def point_numbers(row: IndexRow, points: list[SummaryRow]) -> IndexRow:
    """The row with size, probability and interval; for a sweep, those of its best and its worst point."""
    best, worst = extreme_points(points)
    extremes = [best] if len(points) == 1 else [best, worst]
    size = count_text(best["draws"], "draw") + (f" at {len(points):,} points" if len(points) > 1 else "")
    return row._replace(
        size=size,
        probability=" to ".join(probability_text(point["probability"], point["interval"]) for point in extremes),
        interval=interval(best["interval"]) if len(points) == 1 else "",
        worst=worst["probability"],
    )


def write_index(root: str | Path, made: Callable[[Path], None] = lambda page: None) -> tuple[Path, list[IndexRow]]:
    """Write ``index.html`` for the results below ``root``; reports that are missing or out of date are written first.

    Args:
        root: A folder that contains folders of results and analyses.
        made: Called with each report that was written.

    Returns:
        The file, and the row of each folder.

    Raises:
        ConfigError: ``root`` is not a folder.
    """
    top = Path(root)
    if not top.is_dir():
        raise ConfigError(str(top), "is not a folder of results")
    rows = [index_row(place, made) for place in folders(top)]
    target = top / INDEX
    write_page(index_html(top, rows), target)
    return target, rows


def index_html(root: Path, rows: list[IndexRow]) -> str:
    """The index as a page, sorted by study, then date (newest first), then probability."""
    good = sorted((row for row in rows if not row.trouble), key=lambda row: row.worst)
    good = sorted(sorted(good, key=lambda row: row.started, reverse=True), key=lambda row: row.study)
    bad = [row for row in rows if row.trouble]
    runs = [row for row in good if not row.kind]
    analyses = [row for row in good if row.kind]
    body: list[h.Node] = []

    def link(row: IndexRow) -> h.Element:
        return h.a(href=quote(os.fsencode((row.folder / REPORT).relative_to(root))))[row.study]

    if runs:
        cells = []
        for row in runs:
            folder = h.code[str(row.folder.relative_to(root))]
            cells.append((link(row), moment(row.started), folder, row.size, row.probability, row.interval))
        head = ("study", "started", "folder", "size", "failure probability", "95 % interval")
        body.append(section("runs", "Runs", table("A sweep shows its best and its worst point", head, cells, words=4)))
    if analyses:
        cells = [(link(row), row.kind, h.code[str(row.folder.relative_to(root))], row.answer) for row in analyses]
        head = ("study", "analysis", "folder", "answer")
        body.append(section("analyses", "Analyses", table("Each analysis with its answer", head, cells, words=4)))
    if bad:
        troubled_rows = [(h.code[str(row.folder.relative_to(root))], row.study, row.trouble) for row in bad]
        caption = "Folders without a result that can be shown"
        body.append(section("damaged", "Not shown", table(caption, ("folder", "study", "why"), troubled_rows, words=3)))
    counts = [f"{len(runs):,} {'run' if len(runs) == 1 else 'runs'}"] if runs else []
    counts += [f"{len(analyses):,} {'analysis' if len(analyses) == 1 else 'analyses'}"] if analyses else []
    lead = f"{' and '.join(counts) or 'No result'} in {root.resolve().name}"
    return page(f"Results in {root.resolve().name}", [h.h1["Results"], h.p(".lead")[lead]], body, [])


def section(key: str, heading: str, body: h.Node) -> h.Element:
    """A part of the page."""
    return h.section(aria_labelledby=key)[h.h2(id=key)[heading], body]
