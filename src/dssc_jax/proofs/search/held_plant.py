"""The plant between two samples, chi' = F chi + G U with U held, in floating point.

chi = (e, e', eta, zeta, m): the error and its rate, the zero dynamics eta, the state zeta of the unmodelled dynamics
G(mu s) or of a delay, which holds commands, times k_p, and the memory m of a sensor's lag. Over a sample chi+ = Phi chi
+ Gamma U. Since U = k_p (command + d_r) contains k_p, no entry of F and G does.
"""

from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from dssc_jax.proofs.problem import Interval, ProofProblem, middle


class HeldSample(NamedTuple):
    """The plant with a held command over a sample, or over another time: chi+ = Phi chi + Gamma U.

    Args:
        phi: Phi, shape (n - 2, n - 2).
        gamma: Gamma, shape (n - 2,).
    """

    phi: np.ndarray
    gamma: np.ndarray


class StateLayout(NamedTuple):
    """The places of zeta and of the sensor's memory m in z = (e, e', eta, zeta, m, v, s), and the length n of z."""

    zeta: slice
    memory: slice
    n: int


def state_layout(problem: ProofProblem) -> StateLayout:
    """Places of zeta and m in z = (e, e', eta, zeta, m, v, s), and the length of z, for a problem."""
    zeta_start = 2 + len(problem.zero_a)
    # a denominator of degree n has n states; a delay holds all its commands but the one that acts first
    zeta_end = zeta_start + max(len(problem.denominator), len(problem.delay_weights)) - 1
    memory_end = zeta_end + (2 if problem.sensor_lag else 0)  # of y and y'
    return StateLayout(slice(zeta_start, zeta_end), slice(zeta_end, memory_end), memory_end + 2)


class CompanionForm(NamedTuple):
    """G(mu s) as a state-space system in companion form.

    Args:
        a: a_0 to a_(n-1), the coefficients of the monic denominator in rising powers of mu s, without the leading 1.
        output: Output row over the n states, shape (n,).
        direct: Feedthrough from the input to the output.
    """

    a: np.ndarray
    output: np.ndarray
    direct: float


def companion_form(problem: ProofProblem) -> CompanionForm:
    """G(mu s) in companion form."""
    leading = problem.denominator[-1]
    denominator = np.array(problem.denominator) / leading
    numerator = np.zeros(denominator.size)
    numerator[: len(problem.numerator)] = problem.numerator
    numerator = numerator / leading
    output = numerator[:-1] - numerator[-1] * denominator[:-1]
    return CompanionForm(denominator[:-1], output, float(numerator[-1]))


