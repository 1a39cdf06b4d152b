"""The gains that the loop can have in a region of sigma and e, in floating point."""

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.proofs.problem import Interval, ProofProblem
from dssc_jax.proofs.sampled_loop import functions_of

GRID = 129
MARGIN = 0.06
"""Widening of each interval, relative, so that the verifier's enclosures fit in."""
GAIN_NAMES = ("k_p", "k_i", "k_n", "slide_p", "slide_i")


def gain_hull(problem: ProofProblem, sigma: float, e: float) -> dict[str, Interval]:
    """Intervals of K_P, K_I, K_N, and of K_P and T_s K_I times 1 + tau_av/T_s, for |sigma| and |e| up to bounds."""
    sizes = sigma * np.concatenate([[0.0], np.geomspace(1e-9, 1.0, GRID)])
    values = np.concatenate([-sizes[::-1], sizes])
    own = problem.functions["kind"] == "vgsta"
    errors = e * np.linspace(-1.0, 1.0, GRID if own else 1)
    s, x = (each.ravel() for each in np.meshgrid(values, errors))
    functions = functions_of(problem)
    with jax.enable_x64(True):
        s, x = jnp.asarray(s), jnp.asarray(x)
        at = functions.at(s, x, problem.l0)
        k_o, tau_av, tau_m = at
        if problem.form == "conservative":
            law = functions.law(s, x, at)
            integral = law.gain * law.rate
        else:
            integral = 1.0 / (k_o * tau_av * tau_m)
        proportional, reach = 1.0 / (k_o * tau_av), 1.0 + tau_av / problem.sample_time
        nominal = problem.nominal
        pole = 1.0 / (tau_m * nominal[1]) if nominal and nominal[2] else 0.0
        columns = (proportional, integral, pole, reach * proportional, reach * problem.sample_time * integral)
        hull = {name: with_room(np.asarray(column)) for name, column in zip(GAIN_NAMES, columns, strict=True)}
    if problem.form == "conservative":  # K_P is a mean over sigma, tau_av belongs to its last value
        low, high = with_room(np.asarray(reach))
        hull["slide_p"] = (low * hull["k_p"][0], high * hull["k_p"][1])
    return hull


def with_room(values: np.ndarray) -> Interval:
    """The interval of the values, a little wider; a constant stays one."""
    low, high = float(values.min()), float(values.max())
    room = MARGIN * (high - low) + (1e-12 * abs(high) if low < high else 0.0)
    return low - room, high + room
