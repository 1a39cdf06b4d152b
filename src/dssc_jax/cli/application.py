"""The command-line application, made from the options that :mod:`dssc_jax.cli.declarations` declares.

The command NAME is the function ``run`` of ``dssc_jax.cli.commands.NAME``. It is imported when the command runs, so
that help is fast, and a command loads only what it needs.
"""

import importlib
import inspect
import re
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from importlib.metadata import version
from typing import Annotated, get_args, get_type_hints

import typer
from typer.models import ArgumentInfo

from dssc_jax.cli.declarations import (
    designs,
    flight,
    overview,
    results,
    robustness,
    searches,
    simulation,
    statistics,
)
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.console.terminal import errors
from dssc_jax.core.errors import ConfigError

DECLARATIONS = (simulation, robustness, searches, statistics, results, designs, flight, overview)
"""The modules that declare the commands' options, in the order of the help."""


def declared_commands() -> dict[str, type]:
    """Collect the dataclasses of options in :data:`DECLARATIONS`, by the name of their command."""
    commands = {}
    for module in DECLARATIONS:
        for name, declared in vars(module).items():
            if isinstance(declared, type) and declared.__module__ == module.__name__:
                commands[command_name(name)] = declared
    return commands


def command_name(class_name: str) -> str:
    """Name of the command whose options a class declares: ``compare-log`` for ``CompareLog``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "-", class_name).lower()


COMMANDS = declared_commands()
"""The options of each command, in the order of the help."""


def command_synonyms() -> dict[str, str]:
    """Collect the synonyms that the declarations state for their commands, with the command's name."""
    commands = {}
    for name, options in COMMANDS.items():
        for synonym in getattr(options, "synonyms", ()):
            commands[synonym] = name
    return commands


SYNONYMS = command_synonyms()
"""Names that other programs have for a command, with the command's name in this program."""

EXTRAS = {"clarabel": "proofs", "flint": "proofs", "panel": "explore", "bokeh": "explore"}
"""The extra of this package that installs an optional package, by the package's name."""

app = typer.Typer(
    name="dssc-jax",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def print_version(requested: bool) -> None:
    """Print the version and end the program, if ``--version`` is given."""
    if requested:
        print(f"dssc-jax {version('dssc_jax')}")
        raise typer.Exit(DONE)


def silence(requested: bool) -> None:
    """Turn progress and notices off, if ``--quiet`` is given; errors are still reported."""
    if requested:
        errors().quiet = True


@app.callback()
def dssc_jax(
    show_version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=print_version, help="Print the version and end.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", callback=silence, help="Show no progress and no notices, only errors.")
    ] = False,
) -> None:
    """How much uncertainty does this controller survive, and how do I know?

    Monte Carlo robustness of Dynamic Smooth Sliding Control and its rivals, on study files (TOML).
    """


def command(name: str, options: type) -> Callable[..., int]:
    """Return the function that typer calls for a command.

    Typer reads the options and the help from the function. Therefore its signature and its docstring are replaced by
    the fields and the docstring of the dataclass.

    Args:
        name: Name of the command.
        options: Dataclass of the options.
    """

    def run_command(**values: object) -> int:
        """Import the command's module, run it and return the exit code.

        Raises:
            ConfigError: An optional package is not installed.
        """
        try:
            module = importlib.import_module(f"dssc_jax.cli.commands.{name.replace('-', '_')}")
        except ModuleNotFoundError as error:
            if error.name not in EXTRAS:
                raise
            raise ConfigError(name, f"needs {error.name}: pip install 'dssc_jax[{EXTRAS[error.name]}]'") from None
        return module.run(options(**values))

    hints = get_type_hints(options, include_extras=True)
    parameters = []
    for field in sorted(fields(options), key=lambda field: help_rank(field, options, hints)):
        default = inspect.Parameter.empty if field.default is MISSING else field.default
        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters.append(inspect.Parameter(field.name, keyword, default=default, annotation=hints[field.name]))
    run_command.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
    run_command.__annotations__ = hints
    run_command.__doc__ = options.__doc__
    return run_command


def help_rank(field: "Field[object]", options: type, hints: dict[str, object]) -> int:
    """Return the rank of an option in the help: 0 for arguments, 1 for the command's options, 2 for shared ones.

    Args:
        field: Field of the option.
        options: Dataclass of the command's options; it inherits the shared ones.
        hints: Annotated types of the fields, by name.
    """
    if any(isinstance(note, ArgumentInfo) for note in get_args(hints[field.name])):
        return 0
    return 1 if field.name in options.__annotations__ else 2


for name, options in COMMANDS.items():
    app.command(name)(command(name, options))
