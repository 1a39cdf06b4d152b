"""Steps that commands on analyses share: choose a folder, check the integration, save and print the analysis."""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Protocol, TypeVar

from dssc_jax.cli.warnings import checked_integration, warn_of_integration, warn_of_study
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.plotting import save_figure
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import require_free_folder
from dssc_jax.study import Study, hash_of

AnalysisKind = TypeVar("AnalysisKind", bound=Analysis)


class PrintedOptions(Protocol):
    """The options that :func:`finish` and its parts read: whether to check the integration, and the output's format."""

    @property
    def no_check(self) -> bool:
        """Whether to skip the check of the integration between the samples."""
        ...

    @property
    def as_json(self) -> bool:
        """Whether to print JSON."""
        ...


def free_folder(study: Study, kind: str, out: Path | None, *options: object, ending: str = "") -> Path:
    """Return the folder for a new analysis, after a check that the analysis may be saved there.

    Args:
        study: The study.
        kind: Kind of the analysis.
        out: The folder that the user names; None: the usual folder, see :func:`usual_folder`.
        options: Options that change the answer; they enter the name of the usual folder.
        ending: Ending of the usual folder's name, after the study's; empty: the kind.

    Raises:
        ConfigError: The folder holds something other than this analysis of the study.
    """
    folder = out or usual_folder(study, ending or kind, *options)
    require_free_folder(folder, kind, study)
    return folder


def usual_folder(study: Study, command: str, *options: object) -> Path:
    """Return the folder of a command whose user names none: ``results/STUDY-COMMAND``.

    A digest is appended if an option is given, or if that folder holds results of other studies only. An earlier
    version of the same file is another study.

    Args:
        study: The study.
        command: What follows the study's name in that of the folder.
        options: Options that change the answer; None and an empty list mean that an option is not given.
    """
    folder = Path("results") / f"{study.name}-{command}"
    option_texts = [str(option) for option in options if option not in (None, [])]
    if not option_texts and not holds_another_study(folder, study):
        return folder
    digest = hash_of({"study": study.hash, "options": option_texts}) if option_texts else study.hash
    return folder.with_name(f"{folder.name}-{digest[:8]}")


def holds_another_study(folder: Path, study: Study) -> bool:
    """Whether a folder holds results of other studies, but none of this study."""
    contents = [files.read_text(file, errors="replace") for file in folder.glob("*.json")]
    return bool(contents) and not any(f'"{study.hash}"' in content for content in contents)


def finish(
    analysis: AnalysisKind,
    folder: Path,
    options: PrintedOptions,
    show: Callable[[AnalysisKind, list[Path]], None],
) -> None:
    """Check the integration of an analysis, save it with its figure, and print it.

    Args:
        analysis: The analysis.
        folder: The folder to save it in.
        options: Options of the command.
        show: Prints the analysis and the paths of the written files as text; it is not called for JSON.
    """
    print_analysis(analysis, save_analysis(analysis, folder, options), options, show, {"result": folder})


def save_analysis(analysis: Analysis, folder: Path, options: PrintedOptions) -> list[Path]:
    """Check the integration of an analysis, save it with its figure, and return the files of the figure.

    Args:
        analysis: The analysis; its ``integration`` is set to the result of the check.
        folder: The folder to save it in.
        options: Options of the command; ``no_check`` skips the check.
    """
    warn_of_study(analysis.study)
    if not options.no_check:
        analysis.integration = checked_integration(analysis.study)
        warn_of_integration(analysis.integration)
    analysis.save(folder)
    return save_figure(analysis.figure(), folder / "figures", analysis.kind)


def print_analysis(
    analysis: AnalysisKind,
    figures: list[Path],
    options: PrintedOptions,
    show: Callable[[AnalysisKind, list[Path]], None],
    files_by_name: Mapping[str, Path],
) -> None:
    """Print an analysis as JSON or as text.

    Args:
        analysis: The analysis.
        figures: Files of the figure.
        options: Options of the command.
        show: Prints the analysis and the paths of the written files as text; it is not called for JSON.
        files_by_name: Folders and other files that were written, by their names in the JSON.
    """
    if options.as_json:
        paths = {name: str(path) for name, path in files_by_name.items()}
        print(json.dumps(analysis.summary() | paths, allow_nan=False))
    else:
        show(analysis, [*files_by_name.values(), *figures])


def save_text(path: Path, text: str | Iterable[str]) -> None:
    """Write a text file, and report a failure as bad input.

    Args:
        path: The file.
        text: The text, or its parts in order.

    Raises:
        ConfigError: The file cannot be written.
    """
    write_or_refuse(path, lambda: files.write_text(path, text))


def write_or_refuse(path: Path, write: Callable[[], object]) -> None:
    """Call a function that writes a file or a folder, and report a failure as bad input.

    Args:
        path: The file or folder, for the message.
        write: Writes it.

    Raises:
        ConfigError: ``write`` raised an OSError or a ValueError.
    """
    try:
        write()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise ConfigError(str(path), f"cannot be written: {reason}") from error
