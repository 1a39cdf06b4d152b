"""The sampled loop in sliding, z+ = A z + B w, enclosed in balls: the verifier's own construction."""

from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.balls import both, enclosing, exact_ends, larger
from dssc_jax.proofs.gain_enclosures import Balls

HALF = arb(1) / 2 * (1 + arb(2) ** -100)  # of a width, from its middle, which is rounded
SAMPLE_PIECES = 8  # pieces of a sample on which its inside is enclosed


class Corner(NamedTuple):
    """One sample at a corner: A and the inputs' columns."""

    a: arb_mat
    b: arb_mat


def dimensions(problem: dict[str, Any]) -> tuple[int, int, int]:
    """Numbers of eta, of zeta, and of all states."""
    eta, lag = len(problem["zero_a"]), problem["lag_order"]
    return eta, lag, 4 + eta + lag


def signal_rows(problem: dict[str, Any]) -> dict[str, arb_mat]:
    """Rows of e, sigma, sigma - s and v."""
    _, _, n = dimensions(problem)
    e, speed, v, s = (arb_mat([[int(i == at) for i in range(n)]]) for at in (0, 1, n - 2, n - 1))
    sigma = speed + e * arb(problem["l0"])
    return {"e": e, "sigma": sigma, "change": sigma - s, "v": v}


def held_generator(problem: dict[str, Any], a_p: arb, rate: arb) -> arb_mat:
    """[[F, G], [0, 0]] of the held plant chi' = F chi + G U, U' = 0."""
    eta, lag, n = dimensions(problem)
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
    first = 2 + eta
    for i in range(lag):
        f[first + i][first + i] = -rate
        f[first + i][first + i - 1 if i else size - 1] = rate
    f[1][first + lag - 1 if lag else size - 1] = arb(1)
    return arb_mat(f)


def sample_corners(problem: dict[str, Any], box: dict[str, Any], gains: Balls) -> list[Corner]:
    """Every corner of plant and gains; each of its balls also holds what interpolation between corners leaves out."""
    rate = box.get("rate", (0.0, 0.0))
    rest = interpolation_error(problem, box)
    inside = inside_bounds(problem, box, arb(problem["sample_time"]))
    result = []
    for a_p, lag_rate in product(exact_ends(box["a_p"]), exact_ends(rate)):
        held = (held_generator(problem, a_p, lag_rate) * arb(problem["sample_time"])).exp() + rest
        for k_p in exact_ends(box["k_p"]):
            b = input_columns(problem, k_p, inside)
            for gain in product(*(both(gains[name]) for name in ("k_p", "k_i", "k_n"))):
                result.append(Corner(sampled(problem, held, k_p, gain), b))
    return result


def sampled(problem: dict[str, Any], held: arb_mat, k_p: arb, gain: Sequence[arb]) -> arb_mat:
    """A at one corner."""
    _, _, n = dimensions(problem)
    chi, rows = n - 2, signal_rows(problem)
    new = new_row(problem, gain[0], gain[1])
    command = command_row(problem, new, gain[2])
    a = [
        [(held[i, j] if j < chi else arb(0)) + k_p * held[i, chi] * command[0, j] for j in range(n)] for i in range(chi)
    ]
    return arb_mat([*a, *([row[0, j] for j in range(n)] for row in (new, rows["sigma"]))])


def new_row(problem: dict[str, Any], k_p: arb, k_i: arb) -> arb_mat:
    """The row of v+, without the jump of d."""
    rows = signal_rows(problem)
    return rows["v"] + rows["change"] * k_p + rows["sigma"] * (arb(problem["sample_time"]) * k_i)


def command_row(problem: dict[str, Any], new: arb_mat, k_n: arb) -> arb_mat:
    """The row of u + d: -v+ and the nominal control."""
    command, rows = -new, signal_rows(problem)
    if problem["nominal"]:
        a_n, k, _ = problem["nominal"]
        a_n, k, l0 = arb(a_n), arb(k), arb(problem["l0"])
        command = command - (rows["e"] * ((a_n - l0) * l0) + rows["sigma"] * (l0 - a_n)) * (1 / k)
        command = command - rows["sigma"] * k_n
    return command


def input_columns(problem: dict[str, Any], k_p: arb, inside: list[arb]) -> arb_mat:
    """Columns of Delta and of theta's components, for inputs of magnitude at most 1."""
    eta, lag, n = dimensions(problem)
    jump = arb(problem["sample_time"]) * arb(problem["slope"])
    first = [arb(0)] * (2 + eta) + [k_p * jump] * lag + [-jump, arb(0)]
    columns = [first, *([inside[i] if i == j else arb(0) for i in range(n)] for j in range(2 + eta))]
    return arb_mat([[column[i] for column in columns] for i in range(n)])


