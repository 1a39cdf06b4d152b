"""Shared by the commands: the application, loading of studies and results, and output."""

import os
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.analyses.loading import Loaded
    from dssc_jax.results.analysis import Analysis
    from dssc_jax.results.result import Result
    from dssc_jax.study import Study

DONE, FAILS, BAD_INPUT = 0, 1, 2
LONGEST = 1000  # characters of a message

app = typer.Typer(
    name="dssc-jax",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def assignment(text: str, option: str) -> tuple[str, str]:
    """Parse name and value of ``NAME=VALUE``."""
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        from dssc_jax.study.separators import separated

        raise ConfigError(option, f"must be NAME=VALUE, got '{text}'{separated(text, 1)}")
    return name, value


def parse_value(text: str) -> Any:
    """Parse a TOML value; text that is not valid TOML is a string."""
    import tomllib

    try:
        parsed = tomllib.loads(f"value = {text}")
    except ValueError:  # TOMLDecodeError is one, so are integers too long
        return text
    return parsed["value"] if len(parsed) == 1 else text


def parse_over(text: str) -> tuple[str, dict[str, list[Any]]]:
    """Parse name and axis of ``NAME=LO:HI:COUNT[:log]``."""
    from dssc_jax.study.separators import separated

    try:
        name, value = text.split("=")
        low, high, count, *rest = value.split(":")
        numbers = [float(low), float(high), int(count)]
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI:COUNT[:log], got '{text}'{separated(text, 3)}") from None
    if rest not in ([], ["log"]):
        raise ConfigError("--over", f"only ':log' may follow COUNT, got '{text}'")
    return name, {"logspace" if rest else "linspace": numbers}


def parse_overs(texts: list[str]) -> dict[str, dict[str, list[Any]]]:
    """Parse the axes of all ``--over`` options."""
    axes: dict[str, dict[str, list[Any]]] = {}
    for text in texts:
        name, axis = parse_over(text)
        if name in axes:
            raise ConfigError("--over", f"'{name}' is given twice")
        axes[name] = axis
    return axes


def parse_bounds(text: str) -> tuple[str, tuple[float, float]]:
    """Parse name and bounds of ``NAME=LO:HI``."""
    from dssc_jax.study.separators import separated

    try:
        name, value = text.split("=")
        start, end = map(float, value.split(":"))
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI, got '{text}'{separated(text, 2)}") from None
    return name, (start, end)


def require_proofs() -> None:
    """Check that what proofs need is installed.

    Raises:
        ConfigError: it is not.
    """
    for name in ("clarabel", "flint"):
        if find_spec(name) is None:
            raise ConfigError("prove", f"needs {name}: pip install 'dssc_jax[proofs]'")


def load_study(
    name: str,
    settings: list[str] | None,
    draws: int | None,
    seed: int | None,
    local: bool,
    cluster: str | None = None,
) -> "Study":
    """Load a study and apply the options."""
    if cluster:  # validation starts JAX: leave a GPU's memory to the worker that computes on it
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    from dssc_jax.study import Study, read_toml
    from dssc_jax.study.importing import allow_imports
    from dssc_jax.study.library import find
    from dssc_jax.study.recorded import with_records
    from dssc_jax.study.tables import changed

    path = find(name)
    if local:
        allow_imports(path.parent)
    changes: dict[str, Any] = {}
    for text in settings or []:
        key, value = assignment(text, "--set")
        changes[key] = parse_value(value)
    changes |= {key: value for key, value in (("draws", draws), ("seed", seed)) if value is not None}
    try:
        table = with_records(changed(read_toml(path), changes, str(path)), path.parent)
    except ConfigError as error:
        raise error.within(str(path)) from None
    show_code("study", table)
    return Study.from_table(table, str(path))


def load_result(folder: Path, trust_code: bool = False, local: bool = False) -> "Result":
    """Load a stored result, which may be from an untrusted source.

    Args:
        folder: The results folder.
        trust_code: Import the code that its study names, after showing which.
        local: As in :func:`load_study`, for the study file it was made from; only used if its code is trusted.
    """
    from dssc_jax.results.manifest import read_manifest
    from dssc_jax.results.result import load_result

    if trust_code:
        trust(read_manifest(folder), local)
    return load_result(folder, trust_code)


def load_any(folder: Path, trust_code: bool = False, local: bool = False) -> "Loaded":
    """Load a stored result or analysis, which may be from an untrusted source; arguments as for :func:`load_result`."""
    from dssc_jax.analyses.loading import description, load

    if trust_code:
        trust(description(folder), local)
    return load(folder, trust_code)


def trust(about: dict[str, Any], local: bool) -> None:
    """Show which code of a stored study is about to run, and make it importable if requested.

    It may then come from the folder of the study file, or from the folders of the modules that the run used.
    """
    if local:
        from dssc_jax.study.code import folders_of
        from dssc_jax.study.importing import allow_imports

        for folder in (Path(str(about.get("source", ""))).parent, *folders_of(about.get("code"))):
            allow_imports(folder)
    show_code("result", about["study"], about.get("code"))


def show_code(what: str, table: dict[str, Any], then: dict[str, Any] | None = None) -> None:
    """Show which code is about to run, and from which files, before it is imported."""
    from dssc_jax.study.code import describe_code

    if names := describe_code(table, then):
        say(f"this {what} runs code: {names}")


def say(text: str) -> None:
    """Print one line on stderr, so that stdout is left for results; control characters are replaced."""
    line = " ".join(text.split())
    line = line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."
    print("".join(c if c.isprintable() else "?" for c in line), file=sys.stderr)


def warn_of_vehicle(study: "Study") -> None:
    """Print a warning for each number of the study's own vehicle that multirotors usually do not have."""
    from dssc_jax.models.uav.plausibility import implausible
    from dssc_jax.models.uav.vehicle import Vehicle
    from dssc_jax.study import Described

    if isinstance(study, Described):
        return
    vehicle, table = getattr(study.template.plant, "vehicle", None), study.config.plant.get("vehicle")
    if isinstance(vehicle, Vehicle) and isinstance(table, dict):
        for text in implausible(vehicle, table):
            say(f"warning: {text}")


def warn_of_study(study: "Study") -> None:
    """Print a warning where noise is predicted to move the loop, where an exact y' flatters it, and of odd vehicles."""
    from dssc_jax.design import noise_warning, rate_warning

    warn_of_vehicle(study)
    for warning in (noise_warning, rate_warning):
        if text := warning(study):
            say(f"warning: {text}")


def checked(study: "Study") -> dict[str, Any] | None:
    """The error of integration between the samples; None of a study whose code is not imported."""
    from dssc_jax.engine.integration import integration_error
    from dssc_jax.study import Described

    return None if isinstance(study, Described) else integration_error(study).to_dict()


def warn_of_integration(about: dict[str, Any] | None) -> None:
    """Print a warning where the error of integration matters."""
    if about and about["warning"]:
        say(f"warning: {about['warning']}")


def default_out(study: "Study", command: str, *options: Any) -> Path:
    """results/NAME-COMMAND, followed by the study's hash if an option or an edit has changed the question."""
    folder = Path("results") / f"{study.name}-{command}"
    altered = any(option not in (None, []) for option in options)
    return folder.with_name(f"{folder.name}-{study.hash[:8]}") if altered or of_another(folder, study) else folder


def of_another(folder: Path, study: "Study") -> bool:
    """Whether a folder holds results, and none of this study."""
    contents = [files.read_text(file, errors="replace") for file in folder.glob("*.json")]
    return bool(contents) and not any(f'"{study.hash}"' in content for content in contents)


def save_analysis(analysis: "Analysis", folder: Path, check: bool) -> list[Path]:
    """Write an analysis and its figure into its folder; return the figure's files.

    Args:
        analysis: The analysis.
        folder: Its folder.
        check: Whether to tell the error of integration between the samples.
    """
    from dssc_jax.plotting import save_figure

    if check:
        analysis.integration = checked(analysis.study)
        warn_of_integration(analysis.integration)
    analysis.save(folder)
    return save_figure(analysis.figure(), folder / "figures", analysis.kind)


def output_analysis(
    analysis: "Analysis",
    files: dict[str, Path],
    figures: list[Path],
    as_json: bool,
    show: Callable[[Any, list[Path]], None],
) -> None:
    """Print an analysis.

    Args:
        analysis: The analysis.
        files: Other files written, by their names in the JSON output.
        figures: The figure's files.
        as_json: Print JSON for programs.
        show: Prints the analysis for people.
    """
    import json

    summary = analysis.summary() | {name: str(path) for name, path in files.items()}
    if as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        show(analysis, [*files.values(), *figures])


def attempt(path: Path, write: Callable[[], Any]) -> None:
    """Write a file that the user named; a failure to write is reported as bad input."""
    try:
        write()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise ConfigError(str(path), f"cannot be written: {reason}") from error
