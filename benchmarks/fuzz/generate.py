"""Programs from seeds: each operation alone in every type, then random ones of 1 to 12 operations."""

import numpy as np

from benchmarks.fuzz.draft import Draft, Misfit
from benchmarks.fuzz.program import Program
from benchmarks.fuzz.recipes import LONG, RECIPES, SELDOM, UNUSUAL
from benchmarks.fuzz.values import TYPES

VARIANTS = 12
"""Programs of each operation and type."""

NAMES = tuple(RECIPES)
SINGLES = len(NAMES) * len(TYPES) * VARIANTS
"""Seeds of programs of one operation; those beyond make random programs."""

SIZES = np.arange(1, 13)
"""Numbers of operations of a random program, small ones more often."""
MOST_OUTPUTS = 4


def generate(seed: int) -> Program | None:
    """The program of a seed; None if JAX has no such operation for its type."""
    rng = np.random.default_rng([seed, 38])
    return single(seed, rng) if seed < SINGLES else several(rng)


def single(seed: int, rng: np.random.Generator) -> Program | None:
    """One operation in one type."""
    number = seed // VARIANTS
    name, dtype = NAMES[number // len(TYPES)], TYPES[number % len(TYPES)]
    draft = Draft(rng)
    for _ in range(3):
        try:
            result = RECIPES[name](draft, dtype)
        except Misfit:
            continue
        program = draft.program([result])
        return program if program.inputs else None
    return None


def several(rng: np.random.Generator) -> Program:
    """A random program; what nobody reads of it is returned."""
    common = [dtype for dtype in TYPES if dtype not in SELDOM]
    weights = np.array([8.0 if dtype == "float64" else 3.0 if dtype == "float32" else 1.0 for dtype in common])
    usual = [name for name in NAMES if name not in UNUSUAL]
    while True:
        draft, wanted = Draft(rng), int(rng.choice(SIZES, p=1.0 / SIZES / (1.0 / SIZES).sum()))
        main, made = rng.choice(common, 3, p=weights / weights.sum()), 0
        for _ in range(20 * wanted):
            if made == wanted:
                break
            name = (
                usual[int(rng.integers(len(usual)))] if rng.random() < 0.995 else NAMES[int(rng.integers(len(NAMES)))]
            )
            if name in LONG and rng.random() < 0.6:
                continue
            dtype = str(rng.choice(main) if rng.random() < 0.99 else rng.choice(TYPES))
            try:
                RECIPES[name](draft, dtype)
                made += 1
            except Misfit:
                continue
        outputs = unread(draft)
        if outputs and draft.wanted:
            program = draft.program(outputs[-MOST_OUTPUTS:])
            if program.inputs:
                return program


def unread(draft: Draft) -> list[int]:
    """Results that no operation reads, but constants."""
    read = {operand for node in draft.nodes for operand in node.operands}
    numbers = range(1000, draft.fresh)
    return [i for i, node in zip(numbers, draft.nodes, strict=True) if i not in read and node.operation != "constant"]
