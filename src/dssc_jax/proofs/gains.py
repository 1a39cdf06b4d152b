"""The gains that the loop can have in a region of sigma and e, in floating point."""

from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.signals import Scalar
from dssc_jax.proofs.problem import Interval, ProofProblem
from dssc_jax.proofs.sampled_loop import functions_of

GRID = 129
MARGIN = 0.06
"""Widening of each interval, relative, so that the verifier's enclosures fit in."""
GAIN_NAMES = ("k_p", "k_i", "k_n", "slide_p", "slide_i")
MOST_PIECES, PIECE_RATIO = 12, 1.2
"""Largest number of pieces of a region, and the ratio of the largest to the smallest K_P in one."""
Hull = dict[str, Interval]
GainArrays = dict[str, jax.Array]


def gain_hull(problem: ProofProblem, sigma: float, e: float, least: float = 0.0) -> Hull:
    """Intervals of the gains for |sigma| from ``least`` to a bound, and |e| up to one.

    Of K_P, K_I, K_N, of K_P and T_s K_I times 1 + tau_av/T_s, and in the conservative form of phi_1/sigma (``mean``).
    """
    sizes = np.linspace(np.sqrt(least), np.sqrt(sigma), GRID) ** 2
    if not least:
        sizes[1:] = sigma * np.geomspace(1e-9, 1.0, GRID - 1)
    values = np.concatenate([-sizes[::-1], sizes])
    own = problem.functions["kind"] == "vgsta"
    errors = e * np.linspace(-1.0, 1.0, GRID if own else 1)
    s, x = (each.ravel() for each in np.meshgrid(values, errors))
    _, k_n, term = problem.nominal or (0.0, np.inf, False)
    pole = 1.0 / k_n if term else 0.0
    with jax.enable_x64(True):
        numbers = jnp.float64(problem.l0), jnp.float64(problem.sample_time), jnp.float64(pole)
        of = conservative_gains if problem.form == "conservative" else implicit_gains
        columns = of(functions_of(problem), jnp.asarray(s), jnp.asarray(x), *numbers)
    return {name: with_room(np.asarray(column)) for name, column in columns.items()}


@jax.jit
def implicit_gains(functions: Any, s: jax.Array, e: jax.Array, l0: Scalar, t: Scalar, pole: Scalar) -> GainArrays:
    """The gains at points (sigma, e) of the implicit form; ``pole`` is 1/k_n where u_n has its term 1/tau_m."""
    k_o, tau_av, tau_m = functions.at(s, e, l0)
    proportional, reach = 1.0 / (k_o * tau_av), 1.0 + tau_av / t
    integral = proportional / tau_m
    values = (proportional, integral, pole / tau_m, reach * proportional, reach * t * integral)
    return dict(zip(GAIN_NAMES, jnp.broadcast_arrays(*values, s)[:-1], strict=True))


@jax.jit
def conservative_gains(functions: Any, s: jax.Array, e: jax.Array, l0: Scalar, t: Scalar, pole: Scalar) -> GainArrays:
    """The same of the conservative form, in which K_P is a mean over sigma, and tau_av belongs to its last value."""
    at = functions.at(s, e, l0)
    law = functions.law(s, e, at)
    own = implicit_gains(functions, s, e, l0, t, pole)
    reach, integral = 1.0 + at.tau_av / t, law.gain * law.rate
    low, high = jnp.min(own["k_p"]), jnp.max(own["k_p"])
    slide_p = jnp.stack([low * jnp.min(reach), high * jnp.max(reach)])
    mean = jnp.broadcast_to(law.gain, s.shape)
    return own | {"k_i": integral, "slide_i": reach * t * integral, "slide_p": slide_p, "mean": mean}


class Region(NamedTuple):
    """Bounds of |sigma| and |e|, and the gains there: in all, and in each piece of |sigma|, equal in its root.

    Args:
        sigma: Bound of |sigma| [m/s].
        e: Bound of |e| [m].
        hull: The gains.
        ends: Upper ends of the pieces [m/s].
        pieces: The gains in each.
    """

    sigma: float
    e: float
    hull: Hull
    ends: list[float]
    pieces: list[Hull]


def region_of(problem: ProofProblem, sigma: float, e: float) -> Region:
    """The region of these bounds, in pieces in which K_P varies little."""
    hull = gain_hull(problem, sigma, e)
    low, high = hull["k_p"]
    ratio = high / low if 0.0 < low < high < np.inf else 1.0  # elsewhere the functions are not positive
    count = int(np.clip(np.ceil(np.log(ratio) / np.log(PIECE_RATIO)), 1, MOST_PIECES))
    ends = [sigma * (i / count) ** 2 for i in range(count + 1)]
    return Region(sigma, e, hull, ends[1:], [gain_hull(problem, high, e, low) for low, high in pairwise(ends)])


def with_room(values: np.ndarray) -> Interval:
    """The interval of the values, a little wider; a constant stays one."""
    low, high = float(values.min()), float(values.max())
    room = MARGIN * (high - low) + (1e-12 * abs(high) if low < high else 0.0)
    return low - room, high + room
