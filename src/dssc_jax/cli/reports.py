"""Commands that show results: report."""

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.analyses.defaults import WORST_DRAWS
from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, attempt, load_any
from dssc_jax.core.errors import ConfigError


@app.command()
def report(
    result: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="The folder of a result, or of an analysis.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="The page [FOLDER/report.html].")] = None,
    worst: Annotated[int, typer.Option("--worst", metavar="N", min=0, help="Worst draws to show.")] = WORST_DRAWS,
    index: Annotated[
        Path | None, typer.Option("--index", metavar="DIR", help="Write DIR/index.html over the results in DIR.")
    ] = None,
    interactive: Annotated[
        bool, typer.Option("--interactive", help="Write a page of the draws with linked brushing [interactive.html].")
    ] = False,
    as_json: opt.Json = False,
    trust_code: opt.TrustCode = False,
    allow_local: opt.Local = False,
) -> int:
    """Write a result, or an analysis, as one HTML page.

    The page needs neither network nor JavaScript and prints well. A result's worst draws are simulated again for it;
    those of a study that names code of its own with --trust-code only.

    With --interactive, one file in which the draws of a result can be brushed; it needs JavaScript, but no network.

    With --index, a page over all the results in a folder instead; reports that are missing or out of date are made.
    """
    if (result is None) == (index is None):
        raise ConfigError("report", "takes a results folder, or --index with a folder of them, and not both")
    if result is None:
        if out is not None:
            raise ConfigError("--out", "applies to one report; the index is written into the folder of results")
        assert index is not None
        return output_index(index, as_json)
    began = time.perf_counter()
    loaded = load_any(result, trust_code, allow_local)
    if interactive:
        from dssc_jax.exploration import require_panel

        require_panel()
        from dssc_jax.exploration.interactive_report import INTERACTIVE, interactive_html
        from dssc_jax.report.page import write_page

        page, text = out or result / INTERACTIVE, interactive_html(loaded)
        attempt(page, lambda: write_page(text, page, loaded))
    else:
        from dssc_jax.report import write

        page = out or result / "report.html"
        attempt(page, lambda: write(loaded, page, worst))
    size, seconds = page.stat().st_size, time.perf_counter() - began
    if as_json:
        print(json.dumps({"report": str(page), "bytes": size, "seconds": seconds}))
    else:
        from dssc_jax.console.terminal import show_page

        show_page(page, f"{size / 1e6:.2f} MB in {seconds:.1f} s")
    return DONE


def output_index(root: Path, as_json: bool) -> int:
    """Write the index of a folder of results and analyses, and show its content."""
    from dssc_jax.console.terminal import show_page
    from dssc_jax.report import write_index

    page, rows = write_index(root, lambda made: None if as_json else show_page(made, "it was missing or out of date"))
    troubled = sum(bool(row.trouble) for row in rows)
    if as_json:
        results = [{**row._asdict(), "folder": str(row.folder)} for row in rows]
        print(json.dumps({"index": str(page), "results": results}))
    else:
        show_page(page, f"{len(rows) - troubled} results, {troubled} that cannot be shown")
    return DONE
