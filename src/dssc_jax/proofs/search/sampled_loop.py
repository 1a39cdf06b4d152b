"""The sampled loop in sliding, z+ = A z + B w, in floating point: what the search works with.

z = (chi, v, s), chi = (e, e', eta, zeta, m): errors, zero dynamics, k_p times what the unmodelled dynamics or the delay
hold, the sensor's memory, u_av and the previous sigma. With f what the reference adds to the nominal control, and d_r =
d - (y_m'' + a_p y_m')/k_p, zeta is relative to -d_r and v to d_r + f, so that U = k_p (command + d_r) vanishes where
the loop rests. Between samples chi' = F chi + G U, and

    v+ = v + K_P (sigma - s) + T_s K_I sigma - Delta,    s+ = sigma,    chi+ = Phi chi + Gamma U + theta,

where Delta is the change of d_r + f and theta the effect of d_r(t) - d_r(t_k) within the sample. A is affine in each of
k_p, K_P, K_I and K_N, so a convex function of z+ is largest at their ends. In the coordinate phi_1 of the conservative
form, q = v - phi_1(s) takes the place of v. docs/proofs.md derives these equations.
"""

from collections.abc import Iterable
from functools import lru_cache
from itertools import product
from math import comb
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS
from dssc_jax.proofs.problem import Box, Interval, ProofProblem

INNER_STEPS = 16  # of a sample, after each of which its inside is evaluated
ROOM = 1.02  # widening of a bound, so that the verifier's enclosure fits in


class LoopGains(NamedTuple):
    """K_P [1], K_I [1/s], and K_N [1] of the nominal control's term 1/tau_m."""

    k_p: float
    k_i: float
    k_n: float


class LoopPoint(NamedTuple):
    """A plant and gains: k_p [1/s], a_p [1/s], 1/mu [1/s; 0 without G], and the gains."""

    k_p: float
    a_p: float
    rate: float
    gains: LoopGains


class Step(NamedTuple):
    """One sample z+ = A z + B w of a plant with given gains.

    Args:
        a: A, (n, n).
        b: B, (n, inputs): columns for the changes of d_r + f and of -f, and for theta's components, of size 1 each.
        rows: Rows of the measured e, of e, of the measured sigma, and of sigma - s, (4, n).
        command: Row of the command plus d_r, (n,).
        push: Column with which this command acts, (n,).
        jump: k_p times what a change of d_r adds to zeta, (n,).
    """

    a: np.ndarray
    b: np.ndarray
    rows: np.ndarray
    command: np.ndarray
    push: np.ndarray
    jump: np.ndarray


class HeldSample(NamedTuple):
    """The plant over a sample with a held command, chi+ = Phi chi + Gamma U.

    Args:
        phi: Phi, (n - 2, n - 2).
        gamma: Gamma, (n - 2,).
    """

    phi: np.ndarray
    gamma: np.ndarray


class StateLayout(NamedTuple):
    """Places in z: of zeta and of the sensor's memory, and the number of all states."""

    zeta: slice
    memory: slice
    n: int


class SignalSizes(NamedTuple):
    """Bounds, over a box, of the disturbance with the reference's share, d_r, and of the nominal control's share, f.

    Args:
        level: Bound of |d_r| [m/s].
        slope: Bound of |d_r'| [m/s^2].
        feed_slope: Bound of |f'| [m/s^2].
        offset: Bound of |d_r + f| [m/s].
        offset_slope: Bound of the derivative of d_r + f [m/s^2].
    """

    level: float
    slope: float
    feed_slope: float
    offset: float
    offset_slope: float


def state_layout(problem: ProofProblem) -> StateLayout:
    """Places of the states in z."""
    zeta_start = 2 + len(problem.zero_a)
    memory = zeta_start + max(len(problem.denominator), len(problem.delay_weights)) - 1
    end = memory + (2 if problem.sensor_lag else 0)
    return StateLayout(slice(zeta_start, memory), slice(memory, end), end + 2)


