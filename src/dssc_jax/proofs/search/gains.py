"""The gains that the loop can have in a region of sigma and e, in floating point."""

from itertools import pairwise, product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.signals import Scalar
from dssc_jax.proofs.problem import Interval, ProofProblem
from dssc_jax.proofs.search.sampled_loop import functions_of

GRID = 129
MARGIN = 0.06
"""Widening of each interval, relative, so that the verifier's enclosures fit in."""
GAIN_NAMES = ("k_p", "k_i", "k_n", "slide_p", "slide_i")
MOST_PIECES = 12
"""Largest number of pieces of a region."""
PIECE_RATIO = 1.2
"""Ratio of the largest to the smallest K_P in a piece."""
KNOWN_INTEGRALS = ("approx_sta_1", "approx_sta_2", "square_root", "field")
"""Functions of sigma alone with k_o tau_av = alpha (|sigma|^(1/2) + beta), whose integral phi_1 is known."""
Hull = dict[str, Interval]
GainArrays = dict[str, jax.Array]


def gain_hull(problem: ProofProblem, sigma: float, e: float, sigma_from: float = 0.0, e_from: float = 0.0) -> Hull:
    """Intervals of the gains that the loop can have in a region of sigma and e, by name.

    They are K_P, K_I and K_N, and K_P and T_s K_I times 1 + tau_av/T_s (``slide_p``, ``slide_i``). In the conservative
    form, and for ``KNOWN_INTEGRALS``, phi_1/sigma (``mean``) is among them; in the conservative form also d phi_1/d e
    times 1 + tau_av/T_s (``slide_e``).

    Args:
        problem: The problem, with the functions and the sampled form.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m].
        sigma_from: Smallest |sigma| [m/s].
        e_from: Smallest |e| [m].
    """
    points = gain_points(problem, sigma, e, sigma_from, e_from)
    return {name: with_room(column) for name, column in points.columns.items()}


class GainPoints(NamedTuple):
    """Points of a region, and the gains there.

    Args:
        sigma: sigma [m/s] at each point.
        columns: Each gain at the points; of ``slide_p`` and ``slide_e`` in the conservative form only the ends.
    """

    sigma: np.ndarray
    columns: dict[str, np.ndarray]


