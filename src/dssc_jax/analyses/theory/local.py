"""Local margins: the value of a number at which small deviations from the origin begin to grow."""

import time
from collections.abc import Callable
from enum import StrEnum

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.analyses.margins import Margins, Walk, search_critical
from dssc_jax.analyses.margins.simulated import checked_walk, placed, require_spread
from dssc_jax.analyses.theory.linearised import (
    SMOOTH,
    at_rest,
    continuous_matrix,
    kind_of,
    require_smooth,
    sampled_matrix,
)
from dssc_jax.backend.plain import plain_options
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Arrays, drawn
from dssc_jax.study import Study
from dssc_jax.study.laws import SPREAD


class Time(StrEnum):
    """Type of linearisation: of the sampled loop as simulated, or of the synthesised law in continuous time."""

    SAMPLED = "sampled"
    CONTINUOUS = "continuous"


CRITERION = {
    Time.SAMPLED: "every eigenvalue of the sampled loop, linearised at the origin, inside the unit circle",
    Time.CONTINUOUS: "every eigenvalue of the loop with (22), linearised at the origin, in the left half-plane",
}


def spectrum(study: Study, kind: Time = Time.SAMPLED) -> Callable[[Arrays], np.ndarray]:
    """Eigenvalues of the linearised loop for many draws.

    Args:
        study: A study at rest, see :func:`at_rest`.
        kind: Sampled or continuous.

    Returns:
        A function of the values of every law and every swept number, each of shape (n,). It returns eigenvalues, shape
        (n, states), of the step from sample to sample, or in 1/s. It raises ConfigError if the loop does not start at
        rest.
    """

    def matrix(lane: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
        params = study.params(lane)
        if kind == Time.CONTINUOUS:
            return continuous_matrix(study, params), jnp.zeros(())
        return sampled_matrix(study.loop, params)

    matrices_of = jax.jit(jax.vmap(matrix), compiler_options=plain_options())

    def eigenvalues(values: Arrays) -> np.ndarray:
        with jax.enable_x64(True):
            matrices, moved = jax.tree.map(np.asarray, matrices_of(values))
        if np.any(moved > 0.0):
            raise ConfigError(study.source, f"is not at rest at the origin: one sample moves it by {moved.max():.3g}")
        return np.linalg.eigvals(matrices)

    return eigenvalues


def local_margin(
    study: Study,
    *,
    over: str,
    bounds: tuple[float, float],
    log: bool = False,
    points: int = POINTS,
    bisections: int = BISECTIONS,
    kind: Time = Time.SAMPLED,
) -> Margins:
    """Find the critical value of one number for small deviations from the origin, for every draw of a study.

    Reference, disturbance, initial state and requirements are ignored. Only stability counts, and only near the origin,
    where state-dependent functions have their values at sigma = e = 0.

    Args:
        study: A study of DSSC, SSC or PI on a plant of one channel.
        over: Dotted name of the number.
        bounds: The safe end, then the other end.
        log: Space the values evenly in the logarithm.
        points: Number of values in the bracketing grid.
        bisections: Number of bisections of the grid cell.
        kind: Sampled or continuous.

    Returns:
        Margins whose slack is the rate [1/s] at which the slowest deviation decays.

    Raises:
        ConfigError: the loop has no linearisation, or the number or a bound is not admissible.
    """
    kind, rest, began = Time(kind), at_rest(study), time.perf_counter()
    require_smooth(rest)
    if kind == Time.CONTINUOUS and kind_of(rest, "controller") not in SMOOTH:
        raise ConfigError(f"{study.source}: controller.kind", f"(22) is known for {', '.join(SMOOTH)} only")
    walk = Walk(*checked_walk(over, bounds, log, points, bisections), log, points)
    if over in study.quantities and over not in rest.quantities:
        raise ConfigError(over, "has no effect near the origin, where reference and disturbance are neglected")
    if over == SPREAD:
        require_spread(study, bounds)
    swept = rest.override({"sweep": {over: sorted(bounds)} if over != SPREAD else {}})
    draws, place = study.config.draws, placed(rest, over)
    laws = drawn(swept, slice(0, draws))
    eigenvalues_of = spectrum(swept, kind)

    def decay(which: np.ndarray, values: np.ndarray) -> np.ndarray:
        eigenvalues = eigenvalues_of(place({name: column[which] for name, column in laws.items()}, values))
        if kind == Time.CONTINUOUS:
            return -np.max(np.real(eigenvalues), axis=-1)
        return -np.log(np.max(np.abs(eigenvalues), axis=-1)) / swept.loop.sample_time

    critical = search_critical(decay, draws, walk, bisections)
    times = {"seconds": time.perf_counter() - began, "compile_seconds": 0.0}
    return Margins.of(study, over, walk, critical, laws, times, (CRITERION[kind],), unit="1/s")
