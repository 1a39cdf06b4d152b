"""The types of a certificate's content. :mod:`dssc_jax.proofs.verifier.well_formed` checks that a file has them."""

from collections.abc import Mapping, Sequence
from typing import TypedDict

Interval = Sequence[float]
Box = Mapping[str, Interval]
"""Intervals of k_p, a_p and, with a transfer function, of ``rate``, 1/mu."""


class Problem(TypedDict):
    """The loop: the entries of :class:`dssc_jax.proofs.problem.ProofProblem`, which documents them."""

    sample_time: float
    l0: float
    form: str
    functions: Mapping[str, float | str]
    rho: float | None
    nominal: tuple[float, float, bool] | None
    k_p: Interval
    a_p: Interval
    zero_a: Sequence[float]
    zero_c: Sequence[float]
    numerator: Sequence[float]
    denominator: Sequence[float]
    mu: Interval
    delay: float
    sensor_lag: float
    level: float
    slope: float
    reference: Sequence[float]
    initial: Sequence[Interval]
    start: str
    by_state: Sequence[float]
    reference_size: float


class Stage(TypedDict):
    """The entries of a stage of either method.

    ``sigma`` and ``e`` bound the region, ``level`` and ``slope`` the disturbance; ``rate`` is lambda, ``p`` is P.
    """

    sigma: float
    e: float
    level: float
    slope: float
    rate: float
    p: Sequence[Sequence[float]]
    method: str


class SmallGainStage(Stage):
    """A stage of the method "small gain"."""

    gains: Sequence[float]  # of the middle loop, from which those of the functions deviate
    bounds: Sequence[float]  # of the absolute values of the middle loop's signals, then of its states
    change: float  # bound of |sigma[k+1] - sigma[k]|
    coordinate: str  # quantity that the state z of the controller holds, one of COORDINATES


class InvariantStage(Stage):
    """A stage of the method "invariant set".

    ``pieces`` is the number of pieces of the region, ``degree`` that of the polynomial in 1/mu, ``multipliers`` are the
    mu_j of P6. ``coordinate`` is v or q, and ``moved`` bounds the change of e in a sample.
    """

    pieces: int
    degree: int
    multipliers: Sequence[float]
    coordinate: str
    moved: float


class BoxProof(TypedDict):
    """The proof of one box: the first stage holds the start, each other one begins where the one before it ends."""

    box: Box
    stages: Sequence[SmallGainStage | InvariantStage]


class Certificate(TypedDict):
    """The content of a certificate's file: a problem, the proofs of its boxes, and whether they cover the problem."""

    version: int
    complete: bool
    problem: Problem
    proofs: Sequence[BoxProof]