def signal_sizes(problem: ProofProblem, box: Box) -> SignalSizes:
    """Bounds of d_r and f over a box of plants; the module's text defines both."""
    speed, acceleration, jerk = problem.reference
    a_n, k_n, _ = problem.nominal or (0.0, np.inf, False)
    plants = list(product(box["k_p"], box["a_p"]))
    feed_weights = (problem.nominal is not None) * np.array([1.0, abs(a_n)]) / k_n
    k_low = box["k_p"][0]
    disturbance_weights = np.array([1.0, max(map(abs, box["a_p"]))]) / k_low
    offset_weights = np.max([[abs(1.0 / k_n - 1.0 / k_p), abs(a_n / k_n - a_p / k_p)] for k_p, a_p in plants], axis=0)
    level_terms = np.array([acceleration, speed])
    slope_terms = np.array([jerk, acceleration])
    return SignalSizes(
        level=float(problem.level + disturbance_weights @ level_terms),
        slope=float(problem.slope + disturbance_weights @ slope_terms),
        feed_slope=float(feed_weights @ slope_terms),
        offset=float(problem.level + offset_weights @ level_terms),
        offset_slope=float(problem.slope + offset_weights @ slope_terms),
    )


def companion_form(problem: ProofProblem) -> tuple[np.ndarray, np.ndarray, float]:
    """G(mu s) in companion form: coefficients a_0 .. a_(n-1) of the monic denominator, output row, feedthrough."""
    leading = problem.denominator[-1]
    denominator = np.array(problem.denominator) / leading
    numerator = np.zeros(denominator.size)
    numerator[: len(problem.numerator)] = problem.numerator
    numerator = numerator / leading
    output = numerator[:-1] - numerator[-1] * denominator[:-1]
    return denominator[:-1], output, float(numerator[-1])


