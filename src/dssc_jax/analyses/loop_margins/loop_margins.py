"""Compute classical margins of every draw's linearised loop, at its equilibrium or along its flight."""

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.multiloop import multiloop_margins
from dssc_jax.analyses.loop_margins.operating_points import operating_points
from dssc_jax.analyses.loop_margins.result import BrokenLoop, LoopMargins, Status, margins_dataset, multiloop_columns
from dssc_jax.closed_loop.break_points import place_names
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.engine.linearisation.matrices import Operating
from dssc_jax.engine.linearisation.response import (
    ClassicalMargins,
    classical_margins,
    common_grid,
    grid_with_poles,
    response_of,
)
from dssc_jax.study import Study, takes_file

NO_EFFECT = 1e-12  # largest response of a break point that counts as without effect


@takes_file
def loop_margins(study: Study, *, times: Sequence[float] = (), progress: ProgressCallback | None = None) -> LoopMargins:
    """Compute gain, phase, delay and disk margins, peak sensitivities, crossover and bandwidth of every draw.

    The loop is linearised as it is sampled and simulated: one step of the simulation is differentiated. It is broken at
    the command of each channel (``input``), and at each measurement alone (``output``, ``rate``), while all other loops
    stay closed. DSSC is linearised in sliding, with the values of its functions at the operating point; at an
    equilibrium these are the values at sigma = 0. Several channels also have the disk margin of all commands
    perturbed at once.

    Args:
        study: The study, or its file; its own sweep is ignored. Draws have to be independent.
        times: Times of the flight at which the loop is linearised about the state of the draw, with the draw's own
            reference, wind and disturbance [s]. Empty: at the equilibrium without these; a vehicle hovers.
        progress: Called with the linearised draws, and their total.

    Raises:
        ConfigError: A part does not declare where it is smooth, or has no derivative there: the controller switches, or
            the sensor has its own sampling period; draws are not independent; no draw has an equilibrium; no break
            point has an effect; or a time is outside the flight.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/motor.toml").override({"draws": 100})
        >>> loop = dj.loop_margins(study)
        >>> 0.5 < loop.summary()["loops"]["input"]["phase"]["median"] < 1.6
        True
    """
    require_independent(study, "a tolerance limit")
    began = time.perf_counter()
    study = study.without_sweep()
    points, notes = operating_points(study, tuple(times))
    for operating in points.values():
        notes += operating.taken
    matrices = {name: matrices_by_break_point(study, operating) for name, operating in points.items()}
    if not any(matrices.values()):
        raise ConfigError(
            study.source,
            "no break point has an effect: the loop is open at its operating points, as where a command is at its "
            "limit; `times` takes others, along the flight",
        )
    poles = []
    for by_loop in matrices.values():
        poles += [closed_loops.poles.ravel() for closed_loops in by_loop.values()]
    common_angles = common_grid(np.concatenate(poles))
    sample_time = study.config.loop.sample_time
    broken_loops: dict[str, dict[str, BrokenLoop]] = {}
    for count, (name, by_loop) in enumerate(matrices.items(), start=1):
        broken_loops[name] = {}
        for loop, closed_loops in by_loop.items():
            broken = broken_loop(closed_loops, common_angles, sample_time)
            if broken is not None:
                broken_loops[name][loop] = broken
        if progress:
            progress(count * study.config.draws, len(matrices) * study.config.draws)
    dataset = margins_dataset(study, broken_loops, common_angles / sample_time)
    multiloop = {name: multiloop_margins(study.loop.channels, at, sample_time) for name, at in points.items()}
    dataset = dataset.merge(multiloop_columns(multiloop))
    return LoopMargins(study, dataset, tuple(map(float, times)), notes, time.perf_counter() - began)


class BrokenMatrices(NamedTuple):
    """The closed loops of n draws as x_(k+1) = A x_k + b w_k, v_k = c x_k; w is added to the signal v at a break point.

    Only draws with an operating point within the limits have such a loop, and only states between w and v are kept.

    Args:
        closed: Whether each draw is one of these, shape (draws,).
        a: Shape (n, states, states).
        b: Shape (n, states).
        c: Shape (n, states).
        poles: Eigenvalues of A, shape (n, states).
    """

    closed: np.ndarray
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    poles: np.ndarray


def matrices_by_break_point(study: Study, operating: Operating) -> dict[str, BrokenMatrices]:
    """The closed loops at an operating point, for each break point by name; one without a loop is left out."""
    matrices = operating.matrices
    parts = {}
    for point, name in enumerate(place_names(study.loop.channels)):
        closed = operating.closed(point)
        state_indices = matrices.loop_states(point, closed)
        if state_indices.size:
            a = matrices.a[np.ix_(closed, state_indices, state_indices)]
            b = matrices.b[closed][:, state_indices, point]
            c = matrices.c[closed][:, point, state_indices]
            parts[name] = BrokenMatrices(closed, a, b, c, np.linalg.eigvals(a))
    return parts


def broken_loop(matrices: BrokenMatrices, common_angles: np.ndarray, sample_time: float) -> BrokenLoop | None:
    """Compute margins and frequency responses of all draws at one break point; None if it has no effect.

    Args:
        matrices: The closed loops of the draws that have one.
        common_angles: omega T_s of the frequency response, shape (frequencies,).
        sample_time: T_s [s].
    """
    has_closed_loop, a, b, c, poles = matrices
    g = np.full((len(has_closed_loop), common_angles.size), np.nan, complex)
    g[has_closed_loop] = response_of(a, b, c)(np.broadcast_to(common_angles, (len(a), common_angles.size)))
    if np.nanmax(np.abs(g)) < NO_EFFECT:
        return None
    open_loop_poles = np.full((len(has_closed_loop), a.shape[-1]), np.nan, complex)
    open_loop_poles[has_closed_loop] = np.linalg.eigvals(a - b[:, :, None] * c[:, None, :])
    stable = np.max(np.abs(poles), axis=1) < 1.0
    status = np.full(len(has_closed_loop), Status.NO_OPERATING_POINT.value)
    status[has_closed_loop] = np.where(stable, Status.STABLE.value, Status.UNSTABLE.value)
    columns = {field: np.full(len(has_closed_loop), np.nan) for field in ClassicalMargins._fields}
    if stable.any():
        all_poles = np.concatenate([poles, open_loop_poles[has_closed_loop]], axis=1)
        angles = grid_with_poles(common_angles, all_poles[stable])
        margins = classical_margins(response_of(a[stable], b[stable], c[stable]), angles, sample_time)
        for field, values in margins._asdict().items():
            columns[field][status == Status.STABLE] = values
    return BrokenLoop(columns, status, g, open_loop_poles)
