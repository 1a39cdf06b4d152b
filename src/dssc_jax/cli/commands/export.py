"""dssc-jax export: a result or an analysis for other programs."""

import json

from dssc_jax.cli.declarations.results import Export
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import stored_analysis
from dssc_jax.console.terminal import show_files
from dssc_jax.results.export import export


def run(options: Export) -> int:
    """Write the files and print their paths."""
    exported_files = export(stored_analysis(options.result), options.to, options.out)
    if options.as_json:
        print(json.dumps({"result": str(options.result), "files": [str(path) for path in exported_files]}))
    else:
        show_files(exported_files)
    return DONE
