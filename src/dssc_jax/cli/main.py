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

from dssc_jax.cli.application import COMMANDS, MEANT, app
from dssc_jax.cli.exit_codes import BAD_INPUT, DONE
from dssc_jax.cli.output import say, show_warning
from dssc_jax.core.errors import ConfigError

ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end a command as Ctrl-C does: finished work is kept."""
INTERRUPTED = [128 + number for number in ENDING]
"""Exit codes of a command that a signal ended."""
CRASHED = 1  # exit code after an exception, as Python has it
HUNG_UP = 129  # as if the terminal's signal had come
RECEIVED: list[int] = []
"""Exit codes of the signals that have come to this process."""
YOUNG = 1_000_000  # objects between two garbage collections: imports and traces create a million that stay


def main() -> None:
    """Run the command line; bad input gives a one-line message without a traceback."""
    gc.set_threshold(YOUNG)
    warnings.showwarning = show_warning
    codes = [CRASHED]
    atexit.register(lambda: leave(codes[-1]))  # libraries' own callbacks are registered later and come first
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:  # as nohup has it
            signal.signal(number, end)
    try:
        code = guarded(sys.argv[1:])
    except BaseException:
        if not RECEIVED:  # a library may turn the end by a signal into an error of its own
            raise
        code = RECEIVED[0]
    code = RECEIVED[0] if RECEIVED else code
    if code in INTERRUPTED:  # threads may still run machine code, which Python would wait for and then pull away
        leave(code)
    codes.append(code)
    sys.exit(code)


def leave(code: int) -> NoReturn:
    """End the process without Python's final clean-up of every object, which would take up to half a second."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(code)


def end(number: int, _: FrameType | None) -> None:
    """Stop the running command; its folders are closed and its processes end."""
    RECEIVED.append(128 + number)
    discard_closed_output()
    if number == signal.SIGINT:
        raise KeyboardInterrupt  # a search may end with the best so far
    raise SystemExit(128 + number)


def discard_closed_output() -> bool:
    """Send further output nowhere if its terminal is closed; return whether it is."""
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
    """The end of an interruption's message: the command line that continues the work, if there is one."""
    options = COMMANDS.get(arguments[0] if arguments else "")
    if options is None or "resume" not in {field.name for field in fields(options)}:
        return ""
    resumed = arguments if "--resume" in arguments else [*arguments, "--resume"]
    return f"; finished blocks are kept, continue with: {shlex.join(['dssc-jax', *resumed])}"


def with_options(text: str, arguments: list[str]) -> str:
    """A message in which each `argument` that is an option of the command has the option's form, --argument."""
    options = COMMANDS.get(arguments[0] if arguments else "")
    names = {field.name for field in fields(options)} if options else set()

    def option(match: re.Match[str]) -> str:
        name = match[1]
        return f"--{name.replace('_', '-')}" if name in names else match[0]

    return re.sub(r"`(\w+)`", option, text)


def guarded(arguments: list[str]) -> int:
    """Run a command and turn an exception that ends it into an exit code."""
    suggestion = MEANT.get(arguments[0].lower()) if arguments else None
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
    if code in INTERRUPTED:
        say(f"interrupted{continuation(arguments)}")
    return code if isinstance(code, int) else DONE
