"""The error for a function that a lane's program cannot express."""

from typing import Any

LIBRARY_PATHS = ("/jax/", "\\jax\\", "<frozen", "dssc_jax/lanes")
"""Parts of the paths of files that belong to no model."""


class Unsupported(Exception):
    """An operation that has no translation.

    Args:
        reason: The reason why it has none.
        operation: The operation in quotes; empty: not yet known.
        call: The place where the model calls it, from :func:`origin`; empty: not yet known.
    """

    def __init__(self, reason: str, operation: str = "", call: str = "") -> None:
        """Begin with what is known; :meth:`locate` adds operation and call."""
        super().__init__(f"{operation}{call}: {reason}" if operation else reason)
        self.reason = reason
        self.operation = operation
        self.call = call

    def locate(self, equation: Any) -> "Unsupported":
        """This error with the operation and the call of an equation, where it lacks them.

        A call or a loop is an equation that contains others. Each level calls this method, from the inside out. The
        first equation gives the operation. The first equation with a source line in a model gives the call.
        """
        if self.call:
            return self
        operation = self.operation or f"'{equation.primitive.name}'"
        return Unsupported(self.reason, operation, call=origin(equation))


def origin(equation: Any) -> str:
    """The place where a model calls an operation, as " in FUNCTION (FILE:LINE)"; empty if no model calls it."""
    traceback = getattr(getattr(equation, "source_info", None), "traceback", None)
    for frame in getattr(traceback, "frames", ()):  # innermost first
        if not any(part in frame.file_name for part in LIBRARY_PATHS):
            return f" in {frame.function_name} ({frame.file_name}:{frame.line_num})"
    return ""
