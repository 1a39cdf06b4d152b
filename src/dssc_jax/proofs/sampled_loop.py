"""The sampled loop in sliding, z+ = A z + B w, in floating point: what the search works with.

z = (e, e', eta, zeta, v, s): errors, zero dynamics, k_p times the lag's states plus d, u_av minus d, and the previous
sigma. With U = k_p (u + d) held, chi = (e, e', eta, zeta) obeys chi' = F chi + G U between samples, and

    v+ = v + K_P (sigma - s) + T_s K_I sigma - Delta,    s+ = sigma,    sigma = e' + l0 e,
    chi+ = Phi chi + k_p Gamma (u_n - v - K_P (sigma - s) - T_s K_I sigma) + theta,    zeta+ also + k_p Delta,

where Delta = d(t_(k+1)) - d(t_k) and theta is the effect of d(t) - d(t_k) within the sample. A is affine in each of
k_p, K_P, K_I and K_N, so a convex function of z+ is largest at their ends. docs/proofs.md derives these equations.
"""

from collections.abc import Iterable
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from dssc_jax.proofs.problem import Interval, ProofProblem

INNER_POINTS = 17  # points of a sample at which its inside is evaluated
ROOM = 1.02  # widening of a bound, so that the verifier's enclosure fits in


class LoopGains(NamedTuple):
    """K_P [1], K_I [1/s], and K_N [1] of the nominal control's term 1/tau_m."""

    k_p: float
    k_i: float
    k_n: float


class LoopPoint(NamedTuple):
    """A plant and gains: k_p [1/s], a_p [1/s], 1/mu [1/s; 0 without lag], the gains, and the largest k_p of its box."""

    k_p: float
    a_p: float
    rate: float
    gains: LoopGains
    largest_k_p: float


class Step(NamedTuple):
    """One sample.

    Args:
        a: (n, n).
        b: (n, inputs): columns for Delta and for each component of theta, of size one each.
        rows: Rows of e, e', sigma and sigma - s, (4, n).
        command: Row of u + d, (n,).
        push: k_p Gamma, how the command acts, (n,).
    """

    a: np.ndarray
    b: np.ndarray
    rows: np.ndarray
    command: np.ndarray
    push: np.ndarray


def state_sizes(problem: ProofProblem) -> tuple[int, int, int]:
    """Numbers of eta, of zeta, and of all states."""
    eta, lag = len(problem.zero_a), problem.lag_order
    return eta, lag, 4 + eta + lag


