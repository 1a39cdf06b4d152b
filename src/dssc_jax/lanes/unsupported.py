"""The error for a function that a lane's program cannot express."""

from typing import Any


class Unsupported(Exception):
    """An operation that has no translation.

    Args:
        reason: The reason why it has none.
        operation: The operation in quotes; empty: not yet known.
        call: The place where the model calls it, from :func:`origin`; empty: not yet known.
    """

    def __init__(self, reason: str, operation: str = "", call: str = "") -> None:
        super().__init__(f"{operation}{call}: {reason}" if operation else reason)
        self.reason = reason
        self.operation = operation
        self.call = call

    def locate(self, equation: Any) -> "Unsupported":
        """This error with the place of an equation.

        Each level of nested equations calls it, from the inside out. The first equation gives the operation. The first
        equation with a source line in a model gives the call.
        """
        if self.call:
            return self
        return Unsupported(self.reason, self.operation or f"'{equation.primitive.name}'", origin(equation))


def origin(equation: Any) -> str:
    """The place where a model calls an operation, in words: function, file and line; empty if no model calls it."""
    traceback = getattr(getattr(equation, "source_info", None), "traceback", None)
    for frame in getattr(traceback, "frames", ()):
        if not any(part in frame.file_name for part in ("/jax/", "\\jax\\", "<frozen", "dssc_jax/lanes")):
            return f" in {frame.function_name} ({frame.file_name}:{frame.line_num})"
    return ""