def held_plant(problem: ProofProblem, a_p: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """F and G of chi' = F chi + G U at a_p and 1/mu [1/s], (n - 2, n - 2) and (n - 2,); memories are at rest."""
    eta = len(problem.zero_a)
    zeta, _, n = state_layout(problem)
    f = np.zeros((n - 2, n - 2))
    g = np.zeros(n - 2)
    f[0, 1] = 1.0
    f[1, 1] = -a_p
    f[1, 2 : 2 + eta] = np.negative(problem.zero_c)
    for i in range(eta - 1):
        f[2 + i, 3 + i] = 1.0
    if eta:
        f[1 + eta, 1] = 1.0
        f[1 + eta, 2 : 2 + eta] = np.negative(problem.zero_a)
    if problem.denominator:
        a, f[1, zeta], g[1] = companion_form(problem)
        for i in range(zeta.start, zeta.stop - 1):
            f[i, i + 1] = rate
        f[zeta.stop - 1, zeta] = -rate * a
        g[zeta.stop - 1] = rate
    else:
        g[1], *f[1, zeta] = problem.delay_weights
    return f, g


@lru_cache(maxsize=256)
def flow(problem: ProofProblem, a_p: float, rate: float, time: float) -> tuple[np.ndarray, np.ndarray]:
    """The exact solution of x' = F x + G u over a time t [s] with u held: exp(F t), and the integral of exp(F s) G.

    Shapes (n, n) and (n,). The matrices are cached, so callers must not change them.
    """
    exponential = expm(held_matrix(problem, a_p, rate) * time)
    return exponential[:-1, :-1], exponential[:-1, -1]


def held_matrix(problem: ProofProblem, a_p: float, rate: float) -> np.ndarray:
    """[[F, G], [0, 0]] of the held plant at a_p and 1/mu [1/s], (n - 1, n - 1)."""
    f, g = held_plant(problem, a_p, rate)
    size = f.shape[0]
    generator = np.zeros((size + 1, size + 1))
    generator[:size, :size] = f
    generator[:size, size] = g
    return generator


def sensor_weights(problem: ProofProblem) -> tuple[float, float]:
    """kappa and lambda of a sensor's lag: it shows (1 - kappa) y + m, and m+ = lambda m + kappa (1 - lambda) y."""
    if not problem.sensor_lag:
        return 0.0, 0.0
    steps = problem.sample_time / problem.sensor_lag
    return float(-np.expm1(-steps) / steps), float(np.exp(-steps))


def held_matrices(problem: ProofProblem, a_p: float, rate: float) -> HeldSample:
    """Phi and Gamma of one sample at a_p and 1/mu [1/s], in which the memories of delay and sensor move on."""
    return with_next_memories(problem, HeldSample(*map(np.copy, flow(problem, a_p, rate, problem.sample_time))))


def with_next_memories(problem: ProofProblem, sample: HeldSample) -> HeldSample:
    """Replace, in place, the rows of the memories of delay and sensor, which change at the samples only."""
    phi, gamma = sample
    zeta, memory, _ = state_layout(problem)
    if not problem.denominator:
        for i in range(zeta.start, zeta.stop):
            phi[i] = np.eye(phi.shape[0])[i - 1] * (i > zeta.start)
            gamma[i] = i == zeta.start
    kappa, memory_decay = sensor_weights(problem)
    for i in range(memory.start, memory.stop):
        phi[i] = 0.0
        phi[i, i] = memory_decay
        phi[i, i - memory.start] = kappa * (1.0 - memory_decay)
    return sample


def control_points(problem: ProofProblem, a_p: float, rates: Interval, degree: int) -> list[HeldSample]:
    """Phi and Gamma whose hull holds those of every 1/mu in an interval, up to the remainder of a Taylor polynomial.

    The Taylor polynomial about the middle of the interval is a convex combination of its coefficients in Bernstein's
    basis.

    Args:
        problem: The problem.
        a_p: Damping [1/s].
        rates: Interval of 1/mu [1/s].
        degree: Degree of the polynomial.
    """
    low, high = rates
    if low == high:
        return [held_matrices(problem, a_p, low)]
    n = state_layout(problem).n
    centre = held_matrix(problem, a_p, middle(rates)) * problem.sample_time
    origin = held_matrix(problem, a_p, 0.0) * problem.sample_time
    slope = (centre - origin) / middle(rates) * (0.5 * (high - low))
    blocks = expm(np.kron(np.eye(degree + 1), centre) + np.kron(np.eye(degree + 1, k=1), slope))
    terms = [blocks[: n - 1, k * (n - 1) : (k + 1) * (n - 1)] for k in range(degree + 1)]
    result = []
    for i in range(degree + 1):
        point = np.sum([bernstein_weight(degree, i, k) * term for k, term in enumerate(terms)], axis=0)
        result.append(with_next_memories(problem, HeldSample(point[:-1, :-1].copy(), point[:-1, -1].copy())))
    return result


def bernstein_weight(degree: int, i: int, k: int) -> float:
    """Share of the k-th term of a polynomial on [-1, 1] in its i-th coefficient in Bernstein's basis."""
    signed_sum = sum((-1) ** (k - j) * comb(i, j) * comb(degree - i, k - j) for j in range(k + 1))
    return signed_sum / comb(degree, k)


def step_of(
    problem: ProofProblem,
    point: LoopPoint,
    box: Box,
    *,
    is_integrated: bool = False,
    held_sample: HeldSample | None = None,
) -> Step:
    """The matrices of one sample.

    Args:
        problem: The problem.
        point: Plant and gains.
        box: Intervals over which the inputs are bounded, which are scaled to size 1.
        is_integrated: Whether z holds q = v - phi_1(s) in place of v; then the first gain is phi_1/sigma.
        held_sample: Phi and Gamma; None: those of the point.
    """
    zeta, memory, n = state_layout(problem)
    t = problem.sample_time
    chi = n - 2
    unit = np.eye(n)
    sizes = signal_sizes(problem, box)
    phi, gamma = held_sample or held_matrices(problem, point.a_p, point.rate)
    kappa, _ = sensor_weights(problem)
    e, speed, *_, v, s = unit
    if problem.sensor_lag:
        e, speed = (1.0 - kappa) * e + unit[memory.start], (1.0 - kappa) * speed + unit[memory.start + 1]
    sigma = speed + problem.l0 * e
    v_row = v + t * point.gains.k_i * sigma + (0.0 if is_integrated else point.gains.k_p) * (sigma - s)
    command = -v_row - (point.gains.k_p if is_integrated else 0.0) * sigma
    if problem.nominal:
        a_n, k_n, _ = problem.nominal
        command = command - ((a_n - problem.l0) * problem.l0 * e + (problem.l0 - a_n) * sigma) / k_n
        command = command - point.gains.k_n * sigma
    a = np.zeros((n, n))
    push = np.zeros(n)
    jump = np.zeros(n)
    a[:chi, :chi] = phi
    push[:chi] = point.k_p * gamma
    a += np.outer(push, command)
    a[n - 2] = v_row
    a[n - 1] = sigma
    if problem.denominator:
        jump[zeta.start] = point.k_p / companion_form(problem)[0][0]
    else:
        jump[zeta] = point.k_p
    columns = [t * sizes.offset_slope * (jump - v), t * sizes.feed_slope * jump]
    bounds = inside_bound(problem, point, box)
    columns += [bound * unit[i] for i, bound in enumerate(bounds[: zeta.start])]
    return Step(
        a=a,
        b=np.stack(columns, axis=1),
        rows=np.stack([e, unit[0], sigma, sigma - s]),
        command=command,
        push=push,
        jump=jump,
    )


def inside_bound(problem: ProofProblem, point: LoopPoint, box: Box) -> np.ndarray:
    """Bounds of the components of theta, the effect of d_r's change within a sample.

    d_r changes by at most D t after a time t and acts through exp(F t) k_p b, so that a component is below D T_s^2/2
    times the largest |exp(F t) k_p b| in the sample.
    """
    inner, _ = flow(problem, point.a_p, point.rate, problem.sample_time / INNER_STEPS)
    states = [np.eye(inner.shape[0])[1]]
    for _ in range(INNER_STEPS):
        states.append(inner @ states[-1])
    slope = signal_sizes(problem, box).slope
    return ROOM * 0.5 * slope * problem.sample_time**2 * box["k_p"][1] * np.max(np.abs(states), axis=0)


def interval_ends(interval: Interval) -> tuple[float, ...]:
    """Both ends, or the one value."""
    return interval if interval[0] < interval[1] else interval[:1]


def middle(interval: Interval) -> float:
    """The middle of an interval."""
    return 0.5 * (interval[0] + interval[1])


def box_middle(box: Box, gains: dict[str, Interval]) -> LoopPoint:
    """The plant and the gains at the middle of their intervals."""
    middle_gains = LoopGains(middle(gains["k_p"]), middle(gains["k_i"]), middle(gains["k_n"]))
    rate = middle(box.get("rate", (0.0, 0.0)))
    return LoopPoint(middle(box["k_p"]), middle(box["a_p"]), rate, middle_gains)


def box_steps(
    problem: ProofProblem,
    box: Box,
    gains: dict[str, Interval],
    degree: int,
    *,
    is_integrated: bool,
) -> Iterable[Step]:
    """Steps of the loop over one sample, at every corner of plant and gains and at the control points of 1/mu."""
    names = ("mean" if is_integrated else "k_p", "k_i", "k_n")
    rates = box.get("rate", (0.0, 0.0))
    for a_p in interval_ends(box["a_p"]):
        for held_sample in control_points(problem, a_p, rates, degree):
            for k_p in interval_ends(box["k_p"]):
                for corner in product(*(interval_ends(gains[name]) for name in names)):
                    point = LoopPoint(k_p, a_p, middle(rates), LoopGains(*corner))
                    yield step_of(problem, point, box, is_integrated=is_integrated, held_sample=held_sample)


def start_corners(problem: ProofProblem, box: Box, ratio: Interval) -> list[np.ndarray]:
    """Every corner of the states in which the loop may start, (n,) each.

    z is affine in the initial state, in each signal and in the ratio, so that every start is in the corners' hull.

    Args:
        problem: The problem.
        box: Intervals of the plant.
        ratio: Interval of -v/sigma, or of -q/sigma, at the start, by :func:`dssc_jax.proofs.search.gains.start_ratio`.
    """
    zeta, memory, n = state_layout(problem)
    sizes = signal_sizes(problem, box)
    kappa, _ = sensor_weights(problem)
    pairs = {(d, f) for d in (-sizes.level, sizes.level) for f in (-sizes.offset, sizes.offset)}
    if not any(problem.reference):  # d_r and d_r + f are the same
        pairs = {(d, d) for d, _ in pairs}
    result = []
    for plant in product(*(interval_ends(interval) for interval in problem.initial)):
        sigma = plant[1] + problem.l0 * plant[0]
        s = 0.0 if problem.start == "zero" else sigma
        for (level, offset), k_p in product(pairs, interval_ends(box["k_p"])):
            for share in interval_ends(ratio):
                z = np.zeros(n)
                z[: len(plant)] = plant
                if problem.denominator:
                    z[zeta.start] = k_p * level / companion_form(problem)[0][0]
                else:
                    z[zeta] = k_p * level
                z[memory] = kappa * np.array(plant[:2])[: memory.stop - memory.start]
                z[n - 2] = -offset - share * s
                z[n - 1] = s
                result.append(z)
    return result


def functions_of(problem: ProofProblem) -> Any:
    """The state-dependent functions of a problem, a member of :data:`GAIN_FUNCTIONS`."""
    constants = dict(problem.functions)
    return GAIN_FUNCTIONS[constants.pop("kind")].members[None](**constants)
