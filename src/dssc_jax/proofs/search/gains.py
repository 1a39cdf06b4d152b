"""The gains that the sampled loop can have in a region |sigma| <= S, |e| <= E, in floating point.

    v+ = v + K_P (sigma - s) + T_s K_I sigma,    K_P = 1/(k_o tau_av),    K_I = K_P/tau_m,    K_N = 1/(k_n tau_m)

The gains follow from the state-dependent functions k_o, tau_av, tau_m. Their extremes are taken from a grid of points;
the verifier encloses them rigorously in :mod:`dssc_jax.proofs.verifier.gain_enclosures`.
"""

from itertools import pairwise, product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.signals import Scalar
from dssc_jax.proofs.problem import Interval, ProofProblem
from dssc_jax.proofs.search.sampled_loop import functions_of

GRID = 129
"""Number of sizes of sigma at which the gains are evaluated, with either sign."""
NEAR_ORIGIN = 1e-9
"""Bound of |sigma| [m/s] and of |e| [m] of the smallest region; the gains there count as those at sigma = e = 0."""
MARGIN = 0.06
"""Widening of an interval at each end, as a share of its width, so that the verifier's enclosure fits in."""
GAIN_NAMES = ("k_p", "k_i", "k_n", "slide_p", "slide_i")
"""K_P, K_I [1/s] and K_N, then K_P (1 + tau_av/T_s) and T_s K_I (1 + tau_av/T_s), the gains of u_eq."""
MOST_PIECES = 12
"""Largest number of pieces of a region."""
PIECE_RATIO = 1.2
"""Ratio of the largest to the smallest K_P that a piece of a region may have."""
KNOWN_INTEGRALS = ("approx_sta_1", "approx_sta_2", "square_root", "field")
"""Functions of sigma alone with k_o tau_av = alpha (|sigma|^(1/2) + beta), whose integral phi_1 is known."""
Hull = dict[str, Interval]
"""Interval of each gain, by its name."""
GainArrays = dict[str, jax.Array]
"""Each gain at several points, by its name."""


