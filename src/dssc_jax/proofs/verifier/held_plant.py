"""The plant with its unmodelled dynamics between two samples, enclosed in balls over a box of plants."""

import math
from collections.abc import Iterator
from functools import reduce
from itertools import combinations, product
from operator import add
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import exact_ends, interval_ball
from dssc_jax.proofs.verifier.certificate import Box, Interval, Problem

HALF = arb(1) / 2 * (1 + arb(2) ** -100)  # of a width, from its middle, which is rounded


class StatePlaces(NamedTuple):
    """Places in z: of zeta and of the sensor's memory, and the number of all states."""

    zeta: range
    memory: range
    n: int


class CompanionForm(NamedTuple):
    """G(mu s) as a state-space system.

    Args:
        a: Coefficients of the denominator over the leading one, in rising powers, without that of 1.
        output: Output row.
        direct: Feedthrough.
    """

    a: list[arb]
    output: list[arb]
    direct: arb


class BoxSide(NamedTuple):
    """A side of a box along which the held plant varies.

    Args:
        name: ``a_p`` or ``rate``.
        width: Width of the interval.
        slope: Derivative of the generator along it, times T_s.
    """

    name: str
    width: arb
    slope: arb_mat


def state_places(problem: Problem) -> StatePlaces:
    """Places of the states in z = (e, e', eta, zeta, sensor's memory, v or q, s)."""
    zeta_start = 2 + len(problem["zero_a"])
    order = max(len(problem["denominator"]) - 1, math.ceil(problem["delay"]))
    memory = zeta_start + order
    end = memory + (2 if problem["sensor_lag"] else 0)
    return StatePlaces(range(zeta_start, memory), range(memory, end), end + 2)


def rate_interval(box: Box) -> Interval:
    """The interval of 1/mu; (0, 0) without a transfer function."""
    return box.get("rate", (0.0, 0.0))


def memory_weights(problem: Problem) -> tuple[arb, arb]:
    """kappa and lambda of a sensor's lag, which shows (1 - kappa) y + m, where m+ = lambda m + kappa (1 - lambda) y."""
    ratio = arb(problem["sample_time"]) / arb(problem["sensor_lag"])
    return -(-ratio).expm1() / ratio, (-ratio).exp()


def companion_form(problem: Problem) -> CompanionForm:
    """G(mu s) in companion form."""
    denominator = [arb(x) for x in problem["denominator"]]
    numerator = [arb(x) for x in problem["numerator"]]
    numerator += [arb(0)] * (len(denominator) - len(numerator))
    leading = denominator[-1]
    direct = numerator[-1] / leading
    a = [x / leading for x in denominator[:-1]]
    output = [x / leading - direct * y for x, y in zip(numerator, a, strict=False)]
    return CompanionForm(a, output, direct)


def delay_weights(delay: float) -> list[arb]:
    """Weights of the commands of ages 0, 1, ... samples in the command that acts on the plant.

    Args:
        delay: Delay of the command, in samples; a fraction divides a sample between two commands.
    """
    samples = math.floor(delay)
    fraction = arb(delay) - samples
    weights = [arb(0)] * samples + [1 - fraction]
    return [*weights, fraction] if fraction > 0 else weights


def held_generator(problem: Problem, a_p: arb, rate: arb) -> arb_mat:
    """[[F, G], [0, 0]] of the held plant chi' = F chi + G U, U' = 0; memories rest between samples."""
    zeta, _, n = state_places(problem)
    eta = len(problem["zero_a"])
    f = [[arb(0)] * (n - 1) for _ in range(n - 1)]
    f[0][1] = arb(1)
    f[1][1] = -a_p
    for i, c in enumerate(problem["zero_c"]):
        f[1][2 + i] = -arb(c)
    for i in range(eta - 1):
        f[2 + i][3 + i] = arb(1)
    if eta:
        f[1 + eta][1] = arb(1)
        for i, a in enumerate(problem["zero_a"]):
            f[1 + eta][2 + i] = f[1 + eta][2 + i] - arb(a)
    if not problem["denominator"]:
        f[1][-1], *weights = delay_weights(problem["delay"])
        for i, weight in zip(zeta, weights, strict=True):
            f[1][i] = weight
        return arb_mat(f)
    form = companion_form(problem)
    end = zeta[-1]
    f[1][-1] = form.direct
    for i, a, c in zip(zeta, form.a, form.output, strict=True):
        f[1][i] = c
        f[end][i] = -rate * a
        if i < end:
            f[i][i + 1] += rate
    f[end][-1] = rate
    return arb_mat(f)


def generator_over(problem: Problem, box: Box) -> arb_mat:
    """[[F, G], [0, 0]] of the held plant, enclosed over all a_p and 1/mu of a box."""
    return held_generator(problem, interval_ball(*box["a_p"]), interval_ball(*rate_interval(box)))


def flows(generator: arb_mat, time: arb, pieces: int) -> Iterator[arb_mat]:
    """Enclosures of exp(generator s) over each of ``pieces`` equal pieces of 0 <= s <= time."""
    for piece in range(pieces):
        yield (generator * (time * interval_ball(piece / pieces, (piece + 1) / pieces))).exp()


def held_sample(problem: Problem, a_p: arb, rate: arb) -> arb_mat:
    """[[Phi, Gamma], [0, 1]] of one sample, in which the memories of delay and sensor move on."""
    return with_memories(problem, (held_generator(problem, a_p, rate) * arb(problem["sample_time"])).exp())


