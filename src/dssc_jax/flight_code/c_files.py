"""The parts that all generated sources and headers in C share."""

from collections.abc import Iterable, Sequence

import numpy as np

from dssc_jax.flight_code.template_files import fill
from dssc_jax.lanes.c.operations import c_type

LENGTH_ERROR = 1e-3
"""Largest deviation from 1 of the length of a vector that should have it."""


def source_file(label: str, header: str, remarks: Iterable[str], body: str) -> str:
    """A source: its first comment, the includes, the refusal of other arithmetic, and its body.

    Args:
        label: What it computes, in words, such as ``monitor``.
        header: Name of its header.
        remarks: Lines of the first comment.
        body: Definitions of all that it has.
    """
    return fill("source.c", label=label, header=header, comment=remarks, body=body)


def header_file(name: str, remarks: Iterable[str], declarations: str) -> str:
    """A header for C and C++.

    Args:
        name: Its file's name without ending.
        remarks: Lines of the first comment.
        declarations: All that it declares.
    """
    return fill("header.h", comment=remarks, guard=f"{name.upper()}_H", declarations=declarations)


def absolute_value(real: np.dtype) -> str:
    """C's function for an absolute value."""
    return "fabsf" if real.itemsize == 4 else "fabs"


def finite_function(real: np.dtype) -> str:
    """The function ``is_finite``, which fast arithmetic does not break."""
    largest = "FLT_MAX" if real.itemsize == 4 else "DBL_MAX"
    return fill("is_finite.c", real=c_type(real), fabs=absolute_value(real), largest=largest)


def finite(members: Sequence[str]) -> str:
    """The condition that numbers are finite."""
    return "\n        && ".join(f"is_finite({member})" for member in members)


def of_length_1(members: Sequence[str], real: np.dtype) -> str:
    """The condition that the length of a vector is 1, up to :data:`LENGTH_ERROR`."""
    suffix = "f" if real.itemsize == 4 else ""
    square = " + ".join(f"{member} * {member}" for member in members)
    return f"{absolute_value(real)}({square} - 1.0{suffix}) <= {2.0 * LENGTH_ERROR:g}{suffix}"


def joined_definitions(definitions: Iterable[str]) -> str:
    """Definitions with an empty line behind each."""
    return "".join(f"{definition}\n\n" for definition in definitions)