def held_plant(problem: ProofProblem, a_p: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """F and G of chi' = F chi + G U."""
    eta, lag, n = state_sizes(problem)
    f, g = np.zeros((n - 2, n - 2)), np.zeros(n - 2)
    f[0, 1], f[1, 1] = 1.0, -a_p
    f[1, 2 : 2 + eta] = np.negative(problem.zero_c)
    for i in range(eta - 1):
        f[2 + i, 3 + i] = 1.0
    if eta:
        f[1 + eta, 1], f[1 + eta, 2 : 2 + eta] = 1.0, np.negative(problem.zero_a)
    first = 2 + eta
    for i in range(lag):
        f[first + i, first + i] = -rate
        if i:
            f[first + i, first + i - 1] = rate
    if lag:
        f[1, first + lag - 1], g[first] = 1.0, rate
    else:
        g[1] = 1.0
    return f, g


def held_matrices(problem: ProofProblem, a_p: float, rate: float, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Phi and Gamma over a time."""
    f, g = held_plant(problem, a_p, rate)
    size = f.shape[0]
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size], whole[:size, size] = f * time, g * time
    whole = expm(whole)
    return whole[:size, :size], whole[:size, size]


def step_of(problem: ProofProblem, point: LoopPoint) -> Step:
    """The matrices of one sample, with inputs scaled by their bounds."""
    _, lag, n = state_sizes(problem)
    t, chi = problem.sample_time, n - 2
    phi, gamma = held_matrices(problem, point.a_p, point.rate, t)
    e, speed, s = np.eye(n)[0], np.eye(n)[1], np.eye(n)[n - 1]
    sigma = speed + problem.l0 * e
    change = point.gains.k_p * (sigma - s) + t * point.gains.k_i * sigma
    command = -np.eye(n)[n - 2] - change
    if problem.nominal:
        a_n, k_n, _ = problem.nominal
        command = command - ((a_n - problem.l0) * problem.l0 * e + (problem.l0 - a_n) * sigma) / k_n
        command = command - point.gains.k_n * sigma
    a = np.zeros((n, n))
    a[:chi, :chi] = phi
    push = np.concatenate([point.k_p * gamma, [0.0, 0.0]])
    a += np.outer(push, command)
    a[n - 2] = np.eye(n)[n - 2] + change
    a[n - 1] = sigma
    jump = np.zeros(n)
    jump[chi - lag : chi], jump[n - 2] = point.k_p, -1.0
    columns = [t * problem.slope * jump]
    bounds = inside_bound(problem, point)
    columns += [bound * np.eye(n)[i] for i, bound in enumerate(bounds[: chi - lag])]
    return Step(a, np.stack(columns, axis=1), np.stack([e, speed, sigma, sigma - s]), command, push)


def inside_bound(problem: ProofProblem, point: LoopPoint) -> np.ndarray:
    """Bound of each component of theta: D T_s^2/2 times the largest |exp(F t) k_p b| within a sample."""
    times = np.linspace(0.0, problem.sample_time, INNER_POINTS)
    largest = np.max([np.abs(held_matrices(problem, point.a_p, point.rate, t)[0][:, 1]) for t in times], axis=0)
    return ROOM * 0.5 * problem.slope * problem.sample_time**2 * point.largest_k_p * largest


def interval_ends(interval: Interval) -> tuple[float, ...]:
    """Both ends, or the one value."""
    return interval if interval[0] < interval[1] else interval[:1]


def middle(interval: Interval) -> float:
    """The middle of an interval."""
    return 0.5 * (interval[0] + interval[1])


def box_middle(box: dict[str, Interval], gains: dict[str, Interval]) -> LoopPoint:
    """The middle of plant and gains."""
    own = LoopGains(*(middle(gains[name]) for name in ("k_p", "k_i", "k_n")))
    return LoopPoint(middle(box["k_p"]), middle(box["a_p"]), middle(box.get("rate", (0.0, 0.0))), own, box["k_p"][1])


def box_corners(box: dict[str, Interval], gains: dict[str, Interval]) -> Iterable[LoopPoint]:
    """Every corner of plant and gains."""
    names = ("k_p", "k_i", "k_n")
    for k_p, a_p, rate in product(*(interval_ends(box.get(name, (0.0, 0.0))) for name in ("k_p", "a_p", "rate"))):
        for corner in product(*(interval_ends(gains[name]) for name in names)):
            yield LoopPoint(k_p, a_p, rate, LoopGains(*corner), box["k_p"][1])


def start_corners(problem: ProofProblem) -> list[np.ndarray]:
    """Every corner of the states in which the loop may start: z is affine in the initial state and in d(0)."""
    _, lag, n = state_sizes(problem)
    result = []
    for plant in product(*(interval_ends(interval) for interval in problem.initial)):
        for level in {-problem.level, problem.level}:
            for k_p in interval_ends(problem.k_p):
                z = np.zeros(n)
                z[: len(plant)] = plant
                z[n - 2 - lag : n - 2], z[n - 2] = k_p * level, -level
                z[n - 1] = plant[1] + problem.l0 * plant[0] if problem.matched else 0.0
                result.append(z)
    return result


def functions_of(problem: ProofProblem) -> Any:
    """The state-dependent functions."""
    from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS

    own = dict(problem.functions)
    return GAIN_FUNCTIONS[own.pop("kind")].members[None](**own)
