"""The command line. Heavy imports wait until a command needs them, so that help is instant."""

import json
import math
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssc_jax.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.results import Result
    from dssc_jax.study import Study

FIGURES = (".png", ".svg", ".pdf")
DONE, FAILS, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

app = typer.Typer(
    name="dssc-jax",
    help="How much uncertainty does this controller survive, and how do I know?\n\n"
    "Monte Carlo robustness of Dynamic Smooth Sliding Control and its rivals, on study files (TOML).",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

StudyArgument = Annotated[str, typer.Argument(metavar="STUDY", help="A study file, or the name of one of `studies`.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Override a value by dotted name; may be repeated."),
]
OverOption = Annotated[
    list[str] | None,
    typer.Option(
        "--over",
        metavar="NAME=LO:HI:COUNT[:log]",
        help="Sweep this parameter instead of the study's own axes; may be repeated.",
    ),
]
DrawsOption = Annotated[int | None, typer.Option("--draws", metavar="N", help="Number of draws.")]
SeedOption = Annotated[int | None, typer.Option("--seed", metavar="S", help="Seed of the draws.")]
OutOption = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Results folder [results/NAME-COMMAND].")]
ResumeOption = Annotated[bool, typer.Option("--resume", help="Keep what an interrupted run of this study finished.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
LocalOption = Annotated[
    bool, typer.Option("--allow-local", help="Let `module:object` names in the study import from its own folder.")
]
PointOption = Annotated[
    list[str] | None, typer.Option("--at", metavar="NAME=VALUE", help="Point of the sweep; may be repeated.")
]
CsvOption = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the trajectory as CSV.")]
FigureOption = Annotated[Path | None, typer.Option("--figure", metavar="FILE", help="Write a figure (PNG, SVG, PDF).")]
EveryOption = Annotated[int, typer.Option("--every", metavar="K", min=1, help="Keep every K-th sample.")]


def say(text: str) -> None:
    """For people: one line on stderr, so that stdout stays for results; control characters are not passed on."""
    line = " ".join(text.split())
    print("".join(c if c.isprintable() else "?" for c in line), file=sys.stderr)


def assignment(text: str, option: str) -> tuple[str, str]:
    """Name and value of ``NAME=VALUE``."""
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise ConfigError(option, f"must be NAME=VALUE, got '{text}'")
    return name, value


def parse_value(text: str) -> Any:
    """A TOML value; what is none is a string."""
    import tomllib

    try:
        found = tomllib.loads(f"value = {text}")
    except ValueError:  # TOMLDecodeError is one, so are integers too long
        return text
    return found["value"] if len(found) == 1 else text


def parse_over(text: str) -> tuple[str, dict[str, list[Any]]]:
    """Name and axis of ``NAME=LO:HI:COUNT[:log]``."""
    name, value = assignment(text, "--over")
    try:
        low, high, count, *rest = value.split(":")
        numbers = [float(low), float(high), int(count)]
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI:COUNT[:log], got '{text}'") from None
    if rest not in ([], ["log"]):
        raise ConfigError("--over", f"after COUNT only ':log' may stand, got '{text}'")
    return name, {"logspace" if rest else "linspace": numbers}


def parse_overs(texts: list[str]) -> dict[str, dict[str, list[Any]]]:
    """The axes of all ``--over`` options."""
    axes: dict[str, dict[str, list[Any]]] = {}
    for text in texts:
        name, axis = parse_over(text)
        if name in axes:
            raise ConfigError("--over", f"'{name}' is given twice")
        axes[name] = axis
    return axes


def load_study(name: str, settings: list[str] | None, draws: int | None, seed: int | None, local: bool) -> "Study":
    """The study as the options change it."""
    from dssc_jax.study import Study
    from dssc_jax.study.library import find

    path = find(name)
    if local:
        sys.path.insert(0, str(path.resolve().parent))
    study = Study.load(path)
    changes: dict[str, Any] = {}
    for text in settings or []:
        key, value = assignment(text, "--set")
        changes[key] = parse_value(value)
    changes |= {key: value for key, value in (("draws", draws), ("seed", seed)) if value is not None}
    return study.override(changes) if changes else study


def default_out(study: "Study", command: str, altered: bool) -> Path:
    """results/NAME-COMMAND, with the study's hash where options have altered it."""
    return Path("results") / f"{study.name}-{command}{'-' + study.hash[:8] if altered else ''}"


def finish(study: "Study", out: Path, resume: bool, as_json: bool) -> int:
    """Run, draw the figures, tell the result."""
    from dssc_jax import api
    from dssc_jax.console import progress_bar, show_result

    with progress_bar(study, quiet=as_json) as advance:
        result = api.run(study, out, resume=resume, progress=advance)
    figures = draw_figures(result, out)
    if as_json:
        print(json.dumps(result.summary()))
    else:
        show_result(result, figures)
    return DONE


def draw_figures(result: "Result", out: Path) -> list[Path]:
    """The figures of a results folder."""
    from dssc_jax import plotting

    return plotting.save_all(result, out / "figures")


@app.command()
def run(
    study: StudyArgument,
    settings: SetOption = None,
    draws: DrawsOption = None,
    seed: SeedOption = None,
    out: OutOption = None,
    resume: ResumeOption = False,
    as_json: JsonOption = False,
    allow_local: LocalOption = False,
) -> int:
    """Simulate every draw at the study's own values.

    The study's [sweep] is left aside.

    Prints the failure probability with its exact (Clopper-Pearson) interval, and writes a results folder. Draws that
    fail are outcomes: the exit code is 0.
    """
    found = load_study(study, settings, draws, seed, allow_local).without_sweep()
    altered = bool(settings or draws is not None or seed is not None)
    return finish(found, out or default_out(found, "run", altered), resume, as_json)


@app.command()
def sweep(
    study: StudyArgument,
    over: OverOption = None,
    settings: SetOption = None,
    draws: DrawsOption = None,
    seed: SeedOption = None,
    out: OutOption = None,
    resume: ResumeOption = False,
    as_json: JsonOption = False,
    allow_local: LocalOption = False,
) -> int:
    """Simulate every draw at every point of a sweep.

    The axes are those of the study's [sweep], or those given by --over.

    All points see the same draws. A swept value takes the place of the law of that parameter. Running the same study
    into the same folder again starts over, unless --resume is given; another study's folder is never touched.
    """
    found = load_study(study, settings, draws, seed, allow_local)
    if over:
        found = found.override({"sweep": parse_overs(over)})
    if not found.axes:
        raise ConfigError(found.source, "has no [sweep]; add one, or --over NAME=LO:HI:COUNT")
    altered = bool(over or settings or draws is not None or seed is not None)
    return finish(found, out or default_out(found, "sweep", altered), resume, as_json)


@app.command()
def simulate(
    study: StudyArgument,
    draw: Annotated[int, typer.Option("--draw", metavar="I", help="Index of the draw.")] = 0,
    csv: CsvOption = None,
    figure: FigureOption = None,
    every: EveryOption = 1,
    settings: SetOption = None,
    seed: SeedOption = None,
    as_json: JsonOption = False,
    allow_local: LocalOption = False,
) -> int:
    """Simulate one draw and keep its trajectory.

    Values are the study's own. Tells how the draw ended; --csv and --figure keep the trajectory.
    """
    from dssc_jax import api

    found = load_study(study, settings, None, seed, allow_local)
    return tell_trajectory(api.simulate(found, draw, every=every), csv, figure, as_json)


@app.command()
def replay(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A results folder.")],
    draw: Annotated[int, typer.Option("--draw", metavar="I", help="Index of the draw.")],
    at: PointOption = None,
    csv: CsvOption = None,
    figure: FigureOption = None,
    every: EveryOption = 1,
    as_json: JsonOption = False,
) -> int:
    """Simulate one draw of a result again.

    Its metrics are compared with the stored ones.

    In a sweep, --at picks the point (the nearest one); without it, the point where the draw's margin is smallest.
    """
    from dssc_jax import api
    from dssc_jax.results import load

    point = {}
    for text in at or []:
        name, value = assignment(text, "--at")
        try:
            point[name] = float(value)
        except ValueError:
            point[name] = math.nan
        if not math.isfinite(point[name]):
            raise ConfigError("--at", f"must be NAME=NUMBER, got '{text}'")
    return tell_trajectory(api.replay(load(result), draw, point=point or None, every=every), csv, figure, as_json)


def tell_trajectory(found: Any, csv: Path | None, figure: Path | None, as_json: bool) -> int:
    """Keep a trajectory as asked, and tell how the draw ended."""
    from dssc_jax.console import show_draw

    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise ConfigError(str(figure), f"cannot be written: the name must end in one of {', '.join(FIGURES)}")
    if csv is not None:
        attempt(csv, lambda: found.to_dataframe().to_csv(csv, index_label="t"))
    if figure is not None:
        from dssc_jax import plotting

        attempt(figure, lambda: plotting.write(plotting.trajectory(found), figure))
    if as_json:
        from dssc_jax.console import jsonable

        print(json.dumps(jsonable(found.attrs), allow_nan=False))
    else:
        show_draw(found.attrs, [path for path in (csv, figure) if path is not None])
    return DONE


def attempt(path: Path, write: Callable[[], Any]) -> None:
    """Write a file the user named; what prevents it is bad input."""
    try:
        write()
    except (OSError, ValueError) as error:
        raise ConfigError(str(path), f"cannot be written: {' '.join(str(error).split())}") from error


@app.command()
def check(
    design: Annotated[
        Path, typer.Argument(metavar="DESIGN", help="A design file: [bounds] with [parameters] or [free].")
    ],
    as_json: JsonOption = False,
) -> int:
    """Check Table 1's design inequalities.

    They must hold strictly over the whole interval of k_p; exit 1 otherwise.
    """
    from dssc_jax.console import jsonable, show_certificate
    from dssc_jax.design import check as check_design
    from dssc_jax.study.design_file import load_design

    found = load_design(design)
    certificate = check_design(found.parameters, found.bounds)
    if as_json:
        content = {"design": found.name, "parameters": found.parameters._asdict(), **certificate.to_dict()}
        print(json.dumps(jsonable(content), allow_nan=False))
    else:
        show_certificate(found.name, found.parameters, certificate)
    return DONE if certificate.certified else FAILS


@app.command()
def studies(as_json: JsonOption = False) -> int:
    """List the studies that can be run by name."""
    from dssc_jax.console import show_table
    from dssc_jax.study import read_toml
    from dssc_jax.study.library import available

    rows = []
    for name, path in available().items():
        try:
            about = str(read_toml(path).get("description", ""))
        except ConfigError as error:
            about = f"({error.rule})"
        rows.append((name, about, str(path)))
    if as_json:
        print(json.dumps({"studies": [dict(zip(("name", "description", "path"), row, strict=True)) for row in rows]}))
    else:
        show_table(("study", "description", "file"), rows)
    return DONE


@app.command()
def info(as_json: JsonOption = False) -> int:
    """Show versions, devices and every kind of model.

    Each kind with its fields and options, and the compiler flags in force.
    """
    from dssc_jax.console import environment, show_environment

    found = environment()
    if as_json:
        print(json.dumps(found))
    else:
        show_environment(found)
    return DONE


def main() -> None:
    """Entry point: one line for bad input, no traceback."""
    sys.exit(guarded(sys.argv[1:]))


def guarded(arguments: list[str]) -> int:
    """Run a command and turn what ends it into an exit code."""
    warnings.filterwarnings("ignore", category=RuntimeWarning)  # numbers that overflow are outcomes, told as such
    try:
        code = app(arguments or ["--help"], standalone_mode=False)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except ConfigError as error:
        say(f"error: {error}")
        return BAD_INPUT
    except MemoryError:
        say("error: not enough memory for so many draws, points or samples")
        return BAD_INPUT
    except OSError as error:
        say(f"error: {error.filename or 'a file'}: {error.strerror or error}")
        return BAD_INPUT
    except Exception as error:
        usage = getattr(error, "format_message", None)  # typer's errors of usage
        if usage is None:
            raise
        say(f"error: {usage()}")
        return BAD_INPUT
    if code == INTERRUPTED:  # typer turns the signal into this code itself
        say("interrupted; what was finished is kept, --resume goes on from there")
    return code if isinstance(code, int) else DONE


if __name__ == "__main__":
    main()
