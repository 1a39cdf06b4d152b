"""dssc-jax report: a result, an analysis, or a folder of them as an HTML page."""

import json
import time
from pathlib import Path

from dssc_jax.cli.analysing import write_or_refuse
from dssc_jax.cli.declarations.results import Report
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import stored_analysis
from dssc_jax.console.terminal import show_line
from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration import require_panel
from dssc_jax.report import write, write_index
from dssc_jax.report.page import write_page


def run(options: Report) -> int:
    """Write the page of a result or an index, and print its path."""
    if (options.result is None) == (options.index is None):
        raise ConfigError("report", "takes a results folder, or --index with a folder of them, and not both")
    if options.result is None:
        if options.out is not None:
            raise ConfigError("--out", "applies to one report; the index is written into the folder of results")
        assert options.index is not None  # one of them is given
        return print_index(options.index, options.as_json)
    began = time.perf_counter()
    analysis = stored_analysis(options.result, options.trust_code, options.allow_local, options.allow_native)
    if options.interactive:
        require_panel()
        from dssc_jax.exploration.interactive_report import INTERACTIVE, interactive_html  # needs an optional package

        page = options.out or options.result / INTERACTIVE
        text = interactive_html(analysis)
        write_or_refuse(page, lambda: write_page(text, page, analysis))
    else:
        page = options.out or options.result / "report.html"
        write_or_refuse(page, lambda: write(analysis, page, options.worst))
    size = page.stat().st_size
    seconds = time.perf_counter() - began
    if options.as_json:
        print(json.dumps({"report": str(page), "bytes": size, "seconds": seconds}))
    else:
        show_line(f"wrote {page} ({size / 1e6:.2f} MB in {seconds:.1f} s)")
    return DONE


def print_index(root: Path, as_json: bool) -> int:
    """Write the index of a folder of results and analyses, print its path, and return the exit code.

    Args:
        root: The folder.
        as_json: Whether to print JSON.
    """

    def show_written(file: Path) -> None:
        """Print the path of a report that was made for the index."""
        if not as_json:
            show_line(f"wrote {file} (it was missing or out of date)")

    page, rows = write_index(root, show_written)
    trouble_count = sum(bool(row.trouble) for row in rows)
    if as_json:
        results = [{**row._asdict(), "folder": str(row.folder)} for row in rows]
        print(json.dumps({"index": str(page), "results": results}))
    else:
        show_line(f"wrote {page} ({len(rows) - trouble_count} results, {trouble_count} that cannot be shown)")
    return DONE
