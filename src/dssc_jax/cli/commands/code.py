"""dssc-jax code: the sampled controller as C99, and as an FMU."""

import json

from dssc_jax.cli.analysing import attempt
from dssc_jax.cli.declarations.flight import Code
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.fmu_library import built_library
from dssc_jax.cli.loading import study_of
from dssc_jax.console.flight import show_code
from dssc_jax.core import files
from dssc_jax.flight_code.folder import FlightFolder


def run(options: Code) -> int:
    """Write the folder of the controller, and print what it holds."""
    folder = FlightFolder(study_of(options))
    out = options.out
    attempt(out, lambda: files.make_folder(out))
    texts = folder.texts()
    for name, text in texts.items():
        path = out / name
        attempt(path, lambda path=path, text=text: files.write_text(path, text))
    path = out / "recorded.bin"
    parts = folder.recording(options.draws, options.samples)
    attempt(path, lambda: files.write_parts(path, parts))
    written = [*texts, path.name]
    summary = folder.summary() | {"folder": str(out)}
    if options.fmu:
        unit = folder.fmu()
        library, reason = built_library(unit)
        packed = out / f"{unit.name}.fmu"
        attempt(packed, lambda: files.write_bytes(packed, unit.archive(library)))
        written.append(packed.name)
        summary["fmu"] = {"file": packed.name, "library": library is not None, "reason": reason}
    summary["files"] = written
    if options.as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        show_code(summary)
    return DONE
