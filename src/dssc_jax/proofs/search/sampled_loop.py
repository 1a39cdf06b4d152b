"""The sampled loop in sliding, z+ = A z + B w with |w_j| <= 1, in floating point.

z = (chi, v, s), where chi = (e, e', eta, zeta, m) is the plant's state in :mod:`dssc_jax.proofs.search.held_plant`, v
is u_av and s the sigma of the sample before. Disturbance and reference act together in d_r = d - (y_m'' + a_p y_m')/k_p
and in f, the nominal control's share of the reference. zeta is counted from -d_r and v from d_r + f, so that U = k_p
(command + d_r) vanishes where the loop rests. In a sample

    v+ = v + K_P (sigma - s) + T_s K_I sigma - Delta,    s+ = sigma,    chi+ = Phi chi + Gamma U + theta,

where Delta is the change of d_r + f, and theta the effect of d_r(t) - d_r(t_k) within the sample. With the coordinate q
= v - phi_1(s) in place of v, q+ = q + T_s phi_2 - Delta. A is affine in each of k_p, K_P, K_I and K_N, so a convex
function of z+ is largest at ends of their intervals. docs/proofs.md derives these equations.
"""

from collections.abc import Iterable
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS
from dssc_jax.proofs.problem import Box, Interval, ProofProblem, interval_ends, middle
from dssc_jax.proofs.search.held_plant import (
    HeldSample,
    companion_form,
    control_points,
    flow,
    held_matrices,
    sensor_weights,
    state_layout,
)

INNER_STEPS = 16
"""Number of equal steps of a sample, after each of which the plant between the samples is evaluated."""
ROOM = 1.02
"""Factor that widens bounds found at these steps, for the times between them and for the verifier's enclosure."""


class LoopGains(NamedTuple):
    """The gains K_P, K_I [1/s], and K_N of the nominal control's term 1/tau_m.

    If z contains q in place of v, ``k_p`` is phi_1/sigma.
    """

    k_p: float
    k_i: float
    k_n: float


class LoopPoint(NamedTuple):
    """One plant with one set of gains: k_p [1/s], a_p [1/s], 1/mu [1/s] (0 without G(mu s)), and the gains."""

    k_p: float
    a_p: float
    rate: float
    gains: LoopGains


class SignalRows(NamedTuple):
    """Signals of the loop as rows over z, shape (n,) each: a signal is the product of its row and z.

    Args:
        e: The measured e, behind a sensor's lag.
        true_e: e itself.
        sigma: The measured sigma.
        change: sigma - s, the change of the measured sigma in a sample.
    """

    e: np.ndarray
    true_e: np.ndarray
    sigma: np.ndarray
    change: np.ndarray


class Step(NamedTuple):
    """One sample z+ = A z + B w of a plant with given gains.

    Args:
        a: A, shape (n, n).
        b: B, shape (n, inputs). Its inputs, each of magnitude at most 1, stand for the change of d_r + f, the change of
            -f, and theta's components along e, e' and eta.
        rows: Signals as rows over z.
        command: command + d_r as a row over z, shape (n,).
        push: The part of z+ that 1 m/s of command + d_r causes, shape (n,).
        jump: The jump of z that a change of d_r by 1 m/s causes, shape (n,); only zeta jumps.
    """

    a: np.ndarray
    b: np.ndarray
    rows: SignalRows
    command: np.ndarray
    push: np.ndarray
    jump: np.ndarray


