"""The types of a certificate's content. :mod:`dssc_jax.proofs.verifier.well_formed` checks a file against them."""

from collections.abc import Mapping, Sequence
from typing import TypedDict

Interval = Sequence[float]
"""Lower and upper end."""
Box = Mapping[str, Interval]
"""Intervals of ``k_p`` [1/s], ``a_p`` [1/s] and, with a transfer function G(mu s), of ``rate``, 1/mu [1/s]."""


class Problem(TypedDict):
    """The loop of a certificate; :class:`dssc_jax.proofs.problem.ProofProblem` documents the entries."""

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
    """The entries that the stages of both methods have."""

    sigma: float  # bound of |sigma| [m/s] in the region
    e: float  # bound of |e| [m] in the region
    level: float  # bound of |d| [m/s], including the state's share
    slope: float  # bound of |d'| [m/s^2], including the state's share
    rate: float  # lambda [1/s], with which V = z'Pz falls
    p: Sequence[Sequence[float]]  # P, by rows
    method: str


class SmallGainStage(Stage):
    """A stage of the method "small gain": bounds of all signals that imply themselves."""

    gains: Sequence[float]  # of the middle loop, in the order of MIDDLE_GAINS
    bounds: Sequence[float]  # of |sigma - s|, |sigma|, |e|, |command + d_r|, |u_eq - d_r - f|, and of each state
    change: float  # bound of |sigma - s| [m/s], the change of sigma in a sample, in the region
    coordinate: str  # the integrator state in z: "u_av" for v, "phi_1" for q = v - phi_1(s)


class InvariantStage(Stage):
    """A stage of the method "invariant set": the set {z'Pz <= 1}."""

    pieces: int  # number of pieces of |sigma|, each with gains of its own
    degree: int  # of the polynomial in 1/mu that stands for the held plant
    multipliers: Sequence[float]  # mu_j [1/s] of P6
    coordinate: str  # the integrator state in z: "u_av" for v, "phi_1" for q = v - phi_1(s)
    moved: float  # bound of the change of e in a sample [m]


class BoxProof(TypedDict):
    """The proof of one box: the first stage covers every start, and each later stage begins where the last one ends."""

    box: Box
    stages: Sequence[SmallGainStage | InvariantStage]


class Certificate(TypedDict):
    """The content of a certificate's file: a problem, proofs of boxes, and whether the boxes cover the problem."""

    version: int
    complete: bool
    problem: Problem
    proofs: Sequence[BoxProof]
