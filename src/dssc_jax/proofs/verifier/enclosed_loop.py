"""The sampled loop in sliding, z+ = A z + B w, enclosed in balls: the verifier's own construction.

The state z holds e, e', the zero dynamics' eta, zeta, the sensor's memory, v or q, and s. zeta is k_p times what the
unmodelled dynamics or the delay hold, v is u_av, q = v - phi_1(s), and s is sigma one sample before. The command counts
relative to d_r, the disturbance and what the reference asks for. docs/proofs.md derives the equations.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import Balls, ball_ends, exact_ends, matrix_of_columns, maximum, unit_rows
from dssc_jax.proofs.verifier.certificate import Box, Problem
from dssc_jax.proofs.verifier.held_plant import companion_form, flows, generator_over, memory_weights, state_places

SAMPLE_PIECES = 8  # pieces of a sample on which its inside is enclosed


class Corner(NamedTuple):
    """One sample z+ = A z + B w of the plant and the gains at a corner of their intervals.

    Args:
        a: A, (n, n).
        b: B, a column for each input of magnitude at most 1, (n, inputs).
    """

    a: arb_mat
    b: arb_mat


class SignalBounds(NamedTuple):
    """Bounds, over a box, of the disturbance with the reference's share, d_r, and of the nominal control's share, f.

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
    """Rows over the state z, (1, n) each.

    Args:
        e: e as it is measured.
        sigma: sigma as it is measured.
        change: sigma - s, the change of sigma in a sample.
        v: v, or q.
        s: s, sigma one sample before.
    """

    e: arb_mat
    sigma: arb_mat
    change: arb_mat
    v: arb_mat
    s: arb_mat


def signal_bounds(problem: Problem, box: Box) -> SignalBounds:
    """Bounds of d_r = d - (y_m'' + a_p y_m')/k_p and f = (y_m'' + a_n y_m')/k_n over a box of plants."""
    level = arb(problem["level"])
    slope = arb(problem["slope"])
    speed, acceleration, jerk = map(arb, problem["reference"])
    a_n = arb(0)
    inverse_k_n = arb(0)
    if problem["nominal"]:
        a_n = arb(problem["nominal"][0])
        inverse_k_n = 1 / arb(problem["nominal"][1])
    largest_bounds = [arb(0)] * 5
    for k_p, a_p in product(exact_ends(box["k_p"]), exact_ends(box["a_p"])):  # every bound is largest at a corner
        ratio = abs(a_p) / k_p
        by_acceleration = abs(inverse_k_n - 1 / k_p)
        by_speed = abs(a_n * inverse_k_n - a_p / k_p)
        bounds = (
            level + acceleration / k_p + speed * ratio,
            slope + jerk / k_p + acceleration * ratio,
            inverse_k_n * (jerk + abs(a_n) * acceleration),
            level + by_acceleration * acceleration + by_speed * speed,
            slope + by_acceleration * jerk + by_speed * acceleration,
        )
        largest_bounds = [
            maximum(bound.upper(), largest) for bound, largest in zip(bounds, largest_bounds, strict=True)
        ]
    return SignalBounds(*largest_bounds)


def signal_rows(problem: Problem) -> SignalRows:
    """The rows of the signals that the controller works with; a sensor's lag shows e and e' through its memory."""
    places = state_places(problem)
    unit = unit_rows(places.n)
    e, speed, *_, v, s = unit
    if places.memory:
        kappa, _ = memory_weights(problem)
        e, speed = (unit[i] * (1 - kappa) + unit[place] for i, place in enumerate(places.memory))
    sigma = speed + e * arb(problem["l0"])
    return SignalRows(e, sigma, sigma - s, v, s)


def sample_corners(
    problem: Problem, box: Box, vertices: list[arb_mat], gains: Balls, *, is_integrated: bool
) -> list[Corner]:
    """One sample at every corner of plant and gains.

    Every plant and gain of the box has an A in the hull of these, so that what is convex in A holds for all.

    Args:
        problem: The certificate's problem.
        box: Intervals of k_p, a_p and 1/mu.
        vertices: The held plant at its vertices, by :func:`dssc_jax.proofs.verifier.held_plant.held_vertices`.
        gains: Balls of the gains.
        is_integrated: Whether z holds q in place of v.
    """
    sizes = signal_bounds(problem, box)
    within_sample = inside_bounds(problem, box, arb(problem["sample_time"]))
    names = ("mean" if is_integrated else "k_p", "k_i", "k_n")
    corners = []
    for vertex, k_p in product(vertices, exact_ends(box["k_p"])):
        b = input_columns(problem, k_p, sizes, within_sample)
        for gain in product(*(ball_ends(gains[name]) for name in names)):
            corners.append(Corner(sample_matrix(problem, vertex, k_p, gain, is_integrated=is_integrated), b))
    return corners


def sample_matrix(
    problem: Problem, held_matrix: arb_mat, k_p: arb, gain: Sequence[arb], *, is_integrated: bool
) -> arb_mat:
    """A of one sample, (n, n).

    Args:
        problem: The certificate's problem.
        held_matrix: [[Phi, Gamma], [0, 1]] of the plant with a held command.
        k_p: High-frequency gain [1/s].
        gain: K_P, K_I and K_N; if z holds q, the first is phi_1/sigma.
        is_integrated: Whether z holds q = v - phi_1(s) in place of v.
    """
    n = state_places(problem).n
    chi = n - 2
    v_row, command = control_rows(problem, gain, is_integrated=is_integrated)
    rows = []
    for i in range(chi):
        push = k_p * held_matrix[i, chi]
        rows.append([(held_matrix[i, j] if j < chi else arb(0)) + push * command[0, j] for j in range(n)])
    return arb_mat([*rows, *v_row.tolist(), *signal_rows(problem).sigma.tolist()])


