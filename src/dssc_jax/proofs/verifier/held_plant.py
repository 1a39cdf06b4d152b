"""The plant between two samples, chi' = F chi + G U with U held, enclosed in balls over a box of plants.

chi = (e, e', eta, zeta, m): the error and its rate, the zero dynamics eta, the state zeta of the unmodelled dynamics
G(mu s) or of a delay, which holds commands, times k_p, and the memory m of a sensor's lag. Over a sample
[chi+, U] = [[Phi, Gamma], [0, 1]] [chi, U], where this matrix is the exponential of T_s [[F, G], [0, 0]]; only the rows
of a memory differ from it.
"""

import math
from collections.abc import Iterator
from functools import reduce
from itertools import combinations, product
from operator import add
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import exact_ends, interval_ball
from dssc_jax.proofs.verifier.certificate import Box, Interval, Problem

HALF = arb(1) / 2 * (1 + arb(2) ** -100)
"""Bound of the distance of any point of an interval from the interval's rounded middle, over the interval's width."""


class StatePlaces(NamedTuple):
    """The places of zeta and of the sensor's memory m in z = (e, e', eta, zeta, m, v, s), and the length n of z."""

    zeta: range
    memory: range
    n: int


class CompanionForm(NamedTuple):
    """G(mu s) as a state-space system in companion form.

    Args:
        a: a_0 to a_(n-1), the coefficients of the monic denominator in rising powers of mu s, without the leading 1.
        output: Output row over the n states.
        direct: Feedthrough from the input to the output.
    """

    a: list[arb]
    output: list[arb]
    direct: arb


class BoxSide(NamedTuple):
    """A side of a box along which the held plant varies: an interval of a_p or of 1/mu.

    Args:
        name: ``a_p``, or ``rate`` for 1/mu.
        width: Width of the interval [1/s].
        slope: Derivative of T_s [[F, G], [0, 0]] by the number of the interval [s], shape (n - 1, n - 1).
    """

    name: str
    width: arb
    slope: arb_mat


def state_places(problem: Problem) -> StatePlaces:
    """Places of zeta and m in z = (e, e', eta, zeta, m, v or q, s), and the length of z, from a problem's entries."""
    zeta_start = 2 + len(problem["zero_a"])
    order = max(len(problem["denominator"]) - 1, math.ceil(problem["delay"]))  # of G, or of the delay
    zeta_end = zeta_start + order
    memory_end = zeta_end + (2 if problem["sensor_lag"] else 0)  # of y and y'
    return StatePlaces(range(zeta_start, zeta_end), range(zeta_end, memory_end), memory_end + 2)


def rate_interval(box: Box) -> Interval:
    """The interval of 1/mu [1/s] of a box; (0, 0) without a transfer function."""
    return box.get("rate", (0.0, 0.0))


class SensorWeights(NamedTuple):
    """Weights of a sensor's lag, which measures (1 - kappa) y + m at a sample, with a memory m.

    Args:
        kappa: Share of y that the measurement leaves out.
        decay: lambda, the factor of m in a sample: m+ = lambda m + kappa (1 - lambda) y.
    """

    kappa: arb
    decay: arb


def sensor_weights(problem: Problem) -> SensorWeights:
    """The weights of a sensor's lag; the problem must have one."""
    ratio = arb(problem["sample_time"]) / arb(problem["sensor_lag"])
    return SensorWeights(kappa=-(-ratio).expm1() / ratio, decay=(-ratio).exp())


def companion_form(problem: Problem) -> CompanionForm:
    """G(mu s) in companion form, from its numerator and denominator."""
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
    """[[F, G], [0, 0]] of the held plant chi' = F chi + G U, U' = 0, shape (n - 1, n - 1).

    The rows of the memories of delay and sensor are 0, since they do not change between samples.

    Args:
        problem: The certificate's problem.
        a_p: Damping [1/s].
        rate: 1/mu [1/s] of G(mu s); unused without a transfer function.
    """
    zeta, _, n = state_places(problem)
    generator = [[arb(0)] * (n - 1) for _ in range(n - 1)]  # the last column is G
    generator[0][1] = arb(1)  # e
    generator[1][1] = -a_p  # e'' = -a_p e' - zero_c eta + the unmodelled dynamics' output
    for i, coefficient in enumerate(problem["zero_c"], 2):
        generator[1][i] = -arb(coefficient)
    last_eta = 1 + len(problem["zero_a"])
    for i in range(2, last_eta):  # eta_i' = eta_(i+1), and the last one is driven by e'
        generator[i][i + 1] = arb(1)
    if problem["zero_a"]:
        generator[last_eta][1] = arb(1)
    for i, coefficient in enumerate(problem["zero_a"], 2):
        generator[last_eta][i] = generator[last_eta][i] - arb(coefficient)
    if not problem["denominator"]:  # a weighted sum of the command and of those before it, which zeta holds
        generator[1][-1], *weights = delay_weights(problem["delay"])
        for i, weight in zip(zeta, weights, strict=True):
            generator[1][i] = weight
        return arb_mat(generator)
    form = companion_form(problem)
    last_zeta = zeta[-1]
    generator[1][-1] = form.direct
    for i, output in zip(zeta, form.output, strict=True):
        generator[1][i] = output
    for i in zeta[:-1]:  # mu zeta_i' = zeta_(i+1), and the last one is driven by U
        generator[i][i + 1] = rate
    for i, coefficient in zip(zeta, form.a, strict=True):
        generator[last_zeta][i] = -rate * coefficient
    generator[last_zeta][-1] = rate
    return arb_mat(generator)