def inside_bounds(problem: dict[str, Any], box: dict[str, Any], time: arb) -> list[arb]:
    """Bound of each component of theta: D t^2/2 times the largest |exp(F s)| k_p from d to it, for s in [0, t]."""
    _, _, n = dimensions(problem)
    f = held_generator(problem, enclosing(*box["a_p"]), enclosing(*box.get("rate", (0.0, 0.0))))
    largest = [arb(0)] * n
    for piece in range(SAMPLE_PIECES):
        s = time * enclosing(piece / SAMPLE_PIECES, (piece + 1) / SAMPLE_PIECES)
        flow = (f * s).exp()
        largest = [larger(largest[i], abs(flow[i, 1]).upper() if i < n - 2 else arb(0)) for i in range(n)]
    factor = arb(problem["slope"]) * time * time / 2 * arb(box["k_p"][1])
    return [(factor * each).upper() for each in largest]


def start_columns(problem: dict[str, Any]) -> arb_mat:
    """Every corner of the starts: z is affine in the initial state, in d(0) and in k_p d(0)."""
    lag, level = problem["lag_order"], arb(problem["level"])
    columns = []
    for plant in product(*(exact_ends(pair) for pair in problem["initial"])):
        for d, k_p in product((-level, level), exact_ends(problem["k_p"])):
            sigma = plant[1] + arb(problem["l0"]) * plant[0]
            columns.append([*plant, *([k_p * d] * lag), -d, sigma if problem["matched"] else arb(0)])
    return arb_mat([list(row) for row in zip(*columns, strict=True)])


def box_directions(problem: dict[str, Any], box: dict[str, Any]) -> list[tuple[arb, arb_mat]]:
    """Width of the box along a_p and along 1/mu, where it has one, and the derivative of the generator times T_s."""
    zero, one, t = arb(0), arb(1), arb(problem["sample_time"])
    origin = held_generator(problem, zero, zero)
    sides = ((box["a_p"], (one, zero)), (box.get("rate", (0.0, 0.0)), (zero, one)))
    live = [(arb(high) - arb(low), unit) for (low, high), unit in sides if low < high]
    return [(width, (held_generator(problem, *unit) - origin) * t) for width, unit in live]


def chained(whole: arb_mat, along: arb_mat, order: int) -> arb_mat:
    """The derivative of exp(W) along W_i, of this order over its factorial, from one exponential of blocks.

    It is the upper right block of exp of the matrix with W on the diagonal of blocks and W_i beside it.
    """
    size, blocks = whole.nrows(), order + 1
    entries = [[arb(0)] * (blocks * size) for _ in range(blocks * size)]
    for i, j in product(range(size), range(size)):
        for k in range(blocks):
            entries[k * size + i][k * size + j] = whole[i, j]
        for k in range(order):
            entries[k * size + i][(k + 1) * size + j] = along[i, j]
    flow = arb_mat(entries).exp()
    return arb_mat([[flow[i, order * size + j] for j in range(size)] for i in range(size)])


def box_generator(problem: dict[str, Any], box: dict[str, Any]) -> arb_mat:
    """The generator's enclosure over the box, times T_s."""
    f = held_generator(problem, enclosing(*box["a_p"]), enclosing(*box.get("rate", (0.0, 0.0))))
    return f * arb(problem["sample_time"])


def interpolation_error(problem: dict[str, Any], box: dict[str, Any]) -> arb_mat:
    """What multilinear interpolation of exp between the box's corners leaves out: width^2/8 sup |second derivative|."""
    whole = box_generator(problem, box)
    size = whole.nrows()
    rest = arb_mat(size, size)
    for width, along in box_directions(problem, box):
        second = chained(whole, along, 2)
        for i, j in product(range(size), range(size)):
            bound = (abs(second[i, j]) * 2 * width * width / 8).upper()
            rest[i, j] = rest[i, j] + enclosing(-1.0, 1.0) * bound
    return rest


def held_spread(problem: dict[str, Any], box: dict[str, Any]) -> list[list[arb]]:
    """How far exp is from that of the box's middle: half a width times sup |first derivative|, summed."""
    whole = box_generator(problem, box)
    size = whole.nrows()
    spread = [[arb(0)] * size for _ in range(size)]
    for width, along in box_directions(problem, box):
        first = chained(whole, along, 1)
        for i, j in product(range(size), range(size)):
            spread[i][j] = (spread[i][j] + abs(first[i, j]) * width * HALF).upper()
    return spread
