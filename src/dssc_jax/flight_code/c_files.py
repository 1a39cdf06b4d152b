"""The parts that all generated sources and headers in C share."""

from collections.abc import Iterable, Sequence

import numpy as np

from dssc_jax.flight_code.template_files import fill
from dssc_jax.lanes.c.operations import c_type
from dssc_jax.lanes.c.text import comment

LENGTH_ERROR = 1e-3
"""Largest deviation from 1 of the length of a vector that should have it."""


def source_file(label: str, header: str, remarks: Iterable[str], body: str) -> str:
    """A source file in C: first comment, includes, the refusal of fast arithmetic, and body.

    Args:
        label: Name of the software in words, such as ``monitor``.
        header: Name of its header file.
        remarks: Lines of the first comment.
        body: All definitions.
    """
    return fill("source.c", label=label, header=header, comment=remarks, body=body)


def header_file(name: str, remarks: Iterable[str], declarations: str) -> str:
    """A header file for C and C++.

    Args:
        name: Name of the file without ending.
        remarks: Lines of the first comment.
        declarations: All declarations.
    """
    return fill("header.h", comment=remarks, guard=f"{name.upper()}_H", declarations=declarations)


def comment_lines(sentences: Iterable[str]) -> list[str]:
    """The lines of a comment in C for each sentence, one after the other."""
    lines = []
    for sentence in sentences:
        lines += comment(sentence)
    return lines


def absolute_value(real: np.dtype) -> str:
    """Name of C's function for the absolute value of a number of a dtype."""
    return "fabsf" if real.itemsize == 4 else "fabs"


def finite_function(real: np.dtype) -> str:
    """The definition of the function ``is_finite`` in C, which is right in fast arithmetic, too."""
    largest = "FLT_MAX" if real.itemsize == 4 else "DBL_MAX"
    return fill("is_finite.c", real=c_type(real), fabs=absolute_value(real), largest=largest)


def finite_condition(members: Sequence[str]) -> str:
    """The condition in C that all of some numbers are finite."""
    return "\n        && ".join(f"is_finite({member})" for member in members)


def unit_length_condition(members: Sequence[str], real: np.dtype) -> str:
    """The condition in C that a vector has the length 1, up to :data:`LENGTH_ERROR`; ``members`` are its components."""
    suffix = "f" if real.itemsize == 4 else ""
    square = " + ".join(f"{member} * {member}" for member in members)
    square_error = 2.0 * LENGTH_ERROR  # (1 + error)^2 - 1, to first order
    return f"{absolute_value(real)}({square} - 1.0{suffix}) <= {square_error:g}{suffix}"


def joined_definitions(definitions: Iterable[str]) -> str:
    """Definitions in C as one text, with an empty line after each."""
    return "".join(f"{definition}\n\n" for definition in definitions)
