"""``ConfigError``, the error for bad input: a one-line message raised before tracing."""

import difflib
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

LIBRARIES = ("site-packages", "dist-packages", "dssc_jax/", "dssc_jax\\", "<frozen", "<string>")
"""Parts of the names of files whose lines are not a user's own."""


class ConfigError(ValueError):
    """The error for bad input: where it is, which rule it violates, and the value found.

    Args:
        location: File and dotted path of the field, e.g. ``study.toml: plant.k_p``.
        rule: What must hold, and the value that does not.
    """

    def __init__(self, location: str, rule: str) -> None:
        """Make the message of location and rule."""
        self.where = location
        self.rule = rule
        super().__init__(f"{location}: {rule}" if location else rule)

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        """Tell pickle how to make the error again, because errors travel between the processes of a cluster."""
        return ConfigError, (self.where, self.rule)

    def within(self, place: str) -> "ConfigError":
        """Return the same error with ``place``, usually a file, in front of its location."""
        return ConfigError(f"{place}: {self.where}" if self.where else place, self.rule)

    def within_path(self, path: str) -> "ConfigError":
        """Return the same error with the dotted ``path`` of a table in front of the field's name."""
        return ConfigError(".".join(part for part in (path, self.where) if part), self.rule)


@contextmanager
def errors_under(path: str) -> Iterator[None]:
    """Put the dotted ``path`` of a table in front of the field's name in every error raised inside.

    Raises:
        ConfigError: The error raised inside, with the longer path.
    """
    try:
        yield
    except ConfigError as error:
        raise error.within_path(path) from None


@contextmanager
def errors_in_file(name: str) -> Iterator[None]:
    """Put the name of a file in front of every error raised inside: ``flight.ulg: signals.y: ...``.

    Raises:
        ConfigError: The error raised inside, with the file.
    """
    try:
        yield
    except ConfigError as error:
        raise error.within(name) from None


@contextmanager
def errors_in_code(subject: str, function: Callable[..., object]) -> Iterator[None]:
    """Turn any exception of a user's code into a ConfigError of one line, which tells the line of the user's file.

    Args:
        subject: The part of the study to which the code belongs.
        function: The user's function. The message gives its place if no line of the user's leads to the exception.

    Raises:
        ConfigError: The code raises an exception.
    """
    try:
        yield
    except ConfigError:
        raise
    except Exception as error:
        text = str(error).strip().partition("\n")[0]
        frames = traceback.extract_tb(error.__traceback__)
        user_frames = [frame for frame in frames if not is_of_library(frame.filename)]  # outermost first
        code = getattr(function, "__code__", None)
        location = ""
        if user_frames:
            location = f", in line {user_frames[-1].lineno} of {user_frames[-1].filename}"
        elif code is not None:
            location = f", in line {code.co_firstlineno} of {code.co_filename}"
        raise ConfigError(subject, f"{type(error).__name__}: {text}{location}") from error


def is_of_library(file: str) -> bool:
    """Whether a file of source code belongs to a library, and not to the user."""
    return any(part in file for part in LIBRARIES)


def fold_name(name: str) -> str:
    """Return a name in small letters without underscores and hyphens, so that similar spellings compare equal."""
    return name.lower().replace("_", "").replace("-", "")


def close_names(name: str, valid: Iterable[str]) -> list[str]:
    """Return the valid name nearest to a misspelt name, in a list of length 1; an empty list if no name is near.

    A valid name that is equal after :func:`fold_name` is nearest. If there is none, the most similar name is nearest.
    """
    names = sorted(map(str, valid))
    equal_names = [valid_name for valid_name in names if fold_name(valid_name) == fold_name(name)]
    return equal_names[:1] or difflib.get_close_matches(name, names, n=1, cutoff=0.6)


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: ``did you mean 'x_e'?``, or all valid names.

    Args:
        name: The unknown name.
        valid: The valid names.
    """
    names = sorted(map(str, valid))
    words = sorted(name.split("_"))
    reordered = [full for full in names if sorted(full.split("_")) == words]  # e_x for x_e
    closest = reordered or close_names(name, names)
    if not closest:  # people remember the last part of a dotted path
        _, _, tail = name.rpartition(".")
        closest = [full for full in names if full.rpartition(".")[2] == tail]
    if closest:
        return f"did you mean '{closest[0]}'?"
    return f"valid names are {', '.join(names) or 'none'}"
