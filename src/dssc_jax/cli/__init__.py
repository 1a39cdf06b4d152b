"""The command line. Heavy imports wait until a command needs them, so that help is instant."""

import gc
import importlib
import shlex
import sys
import warnings

import typer

from dssc_jax.cli.shared import BAD_INPUT, DONE, INTERRUPTED, app
from dssc_jax.errors import ConfigError

MODULES = ("simulation", "robustness", "tuning", "statistics", "stored", "reports", "designs", "about")
"""Each registers its commands; help lists them in this order."""

for module in MODULES:
    importlib.import_module(f"dssc_jax.cli.{module}")

LONGEST = 1000  # characters of a message
YOUNG = 100_000  # objects between two searches for garbage: imports and traces make a million that stay


def say(text: str) -> None:
    """For people: one line on stderr, so that stdout stays for results; control characters are not passed on."""
    line = " ".join(text.split())
    line = line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."
    print("".join(c if c.isprintable() else "?" for c in line), file=sys.stderr)


def main() -> None:
    """Entry point: one line for bad input, no traceback."""
    gc.set_threshold(YOUNG)
    code = guarded(sys.argv[1:])
    gc.freeze()  # what is left goes with the process: to look through it once more would take half a second
    sys.exit(code)


def how_to_go_on(arguments: list[str]) -> str:
    """The end of the message of an interruption: the command line that goes on, where there is one."""
    command = getattr(typer.main.get_command(app), "commands", {}).get(arguments[0] if arguments else "")
    if command is None or not any(option.name == "resume" for option in command.params):
        return ""
    resumed = arguments if "--resume" in arguments else [*arguments, "--resume"]
    return f"; what was finished is kept, go on with: {shlex.join(['dssc-jax', *resumed])}"


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
        say(f"interrupted{how_to_go_on(arguments)}")
    return code if isinstance(code, int) else DONE