def held_plant(problem: ProofProblem, a_p: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """F and G of chi' = F chi + G U; the memories of a delay and of the sensor do not change within a sample.

    Args:
        problem: The loop and its uncertain numbers.
        a_p: Damping [1/s].
        rate: 1/mu [1/s] of G(mu s); unused without a transfer function.

    Returns:
        F, shape (n - 2, n - 2), and G, shape (n - 2,).
    """
    order = len(problem.zero_a)  # of the zero dynamics
    zeta, _, n = state_layout(problem)
    f = np.zeros((n - 2, n - 2))
    g = np.zeros(n - 2)
    f[0, 1] = 1.0  # e
    f[1, 1] = -a_p  # e'' = -a_p e' - zero_c eta + the unmodelled dynamics' output
    f[1, 2 : 2 + order] = np.negative(problem.zero_c)
    for i in range(order - 1):  # eta_i' = eta_(i+1), and the last one is driven by e'
        f[2 + i, 3 + i] = 1.0
    if order:
        f[1 + order, 1] = 1.0
        f[1 + order, 2 : 2 + order] = np.negative(problem.zero_a)
    if problem.denominator:
        dynamics = companion_form(problem)
        f[1, zeta] = dynamics.output
        g[1] = dynamics.direct
        for i in range(zeta.start, zeta.stop - 1):  # mu zeta_i' = zeta_(i+1), and the last one is driven by U
            f[i, i + 1] = rate
        f[zeta.stop - 1, zeta] = -rate * dynamics.a
        g[zeta.stop - 1] = rate
    else:  # a weighted sum of the command and of those before it, which zeta holds
        g[1] = problem.delay_weights[0]
        f[1, zeta] = problem.delay_weights[1:]
    return f, g


@lru_cache(maxsize=256)
def flow(problem: ProofProblem, a_p: float, rate: float, time: float) -> HeldSample:
    """The exact solution of chi' = F chi + G U after some time with U held: chi(t) = exp(F t) chi(0) + gamma(t) U.

    Args:
        problem: The loop and its uncertain numbers.
        a_p: Damping [1/s].
        rate: 1/mu [1/s].
        time: t [s].

    Returns:
        Phi = exp(F t) and Gamma = gamma(t), the integral of exp(F r) G over r from 0 to t. Both are cached, so callers
        must not change them.
    """
    exponential = expm(held_matrix(problem, a_p, rate) * time)
    return HeldSample(phi=exponential[:-1, :-1], gamma=exponential[:-1, -1])


def held_matrix(problem: ProofProblem, a_p: float, rate: float) -> np.ndarray:
    """[[F, G], [0, 0]], shape (n - 1, n - 1); its exponential solves the held plant.

    Args:
        problem: The loop and its uncertain numbers.
        a_p: Damping [1/s].
        rate: 1/mu [1/s] of G(mu s); unused without a transfer function.
    """
    f, g = held_plant(problem, a_p, rate)
    size = f.shape[0]
    generator = np.zeros((size + 1, size + 1))
    generator[:size, :size] = f
    generator[:size, size] = g
    return generator


class SensorWeights(NamedTuple):
    """Weights of a sensor's lag, which measures (1 - kappa) y + m at a sample, with a memory m.

    Args:
        kappa: Share of y that the measurement leaves out.
        decay: lambda, the factor of m in a sample: m+ = lambda m + kappa (1 - lambda) y.
    """

    kappa: float
    decay: float


def sensor_weights(problem: ProofProblem) -> SensorWeights:
    """The weights of a sensor's lag; both are 0 for an exact sensor."""
    if not problem.sensor_lag:
        return SensorWeights(0.0, 0.0)
    ratio = problem.sample_time / problem.sensor_lag  # T_s/mu_s
    return SensorWeights(kappa=float(-np.expm1(-ratio) / ratio), decay=float(np.exp(-ratio)))


def held_matrices(problem: ProofProblem, a_p: float, rate: float) -> HeldSample:
    """Phi and Gamma of one whole sample, including the step of the memories at the sample's end.

    Args:
        problem: The loop and its uncertain numbers.
        a_p: Damping [1/s].
        rate: 1/mu [1/s] of G(mu s); unused without a transfer function.
    """
    phi, gamma = flow(problem, a_p, rate, problem.sample_time)
    return with_next_memories(problem, HeldSample(phi.copy(), gamma.copy()))


def with_next_memories(problem: ProofProblem, sample: HeldSample) -> HeldSample:
    """Replace, in place, the rows of Phi and Gamma for the memories of delay and sensor, which change at samples only.

    Args:
        problem: The loop and its uncertain numbers.
        sample: Phi and Gamma of one sample, which are changed and returned.
    """
    phi, gamma = sample
    zeta, memory, _ = state_layout(problem)
    if not problem.denominator:  # zeta holds past commands, the youngest first: each takes the place of the next older
        phi[zeta] = 0.0
        gamma[zeta] = 0.0
        for i in range(zeta.start, zeta.stop):
            if i == zeta.start:
                gamma[i] = 1.0
            else:
                phi[i, i - 1] = 1.0
    kappa, decay = sensor_weights(problem)
    phi[memory] = 0.0
    for signal, i in enumerate(range(memory.start, memory.stop)):  # states 0 and 1 are e and e'
        phi[i, i] = decay
        phi[i, signal] = kappa * (1.0 - decay)
    return sample


def control_points(problem: ProofProblem, a_p: float, rates: Interval, degree: int) -> list[HeldSample]:
    """Points of Phi and Gamma whose convex hull contains, nearly, those of every 1/mu in an interval.

    The points are the coefficients, in Bernstein's basis, of the Taylor polynomial of exp([[F, G], [0, 0]] T_s) in 1/mu
    about the middle. On the interval the polynomial is a convex combination of them. Its remainder is left out; the
    verifier adds it.

    Args:
        problem: The loop and its uncertain numbers.
        a_p: Damping [1/s].
        rates: Interval of 1/mu [1/s].
        degree: Degree of the polynomial.
    """
    low, high = rates
    if low == high:
        return [held_matrices(problem, a_p, low)]
    size = state_layout(problem).n - 1
    centre = held_matrix(problem, a_p, middle(rates)) * problem.sample_time
    origin = held_matrix(problem, a_p, 0.0) * problem.sample_time
    slope = (centre - origin) / middle(rates) * (0.5 * (high - low))  # change from the middle to the upper end
    # the exponential of centre (x) I + slope (x) N, with a nilpotent N, has the Taylor terms in its first block row
    blocks = expm(np.kron(np.eye(degree + 1), centre) + np.kron(np.eye(degree + 1, k=1), slope))
    terms = [blocks[:size, k * size : (k + 1) * size] for k in range(degree + 1)]
    points = []
    for i in range(degree + 1):
        point = np.sum([bernstein_weight(degree, i, k) * term for k, term in enumerate(terms)], axis=0)
        held_sample = HeldSample(phi=point[:-1, :-1].copy(), gamma=point[:-1, -1].copy())
        points.append(with_next_memories(problem, held_sample))
    return points


def bernstein_weight(degree: int, i: int, k: int) -> float:
    """The i-th coefficient of x^k in Bernstein's basis of the polynomials of a degree on [-1, 1].

    Args:
        degree: Degree of the basis.
        i: Number of the coefficient, 0 to ``degree``.
        k: Power of x, 0 to ``degree``.
    """
    signed_sum = sum((-1) ** (k - j) * comb(i, j) * comb(degree - i, k - j) for j in range(k + 1))
    return signed_sum / comb(degree, k)
