"""The sampled loop in sliding, z+ = A z + B w, enclosed in balls: the verifier's own construction."""

import math
from collections.abc import Sequence
from functools import reduce
from itertools import combinations, product
from operator import add
from typing import Any, NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import Balls, both, enclosing, exact_ends, larger

HALF = arb(1) / 2 * (1 + arb(2) ** -100)  # of a width, from its middle, which is rounded
SAMPLE_PIECES = 8  # pieces of a sample on which its inside is enclosed


class Corner(NamedTuple):
    """One sample at a corner: A and the inputs' columns."""

    a: arb_mat
    b: arb_mat


class StatePlaces(NamedTuple):
    """Places in z: of zeta and of the sensor's memory, and the number of all states."""

    zeta: range
    memory: range
    n: int


class SignalBounds(NamedTuple):
    """Bounds of |d_r| [m/s], |d_r'|, |f'| [m/s^2], |d_r + f| [m/s] and its derivative over a box."""

    level: arb
    slope: arb
    feed_slope: arb
    offset: arb
    offset_slope: arb


def state_places(problem: dict[str, Any]) -> StatePlaces:
    """Where the states are: e, e', eta, zeta, the sensor's memory, v or q, s."""
    first = 2 + len(problem["zero_a"])
    orders = max(len(problem["denominator"]) - 1, math.ceil(problem["delay"]))
    memory = first + orders
    end = memory + (2 if problem["sensor_lag"] else 0)
    return StatePlaces(range(first, memory), range(memory, end), end + 2)


def signal_bounds(problem: dict[str, Any], box: dict[str, Any]) -> SignalBounds:
    """What disturbance and reference add up to: d_r = d - (y_m'' + a_p y_m')/k_p, f = (y_m'' + a_n y_m')/k_n."""
    level, slope = arb(problem["level"]), arb(problem["slope"])
    speed, acceleration, jerk = map(arb, problem["reference"])
    a_n, inverse = arb(0), arb(0)
    if problem["nominal"]:
        a_n, inverse = arb(problem["nominal"][0]), 1 / arb(problem["nominal"][1])
    worst = [arb(0)] * 5
    for k_p, a_p in product(exact_ends(box["k_p"]), exact_ends(box["a_p"])):  # each is largest at a corner
        push, left = abs(a_p) / k_p, abs(a_n * inverse - a_p / k_p)
        here = (
            level + acceleration / k_p + speed * push,
            slope + jerk / k_p + acceleration * push,
            inverse * (jerk + abs(a_n) * acceleration),
            level + abs(inverse - 1 / k_p) * acceleration + left * speed,
            slope + abs(inverse - 1 / k_p) * jerk + left * acceleration,
        )
        worst = [larger(each.upper(), before) for each, before in zip(here, worst, strict=True)]
    return SignalBounds(*worst)


def signal_rows(problem: dict[str, Any]) -> dict[str, arb_mat]:
    """Rows of e and sigma as they are measured, of sigma - s, of v or q, and of s."""
    layout = state_places(problem)
    unit = [arb_mat([[int(i == at) for i in range(layout.n)]]) for at in range(layout.n)]
    e, speed, v, s = unit[0], unit[1], unit[-2], unit[-1]
    if layout.memory:
        kappa, _ = memory_weights(problem)
        e, speed = (unit[i] * (1 - kappa) + unit[at] for i, at in enumerate(layout.memory))
    sigma = speed + e * arb(problem["l0"])
    return {"e": e, "sigma": sigma, "change": sigma - s, "v": v, "s": s}


def memory_weights(problem: dict[str, Any]) -> tuple[arb, arb]:
    """kappa and lambda: the sensor shows (1 - kappa) y + m, and m+ = lambda m + kappa (1 - lambda) y."""
    steps = arb(problem["sample_time"]) / arb(problem["sensor_lag"])
    return -(-steps).expm1() / steps, (-steps).exp()


def companion_of(problem: dict[str, Any]) -> tuple[list[arb], list[arb], arb]:
    """G(mu s) in companion form: a_0 .. of the monic denominator, output row, feedthrough."""
    below, above = ([arb(x) for x in problem[name]] for name in ("denominator", "numerator"))
    above += [arb(0)] * (len(below) - len(above))
    a, direct = [x / below[-1] for x in below[:-1]], above[-1] / below[-1]
    return a, [x / below[-1] - direct * y for x, y in zip(above, a, strict=False)], direct