def with_memories(problem: Problem, held_matrix: arb_mat) -> arb_mat:
    """[[Phi, Gamma], [0, 1]] with the rows of the memories of delay and sensor, which change at the samples only."""
    zeta, memory, n = state_places(problem)
    rows = held_matrix.tolist()
    if not problem["denominator"]:
        for i in zeta:
            source = n - 2 if i == zeta[0] else i - 1
            rows[i] = [arb(int(j == source)) for j in range(n - 1)]
    if memory:
        kappa, memory_decay = memory_weights(problem)
        for output_index, i in enumerate(memory):
            rows[i] = [arb(0)] * (n - 1)
            rows[i][output_index] = kappa * (1 - memory_decay)
            rows[i][i] = memory_decay
    return arb_mat(rows)


def held_vertices(problem: Problem, box: Box, degree: int) -> list[arb_mat]:
    """[[Phi, Gamma], [0, 1]] at vertices whose hull holds that of every a_p and 1/mu of the box.

    Each ball also holds what interpolation in a_p and a Taylor polynomial in 1/mu leave out; that polynomial is a
    convex combination of its coefficients in Bernstein's basis.
    """
    rates = rate_interval(box)
    remainder = interpolation_error(problem, box, degree)
    vertices = []
    for a_p in exact_ends(box["a_p"]):
        if rates[0] == rates[1]:
            points = [(held_generator(problem, a_p, arb(rates[0])) * arb(problem["sample_time"])).exp()]
        else:
            points = bernstein_coefficients(problem, a_p, rates, degree)
        vertices += [with_memories(problem, point + remainder) for point in points]
    return vertices


def bernstein_coefficients(problem: Problem, a_p: arb, rates: Interval, degree: int) -> list[arb_mat]:
    """Bernstein coefficients, over an interval of 1/mu, of exp's Taylor polynomial about the interval's middle.

    The i-th coefficient of a term x^k on [-1, 1] is the mean product of k out of i numbers 1 and degree - i numbers -1.
    """
    low, high = map(arb, rates)
    (side,) = box_sides(problem, {"a_p": (0.0, 0.0), "rate": rates})
    generator = held_generator(problem, a_p, (low + high) / 2) * arb(problem["sample_time"])
    terms = taylor_terms(generator, side.slope * ((high - low) / 2), degree)
    coefficients = []
    for i in range(degree + 1):
        signs = [1] * i + [-1] * (degree - i)
        weighted_terms = []
        for k, term in enumerate(terms):
            products = sum(map(math.prod, combinations(signs, k)))
            weighted_terms.append(term * (arb(products) / math.comb(degree, k)))
        coefficients.append(reduce(add, weighted_terms))
    return coefficients


def box_sides(problem: Problem, box: Box) -> list[BoxSide]:
    """The sides of a box along a_p and along 1/mu that have a width."""
    zero, unit = arb(0), arb(1)
    t = arb(problem["sample_time"])
    origin = held_generator(problem, zero, zero)
    sides = []
    for name, interval, point in (("a_p", box["a_p"], (unit, zero)), ("rate", rate_interval(box), (zero, unit))):
        low, high = interval
        if low < high:
            slope = (held_generator(problem, *point) - origin) * t
            sides.append(BoxSide(name, arb(high) - arb(low), slope))
    return sides


def taylor_terms(generator: arb_mat, slope: arb_mat, order: int) -> list[arb_mat]:
    """The derivatives of exp(W) along W_i, up to this order, each over its factorial, from one exponential of blocks.

    They are the first row of blocks of exp of the matrix with W on the diagonal of blocks and W_i beside it.
    """
    size = generator.nrows()
    blocks = order + 1
    entries = [[arb(0)] * (blocks * size) for _ in range(blocks * size)]
    for i, j in product(range(size), range(size)):
        for k in range(blocks):
            entries[k * size + i][k * size + j] = generator[i, j]
        for k in range(order):
            entries[k * size + i][(k + 1) * size + j] = slope[i, j]
    first_rows = arb_mat(entries).exp().tolist()[:size]
    return [arb_mat([row[k * size : (k + 1) * size] for row in first_rows]) for k in range(blocks)]


def interpolation_error(problem: Problem, box: Box, degree: int) -> arb_mat:
    """A ball for what :func:`held_vertices` leaves out of [[Phi, Gamma], [0, 1]] within a box.

    Linear interpolation in a_p leaves at most width^2/8 sup |second derivative|. The Taylor polynomial in 1/mu about
    the middle leaves (width/2)^(degree + 1) sup |derivative of that order|, over the order's factorial.
    """
    generator = generator_over(problem, box) * arb(problem["sample_time"])
    size = generator.nrows()
    error = arb_mat(size, size)
    for side in box_sides(problem, box):
        order = degree + 1 if side.name == "rate" else 2
        term = taylor_terms(generator, side.slope, order)[-1] * ((side.width / 2) ** order)
        for i, j in product(range(size), range(size)):
            error[i, j] = error[i, j] + interval_ball(-1.0, 1.0) * abs(term[i, j]).upper()
    return error


def held_spread(problem: Problem, box: Box) -> list[list[arb]]:
    """Bounds of how far the entries of [[Phi, Gamma], [0, 1]] are from those at the middle of a box.

    By the mean value theorem that is half the width times the largest |derivative| for each side of the box.
    """
    generator = generator_over(problem, box) * arb(problem["sample_time"])
    size = generator.nrows()
    spread = [[arb(0)] * size for _ in range(size)]
    for side in box_sides(problem, box):
        derivative = taylor_terms(generator, side.slope, 1)[-1]
        for i, j in product(range(size), range(size)):
            spread[i][j] = (spread[i][j] + abs(derivative[i, j]) * side.width * HALF).upper()
    return spread