class SignalSizes(NamedTuple):
    """Bounds, over a box of plants, of the signals d_r and f that disturbance and reference bring into the loop.

    d_r is the disturbance less the reference's share, and f the nominal control's share of the reference.

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


def signal_sizes(problem: ProofProblem, box: Box) -> SignalSizes:
    """Bounds of d_r and f over a box of plants, from bounds of d and of the reference's first three derivatives.

    d_r = d - (y_m'' + a_p y_m')/k_p and f = (y_m'' + a_n y_m')/k_n; without nominal control f = 0.
    """
    speed, acceleration, jerk = problem.reference
    a_n, k_n, _ = problem.nominal or (0.0, np.inf, False)
    motion = np.array([acceleration, speed])
    motion_rates = np.array([jerk, acceleration])
    # largest weights of y_m'' and y_m' in f, in d_r, and in d_r + f; their derivatives have the same weights
    feed_weights = (problem.nominal is not None) * np.array([1.0, abs(a_n)]) / k_n
    disturbance_weights = np.array([1.0, max(map(abs, box["a_p"]))]) / box["k_p"][0]
    offset_weights = np.zeros(2)
    for k_p, a_p in product(box["k_p"], box["a_p"]):
        plant_weights = np.array([abs(1.0 / k_n - 1.0 / k_p), abs(a_n / k_n - a_p / k_p)])
        offset_weights = np.maximum(offset_weights, plant_weights)
    return SignalSizes(
        level=float(problem.level + disturbance_weights @ motion),
        slope=float(problem.slope + disturbance_weights @ motion_rates),
        feed_slope=float(feed_weights @ motion_rates),
        offset=float(problem.level + offset_weights @ motion),
        offset_slope=float(problem.slope + offset_weights @ motion_rates),
    )


def step_of(
    problem: ProofProblem,
    point: LoopPoint,
    box: Box,
    *,
    is_integrated: bool = False,
    held_sample: HeldSample | None = None,
) -> Step:
    """The matrices of one sample of the loop, z+ = A z + B w.

    Args:
        problem: The loop and its uncertain numbers.
        point: Plant and gains.
        box: Intervals of the plant over which the inputs are bounded; the bounds are factors of the columns of B.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v; then the gain k_p is phi_1/sigma.
        held_sample: Phi and Gamma; None: those at the point's a_p and 1/mu.
    """
    zeta, _, n = state_layout(problem)
    chi = n - 2
    sizes = signal_sizes(problem, box)
    phi, gamma = held_sample or held_matrices(problem, point.a_p, point.rate)
    rows = signal_rows(problem)
    unit = np.eye(n)
    v = unit[n - 2]
    k_p, k_i, k_n = point.gains
    v_row = v + problem.sample_time * k_i * rows.sigma + (0.0 if is_integrated else k_p) * rows.change  # v+ or q+
    command = -v_row - (k_p if is_integrated else 0.0) * rows.sigma  # v = q + phi_1
    if problem.nominal:
        a_n, nominal_gain, _ = problem.nominal
        l0 = problem.l0
        command = command - ((a_n - l0) * l0 * rows.e + (l0 - a_n) * rows.sigma) / nominal_gain
        command = command - k_n * rows.sigma
    push = np.zeros(n)
    push[:chi] = point.k_p * gamma
    a = np.zeros((n, n))
    a[:chi, :chi] = phi
    a += np.outer(push, command)
    a[n - 2] = v_row
    a[n - 1] = rows.sigma  # s+
    jump = np.zeros(n)
    jump[zeta] = resting_zeta(problem, point.k_p)
    change_of_offset = problem.sample_time * sizes.offset_slope * (jump - v)  # of d_r + f
    change_of_feed = problem.sample_time * sizes.feed_slope * jump  # of -f
    theta = [bound * unit[i] for i, bound in enumerate(disturbance_effects(problem, point, box)[: zeta.start])]
    b = np.stack([change_of_offset, change_of_feed, *theta], axis=1)
    return Step(a=a, b=b, rows=rows, command=command, push=push, jump=jump)


def resting_zeta(problem: ProofProblem, u: float) -> np.ndarray:
    """The value of zeta at which the unmodelled dynamics or the delay rest under a constant input u, shape (zeta,).

    In companion form only the first state is not 0: it is u over the denominator's constant coefficient a_0. A delay
    holds u in every place.
    """
    zeta, *_ = state_layout(problem)
    if not problem.denominator:
        return np.full(zeta.stop - zeta.start, u)
    resting_state = np.zeros(zeta.stop - zeta.start)
    resting_state[0] = u / companion_form(problem).a[0]
    return resting_state


def signal_rows(problem: ProofProblem) -> SignalRows:
    """The signals as rows over z.

    The state z begins with the error e and its rate e', and ends with s, the sigma of the sample before. A sensor with
    a lag measures (1 - kappa) y + m in place of a signal y; its memories m of e and of e' are the part ``memory`` of z.
    Sigma is e' + l_0 e with the measured e and e'.
    """
    _, memory, n = state_layout(problem)
    state_rows = np.eye(n)
    true_e, true_rate, *_, s = state_rows
    measured_e = true_e
    measured_rate = true_rate
    if problem.sensor_lag:
        kappa = sensor_weights(problem).kappa
        measured_e = (1.0 - kappa) * true_e + state_rows[memory.start]
        measured_rate = (1.0 - kappa) * true_rate + state_rows[memory.start + 1]
    sigma = measured_rate + problem.l0 * measured_e
    return SignalRows(e=measured_e, true_e=true_e, sigma=sigma, change=sigma - s)


def disturbance_effects(problem: ProofProblem, point: LoopPoint, box: Box) -> np.ndarray:
    """Bounds of the components of theta, the effect of d_r's change within a sample, shape (n - 2,).

    At a time t after the sample, d_r has changed by at most D t, where D bounds |d_r'|. It acts through exp(F r) k_p b
    with a unit column b along e'. So a component is at most D T_s^2/2 times the component's largest |exp(F r) k_p b| in
    the sample, which is taken at ``INNER_STEPS`` times and widened by ``ROOM``.

    Args:
        problem: The loop and its uncertain numbers.
        point: Plant, of which a_p and 1/mu are used.
        box: Intervals of the plant, for D and the largest k_p.
    """
    inner, _ = flow(problem, point.a_p, point.rate, problem.sample_time / INNER_STEPS)
    states = [np.eye(inner.shape[0])[1]]  # b
    for _ in range(INNER_STEPS):
        states.append(inner @ states[-1])
    slope = signal_sizes(problem, box).slope
    return ROOM * 0.5 * slope * problem.sample_time**2 * box["k_p"][1] * np.max(np.abs(states), axis=0)


def box_middle(box: Box, gains: dict[str, Interval]) -> LoopPoint:
    """The plant and the gains in the middle of their intervals, from which the linear middle loop follows.

    Args:
        box: Intervals of k_p, a_p and 1/mu.
        gains: Intervals of the gains, of which ``k_p``, ``k_i`` and ``k_n`` are used.
    """
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
    """Yield one sample at every vertex of plant and gains; z+ of any other is a convex combination of these z+.

    The vertices are the ends of k_p, a_p and the gains, and the control points of 1/mu.

    Args:
        problem: The loop and its uncertain numbers.
        box: Intervals of k_p, a_p and 1/mu.
        gains: Intervals of the gains, by name.
        degree: Degree of the polynomial in 1/mu.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
    """
    names = ("mean" if is_integrated else "k_p", "k_i", "k_n")
    rates = box.get("rate", (0.0, 0.0))
    for a_p in interval_ends(box["a_p"]):
        for held_sample in control_points(problem, a_p, rates, degree):
            for k_p in interval_ends(box["k_p"]):
                for corner in product(*(interval_ends(gains[name]) for name in names)):
                    point = LoopPoint(k_p, a_p, middle(rates), LoopGains(*corner))
                    yield step_of(problem, point, box, is_integrated=is_integrated, held_sample=held_sample)


def start_corners(problem: ProofProblem, box: Box, ratio: Interval) -> list[np.ndarray]:
    """The states z in which the loop may start, at the ends of all uncertain numbers, shape (n,) each.

    z is affine in each of the initial state, d_r, d_r + f and the ratio, so every start is in the hull of these states.

    Args:
        problem: The loop and its uncertain numbers.
        box: Intervals of the plant.
        ratio: Interval of -v/sigma_0, or of -q/sigma_0, by :func:`dssc_jax.proofs.search.gains.start_ratio`.
    """
    zeta, memory, n = state_layout(problem)
    sizes = signal_sizes(problem, box)
    kappa, _ = sensor_weights(problem)
    ends_of_d_r = (-sizes.level, sizes.level)
    if any(problem.reference):
        signals = set(product(ends_of_d_r, (-sizes.offset, sizes.offset)))
    else:  # at rest f = 0, so that d_r + f is d_r
        signals = {(d_r, d_r) for d_r in ends_of_d_r}
    corners = []
    for plant_state in product(*(interval_ends(interval) for interval in problem.initial)):  # e, e' and eta
        e, speed = plant_state[:2]
        sigma = speed + problem.l0 * e
        s = 0.0 if problem.start == "zero" else sigma
        for (d_r, offset), k_p in product(signals, interval_ends(box["k_p"])):
            for share in interval_ends(ratio):
                z = np.zeros(n)
                z[: len(plant_state)] = plant_state
                z[zeta] = resting_zeta(problem, k_p * d_r)
                if problem.sensor_lag:
                    z[memory] = kappa * np.array([e, speed])
                z[n - 2] = -offset - share * s
                z[n - 1] = s
                corners.append(z)
    return corners


def functions_of(problem: ProofProblem) -> Any:
    """Build the state-dependent functions k_o, tau_av, tau_m of a problem: a member of :data:`GAIN_FUNCTIONS`.

    The entry ``kind`` of the problem's functions names the row, and the other entries are the constants.
    """
    constants = dict(problem.functions)
    return GAIN_FUNCTIONS[constants.pop("kind")].members[None](**constants)