def delay_weights(problem: dict[str, Any]) -> list[arb]:
    """Weights of the commands of ages 0, 1, ... samples in what acts on the plant."""
    whole = math.floor(problem["delay"])
    late = arb(problem["delay"]) - whole
    return [*([arb(0)] * whole), 1 - late, *([late] if late > 0 else [])]


def held_generator(problem: dict[str, Any], a_p: arb, rate: arb) -> arb_mat:
    """[[F, G], [0, 0]] of the held plant chi' = F chi + G U, U' = 0; memories rest between samples."""
    eta, (zeta, _, n) = len(problem["zero_a"]), state_places(problem)
    size = n - 1
    f = [[arb(0)] * size for _ in range(size)]
    f[0][1], f[1][1] = arb(1), -a_p
    for i, c in enumerate(problem["zero_c"]):
        f[1][2 + i] = -arb(c)
    for i in range(eta - 1):
        f[2 + i][3 + i] = arb(1)
    if eta:
        f[1 + eta][1] = arb(1)
        for i, a in enumerate(problem["zero_a"]):
            f[1 + eta][2 + i] = f[1 + eta][2 + i] - arb(a)
    if problem["denominator"]:
        below, output, f[1][-1] = companion_of(problem)
        for at, a, c in zip(zeta, below, output, strict=True):
            f[1][at] = c
            f[zeta[-1]][at] = -rate * a
            if at < zeta[-1]:
                f[at][at + 1] += rate
        f[zeta[-1]][-1] = rate
    else:
        f[1][-1], *held = delay_weights(problem)
        for at, weight in zip(zeta, held, strict=True):
            f[1][at] = weight
    return arb_mat(f)


def held_sample(problem: dict[str, Any], a_p: arb, rate: arb) -> arb_mat:
    """[[Phi, Gamma], [0, 1]] of one sample, in which the memories of delay and sensor move on."""
    return moved_on(problem, (held_generator(problem, a_p, rate) * arb(problem["sample_time"])).exp())


def moved_on(problem: dict[str, Any], held: arb_mat) -> arb_mat:
    """With the rows of the memories of delay and sensor, which rest between the samples and move on at them."""
    zeta, memory, n = state_places(problem)
    rows = [[held[i, j] for j in range(n - 1)] for i in range(n - 1)]
    if not problem["denominator"]:
        for i in zeta:
            rows[i] = [arb(int(j == (n - 2 if i == zeta[0] else i - 1))) for j in range(n - 1)]
    if memory:
        kappa, keeps = memory_weights(problem)
        for of, i in enumerate(memory):
            rows[i] = [keeps if j == i else kappa * (1 - keeps) if j == of else arb(0) for j in range(n - 1)]
    return arb_mat(rows)


def held_vertices(problem: dict[str, Any], box: dict[str, Any], degree: int) -> list[arb_mat]:
    """[[Phi, Gamma], [0, 1]] at vertices whose hull holds that of every a_p and 1/mu of the box.

    Each ball also holds what interpolation in a_p and a Taylor polynomial in 1/mu leave out; that polynomial is a
    convex combination of its coefficients in Bernstein's basis.
    """
    rates, rest = box.get("rate", (0.0, 0.0)), interpolation_error(problem, box, degree)
    result = []
    for a_p in exact_ends(box["a_p"]):
        if rates[0] == rates[1]:
            points = [(held_generator(problem, a_p, arb(rates[0])) * arb(problem["sample_time"])).exp()]
        else:
            points = bernstein_coefficients(problem, a_p, rates, degree)
        result += [moved_on(problem, point + rest) for point in points]
    return result


def bernstein_coefficients(problem: dict[str, Any], a_p: arb, rates: Any, degree: int) -> list[arb_mat]:
    """Those of the Taylor polynomial of exp about the middle of an interval of 1/mu, over that interval.

    The i-th of the term x^k on [-1, 1] is the mean product of k out of i numbers 1 and degree - i numbers -1.
    """
    low, high = map(arb, rates)
    (_, along), *_ = box_directions(problem, {"a_p": (0.0, 0.0), "rate": rates})
    whole = held_generator(problem, a_p, (low + high) / 2) * arb(problem["sample_time"])
    terms = chained(whole, along * ((high - low) / 2), degree)
    result = []
    for i in range(degree + 1):
        signs = [1] * i + [-1] * (degree - i)
        means = [arb(sum(map(math.prod, combinations(signs, k)))) / math.comb(degree, k) for k in range(degree + 1)]
        result.append(reduce(add, (term * mean for term, mean in zip(terms, means, strict=True))))
    return result


