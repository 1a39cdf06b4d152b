"""The command line. Heavy imports wait until a command needs them, so that help is instant."""

import importlib
import sys
import warnings

from dssc_jax.cli.shared import BAD_INPUT, DONE, INTERRUPTED, app
from dssc_jax.errors import ConfigError

for module in (
    "simulation",
    "robustness",
    "tuning",
    "designs",
    "about",
):  # each registers its commands; help lists them in this order
    importlib.import_module(f"dssc_jax.cli.{module}")


def say(text: str) -> None:
    """For people: one line on stderr, so that stdout stays for results; control characters are not passed on."""
    line = " ".join(text.split())
    print("".join(c if c.isprintable() else "?" for c in line), file=sys.stderr)


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
