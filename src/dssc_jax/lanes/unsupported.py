"""The error for a function that a lane's program cannot express."""

from typing import Any


class Unsupported(Exception):
    """An operation that has no translation.

    Args:
        reason: What is missing.
        place: The operation, and where the model calls it; empty until it is known.
    """

    def __init__(self, reason: str, place: str = "") -> None:
        super().__init__(f"{place}: {reason}" if place else reason)
        self.reason, self.place = reason, place

    def at(self, equation: Any) -> "Unsupported":
        """The same, with the innermost operation that it comes from, and the innermost call by a model."""
        name = self.place or f"'{equation.primitive.name}'"
        return self if " in " in name else Unsupported(self.reason, f"{name}{origin(equation)}")


def origin(equation: Any) -> str:
    """Where a model calls an operation: function, file and line; empty if the trace does not tell."""
    traceback = getattr(getattr(equation, "source_info", None), "traceback", None)
    for frame in getattr(traceback, "frames", ()):
        if not any(part in frame.file_name for part in ("/jax/", "\\jax\\", "<frozen", "dssc_jax/lanes")):
            return f" in {frame.function_name} ({frame.file_name}:{frame.line_num})"
    return ""
