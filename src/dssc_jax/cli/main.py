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
"""Exit code after an exception that nothing handles; Python uses the same one."""
HUNG_UP = 129
"""Exit code after SIGHUP, the signal that a process receives when its terminal is closed."""
RECEIVED_CODES: list[int] = []
"""Exit codes for the signals that this process has received, in their order."""
COLLECTION_THRESHOLD = 1_000_000
"""Number of new objects that starts a garbage collection. Imports and traces create a million objects that stay."""


def main() -> None:
    """Run the command line and end the process; bad input gives a one-line message without a traceback."""
    gc.set_threshold(COLLECTION_THRESHOLD)
    warnings.showwarning = show_warning
    exit_code = CRASHED  # until a command has returned
    atexit.register(lambda: exit_at_once(exit_code))  # runs last, because libraries register their callbacks later
    for number in END_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup sets SIG_IGN
            signal.signal(number, handle_signal)
    try:
        code = guarded(sys.argv[1:])
    except BaseException:
        if not RECEIVED_CODES:  # with a signal, a library may have raised an error of its own in its place
            raise
        code = RECEIVED_CODES[0]
    if RECEIVED_CODES:
        code = RECEIVED_CODES[0]
    if code in SIGNAL_CODES:  # Python would unload machine code that threads may still run
        exit_at_once(code)
    exit_code = code
    sys.exit(code)


def exit_at_once(code: int) -> NoReturn:
    """End the process without Python's final clean-up of all objects, which may take half a second."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(code)


def handle_signal(number: int, _: FrameType | None) -> None:
    """Stop the running command by an exception, so that it closes its folders and ends its processes.

    Args:
        number: The signal that was received.

    Raises:
        KeyboardInterrupt: The signal is SIGINT (Ctrl-C); a search may catch it and end with the best so far.
        SystemExit: It is another signal.
    """
    RECEIVED_CODES.append(128 + number)
    discard_closed_output()
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


def discard_closed_output() -> bool:
    """Redirect standard output and error to nowhere if their terminal is closed; return whether one was."""
    is_closed = False
    with open(os.devnull, "w") as null_device:
        for descriptor in (1, 2):
            try:
                os.write(descriptor, b"")
            except OSError:
                os.dup2(null_device.fileno(), descriptor)
                is_closed = True
    return is_closed


def continuation(arguments: list[str]) -> str:
    """Tell by which command line interrupted work continues; empty if the command has no ``--resume``.

    Args:
        arguments: The interrupted command line, without the program's name.
    """
    if "resume" not in option_names(arguments):
        return ""
    resumed = arguments if "--resume" in arguments else [*arguments, "--resume"]
    return f"; finished blocks are kept, continue with: {shlex.join(['dssc-jax', *resumed])}"


def with_options(text: str, arguments: list[str]) -> str:
    """Return a message in which `argument` is replaced by --argument, if the command has such an option.

    Args:
        text: The message, whose words are those of Python.
        arguments: The command line, without the program's name.
    """
    names = option_names(arguments)

    def option(match: re.Match[str]) -> str:
        """The option for a quoted name; the text as it is if there is no such option."""
        name = match[1]
        return f"--{name.replace('_', '-')}" if name in names else match[0]

    return re.sub(r"`(\w+)`", option, text)


def option_names(arguments: list[str]) -> set[str]:
    """Names of the options of the command that a command line begins with, as in Python; empty without a command."""
    options = COMMANDS.get(arguments[0]) if arguments else None
    return set() if options is None else {field.name for field in fields(options)}


def guarded(arguments: list[str]) -> int:
    """Run a command and return its exit code; an exception that ends the command is reported in one line.

    Args:
        arguments: The command line, without the program's name.

    Raises:
        Exception: It is neither bad input nor an error of the operating system, but a fault of the program.
    """
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
        if discard_closed_output():  # the progress bar wrote to the closed terminal before the signal came
            return HUNG_UP
        say(f"error: {error.filename or 'a file'}: {error.strerror or error}")
        return BAD_INPUT
    except Exception as error:
        format_message = getattr(error, "format_message", None)  # only typer's usage errors have it
        if format_message is None:
            raise
        say(f"error: {format_message()}")
        return BAD_INPUT
    if code in SIGNAL_CODES:
        say(f"interrupted{continuation(arguments)}")
    return code if isinstance(code, int) else DONE
