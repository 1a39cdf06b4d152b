"""dssc-jax code: the sampled controller as C99, with an FMU and a monitor on request."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path

from dssc_jax.cli.analysing import save_text, write_or_refuse
from dssc_jax.cli.declarations.flight import Code
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import read_json, study_of
from dssc_jax.cli.native_build import build_fmu_library
from dssc_jax.cli.warnings import warn_of_study
from dssc_jax.console.flight import show_code
from dssc_jax.core import files
from dssc_jax.core.generated_files import SUMS, require_replaceable, write_sums
from dssc_jax.flight_code import monitor_text, onboard_text
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.premises import Premises
from dssc_jax.study import Study


def premises_of(study: Study, path: Path) -> Premises:
    """Return the premises of a certificate, which the monitor observes in flight.

    Args:
        study: The study, whose loop the certificate must be about.
        path: File of the certificate.

    Raises:
        ConfigError: The verifier rejects the certificate, or it is that of another loop.
    """
    from dssc_jax.flight_code.certified_premises import certified_premises  # the verifier is optional

    return certified_premises(study, read_json(path), str(path))


def recordings_of(folder: FlightFolder) -> dict[str, Callable[[int, int | None], Iterable[bytes]]]:
    """Return the functions that record what the bench of a folder replays, by the names of their files.

    Each function takes the numbers of draws and of samples, and returns the parts of the file's content.
    """
    recordings = {"recorded.bin": folder.recording}
    if folder.software is not None:
        recordings[onboard_text.RECORDING] = folder.software_recording
    if folder.monitor is not None:
        recordings[monitor_text.RECORDING] = folder.monitor_recording
    return recordings


def save_recording(path: Path, parts: Iterable[bytes]) -> None:
    """Write the parts of a recording to a file.

    Raises:
        ConfigError: The file cannot be written.
    """
    write_or_refuse(path, lambda: files.write_parts(path, parts))


def run(options: Code) -> int:
    """Write the folder with the code of the controller, and print its content and cost."""
    study = study_of(options).without_sweep()
    warn_of_study(study)
    premises = None if options.monitor is None else premises_of(study, options.monitor)
    folder = FlightFolder(study, premises)
    out = options.out
    texts = folder.texts()
    recordings = recordings_of(folder)
    unit = folder.fmu() if options.fmu else None
    file_names = [*texts, *recordings]
    if unit is not None:
        file_names.append(f"{unit.name}.fmu")
    require_replaceable(out, file_names)
    write_or_refuse(out, lambda: files.make_folder(out))
    for name, text in texts.items():
        save_text(out / name, text)
    for name, record in recordings.items():
        save_recording(out / name, record(options.draws, options.samples))
    summary = folder.summary() | {"folder": str(out)}
    if unit is not None:
        library, reason = build_fmu_library(unit)
        fmu_file = out / f"{unit.name}.fmu"
        write_or_refuse(fmu_file, lambda: files.write_bytes(fmu_file, unit.archive(library)))
        summary["fmu"] = {"file": fmu_file.name, "library": library is not None, "reason": reason}
    write_or_refuse(out, lambda: write_sums(out, file_names))
    summary["files"] = [*file_names, SUMS]
    if options.as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        show_code(summary)
    return DONE
