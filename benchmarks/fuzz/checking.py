"""Programs as machine code of lanes, compared with the referee."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.fuzz.draft import needed_part
from benchmarks.fuzz.generate import SINGLES
from benchmarks.fuzz.program import Kind, Program, abstract, scalars, text
from benchmarks.fuzz.referee import Referee
from benchmarks.fuzz.values import column
from dssc_jax.engine import kernels
from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.interface import AXIS
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.tracing.translate import Translator, traced_program
from dssc_jax.lanes.unsupported import Unsupported

LANES_OF_SINGLES, LANES = 965, 193  # no whole numbers of vectors
SECOND_TRIAL = 64
"""Replicas for a program whose result seems wrong."""

CLEAR = 0.05
"""A result whose relative spread is larger says nothing."""

WIDTHS = (None, 1, 4, 8)
MODES = {"fast": False, "strict": True}


class Entry(NamedTuple):
    """A program of a unit.

    Args:
        seed: Its seed.
        program: The program.
    """

    seed: int
    program: Program


class Verdict(NamedTuple):
    """What a comparison says of a program.

    Args:
        compared: Results that were compared.
        skipped: Results of which nothing can be said.
        wrong: An example of a wrong result; empty if there is none.
    """

    compared: int
    skipped: int
    wrong: str


def lanes_of(seed: int) -> int:
    """How many lanes a program runs on."""
    return LANES_OF_SINGLES if seed < SINGLES else LANES


def inputs_of(program: Program, count: int) -> list[np.ndarray]:
    """The columns that a program reads."""
    pairs = zip(program.inputs, program.slots, strict=True)
    return [column(kind.dtype, slot, count, 1) for kind, slot in pairs]


class Gate:
    """Tells what the compiler refuses; it traces each elementary function once for many programs."""

    def __init__(self) -> None:
        self.translator = Translator(Builder(fast=True))

    def refusal(self, program: Program) -> str:
        """Why the compiler refuses a program; empty if it takes it.

        Raises:
            Exception: Whatever else the compiler does with it.
        """
        try:
            traced_program(self.translator, scalars(program), *abstract(program.inputs))
        except Unsupported as problem:
            self.translator = Translator(Builder(fast=True))
            return str(problem)
        except Exception:
            self.translator = Translator(Builder(fast=True))
            raise
        return ""


def computed(programs: Sequence[Program], count: int, strict: bool, width: int | None) -> list[list[np.ndarray]]:
    """The results of several programs, compiled as one."""
    wanted: dict[tuple[Kind, int], int] = {}
    for program in programs:
        for pair in zip(program.inputs, program.slots, strict=True):
            wanted.setdefault(pair, len(wanted))

    def lane(*columns: Any) -> list[Any]:
        results = []
        for program in programs:
            pairs = zip(program.inputs, program.slots, strict=True)
            results.append(scalars(program)(*(columns[wanted[pair]] for pair in pairs)))
        return results

    kinds = [kind for kind, _ in wanted]
    columns = [column(kind.dtype, slot, count, 1) for kind, slot in wanted]
    return CompiledLanes(lane, *abstract(kinds), strict=strict, width=width).start(tuple(columns), count, 1)()


def judged(program: Program, results: Sequence[np.ndarray], fast: bool, count: int, replicas: int = 8) -> Verdict:
    """Compare a program's results with the referee's."""
    referee, columns = Referee(fast, replicas), inputs_of(program, count)
    expected = flattened(referee.results(program, columns))
    results = single_columns(results)
    factor = 1.0 if referee.noisy <= 1 else 3.0
    compared, skipped = 0, 0
    for position, (result, reference) in enumerate(zip(results, expected, strict=True)):
        if result.dtype != reference.dtype:
            return Verdict(0, 0, f"result {position} is of type {result.dtype} instead of {reference.dtype}")
        wrong, unclear = differences(result, reference, fast, factor)
        compared, skipped = compared + int((~unclear).sum()), skipped + int(unclear.sum())
        if wrong.any():
            return Verdict(compared, skipped, example(program, columns, position, result, reference, wrong))
    return Verdict(compared, skipped, "")


def flattened(expected: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Arrays element by element, as a lane returns them."""
    columns = []
    for value in expected:
        columns += [value[(..., *position)] for position in np.ndindex(*value.shape[2:])]
    return columns