def sample_corners(
    problem: dict[str, Any], box: dict[str, Any], held: list[arb_mat], gains: Balls, *, integrated: bool
) -> list[Corner]:
    """Every corner of plant and gains, the plant's at the vertices that :func:`held_vertices` gives."""
    sizes = signal_bounds(problem, box)
    inside = inside_bounds(problem, box, arb(problem["sample_time"]))
    first, result = "mean" if integrated else "k_p", []
    for vertex, k_p in product(held, exact_ends(box["k_p"])):
        b = input_columns(problem, k_p, sizes, inside)
        for gain in product(*(both(gains[name]) for name in (first, "k_i", "k_n"))):
            result.append(Corner(sampled(problem, vertex, k_p, gain, integrated=integrated), b))
    return result


def sampled(
    problem: dict[str, Any], held: arb_mat, k_p: arb, gain: Sequence[arb], *, integrated: bool = False
) -> arb_mat:
    """A at one corner; in the coordinate q = v - phi_1(s), the first gain is phi_1/sigma."""
    _, _, n = state_places(problem)
    chi, rows = n - 2, signal_rows(problem)
    new, command = control_rows(problem, gain, integrated=integrated)
    a = [
        [(held[i, j] if j < chi else arb(0)) + k_p * held[i, chi] * command[0, j] for j in range(n)] for i in range(chi)
    ]
    return arb_mat([*a, *([row[0, j] for j in range(n)] for row in (new, rows["sigma"]))])


def control_rows(problem: dict[str, Any], gain: Sequence[arb], *, integrated: bool) -> tuple[arb_mat, arb_mat]:
    """The rows of v+ or q+, without what d_r + f changes by, and of the command plus d_r."""
    rows, (first, k_i, k_n) = signal_rows(problem), gain
    new = rows["v"] + rows["sigma"] * (arb(problem["sample_time"]) * k_i)
    if integrated:
        command = -new - rows["sigma"] * first
    else:
        new = new + rows["change"] * first
        command = -new
    if problem["nominal"]:
        a_n, k, l0 = arb(problem["nominal"][0]), arb(problem["nominal"][1]), arb(problem["l0"])
        command = command - (rows["e"] * ((a_n - l0) * l0) + rows["sigma"] * (l0 - a_n)) * (1 / k)
        command = command - rows["sigma"] * k_n
    return new, command


def zeta_jump(problem: dict[str, Any]) -> list[arb]:
    """What a change of k_p d_r by 1 adds to zeta."""
    zeta = state_places(problem).zeta
    if problem["denominator"]:
        return [1 / companion_of(problem)[0][0], *(arb(0) for _ in zeta[1:])]
    return [arb(1) for _ in zeta]


def input_columns(problem: dict[str, Any], k_p: arb, sizes: SignalBounds, inside: list[arb]) -> arb_mat:
    """Columns of the changes of d_r + f and -f and of theta's components, for inputs of magnitude at most 1."""
    zeta, _, n = state_places(problem)
    t, before, after = arb(problem["sample_time"]), [arb(0)] * zeta.start, [arb(0)] * (n - 2 - zeta.stop)
    jump = [k_p * each for each in zeta_jump(problem)]
    both_move = [*before, *jump, *after, arb(-1), arb(0)]
    feed_moves = [*before, *jump, *after, arb(0), arb(0)]
    columns = [[t * sizes.offset_slope * x for x in both_move], [t * sizes.feed_slope * x for x in feed_moves]]
    columns += [[inside[i] if i == j else arb(0) for i in range(n)] for j in range(zeta.start)]
    return arb_mat([[column[i] for column in columns] for i in range(n)])


def inside_bounds(problem: dict[str, Any], box: dict[str, Any], time: arb) -> list[arb]:
    """Bound of each component of theta: D t^2/2 times the largest |exp(F s)| k_p from d_r to it, for s in [0, t]."""
    _, _, n = state_places(problem)
    f = held_generator(problem, enclosing(*box["a_p"]), enclosing(*box.get("rate", (0.0, 0.0))))
    largest = [arb(0)] * n
    for piece in range(SAMPLE_PIECES):
        s = time * enclosing(piece / SAMPLE_PIECES, (piece + 1) / SAMPLE_PIECES)
        flow = (f * s).exp()
        largest = [larger(largest[i], abs(flow[i, 1]).upper() if i < n - 2 else arb(0)) for i in range(n)]
    factor = signal_bounds(problem, box).slope * time * time / 2 * arb(box["k_p"][1])
    return [(factor * each).upper() for each in largest]