def gain_hull(problem: ProofProblem, sigma: float, e: float, sigma_from: float = 0.0, e_from: float = 0.0) -> Hull:
    """Intervals of the gains in a region of sigma and e, by name, widened for the verifier's enclosures.

    * :data:`GAIN_NAMES`: always.
    * ``mean``: phi_1/sigma, in the conservative form, and in the implicit one for ``KNOWN_INTEGRALS``.
    * ``slide_e``: (d phi_1/d e)(1 + tau_av/T_s), in the conservative form only.
    * ``by_e``: the largest |d phi_1/d e|/|sigma| as both ends of an interval, in the conservative form only.

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
    """The gains at points of a region.

    Args:
        sigma: sigma [m/s] at each point, shape (points,).
        columns: Values of each gain, by the names of :func:`gain_hull`, shape (points,) each. In the conservative form
            ``slide_p`` and ``slide_e`` have the two ends of their interval instead, and ``by_e`` one largest value.
    """

    sigma: np.ndarray
    columns: dict[str, np.ndarray]


def gain_points(
    problem: ProofProblem, sigma: float, e: float, sigma_from: float = 0.0, e_from: float = 0.0
) -> GainPoints:
    """The gains on a grid over a region of sigma and e.

    Args:
        problem: The problem, with the functions and the sampled form.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m].
        sigma_from: Smallest |sigma| [m/s].
        e_from: Smallest |e| [m].
    """
    sigma_grid, error_grid = np.meshgrid(sigma_values(sigma_from, sigma), error_values(problem, e_from, e))
    s = sigma_grid.ravel()
    nominal = problem.nominal
    predictor_gain = 1.0 / nominal.k if nominal is not None and nominal.predictor_term else 0.0  # K_N tau_m
    with jax.enable_x64(True):
        functions = functions_of(problem)
        arguments = functions, jnp.asarray(s), jnp.asarray(error_grid.ravel()), jnp.float64(problem.l0)
        gains = conservative_gains if problem.form == "conservative" else implicit_gains
        columns = gains(*arguments, jnp.float64(problem.sample_time), jnp.float64(predictor_gain))
        if problem.form == "implicit" and problem.functions["kind"] in KNOWN_INTEGRALS:
            columns["mean"] = mean_gains(*arguments)
    return GainPoints(s, {name: np.asarray(column) for name, column in columns.items()})


def sigma_values(smallest: float, largest: float) -> np.ndarray:
    """Values of sigma [m/s] with smallest <= |sigma| <= largest, of either sign, shape (2 GRID,).

    The values are equally spaced in |sigma|^(1/2). If ``smallest`` is 0, they form a geometric sequence instead, since
    the functions change fastest near 0.
    """
    sizes = np.linspace(np.sqrt(smallest), np.sqrt(largest), GRID) ** 2
    if not smallest:
        sizes[1:] = largest * np.geomspace(1e-9, 1.0, GRID - 1)
    return np.concatenate([-sizes[::-1], sizes])


def error_values(problem: ProofProblem, smallest: float, largest: float) -> np.ndarray:
    """Values of e [m] with smallest <= |e| <= largest, of either sign; only one if the functions do not depend on e."""
    if problem.functions["kind"] != "vgsta":  # Table 1
        return np.array([largest])
    positive = np.linspace(smallest, largest, GRID // 2 + 1)
    return np.concatenate([-positive[::-1], positive])


@jax.jit
def implicit_gains(
    functions: Any, s: jax.Array, e: jax.Array, l0: Scalar, t: Scalar, predictor_gain: Scalar
) -> GainArrays:
    """The gains :data:`GAIN_NAMES` of the implicit form at points (sigma, e), by name, shape (points,) each.

    Args:
        functions: The state-dependent functions.
        s: sigma [m/s], shape (points,).
        e: e [m], shape (points,).
        l0: Error pole [1/s].
        t: T_s [s].
        predictor_gain: 1/k_n if the nominal control has its term 1/tau_m; else 0.
    """
    k_o, tau_av, tau_m = functions.at(s, e, l0)
    proportional = 1.0 / (k_o * tau_av)  # K_P
    integral = proportional / tau_m  # K_I
    reach = 1.0 + tau_av / t  # factor of v+ - v in u_eq = v + (1 + tau_av/T_s) (v+ - v)
    gains = {
        "k_p": proportional,
        "k_i": integral,
        "k_n": predictor_gain / tau_m,
        "slide_p": reach * proportional,
        "slide_i": reach * t * integral,
    }
    return {name: jnp.broadcast_to(gain, s.shape) for name, gain in gains.items()}


@jax.jit
def mean_gains(functions: Any, s: jax.Array, e: jax.Array, l0: Scalar) -> jax.Array:
    """phi_1/sigma, the mean of K_P over [0, sigma], at points (sigma, e), shape (points,).

    Args:
        functions: The state-dependent functions, whose integral phi_1 must be known.
        s: sigma [m/s], shape (points,).
        e: e [m], shape (points,).
        l0: Error pole [1/s].
    """
    return jnp.broadcast_to(functions.law(s, e, functions.at(s, e, l0)).gain, s.shape)


def increment_errors(problem: ProofProblem, size: np.ndarray, change: float) -> np.ndarray:
    """R(sigma), a bound of the difference of the implicit form's increment of v from the change of phi_1 [m/s].

    R is the largest |K_P(sigma) (sigma - s) - phi_1(sigma) + phi_1(s)| over |sigma - s| <= C. K_P falls with |sigma|
    and is convex in it. So for |sigma| < C the value at sigma = 0 is a bound. Elsewhere the largest value is that of
    |s| = |sigma| - C, the end next to 0.

    Args:
        problem: The problem, with functions of sigma alone.
        size: |sigma| at each point [m/s], shape (points,).
        change: C, the largest change of sigma in a sample [m/s].

    Returns:
        Shape (points,).
    """
    points = np.concatenate([[0.0, change], size, np.maximum(size - change, 0.0)])
    with jax.enable_x64(True):
        functions = functions_of(problem)
        l0 = jnp.float64(problem.l0)
        mean = mean_gains(functions, jnp.asarray(points), jnp.zeros(points.size), l0)
        k_o, tau_av, _ = functions.at(jnp.asarray(points), jnp.zeros(points.size), l0)
        slope = np.broadcast_to(np.asarray(1.0 / (k_o * tau_av)), points.size)  # K_P, the slope of phi_1
    phi_1 = np.asarray(mean) * points
    slope_at_zero = slope[0]
    phi_at_change = phi_1[1]
    slope_at_end = slope[2 : 2 + size.size]
    phi_at_end, phi_at_begin = np.split(phi_1[2:], 2)  # at |sigma| and at |sigma| - C
    near_zero = slope_at_zero * change - phi_at_change
    farther_out = phi_at_end - phi_at_begin - slope_at_end * change
    return np.where(size < change, near_zero, farther_out)


@jax.jit
def conservative_gains(
    functions: Any, s: jax.Array, e: jax.Array, l0: Scalar, t: Scalar, predictor_gain: Scalar
) -> GainArrays:
    """The gains of the conservative form at points (sigma, e), by the names of :func:`gain_hull`.

    K_P and d phi_1/d e are means over the sample, whereas tau_av is the value at the sample's end. So ``slide_p`` and
    ``slide_e`` are bounded by products of the extremes of their factors over all points.

    Args:
        functions: The state-dependent functions.
        s: sigma [m/s], shape (points,).
        e: e [m], shape (points,).
        l0: Error pole [1/s].
        t: T_s [s].
        predictor_gain: 1/k_n if the nominal control has its term 1/tau_m; else 0.

    Returns:
        An array of shape (points,) for each gain. ``slide_p`` and ``slide_e`` are the two ends of an interval, shape
        (2,); ``by_e`` is one largest value, shape (1,).
    """
    at = functions.at(s, e, l0)
    law = functions.law(s, e, at)
    gains = implicit_gains(functions, s, e, l0, t, predictor_gain)
    reach = 1.0 + at.tau_av / t
    integral = law.gain * law.rate  # phi_2/sigma, in place of K_I
    slide_p = jnp.stack([jnp.min(gains["k_p"]) * jnp.min(reach), jnp.max(gains["k_p"]) * jnp.max(reach)])

    def phi_1(error: jax.Array) -> jax.Array:
        """phi_1(sigma, e) at all points, as a function of e."""
        return functions.law(s, error, functions.at(s, error, l0)).gain * s

    _, by_e = jax.jvp(phi_1, (e,), (jnp.ones_like(e),))  # d phi_1/d e
    slide_e = jnp.max(jnp.abs(by_e)) * jnp.max(reach)
    return gains | {
        "k_i": jnp.broadcast_to(integral, s.shape),
        "slide_i": jnp.broadcast_to(reach * t * integral, s.shape),
        "slide_p": slide_p,
        "by_e": jnp.max(jnp.abs(by_e / jnp.where(s == 0.0, 1.0, s)))[None],  # by_e vanishes at sigma = 0
        "slide_e": jnp.stack([-slide_e, slide_e]),
        "mean": jnp.broadcast_to(law.gain, s.shape),
    }


def start_ratio(problem: ProofProblem, *, is_integrated: bool) -> Interval:
    """The interval of -v/sigma_0 before the first sample, over all starts of the problem; of -q/sigma_0 if z has q.

    The share of d_r + f in v is left out. Before the first sample u_av = 0. The start ``zero`` has s = 0, hence v = q =
    0. The others have s = sigma_0, hence q = -phi_1(sigma_0). ``midpoint`` adds only half of the first T_s phi_2, so
    its v and q are lower by (T_s/2) phi_2.

    Args:
        problem: The loop and its uncertain numbers.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
    """
    if problem.start == "zero":
        return 0.0, 0.0
    errors, speeds, *_ = problem.initial  # of e, e' and eta
    first_sigmas = [e_dot + problem.l0 * e for e, e_dot in product(errors, speeds)]
    sigma_low, sigma_high = magnitudes_of((min(first_sigmas), max(first_sigmas)))
    e_low, e_high = magnitudes_of(errors)
    hull = gain_hull(problem, max(sigma_high, NEAR_ORIGIN), max(e_high, NEAR_ORIGIN), sigma_low, e_low)
    low, high = hull["mean"] if is_integrated else (0.0, 0.0)
    if problem.start == "midpoint":
        low += 0.5 * problem.sample_time * hull["k_i"][0]
        high += 0.5 * problem.sample_time * hull["k_i"][1]
    return low, high


def magnitudes_of(pair: Interval) -> Interval:
    """The interval of |x| for x in an interval; it begins at 0 if the interval contains 0."""
    low, high = pair
    smallest = min(abs(low), abs(high)) if low * high > 0.0 else 0.0
    return smallest, max(abs(low), abs(high))


class Region(NamedTuple):
    """A region of sigma and e, cut into pieces of |sigma| in each of which the gains vary less.

    The pieces have equal lengths in |sigma|^(1/2).

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
    """Cut a region of sigma and e into so many pieces of |sigma| that K_P varies little in each.

    The number of pieces is such that, on average, the largest K_P of a piece is ``PIECE_RATIO`` times the smallest; it
    is at most ``MOST_PIECES``.

    Args:
        problem: The problem, with the functions and the sampled form.
        sigma: Bound of |sigma| [m/s].
        e: Bound of |e| [m].
    """
    hull = gain_hull(problem, sigma, e)
    low, high = hull["k_p"]
    is_positive = 0.0 < low < high < np.inf  # one piece where K_P is constant, or the functions are not positive
    ratio = high / low if is_positive else 1.0
    count = int(np.clip(np.ceil(np.log(ratio) / np.log(PIECE_RATIO)), 1, MOST_PIECES))
    cuts = [sigma * (i / count) ** 2 for i in range(count + 1)]
    pieces = [gain_hull(problem, sigma=end, e=e, sigma_from=begin) for begin, end in pairwise(cuts)]
    return Region(sigma, e, hull, ends=cuts[1:], pieces=pieces)


def with_room(values: np.ndarray) -> Interval:
    """The interval of some values, widened by ``MARGIN`` for the verifier's enclosure; equal values get no room."""
    low = float(values.min())
    high = float(values.max())
    room = MARGIN * (high - low) + (1e-12 * abs(high) if low < high else 0.0)
    return low - room, high + room
