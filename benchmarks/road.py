"""Vertical speed of a road of class C under a wheel at 20 m/s, for the page of signals: ``python -m benchmarks.road``.

The profile is z(s) = sum of sqrt(2 G(n_i) dn) cos(2 pi n_i s + phi_i) with G(n) = G_0 (n/n_0)^-2 and uniform phases.
The file holds its derivative in time at s = v t.

Reference:
    ISO 8608:2016, Mechanical vibration - Road surface profiles - Reporting of measured data: class C has
    G_0 = 256e-6 m^3 at n_0 = 0.1 cycles/m, as geometric mean.
"""

from pathlib import Path

import numpy as np

ROAD = Path(__file__).parents[1] / "docs" / "signals" / "road.csv"
SEED = 8
SPEED = 20.0  # m/s
DURATION = 3.0  # s
SAMPLE_TIME = 0.005  # s
ROUGHNESS = 256e-6  # m^3
REFERENCE = 0.1  # cycles/m
FINEST = 2.83  # cycles/m, the largest spatial frequency of ISO 8608


def road_speed(times: np.ndarray) -> np.ndarray:
    """Vertical speed of the road under the wheel [m/s], shape (n,)."""
    step = 1.0 / (SPEED * DURATION)
    frequencies = np.arange(1, int(FINEST / step) + 1) * step
    phases = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, frequencies.size)
    sizes = np.sqrt(2.0 * ROUGHNESS * (frequencies / REFERENCE) ** -2.0 * step)
    turns = 2.0 * np.pi * SPEED * frequencies
    return -(sizes * turns * np.sin(np.outer(times, turns) + phases)).sum(axis=1)


def content() -> str:
    """The file's text."""
    times = np.arange(round(DURATION / SAMPLE_TIME) + 1) * SAMPLE_TIME
    lines = [f"# ISO 8608 class C at {SPEED:g} m/s, seed {SEED}: vertical speed of the road [m/s]", "t,speed"]
    for time, speed in zip(times, road_speed(times), strict=True):
        lines.append(f"{time:.3f},{speed:.6f}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    ROAD.parent.mkdir(exist_ok=True)
    ROAD.write_text(content())
