"""The error for a function that a lane's program cannot express."""

from typing import Any

LIBRARY_PATHS = ("/jax/", "\\jax\\", "<frozen", "dssc_jax/lanes")
"""Parts of the paths of files that belong to no model."""


class Unsupported(Exception):
    """An operation that has no translation.

    Args:
        reason: The reason why the operation has no translation.
        operation: Name of the operation in quotes; empty: not yet known.
        call: The place where the model calls the operation, from :func:`origin`; empty: not yet known.
    """

    def __init__(self, reason: str, operation: str = "", call: str = "") -> None:
        """Begin with what is known; :meth:`locate` adds operation and call."""
        super().__init__(f"{operation}{call}: {reason}" if operation else reason)
        self.reason = reason
        self.operation = operation
        self.call = call

    def locate(self, equation: Any) -> "Unsupported":
        """Return this error, completed by the operation and the source line of an equation if it lacks them.

        A call or a loop is an equation that contains others. The translation of each of these levels calls this method,
        from the inside out. The innermost equation gives the operation. The innermost equation with a source line in a
        model gives the call.
        """
        if self.call:
            return self
        operation = self.operation or f"'{equation.primitive.name}'"
        return Unsupported(self.reason, operation, call=origin(equation))


def origin(equation: Any) -> str:
    """Return the place where a model calls an operation, as " in FUNCTION (FILE:LINE)".

    The text is empty if no line of a model led to the equation.
    """
    traceback = getattr(getattr(equation, "source_info", None), "traceback", None)
    for frame in getattr(traceback, "frames", ()):  # innermost first
        if not any(part in frame.file_name for part in LIBRARY_PATHS):
            return f" in {frame.function_name} ({frame.file_name}:{frame.line_num})"
    return ""
