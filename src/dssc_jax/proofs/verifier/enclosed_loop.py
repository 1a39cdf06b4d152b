"""The sampled loop in sliding, z+ = A z + B w with |w_j| <= 1, enclosed in balls: the verifier's own construction.

z = (e, e', eta, zeta, m, v, s): error and its rate, zero dynamics, k_p times the state of the unmodelled dynamics or
the commands that a delay holds, the memory of a sensor's lag, u_av, and the sigma of the sample before. q = v -
phi_1(s) may stand in place of v. zeta is counted from -d_r and v from d_r + f, where d_r = d - (y_m'' + a_p y_m')/k_p
and f is the nominal control's share of the reference. So U = k_p (command + d_r) vanishes where the loop rests.
docs/proofs.md derives the equations.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import Balls, ball_ends, exact_ends, matrix_of_columns, maximum, unit_rows
from dssc_jax.proofs.verifier.certificate import Box, Problem
from dssc_jax.proofs.verifier.held_plant import companion_form, flows, generator_over, sensor_weights, state_places

SAMPLE_PIECES = 8
"""Number of equal pieces of a sample, over each of which the plant is enclosed."""


class Corner(NamedTuple):
    """One sample z+ = A z + B w of the loop, for plant and gains at one combination of the ends of their intervals.

    Args:
        a: A, shape (n, n).
        b: B, a column for each input of magnitude at most 1, shape (n, inputs).
    """

    a: arb_mat
    b: arb_mat


class SignalBounds(NamedTuple):
    """Bounds, over a box of plants, of the signals d_r and f that disturbance and reference bring into the loop.

    d_r is the disturbance less the reference's share, and f the nominal control's share of the reference.

    Args:
        level: Bound of |d_r| [m/s].
        slope: Bound of |d_r'| [m/s^2].
        feed_slope: Bound of |f'| [m/s^2].
        offset: Bound of |d_r + f| [m/s].
        offset_slope: Bound of the derivative of d_r + f [m/s^2].
    """

    level: arb
    slope: arb
    feed_slope: arb
    offset: arb
    offset_slope: arb


class SignalRows(NamedTuple):
    """Signals as rows over the state z, shape (1, n) each.

    Args:
        e: The measured e.
        sigma: The measured sigma.
        change: sigma - s, the change of sigma in a sample.
        v: v, or q if z contains q in place of v.
        s: s, the sigma of the sample before.
    """

    e: arb_mat
    sigma: arb_mat
    change: arb_mat
    v: arb_mat
    s: arb_mat


def signal_bounds(problem: Problem, box: Box) -> SignalBounds:
    """Bounds of d_r = d - (y_m'' + a_p y_m')/k_p and f = (y_m'' + a_n y_m')/k_n over a box of plants.

    Args:
        problem: The certificate's problem, with bounds of d and of the reference's derivatives.
        box: Intervals of k_p and a_p; the nominal a_n and k_n are fixed numbers.
    """
    d_level = arb(problem["level"])
    d_slope = arb(problem["slope"])
    speed, acceleration, jerk = map(arb, problem["reference"])
    a_n = arb(0)
    inverse_k_n = arb(0)  # f = 0 without nominal control
    if problem["nominal"]:
        a_n, k_n = map(arb, problem["nominal"][:2])
        inverse_k_n = 1 / k_n
    level = slope = feed_slope = offset = offset_slope = arb(0)
    for k_p, a_p in product(exact_ends(box["k_p"]), exact_ends(box["a_p"])):  # every bound is largest at a corner
        ratio = abs(a_p) / k_p
        by_acceleration = abs(inverse_k_n - 1 / k_p)  # weight of y_m'' in d_r + f
        by_speed = abs(a_n * inverse_k_n - a_p / k_p)  # weight of y_m' in d_r + f
        level = maximum(level, (d_level + acceleration / k_p + speed * ratio).upper())
        slope = maximum(slope, (d_slope + jerk / k_p + acceleration * ratio).upper())
        feed_slope = maximum(feed_slope, (inverse_k_n * (jerk + abs(a_n) * acceleration)).upper())
        offset = maximum(offset, (d_level + by_acceleration * acceleration + by_speed * speed).upper())
        offset_slope = maximum(offset_slope, (d_slope + by_acceleration * jerk + by_speed * acceleration).upper())
    return SignalBounds(level, slope, feed_slope, offset, offset_slope)


def signal_rows(problem: Problem) -> SignalRows:
    """The controller's signals as rows over z.

    Through a sensor's lag the controller sees (1 - kappa) y + m in place of y, with the memory m, and likewise y'.
    """
    places = state_places(problem)
    unit = unit_rows(places.n)
    e, speed, *_, v, s = unit
    if places.memory:
        kappa = sensor_weights(problem).kappa
        error_place, speed_place = places.memory
        e = e * (1 - kappa) + unit[error_place]
        speed = speed * (1 - kappa) + unit[speed_place]
    sigma = speed + e * arb(problem["l0"])
    return SignalRows(e, sigma, sigma - s, v, s)


def sample_corners(
    problem: Problem, box: Box, vertices: list[arb_mat], gains: Balls, *, is_integrated: bool
) -> list[Corner]:
    """One sample at every vertex of plant and gains.

    The A of every plant in the box and every gain lies in the convex hull of the corners' A. So a condition that is
    convex in A holds for all of them if it holds at the corners.

    Args:
        problem: The certificate's problem.
        box: Intervals of k_p, a_p and 1/mu.
        vertices: The held plant at its vertices, by :func:`dssc_jax.proofs.verifier.held_plant.held_vertices`.
        gains: Balls of the gains, by name; the lower and the upper end of each ball are corners.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
    """
    sizes = signal_bounds(problem, box)
    theta_bounds = disturbance_effects(problem, box, arb(problem["sample_time"]))
    names = ("mean" if is_integrated else "k_p", "k_i", "k_n")
    corners = []
    for vertex, k_p in product(vertices, exact_ends(box["k_p"])):
        b = input_columns(problem, k_p, sizes, theta_bounds)
        for gain in product(*(ball_ends(gains[name]) for name in names)):
            corners.append(Corner(sample_matrix(problem, vertex, k_p, gain, is_integrated=is_integrated), b))
    return corners


def sample_matrix(
    problem: Problem, held_matrix: arb_mat, k_p: arb, gain: Sequence[arb], *, is_integrated: bool
) -> arb_mat:
    """A of one sample, shape (n, n): the held plant under the command, then v+ (or q+) and s+ = sigma.

    Args:
        problem: The certificate's problem.
        held_matrix: [[Phi, Gamma], [0, 1]] of the plant with a held command, shape (n - 1, n - 1).
        k_p: High-frequency gain [1/s].
        gain: K_P, K_I and K_N; if z contains q, phi_1/sigma replaces K_P.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
    """
    n = state_places(problem).n
    chi = n - 2
    integrator, command = control_rows(problem, gain, is_integrated=is_integrated)
    rows = []
    for i in range(chi):  # Phi chi + Gamma k_p command
        by_state = [held_matrix[i, j] for j in range(chi)] + [arb(0), arb(0)]
        push = k_p * held_matrix[i, chi]
        rows.append([by_state[j] + push * command[0, j] for j in range(n)])
    return arb_mat([*rows, *integrator.tolist(), *signal_rows(problem).sigma.tolist()])


class ControlRows(NamedTuple):
    """The controller's next integrator state and its command as rows over z, shape (1, n) each.

    Args:
        integrator: v+ = v + K_P (sigma - s) + T_s K_I sigma, or q+ = q + T_s K_I sigma.
        command: command + d_r = -v+, or -q+ - phi_1, less the nominal control's feedback.
    """

    integrator: arb_mat
    command: arb_mat


def control_rows(problem: Problem, gain: Sequence[arb], *, is_integrated: bool) -> ControlRows:
    """The controller's rows of a sample.

    Args:
        problem: The certificate's problem.
        gain: K_P, K_I and K_N; if z contains q, phi_1/sigma replaces K_P.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
    """
    rows = signal_rows(problem)
    proportional, k_i, k_n = gain
    integrator = rows.v + rows.sigma * (arb(problem["sample_time"]) * k_i)
    if is_integrated:
        command = -integrator - rows.sigma * proportional
    else:
        integrator = integrator + rows.change * proportional
        command = -integrator
    if problem["nominal"]:
        a_n, nominal_gain = map(arb, problem["nominal"][:2])
        l0 = arb(problem["l0"])
        feedback = rows.e * ((a_n - l0) * l0) + rows.sigma * (l0 - a_n)
        command = command - feedback * (1 / nominal_gain)
        command = command - rows.sigma * k_n  # the term 1/tau_m
    return ControlRows(integrator, command)


def zeta_jump(problem: Problem) -> list[arb]:
    """The change of zeta if k_p d_r changes by 1, one entry for each state of zeta.

    zeta counts from its rest under the input -k_p d_r, so it changes by its rest under a constant input 1. At this rest
    only the first state of the companion form is not 0; a delay holds 1 in every place.
    """
    zeta = state_places(problem).zeta
    if problem["denominator"]:
        return [1 / companion_form(problem).a[0], *(arb(0) for _ in zeta[1:])]
    return [arb(1) for _ in zeta]


def input_columns(problem: Problem, k_p: arb, sizes: SignalBounds, theta_bounds: list[arb]) -> arb_mat:
    """B, shape (n, inputs), with a column for each input, scaled so that every input is at most 1 in magnitude.

    The first input is the change of d_r + f from sample to sample, the second that of -f. The others are the components
    of theta along e, e' and eta, where theta is the effect of d_r's change within a sample.

    Args:
        problem: The certificate's problem.
        k_p: High-frequency gain [1/s].
        sizes: Bounds of the disturbance and the reference.
        theta_bounds: Bounds of theta's components, by :func:`disturbance_effects`.
    """
    zeta, memory, n = state_places(problem)
    t = arb(problem["sample_time"])
    zero = arb(0)
    plant = [zero] * zeta.start + [k_p * entry for entry in zeta_jump(problem)] + [zero] * len(memory)
    by_feed = [*plant, zero, zero]  # the last two states are v and s
    by_offset = [*plant, arb(-1), zero]  # v counts from d_r + f
    columns = [[t * sizes.offset_slope * x for x in by_offset], [t * sizes.feed_slope * x for x in by_feed]]
    for j in range(zeta.start):
        columns.append([theta_bounds[i] if i == j else zero for i in range(n)])
    return matrix_of_columns(columns)


def disturbance_effects(problem: Problem, box: Box, time: arb) -> list[arb]:
    """Bounds of the n components of theta(t): the effect, at the time t, of d_r's change since the sample.

    By the time r, d_r has changed by at most D r, where D bounds |d_r'|. It acts through exp(F r) k_p b with a unit
    column b along e'. So a component of theta is at most D t^2/2 k_p times the component's largest value in exp(F r) b
    for r in [0, t].

    Args:
        problem: The certificate's problem.
        box: Intervals of the plant.
        time: t, the time since the sample [s].
    """
    n = state_places(problem).n
    largest = [arb(0)] * n
    for flow in flows(generator_over(problem, box), time, SAMPLE_PIECES):
        for i in range(n - 2):
            largest[i] = maximum(largest[i], abs(flow[i, 1]).upper())
    factor = signal_bounds(problem, box).slope * time * time / 2 * arb(box["k_p"][1])
    return [(factor * size).upper() for size in largest]


def start_columns(problem: Problem, box: Box, ratio: arb) -> arb_mat:
    """The states z in which the loop starts at the ends of all uncertain numbers, as columns, shape (n, corners).

    z is affine in each of the initial state, d_r(0), f(0), k_p d_r(0) and the ratio. So every possible start lies in
    the convex hull of these columns.

    Args:
        problem: The certificate's problem.
        box: Intervals of the plant.
        ratio: Ball of -v/sigma_0, or of -q/sigma_0 if z contains q, before the first sample, without d_r + f.
    """
    memory = state_places(problem).memory
    sizes = signal_bounds(problem, box)
    jump = zeta_jump(problem)
    kappa = sensor_weights(problem).kappa if memory else arb(0)
    if any(problem["reference"]):
        signals = list(product((-sizes.level, sizes.level), (-sizes.offset, sizes.offset)))  # d_r and d_r + f
    else:  # at rest f = 0, so that d_r + f is d_r
        signals = [(-sizes.level, -sizes.level), (sizes.level, sizes.level)]
    columns = []
    for plant in product(*(exact_ends(interval) for interval in problem["initial"])):  # e, e' and eta
        e, speed = plant[:2]
        s = arb(0) if problem["start"] == "zero" else speed + arb(problem["l0"]) * e
        memory_entries = [kappa * e, kappa * speed] if memory else []
        for (d_r, offset), k_p, share in product(signals, exact_ends(box["k_p"]), ball_ends(ratio)):
            zeta = [k_p * d_r * entry for entry in jump]
            columns.append([*plant, *zeta, *memory_entries, -offset - share * s, s])
    return matrix_of_columns(columns)