def generator_over(problem: Problem, box: Box) -> arb_mat:
    """[[F, G], [0, 0]] of the held plant, in one matrix of balls for all a_p and 1/mu of a box."""
    return held_generator(problem, interval_ball(*box["a_p"]), interval_ball(*rate_interval(box)))


def flows(generator: arb_mat, time: arb, pieces: int) -> Iterator[arb_mat]:
    """Yield enclosures of exp([[F, G], [0, 0]] r) over the time r since a sample, one for each piece of time.

    Args:
        generator: [[F, G], [0, 0]], shape (n - 1, n - 1).
        time: End of the last piece [s]; the first piece begins at r = 0.
        pieces: Number of equal pieces.
    """
    for piece in range(pieces):
        yield (generator * (time * interval_ball(piece / pieces, (piece + 1) / pieces))).exp()


def held_sample(problem: Problem, a_p: arb, rate: arb) -> arb_mat:
    """[[Phi, Gamma], [0, 1]] of one whole sample, including the step of the memories at the sample's end.

    Args:
        problem: The certificate's problem.
        a_p: Damping [1/s].
        rate: 1/mu [1/s] of G(mu s); unused without a transfer function.
    """
    return with_memories(problem, (held_generator(problem, a_p, rate) * arb(problem["sample_time"])).exp())


def with_memories(problem: Problem, held_matrix: arb_mat) -> arb_mat:
    """Replace the rows of [[Phi, Gamma], [0, 1]] for the memories of delay and sensor, which change at samples only."""
    zeta, memory, n = state_places(problem)
    rows = held_matrix.tolist()
    if not problem["denominator"]:  # zeta holds past commands: the youngest is U, the others move on by one place
        u_place = n - 2
        for i in zeta:
            source = u_place if i == zeta[0] else i - 1
            rows[i] = [arb(int(j == source)) for j in range(n - 1)]
    if memory:
        kappa, decay = sensor_weights(problem)
        for signal, i in enumerate(memory):  # states 0 and 1 are e and e'
            rows[i] = [arb(0)] * (n - 1)
            rows[i][signal] = kappa * (1 - decay)
            rows[i][i] = decay
    return arb_mat(rows)


def held_vertices(problem: Problem, box: Box, degree: int) -> list[arb_mat]:
    """Vertices of [[Phi, Gamma], [0, 1]]: their convex hull contains the matrix of every a_p and 1/mu of a box.

    In a_p the vertices belong to the ends of its interval. In 1/mu they are the coefficients, in Bernstein's basis, of
    a Taylor polynomial, which is a convex combination of its coefficients. The balls are widened by the errors of the
    interpolation and of the polynomial.

    Args:
        problem: The certificate's problem.
        box: Intervals of k_p, a_p and 1/mu.
        degree: Degree of the polynomial.
    """
    rates = rate_interval(box)
    low, high = rates
    remainder = interpolation_error(problem, box, degree)
    vertices = []
    for a_p in exact_ends(box["a_p"]):
        if low == high:
            points = [(held_generator(problem, a_p, arb(low)) * arb(problem["sample_time"])).exp()]
        else:
            points = bernstein_coefficients(problem, a_p, rates, degree)
        vertices += [with_memories(problem, point + remainder) for point in points]
    return vertices


