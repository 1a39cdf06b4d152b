"""What an able user builds without this package: batched NumPy, and Numba with one draw a turn on all cores."""

from collections.abc import Callable
from functools import lru_cache
from importlib.util import find_spec

import numpy as np

from benchmarks.speed.by_hand import Dialect, Program, build, shares, trajectory
from benchmarks.speed.workloads import Found, OneAxis, Task, Uav

REAL = {64: np.float64, 32: np.float32}
FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
"""Fast mathematics but for 'no NaN, no infinity': a draw may diverge."""


def inputs(task: Task) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws, trajectory and the share of each sample with wind or disturbance, in the working precision."""
    real, loop, shared = REAL[task.case.precision], task.study.loop, task.shared
    begins = shared.wind_from if isinstance(shared, Uav) else shared.disturbed_from
    wanted = trajectory(shared.wanted, loop.steps, loop.sample_time)
    return tuple(a.astype(real) for a in (task.draws, wanted, shares(begins, loop.steps, loop.sample_time)))


BATCHED = Dialect(lambda function: function, np.minimum, np.maximum)


def batched(task: Task) -> Callable[[], Found]:
    """NumPy over all draws at once; each call runs it."""
    case, real = task.case, REAL[task.case.precision]
    own = build(task.shared, task.study.loop.sample_time, case.integrator == "euler", real, BATCHED)
    draws, wanted, share = inputs(task)
    count, samples = draws.shape[1], len(share)

    def call() -> Found:
        drawn = own.pick(draws, slice(None))
        state, sums = own.start(drawn, wanted[0])
        outcome, ended = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        with np.errstate(all="ignore"):
            for k in range(samples):
                state, sums = own.sample(drawn, state, sums, wanted[k], share[k], k == 0)
                infinite, singular = own.ended(state)
                code = np.where(infinite, 1, np.where(singular, 2, 0))
                outcome = np.where(outcome == 0, code, outcome)
                ended += outcome == 0
        metrics = np.stack([np.stack(channel) for channel in sums], axis=1)
        return finished(metrics, outcome, ended, samples)

    return call


def finished(metrics: np.ndarray, outcome: np.ndarray, ended: np.ndarray, samples: int) -> Found:
    """Sums of squares become rms; draws that ended early have no metrics."""
    metrics[0] = np.sqrt(metrics[0] / samples)
    return Found(np.where(outcome == 0, metrics, np.nan), outcome, ended)


def has_numba() -> bool:
    """Whether Numba is installed."""
    return find_spec("numba") is not None


@lru_cache
def by_numba(shared: Uav | OneAxis, dt: float, euler: bool, precision: int) -> Callable:
    """The loop over draws, compiled at its first call."""
    import numba

    scalar = Dialect(numba.njit(fastmath=FAST, error_model="numpy", forceinline=True), min, max)
    own: Program = build(shared, dt, euler, REAL[precision], scalar)
    pick, start, sample, ended_early, channels = own

    @numba.njit(parallel=True, fastmath=FAST, error_model="numpy")
    def run(draws, wanted, share, metrics, outcome, ended):
        for i in numba.prange(draws.shape[1]):
            drawn = pick(draws, i)
            state, sums = start(drawn, wanted[0])
            k = 0
            while k < len(share) and outcome[i] == 0:
                state, sums = sample(drawn, state, sums, wanted[k], share[k], k == 0)
                infinite, singular = ended_early(state)
                if infinite:
                    outcome[i] = 1
                elif singular:
                    outcome[i] = 2
                else:
                    ended[i] += 1
                k += 1
            for c in range(channels):
                for m in range(3):
                    metrics[m, c, i] = sums[c][m]

    return run


def parallel(task: Task) -> Callable[[], Found]:
    """Numba's prange over draws; each call runs it, the first one compiles."""
    loop, case = task.study.loop, task.case
    run = by_numba(task.shared, loop.sample_time, case.integrator == "euler", case.precision)
    draws, wanted, share = inputs(task)
    count, channels = draws.shape[1], len(loop.channels)

    def call() -> Found:
        metrics = np.empty((3, channels, count), dtype=draws.dtype)
        outcome, ended = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        run(draws, wanted, share, metrics, outcome, ended)
        return finished(metrics, outcome, ended, len(share))

    return call
