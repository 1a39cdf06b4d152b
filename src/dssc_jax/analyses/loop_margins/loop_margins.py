"""Compute classical margins of every draw's linearised loop, at its equilibrium or along its flight."""

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.dataset import BrokenLoop, margins_dataset, multiloop_dataset
from dssc_jax.analyses.loop_margins.multiloop import multiloop_margins
from dssc_jax.analyses.loop_margins.operating_points import operating_points
from dssc_jax.analyses.loop_margins.result import LoopMargins, Status
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

    The sampled loop is linearised by differentiating one step of the simulation. The loop is broken at one place at a
    time, while all other loops stay closed: at the command of each channel (``input``) and at each measurement
    (``output``, ``rate``). DSSC is linearised in sliding, with the values of its functions at the operating point; at
    an equilibrium these are the values at sigma = 0. A loop with several channels also gets the disk margin of all
    commands perturbed at once.

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
    for by_break_point in matrices.values():
        poles += [closed_loops.poles.ravel() for closed_loops in by_break_point.values()]
    common_angles = common_grid(np.concatenate(poles))
    sample_time = study.config.loop.sample_time
    broken_loops = {}
    for count, (name, by_break_point) in enumerate(matrices.items(), start=1):
        broken_loops[name] = margins_by_break_point(by_break_point, common_angles, sample_time)
        if progress:
            progress(count * study.config.draws, len(matrices) * study.config.draws)
    dataset = margins_dataset(study, broken_loops, common_angles / sample_time)
    multiloop = {}
    for name, operating in points.items():
        multiloop[name] = multiloop_margins(study.loop.channels, operating, sample_time)
    dataset = dataset.merge(multiloop_dataset(multiloop))
    return LoopMargins(study, dataset, tuple(map(float, times)), notes, time.perf_counter() - began)


class BrokenMatrices(NamedTuple):
    """The closed loops of n draws, with an input and an output at a break point: x+ = A x + b w, v = c x.

    At the break point w is added to the signal v. A draw has such a loop only if it has an operating point within the
    limits. The states are reduced to those through which w acts on v.

    Args:
        has_closed_loop: Whether each draw is one of the n, shape (draws,).
        a: A, shape (n, states, states).
        b: b, shape (n, states).
        c: c, shape (n, states).
        poles: Eigenvalues of A, shape (n, states).
    """

    has_closed_loop: np.ndarray
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    poles: np.ndarray


def matrices_by_break_point(study: Study, operating: Operating) -> dict[str, BrokenMatrices]:
    """The closed loops at one operating point, by break point; break points without an effect are left out.

    A break point has an effect if a signal added there comes back to it through some state, in at least one draw.

    Args:
        study: The study.
        operating: Matrices of the loops of all draws at the operating point.
    """
    matrices = operating.matrices
    by_name = {}
    for point, name in enumerate(place_names(study.loop.channels)):
        has_closed_loop = operating.closed(point)
        state_indices = matrices.loop_states(point, has_closed_loop)
        if state_indices.size:
            a = matrices.a[np.ix_(has_closed_loop, state_indices, state_indices)]
            b = matrices.b[has_closed_loop][:, state_indices, point]
            c = matrices.c[has_closed_loop][:, point, state_indices]
            by_name[name] = BrokenMatrices(has_closed_loop, a, b, c, np.linalg.eigvals(a))
    return by_name


def margins_by_break_point(
    closed_loops: dict[str, BrokenMatrices], common_angles: np.ndarray, sample_time: float
) -> dict[str, BrokenLoop]:
    """Margins and frequency responses at one operating point, by break point.

    Break points at which the response is practically 0 are left out (:func:`broken_loop`).

    Args:
        closed_loops: The closed loops by break point.
        common_angles: omega T_s of the frequency response, shape (frequencies,).
        sample_time: T_s [s].
    """
    broken_loops = {}
    for name, matrices in closed_loops.items():
        broken = broken_loop(matrices, common_angles, sample_time)
        if broken is not None:
            broken_loops[name] = broken
    return broken_loops


def broken_loop(matrices: BrokenMatrices, common_angles: np.ndarray, sample_time: float) -> BrokenLoop | None:
    """Compute margins and frequency responses of all draws at one break point.

    None if no draw has a response above :data:`NO_EFFECT`, so that breaking the loop there has no effect.

    Args:
        matrices: The closed loops of the draws that have one.
        common_angles: omega T_s of the frequency response, shape (frequencies,).
        sample_time: T_s [s].
    """
    has_closed_loop, a, b, c, poles = matrices
    draws = len(has_closed_loop)
    responses = np.full((draws, common_angles.size), np.nan, complex)
    angles_of_draws = np.broadcast_to(common_angles, (len(a), common_angles.size))
    responses[has_closed_loop] = response_of(a, b, c)(angles_of_draws)
    if np.nanmax(np.abs(responses)) < NO_EFFECT:
        return None
    open_loop_poles = np.full((draws, a.shape[-1]), np.nan, complex)
    open_loop_poles[has_closed_loop] = np.linalg.eigvals(a - b[:, :, None] * c[:, None, :])
    is_stable = np.max(np.abs(poles), axis=1) < 1.0
    status = np.full(draws, Status.NO_OPERATING_POINT.value)
    status[has_closed_loop] = np.where(is_stable, Status.STABLE.value, Status.UNSTABLE.value)
    margins = {name: np.full(draws, np.nan) for name in ClassicalMargins._fields}
    if is_stable.any():
        all_poles = np.concatenate([poles, open_loop_poles[has_closed_loop]], axis=1)
        angles = grid_with_poles(common_angles, all_poles[is_stable])
        respond = response_of(a[is_stable], b[is_stable], c[is_stable])
        for name, values in classical_margins(respond, angles, sample_time)._asdict().items():
            margins[name][status == Status.STABLE] = values
    return BrokenLoop(margins, status, responses, open_loop_poles)
