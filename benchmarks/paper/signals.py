"""Numbers of a trajectory: what stands for a sentence of the article."""

import numpy as np
import xarray as xr

from benchmarks.paper.loops import AXES

SMOOTH = 2.0  # s: window of the moving average that the high-frequency part is taken from
SECONDS = 20.0  # s: when wind and disturbance begin, and the comparison's transient ends
SETTLED = 30.0  # s: after which oscillations are counted


def window(run: xr.Dataset, name: str, start: float, end: float = np.inf) -> np.ndarray:
    """A signal over start <= t < end."""
    t = run["t"].values
    return run[name].values[(t >= start) & (t < end)]


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def moving_average(values: np.ndarray, dt: float, period: float) -> np.ndarray:
    """Centred moving average of the last axis over a period [s] (less on short runs), the ends repeated beyond them."""
    width = min(round(period / dt), values.shape[-1] // 4) // 2 * 2 + 1
    around = [(0, 0)] * (values.ndim - 1) + [(width // 2 + 1, width // 2)]
    total = np.cumsum(np.pad(values, around, mode="edge"), axis=-1)
    return (total[..., width:] - total[..., :-width]) / width


def fast_part(run: xr.Dataset, name: str, start: float, end: float = np.inf) -> float:
    """rms of the signal less its centred moving average over 2 s; NaN where the run ended."""
    t, values = run["t"].values, run[name].values
    gap = values - moving_average(values, float(t[1] - t[0]), SMOOTH)
    return rms(gap[(t >= start) & (t < end)])


def gap(one: xr.Dataset, other: xr.Dataset, name: str, start: float, end: float = np.inf) -> float:
    """rms of the difference over the rms of the other."""
    a, b = window(one, name, start, end), window(other, name, start, end)
    return rms(a - b) / rms(b)


def correlation(one: xr.Dataset, other: xr.Dataset, name: str, start: float, end: float = np.inf) -> float:
    """Correlation coefficient of a signal in two runs."""
    return float(np.corrcoef(window(one, name, start, end), window(other, name, start, end))[0, 1])


def rise(run: xr.Dataset, name: str, at: float, before: float = 5.0, after: float = 10.0) -> float:
    """Mean over ``after`` seconds from ``at`` on, over the mean of the ``before`` seconds before."""
    return float(np.mean(window(run, name, at, at + after)) / np.mean(window(run, name, at - before, at)))


def per_axis(number, axes: tuple[str, ...] = AXES) -> dict[str, float]:
    """A number for each axis."""
    return {axis: number(axis) for axis in axes}


def text(values: dict[str, float], form: str = ".2g") -> str:
    """Numbers in the order of the axes."""
    return ", ".join(f"{value:{form}}" for value in values.values())


def lost(run: xr.Dataset) -> str:
    """How a run ended, if early."""
    code, at = str(run.attrs["outcome_meaning"]), float(run.attrs["failed_at"])
    return "" if code == "ok" else f"{code.replace('_', ' ')} at {at:.2f} s"


def settled(run: xr.Dataset, name: str) -> np.ndarray:
    """A signal once the transient is over."""
    return window(run, name, SETTLED)