def gain_points(
    problem: ProofProblem, sigma: float, e: float, sigma_from: float = 0.0, e_from: float = 0.0
) -> GainPoints:
    """The gains at points of a region, whose arguments are those of :func:`gain_hull`."""
    sizes = np.linspace(np.sqrt(sigma_from), np.sqrt(sigma), GRID) ** 2
    if not sigma_from:
        sizes[1:] = sigma * np.geomspace(1e-9, 1.0, GRID - 1)
    values = np.concatenate([-sizes[::-1], sizes])
    if problem.functions["kind"] == "vgsta":
        positive = np.linspace(e_from, e, GRID // 2 + 1)
        errors = np.concatenate([-positive[::-1], positive])
    else:
        errors = np.array([e])
    sigma_grid, error_grid = np.meshgrid(values, errors)
    s = sigma_grid.ravel()
    x = error_grid.ravel()
    nominal = problem.nominal
    pole = 1.0 / nominal.k if nominal is not None and nominal.predictor_term else 0.0
    with jax.enable_x64(True):
        numbers = jnp.float64(problem.l0), jnp.float64(problem.sample_time), jnp.float64(pole)
        gains = conservative_gains if problem.form == "conservative" else implicit_gains
        functions = functions_of(problem)
        columns = gains(functions, jnp.asarray(s), jnp.asarray(x), *numbers)
        if problem.form == "implicit" and problem.functions["kind"] in KNOWN_INTEGRALS:
            columns["mean"] = mean_gains(functions, jnp.asarray(s), jnp.asarray(x), numbers[0])
    return GainPoints(s, {name: np.asarray(column) for name, column in columns.items()})


@jax.jit
def implicit_gains(functions: Any, s: jax.Array, e: jax.Array, l0: Scalar, t: Scalar, pole: Scalar) -> GainArrays:
    """The gains of the implicit form at points (sigma, e), (points,) each, by name.

    Args:
        functions: The state-dependent functions.
        s: sigma [m/s], (points,).
        e: e [m], (points,).
        l0: Error pole [1/s].
        t: T_s [s].
        pole: 1/k_n where the nominal control has its term 1/tau_m; else 0.
    """
    k_o, tau_av, tau_m = functions.at(s, e, l0)
    proportional = 1.0 / (k_o * tau_av)
    reach = 1.0 + tau_av / t
    integral = proportional / tau_m
    values = (proportional, integral, pole / tau_m, reach * proportional, reach * t * integral)
    return dict(zip(GAIN_NAMES, jnp.broadcast_arrays(*values, s)[:-1], strict=True))


@jax.jit
def mean_gains(functions: Any, s: jax.Array, e: jax.Array, l0: Scalar) -> jax.Array:
    """phi_1/sigma at points (sigma, e), (points,)."""
    return jnp.broadcast_to(functions.law(s, e, functions.at(s, e, l0)).gain, s.shape)


def increment_errors(problem: ProofProblem, size: np.ndarray, change: float) -> np.ndarray:
    """Largest |K_P(sigma) (sigma - s) - phi_1(sigma) + phi_1(s)| at |sigma| = ``size`` for |sigma - s| <= ``change``.

    K_P falls with |sigma| and is convex in it: near 0 the largest is that of sigma = 0, elsewhere that of s next to 0.
    """
    points = np.concatenate([[0.0, change], size, np.maximum(size - change, 0.0)])
    with jax.enable_x64(True):
        functions = functions_of(problem)
        l0 = jnp.float64(problem.l0)
        mean = mean_gains(functions, jnp.asarray(points), jnp.zeros(points.size), l0)
        k_o, tau_av, _ = functions.at(jnp.asarray(points), jnp.zeros(points.size), l0)
        slope = np.broadcast_to(np.asarray(1.0 / (k_o * tau_av)), points.size)
    phi_1 = np.asarray(mean) * points
    inner = slope[0] * change - phi_1[1]
    phi_at_end, phi_at_begin = np.split(phi_1[2:], 2)
    outer = phi_at_end - phi_at_begin - slope[2 : 2 + size.size] * change
    return np.where(size < change, inner, outer)


@jax.jit
def conservative_gains(functions: Any, s: jax.Array, e: jax.Array, l0: Scalar, t: Scalar, pole: Scalar) -> GainArrays:
    """The gains of the conservative form at points (sigma, e), by name; the arguments are those of the implicit form's.

    K_P and d phi_1/d e are means over a sample, whereas tau_av belongs to its end. So their products ``slide_p`` and
    ``slide_e`` are given by their ends over all points.
    """
    at = functions.at(s, e, l0)
    law = functions.law(s, e, at)
    gains = implicit_gains(functions, s, e, l0, t, pole)
    reach = 1.0 + at.tau_av / t
    integral = law.gain * law.rate
    low = jnp.min(gains["k_p"])
    high = jnp.max(gains["k_p"])
    slide_p = jnp.stack([low * jnp.min(reach), high * jnp.max(reach)])
    mean = jnp.broadcast_to(law.gain, s.shape)
    _, by_e = jax.jvp(lambda x: functions.law(s, x, functions.at(s, x, l0)).gain * s, (e,), (jnp.ones_like(e),))
    largest = jnp.max(jnp.abs(by_e)) * jnp.max(reach)
    return gains | {
        "k_i": jnp.broadcast_to(integral, s.shape),
        "slide_i": jnp.broadcast_to(reach * t * integral, s.shape),
        "slide_p": slide_p,
        "by_e": jnp.max(jnp.abs(by_e / jnp.where(s == 0.0, 1.0, s)))[None],
        "slide_e": jnp.stack([-largest, largest]),
        "mean": mean,
    }


def start_ratio(problem: ProofProblem, *, is_integrated: bool) -> Interval:
    """The interval of -v/sigma_0 at the start, or of -q/sigma_0, without d_r and f.

    Seen from sigma_hat = sigma_0, the start ``midpoint`` halves the first T_s phi_2.

    Args:
        problem: The problem.
        is_integrated: Whether the coordinate is q = v - phi_1(sigma_0) in place of v.
    """
    if problem.start == "zero":
        return 0.0, 0.0
    ends = [e_dot + problem.l0 * e for e, e_dot in product(*problem.initial[:2])]
    sigma_low, sigma_high = magnitudes_of((min(ends), max(ends)))
    e_low, e_high = magnitudes_of(problem.initial[0])
    hull = gain_hull(problem, max(sigma_high, 1e-9), max(e_high, 1e-9), sigma_low, e_low)
    low, high = hull["mean"] if is_integrated else (0.0, 0.0)
    if problem.start == "midpoint":
        low += 0.5 * problem.sample_time * hull["k_i"][0]
        high += 0.5 * problem.sample_time * hull["k_i"][1]
    return low, high


def magnitudes_of(pair: Interval) -> Interval:
    """The interval of |x| for x in an interval."""
    sizes = abs(pair[0]), abs(pair[1])
    return (min(sizes) if pair[0] * pair[1] > 0.0 else 0.0), max(sizes)


class Region(NamedTuple):
    """A region of sigma and e with its gains, cut into pieces of |sigma| that are equal in |sigma|^(1/2).

    Args:
        sigma: Bound of |sigma| [m/s].
        e: Bound of |e| [m].
        hull: Intervals of the gains in the region.
        ends: Upper ends of the pieces [m/s].
        pieces: Intervals of the gains in each piece.
    """

    sigma: float
    e: float
    hull: Hull
    ends: list[float]
    pieces: list[Hull]


def region_of(problem: ProofProblem, sigma: float, e: float) -> Region:
    """The region with these bounds of |sigma| [m/s] and |e| [m], in as many pieces as K_P varies by ``PIECE_RATIO``."""
    hull = gain_hull(problem, sigma, e)
    low, high = hull["k_p"]
    ratio = high / low if 0.0 < low < high < np.inf else 1.0  # elsewhere the functions are not positive
    count = int(np.clip(np.ceil(np.log(ratio) / np.log(PIECE_RATIO)), 1, MOST_PIECES))
    ends = [sigma * (i / count) ** 2 for i in range(count + 1)]
    return Region(sigma, e, hull, ends[1:], [gain_hull(problem, high, e, low) for low, high in pairwise(ends)])


def with_room(values: np.ndarray) -> Interval:
    """The interval of some values, widened by ``MARGIN`` for the verifier; that of a constant stays a number."""
    low = float(values.min())
    high = float(values.max())
    room = MARGIN * (high - low) + (1e-12 * abs(high) if low < high else 0.0)
    return low - room, high + room
