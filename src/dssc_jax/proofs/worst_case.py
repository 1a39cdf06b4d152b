"""A sharper bound of the settled error of one plant: sums of absolute impulse responses, and a small gain.

At gains K_c in the middle of their balls, z+ = A_c z + B w + b_v omega_v + b_n omega_n with
|omega_v| <= dK_P |sigma - s| + T_s dK_I |sigma| and |omega_n| <= dK_N |sigma|. Every signal's upper limit is at most
the sum of its l1 norms times the inputs' bounds. For Y = (|sigma - s|, |sigma|) this reads Y <= h + M Y, so
Y <= (I - M)^-1 h if M has a norm below 1. The region of the gains shrinks to Y, and the bound is taken again.
"""

from itertools import product
from typing import Any, NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.balls import enclosing, larger
from dssc_jax.proofs.enclosed_loop import (
    command_row,
    dimensions,
    held_generator,
    input_columns,
    inside_bounds,
    sampled,
    signal_rows,
)
from dssc_jax.proofs.gain_enclosures import Balls, enclosed_gains

BLOCK, MOST_BLOCKS = 64, 4000
"""Samples that are summed at once, and the largest number of blocks."""
SHRINKINGS = 3
"""Times that the region is taken anew."""
OUTGROWN = arb("1.0001")
"""A multiple of an upper limit, which a signal does not exceed from some time on."""
TAIL_SHARE = arb("3e-4")
"""Share of a sum at which its tail is bounded instead of computed."""


class CentredLoop(NamedTuple):
    """One plant at the middle of its gains.

    Args:
        a: A_c.
        inputs: Columns of w, of omega_v and of omega_n.
        rows: Rows of sigma - s, sigma and e at the samples.
        bend: Row of e'' within a sample.
        slip: Bound of |d e''(t)/d omega| within a sample.
        rest: Bound of the effect of d(t) - d_k on e''(t).
    """

    a: arb_mat
    inputs: arb_mat
    rows: arb_mat
    bend: arb_mat
    slip: arb
    rest: arb


def l1_norms(loop: CentredLoop, p: arb_mat, decay: arb) -> list[list[arb]] | None:
    """Upper bounds of the sums over k of |row A^k column|, by rows and columns; None if the sums converge too slowly.

    Args:
        loop: The loop.
        p: V = z'Pz, which decreases by at least the share ``decay`` in a sample.
        decay: T_s lambda.
    """
    rows = [loop.rows]
    for _ in range(BLOCK - 1):
        rows.append(rows[-1] * loop.a)
    count, columns = loop.rows.nrows(), loop.inputs.ncols()
    stack = arb_mat([[row[i, j] for j in range(row.ncols())] for row in rows for i in range(count)])
    jump, z = loop.a**BLOCK, loop.inputs
    inverse = p.inv()
    reaches = [
        (row * inverse * row.transpose())[0, 0].upper().sqrt()
        for row in (arb_mat([[loop.rows[i, j] for j in range(loop.rows.ncols())]]) for i in range(count))
    ]
    n = p.nrows()
    size_of_ones = sum((abs(p[i, j]) for i, j in product(range(n), range(n))), arb(0)).sqrt()
    sums, lost = [[arb(0)] * columns for _ in range(count)], [arb(0)] * columns
    for block in range(MOST_BLOCKS):
        response = stack * z
        for i, j in product(range(count), range(columns)):
            sums[i][j] = sums[i][j] + sum((abs(response[k * count + i, j]) for k in range(BLOCK)), arb(0))
        z = jump * z
        for j in range(columns):  # go on with exact numbers; V bounds what the difference can still cause
            radius = max((z[i, j].rad() for i in range(n)), key=float)
            lost[j] = lost[j] + size_of_ones * radius
        z = arb_mat([[z[i, j].mid() for j in range(columns)] for i in range(n)])
        if block % 16 == 15:
            left = [column(z, j) for j in range(columns)]
            sizes = [larger((one.transpose() * p * one)[0, 0].upper(), arb(0)).sqrt() for one in left]
            tails = [(size + lost[j]) * 2 / decay for j, size in enumerate(sizes)]
            if all(reaches[i] * tails[j] <= TAIL_SHARE * sums[i][j] for i, j in product(range(count), range(columns))):
                return [[(sums[i][j] + reaches[i] * tails[j]).upper() for j in range(columns)] for i in range(count)]
    return None


def column(matrix: arb_mat, j: int) -> arb_mat:
    """One column."""
    return arb_mat([[matrix[i, j]] for i in range(matrix.nrows())])


