"""The entry point of the command line: signals, exit codes, and errors as one line."""

import atexit
import gc
import os
import re
import shlex
import signal
import sys
import warnings
from contextlib import suppress
from dataclasses import fields
from types import FrameType
from typing import NoReturn

from dssc_jax.cli.application import COMMANDS, SYNONYMS, app
from dssc_jax.cli.exit_codes import BAD_INPUT, DONE
from dssc_jax.cli.output import say, show_warning
from dssc_jax.core.errors import ConfigError

END_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end a command as Ctrl-C does: finished work is kept."""
SIGNAL_CODES = [128 + number for number in END_SIGNALS]
"""Exit codes of a command that a signal ended."""
CRASHED = 1
"""Exit code after an exception, which is that of Python."""
HUNG_UP = 129
"""Exit code after SIGHUP, the signal of a terminal that is closed."""
RECEIVED_CODES: list[int] = []
"""Exit codes of the signals that this process has received."""
COLLECTION_THRESHOLD = 1_000_000
"""Number of new objects before a garbage collection; imports and traces create a million objects that stay."""


def main() -> None:
    """Run the command line; bad input gives a one-line message without a traceback."""
    gc.set_threshold(COLLECTION_THRESHOLD)
    warnings.showwarning = show_warning
    codes = [CRASHED]
    atexit.register(lambda: exit_at_once(codes[-1]))  # libraries register their callbacks later, which run first
    for number in END_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup sets SIG_IGN
            signal.signal(number, handle_signal)
    try:
        code = guarded(sys.argv[1:])
    except BaseException:
        if not RECEIVED_CODES:  # a library may turn the end by a signal into an error of its own
            raise
        code = RECEIVED_CODES[0]
    code = RECEIVED_CODES[0] if RECEIVED_CODES else code
    if code in SIGNAL_CODES:  # threads may still run machine code, which Python would wait for and then pull away
        exit_at_once(code)
    codes.append(code)
    sys.exit(code)


def exit_at_once(code: int) -> NoReturn:
    """End the process without Python's final clean-up of all objects, which would take up to half a second."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(code)


def handle_signal(number: int, _: FrameType | None) -> None:
    """Stop the running command by an exception, so that its folders are closed and its processes end."""
    RECEIVED_CODES.append(128 + number)
    discard_closed_output()
    if number == signal.SIGINT:
        raise KeyboardInterrupt  # a search may end with the best so far
    raise SystemExit(128 + number)


def discard_closed_output() -> bool:
    """Discard further output if its terminal is closed; return whether it is."""
    is_closed = False
    with open(os.devnull, "w") as nowhere:
        for stream in (1, 2):
            try:
                os.write(stream, b"")
            except OSError:
                os.dup2(nowhere.fileno(), stream)
                is_closed = True
    return is_closed


def continuation(arguments: list[str]) -> str:
    """The command line that continues interrupted work, for the end of a message; empty if there is none."""
    options = COMMANDS.get(arguments[0] if arguments else "")
    if options is None or "resume" not in {field.name for field in fields(options)}:
        return ""
    resumed = arguments if "--resume" in arguments else [*arguments, "--resume"]
    return f"; finished blocks are kept, continue with: {shlex.join(['dssc-jax', *resumed])}"


def with_options(text: str, arguments: list[str]) -> str:
    """Write arguments of Python in a message as options of the command line: `argument` becomes --argument."""
    options = COMMANDS.get(arguments[0] if arguments else "")
    names = {field.name for field in fields(options)} if options else set()

    def option(match: re.Match[str]) -> str:
        name = match[1]
        return f"--{name.replace('_', '-')}" if name in names else match[0]

    return re.sub(r"`(\w+)`", option, text)


def guarded(arguments: list[str]) -> int:
    """Run a command, report an exception that ends it in one line, and return the exit code."""
    suggestion = SYNONYMS.get(arguments[0].lower()) if arguments else None
    if suggestion is not None:
        answer = f"dssc-jax {suggestion} answers that, see dssc-jax {suggestion} --help"
        say(f"error: '{arguments[0]}' is no command; {answer}")
        return BAD_INPUT
    try:
        code = app(arguments or ["--help"], standalone_mode=False)
    except SystemExit as ending:
        code = ending.code
    except ConfigError as error:
        say(f"error: {with_options(str(error), arguments)}")
        return BAD_INPUT
    except MemoryError:
        say("error: not enough memory for so many draws, points or samples")
        return BAD_INPUT
    except OSError as error:
        if discard_closed_output():  # the progress met the closed terminal before the signal came
            return HUNG_UP
        say(f"error: {error.filename or 'a file'}: {error.strerror or error}")
        return BAD_INPUT
    except Exception as error:
        usage = getattr(error, "format_message", None)  # typer's errors of usage
        if usage is None:
            raise
        say(f"error: {usage()}")
        return BAD_INPUT
    if code in SIGNAL_CODES:
        say(f"interrupted{continuation(arguments)}")
    return code if isinstance(code, int) else DONE
