"""Estimates of a study's numbers from a logged flight, and the laws that they propose."""

import copy
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from dssc_jax.flight_logs.explanation import Explained
from dssc_jax.flight_logs.residual import fit_scale, unscaled
from dssc_jax.statistics.correlated_noise import correlation_time
from dssc_jax.statistics.noise_posterior import Posterior
from dssc_jax.study import Law, Study
from dssc_jax.study.tables import enclosing_list, has_dotted, set_dotted, toml_entries

INSIDE = 1e-6  # of the distance from an exclusive bound, that a law stays inside
LAW_WIDTH = 5.0  # standard deviations within which a bounded number's law is kept
OUTSIDE_LAW = 3.0  # standard deviations of an estimate beyond the middle 99.8 % of its law, from which this is told


class ResidualNoise(NamedTuple):
    """The noise of a channel's residual.

    Args:
        white: Probability that it is white.
        share: Share of its variance that is correlated, in the likeliest noise; 0: it is white.
        time: Lag at which the correlation of that share has fallen to 1/e [s].
        explained: The residual beside noise and output.
    """

    white: float
    share: float
    time: float
    explained: Explained

    @classmethod
    def of(cls, posterior: Posterior, explained: Explained) -> "ResidualNoise":
        """What is told of a posterior law."""
        likely = posterior.likely
        return cls(posterior.white, likely.share, correlation_time(likely), explained)

    def summary(self) -> dict[str, float]:
        """For JSON."""
        sizes = self.explained
        return {
            "rms": sizes.residual,
            "noise": sizes.noise,
            "output_std": sizes.output,
            "unexplained_share": sizes.unexplained,
            "independent_samples": sizes.independent,
            "white_probability": self.white,
            "correlated_share": self.share,
            "correlation_time": self.time,
        }


class OtherMinimum(NamedTuple):
    """Another minimum of the residual.

    Args:
        starts: Number of starts of the search that end there.
        values: The numbers there.
        ratio: Its weighted residual, as a multiple of that of the best minimum.
    """

    starts: int
    values: dict[str, float]
    ratio: float


@dataclass(frozen=True)
class Fitted:
    """Numbers estimated from a flight.

    Args:
        study: The study.
        names: The estimated numbers.
        estimates: Their values, shape (n,).
        scaled: Estimates on the scale of the fit: the logarithm where the law is logarithmic.
        covariance: Covariance on that scale, shape (n, n).
        noise: The residual's noise by channel, of those with enough readings.
        kept: Numbers that the flight does not tell, with the standard deviation that it leaves, in those of the law.
        samples: Samples of the log that were used.
        replayed: Channels whose commands are those of the analysed controller for the logged outputs.
        starts: Starts of the search, and how many of them end in the minimum that was taken.
        others: Other minima.
    """

    study: Study
    names: tuple[str, ...]
    estimates: np.ndarray
    scaled: np.ndarray
    covariance: np.ndarray
    noise: dict[str, ResidualNoise]
    kept: dict[str, float]
    samples: int
    replayed: tuple[str, ...]
    starts: tuple[int, int]
    others: tuple[OtherMinimum, ...]

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations on the scale of the fit, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    def interval(self, level: float = 0.9) -> np.ndarray:
        """Two-sided confidence intervals, shape (n, 2)."""
        reach = special.ndtri(0.5 + 0.5 * level) * self.deviations
        ends = np.stack([self.scaled - reach, self.scaled + reach], axis=1)
        return np.array([unscaled(self.study.laws[name], pair) for name, pair in zip(self.names, ends, strict=True)])

    def law(self, name: str) -> Law:
        """The proposed law of a number: normal, within its admissible range, or log-normal."""
        place = self.names.index(name)
        middle, std = float(self.scaled[place]), float(self.deviations[place])
        if self.study.laws[name].logarithmic:
            return Law("lognormal", (middle, std))
        quantity = self.study.numbers[name].quantity
        low, high = middle - LAW_WIDTH * std, middle + LAW_WIDTH * std
        if quantity.above is not None:
            low = max(low, quantity.above + INSIDE * (middle - quantity.above))
        if quantity.at_least is not None:
            low = max(low, quantity.at_least)
        if quantity.below is not None:
            high = min(high, quantity.below - INSIDE * (quantity.below - middle))
        if quantity.at_most is not None:
            high = min(high, quantity.at_most)
        bounds = (quantity.above, quantity.at_least, quantity.below, quantity.at_most)
        if all(bound is None for bound in bounds):
            return Law("normal", (middle, std))
        return Law("truncated_normal", (middle, std, low, high))

    def correlations(self) -> dict[str, float]:
        """Rank correlations of the estimates by pair, as ``[correlation]`` has them."""
        linear = self.covariance / np.outer(self.deviations, self.deviations)
        return {
            f"{one}, {other}": float(6.0 / math.pi * math.asin(0.5 * linear[i, j]))
            for i, one in enumerate(self.names)
            for j, other in enumerate(self.names[:i])
        }

    def outside_laws(self) -> list[str]:
        """Numbers whose estimates lie clearly outside their laws in the study."""
        outside = []
        for name, scaled, deviation in zip(self.names, self.scaled, self.deviations, strict=True):
            law = self.study.laws[name]
            low, high = fit_scale(law, law.quantile(np.array([0.001, 0.999])))
            if scaled < low - OUTSIDE_LAW * deviation or scaled > high + OUTSIDE_LAW * deviation:
                outside.append(name)
        return outside

    def table(self) -> dict[str, Any]:
        """The proposal as entries of a study file; a number in a list comes with the whole list."""
        table: dict[str, Any] = {}
        for name in self.names:
            law, above = self.law(name), enclosing_list(self.study.table, name)
            if above and not has_dotted(table, above[0]):
                set_dotted(table, above[0], copy.deepcopy(above[1]))
            set_dotted(table, name, {law.kind: list(law.arguments)})
        pairs = self.correlations()
        return table | ({"correlation": pairs} if pairs else {})

    def toml(self) -> str:
        """The proposal as TOML, one line for each entry."""
        return toml_entries(self.table())

    def summary(self) -> dict[str, Any]:
        """For JSON."""
        numbers = {}
        for name, value, ends in zip(self.names, self.estimates, self.interval(), strict=True):
            law = self.law(name)
            numbers[name] = {
                "unit": self.study.numbers[name].quantity.unit,
                "estimate": float(value),
                "interval_90": [float(end) for end in ends],
                "prior": str(self.study.laws[name]),
                "law": {law.kind: list(law.arguments)},
            }
        return {
            "study": self.study.name,
            "samples": self.samples,
            "replayed": list(self.replayed),
            "numbers": numbers,
            "correlation": self.correlations(),
            "noise": {channel: own.summary() for channel, own in self.noise.items()},
            "noise_unit": {
                channel: units.output for channel, units in zip(self.study.loop.channels, self.study.units, strict=True)
            },
            "starts": self.starts[0],
            "starts_here": self.starts[1],
            "other_minima": [own._asdict() for own in self.others],
            "outside_laws": self.outside_laws(),
            "kept": {name: width if math.isfinite(width) else None for name, width in self.kept.items()},
            "toml": self.toml(),
        }