def bernstein_coefficients(problem: Problem, a_p: arb, rates: Interval, degree: int) -> list[arb_mat]:
    """Coefficients in Bernstein's basis of the Taylor polynomial of exp(T_s [[F, G], [0, 0]]) in 1/mu.

    The polynomial is taken about the middle of the interval. With x from -1 to 1 over the interval, the i-th
    coefficient of x^k is the mean, over all choices of k out of ``degree`` numbers, of their product, where i of these
    numbers are 1 and the others -1.

    Args:
        problem: The certificate's problem.
        a_p: Damping [1/s].
        rates: Interval of 1/mu [1/s].
        degree: Degree of the polynomial.
    """
    low, high = map(arb, rates)
    t = arb(problem["sample_time"])
    generator = held_generator(problem, a_p, (low + high) / 2) * t
    slope = rate_slope(problem) * ((high - low) / 2)  # change of the generator from the middle to the upper end
    terms = taylor_terms(generator, slope, degree)
    coefficients = []
    for i in range(degree + 1):
        signs = [1] * i + [-1] * (degree - i)
        weighted_terms = []
        for k, term in enumerate(terms):
            products = sum(map(math.prod, combinations(signs, k)))
            weighted_terms.append(term * (arb(products) / math.comb(degree, k)))
        coefficients.append(reduce(add, weighted_terms))
    return coefficients


def damping_slope(problem: Problem) -> arb_mat:
    """Derivative of T_s [[F, G], [0, 0]] by a_p [s]; the generator is affine in a_p."""
    zero = arb(0)
    difference = held_generator(problem, arb(1), zero) - held_generator(problem, zero, zero)
    return difference * arb(problem["sample_time"])


def rate_slope(problem: Problem) -> arb_mat:
    """Derivative of T_s [[F, G], [0, 0]] by 1/mu [s]; the generator is affine in 1/mu."""
    zero = arb(0)
    difference = held_generator(problem, zero, arb(1)) - held_generator(problem, zero, zero)
    return difference * arb(problem["sample_time"])


def box_sides(problem: Problem, box: Box) -> list[BoxSide]:
    """The sides of a box that have a width, of a_p and of 1/mu; k_p does not enter the held plant."""
    sides = []
    low, high = box["a_p"]
    if low < high:
        sides.append(BoxSide("a_p", arb(high) - arb(low), damping_slope(problem)))
    low, high = rate_interval(box)
    if low < high:
        sides.append(BoxSide("rate", arb(high) - arb(low), rate_slope(problem)))
    return sides


def taylor_terms(generator: arb_mat, slope: arb_mat, order: int) -> list[arb_mat]:
    """The terms 0 to ``order`` of exp(W + x D) as a power series in x.

    The terms are the first row of blocks of exp(M), where the block matrix M has W in each diagonal block and D in each
    block to the right of the diagonal.

    Args:
        generator: W, a square matrix.
        slope: D, of the same shape.
        order: Order of the last term.
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
    """Balls about 0 that contain the errors of :func:`held_vertices`, shape (n - 1, n - 1).

    Linear interpolation in a_p has an error of at most width^2/8 sup |second derivative|. The Taylor polynomial in 1/mu
    about the middle has one of at most (width/2)^m sup |m-th derivative|/m! with m = degree + 1. For m = 2 both
    formulas agree, so that one line computes both.
    """
    generator = generator_over(problem, box) * arb(problem["sample_time"])
    size = generator.nrows()
    error = arb_mat(size, size)
    for side in box_sides(problem, box):
        order = degree + 1 if side.name == "rate" else 2
        last_term = taylor_terms(generator, side.slope, order)[order]  # derivative over its factorial
        term = last_term * ((side.width / 2) ** order)
        for i, j in product(range(size), range(size)):
            error[i, j] = error[i, j] + interval_ball(-1.0, 1.0) * abs(term[i, j]).upper()
    return error


def held_spread(problem: Problem, box: Box) -> list[list[arb]]:
    """Bounds of the distance of each entry of [[Phi, Gamma], [0, 1]] from the entry's value in the middle of a box.

    By the mean value theorem the distance is at most the sum, over a_p and 1/mu, of half of the interval's width times
    the largest |derivative|.

    Args:
        problem: The certificate's problem.
        box: Intervals of k_p, a_p and 1/mu; k_p is not used.

    Returns:
        Rows of a matrix, shape (n - 1, n - 1).
    """
    generator = generator_over(problem, box) * arb(problem["sample_time"])
    size = generator.nrows()
    spread = [[arb(0)] * size for _ in range(size)]
    for side in box_sides(problem, box):
        _, derivative = taylor_terms(generator, side.slope, 1)
        for i, j in product(range(size), range(size)):
            spread[i][j] = (spread[i][j] + abs(derivative[i, j]) * side.width * HALF).upper()
    return spread
