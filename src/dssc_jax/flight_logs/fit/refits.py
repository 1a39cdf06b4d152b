"""Fits of a log with other outputs or commands, which test a hypothesis about what is wrong with the log."""

import math
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum, minimise
from dssc_jax.flight_logs.fit.sampled_log import SampledLog
from dssc_jax.flight_logs.fit.search_limits import SearchCount


class Refit(NamedTuple):
    """The fit of a log: the problem, and its minimum."""

    problem: FitProblem
    minimum: Minimum

    def residual(self, channel: int) -> float:
        """The root mean square of a channel's residual; infinite without enough readings."""
        squares = self.squares([channel])
        return math.sqrt(squares.residual) if squares is not None else math.inf

    def squares(self, channels: list[int]) -> "Squares | None":
        """Mean squares of the residuals, and variances of the outputs, each summed over some channels.

        Returns:
            None if one of the channels has too few readings, or the simulation diverges.
        """
        residual_square = 0.0
        output_square = 0.0
        found = 0
        for readings, columns in zip(self.problem.readings, self.problem.columns(self.minimum.x), strict=True):
            if readings.channel in channels:
                residual_square += float(np.mean(columns[:, 0] ** 2))
                output_square += float(np.var(readings.values))
                found += 1
        is_usable = found == len(channels) and math.isfinite(residual_square)
        return Squares(residual_square, output_square) if is_usable else None


class Squares(NamedTuple):
    """Mean squares of residuals, and variances of outputs, summed over channels."""

    residual: float
    output: float

    @property
    def share(self) -> float:
        """The root mean square of the residuals over the standard deviation of the outputs."""
        return math.sqrt(self.residual / max(self.output, TINY))


def with_log(problem: FitProblem, log: SampledLog) -> FitProblem:
    """The same problem with another log and white noise; its simulations are not counted."""
    return FitProblem(
        study=problem.study,
        names=problem.names,
        predict=problem.predict,
        log=log,
        count=SearchCount(),
        kept=problem.kept,
    )


def refit(problem: FitProblem, minimum: Minimum, log: SampledLog) -> Refit:
    """Fit another log with white noise, from a minimum and from the medians of the laws; the better end counts.

    Args:
        problem: The problem with the present log.
        minimum: The minimum from which the fit of the other log starts.
        log: The other log.
    """
    refitted = with_log(problem, log)
    starts = (minimum.x, np.zeros_like(minimum.x))
    return Refit(refitted, min((minimise(refitted, x) for x in starts), key=lambda end: end.cost))
