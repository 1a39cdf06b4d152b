"""The bench of software that runs beside the controllers, such as the monitor: its files, and its recording.

The bench replays recorded flights, row by row. A row has the inputs of one call and the results that are expected after
it: the flags first, then the numbers of the state.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine.compiled_lanes import compiled_lanes
from dssc_jax.flight_code.parameters import numbers_of_draws
from dssc_jax.flight_code.template_files import fill, template_text
from dssc_jax.lanes.c.names import c_string
from dssc_jax.lanes.c.operations import c_type
from dssc_jax.lanes.interface import Signature
from dssc_jax.lanes.llvm.machine import usable_cores
from dssc_jax.study import Study

SINGLE = 32  # bits of a number
BATCH_BYTES = 64 << 20
"""Memory for the columns of the draws that are recorded together."""


class ReplayBench(NamedTuple):
    """The bench of one piece of software.

    Args:
        label: Name of the software in words, such as ``inner loop``; names of files and targets follow from it.
        prefix: Prefix of the software's functions and types in C.
        precision: Bits of a number.
        row: Name of the instant of a row: ``sample`` or ``tick``.
        inputs: Number of inputs in a row.
        results: Names of the results in a row.
        advance: Statements in C that give the inputs ``row`` to the state ``held``, fill ``results`` and return the
            flags; ``k`` is the number of the row.
        disturb: Statements in C that set numbers of ``held`` which a caller may change to ``hostile_number()``.
        stays_finite: Whether all results are finite whatever the inputs.
        shows_arithmetic: Whether results show every rounding, so that fast arithmetic is always detected.
    """

    label: str
    prefix: str
    precision: int
    row: str
    inputs: int
    results: Sequence[str]
    advance: Sequence[str]
    disturb: Sequence[str] = ("(void)held;",)
    stays_finite: bool = False
    shows_arithmetic: bool = False


def magic(label: str) -> str:
    """The text with which a recording begins."""
    return f"dssc-jax {label} 1"


def bench_files(bench: ReplayBench, recording: str) -> dict[str, str]:
    """Contents of the bench's source and of its part of the makefile, by the file's name.

    Args:
        bench: The bench.
        recording: Name of the file with its recording.
    """
    stem = bench.label.replace(" ", "_")
    target = bench.label.replace(" ", "-")
    source = fill(
        "replay_bench.c",
        same_bits=template_text("same_bits.c"),
        label=bench.label,
        target=target,
        name=bench.prefix,
        real=c_type(np.dtype(f"float{bench.precision}")),
        precision=str(bench.precision),
        inputs_count=str(bench.inputs),
        results_count=str(len(bench.results)),
        magic=magic(bench.label),
        names=", ".join(c_string(name) for name in bench.results),
        advance=bench.advance,
        row=bench.row,
        hostile=template_text("hostile.c"),
        limits="FLT" if bench.precision == SINGLE else "DBL",
        disturb=bench.disturb,
        stays_finite="1" if bench.stays_finite else "0",
    )
    makefile = fill(
        "replay_bench.mk",
        label=bench.label,
        target=target,
        stem=stem,
        variable=stem.upper(),
        name=bench.prefix,
        recording=recording,
        detected=f"detected: {target}-detected" if bench.shows_arithmetic else "",
    )
    return {f"{stem}_bench.c": source, f"{stem}.mk": makefile}


def recorded_columns(
    study: Study,
    lane: Callable[[dict[str, Any], jax.Array], Any],
    draws: int,
    constants: Mapping[str, float] | None = None,
) -> Iterator[tuple[dict[str, float], Any]]:
    """Run a recording lane for the first draws of a study, in strict arithmetic.

    Args:
        study: The study.
        lane: (numbers by name, draw index) -> a tree of columns.
        draws: Number of draws.
        constants: Numbers without a law that are inputs of the lane all the same, by their keys in ``Study.params``.
            The results that follow from them are then rounded at each operation, as they are in C.

    Returns:
        For each draw its numbers by name, and the tree of its columns.

    Raises:
        Unsupported: The lane has no strict machine code.
    """
    constants = constants or {}
    names = sorted({*study.laws, *constants})
    with arithmetic(study.config.loop.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        index = jax.ShapeDtypeStruct((), jnp.uint32)
        lanes = compiled_lanes(lane, dict.fromkeys(names, number), index, strict=True)
        batch = draws_of_batch(lanes.signature)
        for first_draw in range(0, draws, batch):
            indices = np.arange(first_draw, min(first_draw + batch, draws))
            values = numbers_of_draws(study, indices, constants)
            inputs = {name: values[name] for name in names}
            wait_for_columns = lanes.start((inputs, indices), len(indices), usable_cores())
            columns = wait_for_columns()
            for row in range(len(indices)):
                numbers = {name: float(column[row]) for name, column in values.items()}
                yield numbers, jax.tree.map(lambda column, row=row: column[row], columns)


def draws_of_batch(signature: Signature) -> int:
    """Number of draws whose columns fill :data:`BATCH_BYTES`, in whole vectors of lanes, but at least one vector.

    Args:
        signature: Types and lengths of a lane's outputs, and the number of lanes in a vector.
    """
    lane_bytes = sum(dtype.itemsize * (length or 1) for dtype, length in signature.outputs)
    vectors = max(1, BATCH_BYTES // (lane_bytes * signature.width))
    return vectors * signature.width


def recording_bytes(label: str, flights: Iterator[np.ndarray], precision: int) -> Iterator[bytes]:
    """The bytes of recorded flights for the bench, little-endian; each begins with its number of rows.

    Args:
        label: As of :class:`ReplayBench`.
        flights: The rows of each flight, shape (rows, inputs and results).
        precision: Bits of a number.
    """
    real = np.dtype(f"<f{precision // 8}")
    yield magic(label).encode() + bytes([precision])
    for rows in flights:
        yield np.array([len(rows)], "<u4").tobytes() + np.ascontiguousarray(rows, real).tobytes()
