"""Why a flight leaves numbers open: the causes of wide intervals, and a remedy for each."""

import math
from collections.abc import Mapping

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.roughness import widening
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.statistics.correlated_noise import correlation_time

NOTICEABLE = 1.1  # factor on an interval's width: what widens it by less is not named


def width_reasons(problem: FitProblem, rough: float = 0.0, growth: float = 1.0) -> str:
    """The causes of wide intervals, with the remedies, as sentences.

    Args:
        problem: The problem, with the noise of its minimum.
        rough: Roughness of the sum of squares.
        growth: By how much other commands that may have flown widen the widest interval.
    """
    noises = []
    for readings, noise, variance in zip(problem.readings, problem.noises, problem.variances, strict=True):
        name = signal_name(problem.study.loop.channels[readings.channel], "y")
        unit = problem.study.units[readings.channel].output
        correlated = f", correlated over {correlation_time(noise):.3g} s" if noise.share > 0.0 else ""
        noises.append(f"{math.sqrt(variance):.3g} {unit} in {name}{correlated}")
    reasons = [f"noise of the residual ({'; '.join(noises)})"]
    remedies = ["fly longer, or steps that show the numbers more", "lessen the noise of the outputs"]
    factor = math.sqrt(widening(rough))
    if factor > NOTICEABLE:
        reasons.append(
            "steps in the sum of squares, as where limits or samples of an inner loop act, which widen all intervals "
            f"by {factor:.3g}"
        )
        remedies.append("fly gently enough that no rotor reaches its limit")
    if growth > NOTICEABLE:
        reasons.append(f"commands between the logged ones, which widen an interval by up to {growth:.3g}")
    if problem.log.jumps:
        reasons.append(f"jumps at moments that the log lacks ({', '.join(problem.log.jumps)})")
    if growth > NOTICEABLE or problem.log.jumps or problem.log.rare:
        remedies.append("log every command")
    remedies.append("give a number a wider law where it is not known so well")
    return f"What it leaves open comes from {', '.join(reasons)}. {sentence(', '.join(remedies))}"


def sentence(text: str) -> str:
    """The text with a capital letter at its beginning."""
    return text[:1].upper() + text[1:]


def widest_growth(narrow: np.ndarray, wide: np.ndarray) -> float:
    """The largest growth factor of a standard deviation between two covariances, each of shape (p, p).

    Args:
        narrow: The covariance with the smaller variances.
        wide: The covariance with the larger variances.
    """
    return float(np.sqrt(np.max(np.diag(wide) / np.diag(narrow))))


def open_numbers(widths: Mapping[str, float]) -> str:
    """Numbers that a flight leaves open, each with its standard deviation from the flight over that of its law."""
    parts = []
    for name, width in widths.items():
        parts.append(f"{name} ({width:.3g} times)" if math.isfinite(width) else f"{name} (not at all)")
    return ", ".join(parts)