def settled_error(problem: dict[str, Any], box: dict[str, Any], stage: dict[str, Any], p: arb_mat) -> arb | None:
    """Upper bound of the upper limit of |e(t)| for one plant; None for a box of plants, or if there is none.

    Args:
        problem: The certificate's problem.
        box: Its box.
        stage: The last stage, whose set is known to attract.
        p: Its P.
    """
    if any(low != high for low, high in box.values()):
        return None
    rows, inverse = signal_rows(problem), p.inv()
    wide = enclosed_gains(problem, stage["sigma"], stage["e"])
    decay = arb(problem["sample_time"]) * arb(stage["rate"])
    sizes = [(rows[name] * inverse * rows[name].transpose())[0, 0].upper().sqrt() for name in ("sigma", "e")]
    best = None
    for _ in range(SHRINKINGS):
        sigma, e = (float((size * OUTGROWN).upper()) for size in sizes)
        gains = enclosed_gains(problem, sigma, e)
        centre = {name: gains[name].mid() for name in ("k_p", "k_i", "k_n")}
        if not all(wide[name].contains(value) for name, value in centre.items()):
            return best
        loop = loop_at(problem, box, centre)
        norms = l1_norms(loop, p, decay)
        bounds = None if norms is None else upper_limits(problem, loop, norms, gains, centre, inverse)
        if bounds is None or (best is not None and not bounds[0] < best):
            return best
        best, sizes = bounds[0], [bounds[1], bounds[2]]
    return best


def loop_at(problem: dict[str, Any], box: dict[str, Any], centre: Balls) -> CentredLoop:
    """The loop of one plant at given gains."""
    _, _, n = dimensions(problem)
    t, rows = arb(problem["sample_time"]), signal_rows(problem)
    k_p, rate = arb(box["k_p"][0]), box.get("rate", (0.0, 0.0))
    f = held_generator(problem, arb(box["a_p"][0]), arb(rate[0]))
    held, inside = (f * t).exp(), inside_bounds(problem, box, t)
    gains = [centre[name] for name in ("k_p", "k_i", "k_n")]
    new = rows["v"] + rows["change"] * gains[0] + rows["sigma"] * (t * gains[1])
    command = command_row(problem, new, gains[2])
    by_command = [k_p * held[i, n - 2] for i in range(n - 2)]
    by_v = [*(-x for x in by_command), arb(1), arb(0)]
    by_n = [*(-x for x in by_command), arb(0), arb(0)]
    w = input_columns(problem, k_p, inside)
    inputs = arb_mat([[*(w[i, j] for j in range(w.ncols())), by_v[i], by_n[i]] for i in range(n)])
    # e'' within a sample: row 1 of F exp(F t), t anywhere in the sample
    bent = f * (f * (t * enclosing(0.0, 1.0))).exp()
    through = k_p * bent[1, n - 2]
    second = [(bent[1, j] if j < n - 2 else arb(0)) + through * command[0, j] for j in range(n)]
    at_samples = [[rows[name][0, j] for j in range(n)] for name in ("change", "sigma", "e")]
    rest = k_p * arb(problem["slope"]) * t * (1 + t * abs(bent[1, 1]).upper())
    a = sampled(problem, held, k_p, gains)
    return CentredLoop(a, inputs, arb_mat(at_samples), arb_mat([second]), abs(through).upper(), rest.upper())


def upper_limits(
    problem: dict[str, Any], loop: CentredLoop, norms: list[list[arb]], gains: Balls, centre: Balls, inverse: arb_mat
) -> tuple[arb, arb, arb] | None:
    """Bounds of the upper limits of |e(t)|, and of |sigma| and |e| at the samples; None if the gain is not small."""
    t = arb(problem["sample_time"])
    d_p, d_i, d_n = (abs(gains[name] - centre[name]).upper() for name in ("k_p", "k_i", "k_n"))
    w = len(norms[0]) - 2
    free = [sum(row[:w], arb(0)) for row in norms]
    change, sigma, e = 0, 1, 2

    def by(row: int) -> tuple[arb, arb]:
        """How |sigma - s| and |sigma| act on a row through the deviations of the gains."""
        return norms[row][w] * d_p, norms[row][w] * t * d_i + norms[row][w + 1] * d_n

    (a, b), (c, d) = by(change), by(sigma)
    determinant = (1 - a) * (1 - d) - b * c
    if not (a < 1 and d < 1 and determinant > 0):
        return None
    moved = ((1 - d) * free[change] + b * free[sigma]) / determinant
    size = (c * free[change] + (1 - a) * free[sigma]) / determinant
    omega = d_p * moved + (t * d_i + d_n) * size

    def limit(row: int) -> arb:
        first, second = by(row)
        return free[row] + first * moved + second * size

    # between samples, e deviates from a straight line by at most T_s^2/8 sup |e''|
    steepest = (loop.bend * inverse * loop.bend.transpose())[0, 0]
    bend = t * t / 8 * (abs(steepest).upper().sqrt() + loop.slip * omega + loop.rest)
    settled = limit(e).upper()
    return (settled + bend).upper(), size.upper(), settled