def single_columns(results: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Recordings sample by sample."""
    return [column for result in results for column in (result.T if result.ndim == 2 else [result])]


def differences(result: np.ndarray, reference: np.ndarray, fast: bool, factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Which lanes are wrong, and of which nothing can be said.

    Args:
        result: Of the machine code, shape (lanes,).
        reference: Of the referee, shape (replicas, lanes).
        fast: In fast arithmetic zeros have no sign.
        factor: Of the spread of the replicas, the admitted error.
    """
    first = reference[0]
    if result.dtype.kind not in "fc" and result.dtype.kind != "V":
        unclear = (reference != first).any(0)
        return ~unclear & (result != first), unclear
    if result.dtype.kind == "c":
        parts = [differences(part(result), part(reference), fast, factor) for part in (np.real, np.imag)]
        return parts[0][0] | parts[1][0], parts[0][1] & parts[1][1]
    with np.errstate(all="ignore"):
        wide, got = reference.astype(np.longdouble), result.astype(np.longdouble)
        base = wide[0]
        same = ((wide == base) | (np.isnan(wide) & np.isnan(base))).all(0)
        usual = np.isfinite(wide).all(0)
        spread = np.where(usual, np.abs(wide - base).max(0), 0)
        unclear = ~same & (~usual | (spread > CLEAR * np.abs(base)))
        near = np.abs(got - base) <= factor * spread
        equal = (got == base) | (np.isnan(got) & np.isnan(base))
        if not fast:
            signs = np.signbit(reference)
            equal &= (base != 0) | (signs != signs[0]).any(0) | (np.signbit(result) == signs[0])
        return ~unclear & ~np.where(same, equal, near), unclear


def example(program: Program, columns: Sequence[np.ndarray], position: int, result: np.ndarray, reference: np.ndarray,
            wrong: np.ndarray) -> str:  # fmt: skip
    """A wrong result in words."""
    lane = int(np.flatnonzero(wrong)[0])
    shown = ", ".join(f"v{i}={column[lane]!r}" for i, column in enumerate(columns))
    spread = "" if (reference[:, lane] == reference[0, lane]).all() else f" (.. {reference[1, lane]!r})"
    return (
        f"{int(wrong.sum())} of {len(wrong)} lanes, result {position}: {shown}: "
        f"{result[lane]!r} instead of {reference[0, lane]!r}{spread}"
    )


def checked(entry: Entry, results: Sequence[np.ndarray], fast: bool) -> Verdict:
    """The verdict on a program; a wrong result is judged again with more disturbances."""
    count = lanes_of(entry.seed)
    verdict = judged(entry.program, results, fast, count)
    return judged(entry.program, results, fast, count, SECOND_TRIAL) if verdict.wrong else verdict


def culprit(program: Program, seed: int, strict: bool, width: int | None) -> str:
    """The first operation of a program whose result is wrong, with all that it reads, and plain XLA's result."""
    count = lanes_of(seed)
    for number in range(len(program.inputs), len(program.inputs) + len(program.nodes)):
        part = needed_part(Program(program.inputs, program.slots, program.nodes, [number]))
        if part.nodes[-1].operation == "constant" or not part.inputs:
            continue
        try:
            (results,) = computed([part], count, strict, width)
        except Exception as problem:
            return f"{type(problem).__name__}: {problem}\n{text(part)}"
        verdict = checked(Entry(seed, part), results, not strict)
        if verdict.wrong:
            return f"{verdict.wrong}\n{text(part)}"
    return f"only with the others:\n{text(program)}"


def falls_back(program: Program) -> str:
    """What is wrong with how a refused program falls back: no warning, or no result; empty if nothing."""
    lane = scalars(program)

    def numbers(values: dict[str, Any], index: Any) -> list[Any]:
        return lane(*(jax.lax.convert_element_type(values["a"], jnp.dtype(kind.dtype)) for kind in program.inputs))

    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        try:
            start = kernels.compile_batches("lanes", numbers, ["a"], 16, None, None)
            start({"a": np.arange(16.0)}, np.arange(16))()
        except Exception as problem:
            return "" if xla_fails(program) else f"no result: {type(problem).__name__}: {problem}"
    told = [str(warning.message) for warning in raised if issubclass(warning.category, kernels.KernelWarning)]
    return "" if told and "no machine code for " in told[0] else "no warning"


def xla_fails(program: Program) -> bool:
    """Whether plain XLA has no result, either."""
    try:
        by_xla(program, LANES)
    except Exception:
        return True
    return False


def by_xla(program: Program, count: int) -> list[np.ndarray]:
    """The results of plain XLA."""
    function: Callable[..., Any] = jax.vmap(scalars(program), axis_name=AXIS)
    return [np.asarray(value) for value in jax.jit(function)(*inputs_of(program, count))]