def control_rows(problem: Problem, gain: Sequence[arb], *, is_integrated: bool) -> tuple[arb_mat, arb_mat]:
    """The rows over z of v or q after the sample and of the command, both relative to d_r, (1, n) each.

    Args:
        problem: The certificate's problem.
        gain: K_P, K_I and K_N; if z holds q, the first is phi_1/sigma.
        is_integrated: Whether z holds q = v - phi_1(s) in place of v.
    """
    rows = signal_rows(problem)
    proportional, k_i, k_n = gain
    v_row = rows.v + rows.sigma * (arb(problem["sample_time"]) * k_i)
    if is_integrated:
        command = -v_row - rows.sigma * proportional
    else:
        v_row = v_row + rows.change * proportional
        command = -v_row
    if problem["nominal"]:
        a_n, k = map(arb, problem["nominal"][:2])
        l0 = arb(problem["l0"])
        feedback = rows.e * ((a_n - l0) * l0) + rows.sigma * (l0 - a_n)
        command = command - feedback * (1 / k)
        command = command - rows.sigma * k_n
    return v_row, command


def zeta_jump(problem: Problem) -> list[arb]:
    """The entries by which zeta changes if k_p d_r changes by 1, since zeta counts relative to it."""
    zeta = state_places(problem).zeta
    if problem["denominator"]:
        return [1 / companion_form(problem).a[0], *(arb(0) for _ in zeta[1:])]
    return [arb(1) for _ in zeta]


def input_columns(problem: Problem, k_p: arb, sizes: SignalBounds, within_sample: list[arb]) -> arb_mat:
    """B: a column for each input, scaled so that every input is at most 1 in magnitude, (n, inputs).

    The inputs are the changes of d_r + f and of -f from sample to sample, and the components of theta, the effect of
    d_r's change within a sample.

    Args:
        problem: The certificate's problem.
        k_p: High-frequency gain [1/s].
        sizes: Bounds of the disturbance and the reference.
        within_sample: Bounds of theta's components, by :func:`inside_bounds`.
    """
    zeta, memory, n = state_places(problem)
    t = arb(problem["sample_time"])
    jump = [k_p * entry for entry in zeta_jump(problem)]
    feed = [arb(0)] * zeta.start + jump + [arb(0)] * (len(memory) + 2)
    offset = [*feed[:-2], arb(-1), arb(0)]
    columns = [[t * sizes.offset_slope * x for x in offset], [t * sizes.feed_slope * x for x in feed]]
    for j in range(zeta.start):
        columns.append([within_sample[i] if i == j else arb(0) for i in range(n)])
    return matrix_of_columns(columns)


def inside_bounds(problem: Problem, box: Box, time: arb) -> list[arb]:
    """Bounds of the components of theta, the effect of d_r's change within a time since the sample.

    d_r changes by at most D s after a time s, and acts through exp(F s) k_p, F of the held plant. So a component is
    below D t^2/2 k_p times the largest entry of exp(F s) for s in [0, t].

    Args:
        problem: The certificate's problem.
        box: Intervals of the plant.
        time: t [s].
    """
    n = state_places(problem).n
    largest = [arb(0)] * n
    for flow in flows(generator_over(problem, box), time, SAMPLE_PIECES):
        for i in range(n - 2):
            largest[i] = maximum(largest[i], abs(flow[i, 1]).upper())
    factor = signal_bounds(problem, box).slope * time * time / 2 * arb(box["k_p"][1])
    return [(factor * size).upper() for size in largest]


def start_columns(problem: Problem, box: Box, ratio: arb) -> arb_mat:
    """Every corner of the states in which the loop may start, as columns, (n, corners).

    z is affine in the initial state, in d_r(0), f(0), k_p d_r(0) and the ratio, so that every start is in their hull.

    Args:
        problem: The certificate's problem.
        box: Intervals of the plant.
        ratio: Ball of -v/sigma, or of -q/sigma, at the start, without d_r and f.
    """
    memory = state_places(problem).memory
    sizes = signal_bounds(problem, box)
    jump = zeta_jump(problem)
    kappa = memory_weights(problem)[0] if memory else arb(0)
    pairs = list(product((-sizes.level, sizes.level), (-sizes.offset, sizes.offset)))
    if not any(problem["reference"]):  # d_r and d_r + f are the same
        pairs = [(-sizes.level, -sizes.level), (sizes.level, sizes.level)]
    columns = []
    for plant in product(*(exact_ends(interval) for interval in problem["initial"])):
        s = arb(0)
        if problem["start"] != "zero":
            s = plant[1] + arb(problem["l0"]) * plant[0]
        memory_entries = [kappa * plant[i] for i, _ in enumerate(memory)]
        for (d, offset), k_p, share in product(pairs, exact_ends(box["k_p"]), ball_ends(ratio)):
            zeta = [k_p * d * entry for entry in jump]
            columns.append([*plant, *zeta, *memory_entries, -offset - share * s, s])
    return matrix_of_columns(columns)