def start_columns(problem: dict[str, Any], box: dict[str, Any], ratio: arb) -> arb_mat:
    """Every corner of the starts: z is affine in the initial state, in d_r(0), f(0), k_p d_r(0) and the ratio.

    Args:
        problem: The certificate's problem.
        box: Its box.
        ratio: Ball of what the start takes from v or q, over sigma.
    """
    layout, sizes, jump = state_places(problem), signal_bounds(problem, box), zeta_jump(problem)
    kappa = memory_weights(problem)[0] if layout.memory else arb(0)
    pairs = [(d, offset) for d in (-sizes.level, sizes.level) for offset in (-sizes.offset, sizes.offset)]
    if not any(problem["reference"]):  # d_r and d_r + f are the same
        pairs = [(-sizes.level, -sizes.level), (sizes.level, sizes.level)]
    columns = []
    for plant in product(*(exact_ends(pair) for pair in problem["initial"])):
        s = plant[1] + arb(problem["l0"]) * plant[0] if problem["start"] != "zero" else arb(0)
        shown = [kappa * plant[i] for i, _ in enumerate(layout.memory)]
        for (d, offset), k_p, share in product(pairs, exact_ends(box["k_p"]), both(ratio)):
            zeta = [k_p * d * each for each in jump]
            columns.append([*plant, *zeta, *shown, -offset - share * s, s])
    return arb_mat([list(row) for row in zip(*columns, strict=True)])


def box_directions(problem: dict[str, Any], box: dict[str, Any]) -> list[tuple[arb, arb_mat]]:
    """Width of the box along a_p and along 1/mu, where it has one, and the derivative of the generator times T_s."""
    zero, one, t = arb(0), arb(1), arb(problem["sample_time"])
    origin = held_generator(problem, zero, zero)
    sides = ((box["a_p"], (one, zero)), (box.get("rate", (0.0, 0.0)), (zero, one)))
    live = [(arb(high) - arb(low), unit) for (low, high), unit in sides if low < high]
    return [(width, (held_generator(problem, *unit) - origin) * t) for width, unit in live]


def chained(whole: arb_mat, along: arb_mat, order: int) -> list[arb_mat]:
    """The derivatives of exp(W) along W_i, up to this order, each over its factorial, from one exponential of blocks.

    They are the first row of blocks of exp of the matrix with W on the diagonal of blocks and W_i beside it.
    """
    size, blocks = whole.nrows(), order + 1
    entries = [[arb(0)] * (blocks * size) for _ in range(blocks * size)]
    for i, j in product(range(size), range(size)):
        for k in range(blocks):
            entries[k * size + i][k * size + j] = whole[i, j]
        for k in range(order):
            entries[k * size + i][(k + 1) * size + j] = along[i, j]
    flow = arb_mat(entries).exp()
    return [arb_mat([[flow[i, k * size + j] for j in range(size)] for i in range(size)]) for k in range(blocks)]


def box_generator(problem: dict[str, Any], box: dict[str, Any]) -> arb_mat:
    """The generator's enclosure over the box, times T_s."""
    f = held_generator(problem, enclosing(*box["a_p"]), enclosing(*box.get("rate", (0.0, 0.0))))
    return f * arb(problem["sample_time"])


def interpolation_error(problem: dict[str, Any], box: dict[str, Any], degree: int) -> arb_mat:
    """What is left out by linear interpolation in a_p and a Taylor polynomial in 1/mu about the middle.

    width^2/8 sup |second derivative| of the one, (width/2)^(degree + 1) sup |derivative of that order| over the
    factorial of the other.
    """
    whole = box_generator(problem, box)
    size = whole.nrows()
    rest, sides = arb_mat(size, size), box_directions(problem, box)
    for number, (width, along) in enumerate(sides):
        in_rate = number == len(sides) - 1 and box.get("rate", (0.0, 0.0))[0] < box.get("rate", (0.0, 0.0))[1]
        order = degree + 1 if in_rate else 2
        left = chained(whole, along, order)[-1] * ((width / 2) ** order)
        for i, j in product(range(size), range(size)):
            rest[i, j] = rest[i, j] + enclosing(-1.0, 1.0) * abs(left[i, j]).upper()
    return rest


def held_spread(problem: dict[str, Any], box: dict[str, Any]) -> list[list[arb]]:
    """How far exp is from that of the box's middle: half a width times sup |first derivative|, summed."""
    whole = box_generator(problem, box)
    size = whole.nrows()
    spread = [[arb(0)] * size for _ in range(size)]
    for width, along in box_directions(problem, box):
        first = chained(whole, along, 1)[-1]
        for i, j in product(range(size), range(size)):
            spread[i][j] = (spread[i][j] + abs(first[i, j]) * width * HALF).upper()
    return spread
