"""Estimates of a study's numbers from a logged flight, and the laws that they propose."""

import copy
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import special

from dssc_jax.core.json_types import Json
from dssc_jax.core.quantities import Quantity
from dssc_jax.flight_logs.fit.least_squares import fit_scale, from_fit_scale
from dssc_jax.flight_logs.fit.prediction import declares_noise
from dssc_jax.flight_logs.fit.refusals import Explained
from dssc_jax.flight_logs.hints.conversions import factor_text
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from dssc_jax.statistics.correlated_noise import correlation_time
from dssc_jax.statistics.noise_posterior import NoisePosterior
from dssc_jax.study import Law, Study
from dssc_jax.study.tables import PARAMETERS, enclosing_list, has_dotted, set_dotted, toml_entries

BOUND_MARGIN = 1e-6  # share of the distance from an exclusive bound by which a law stays inside
LAW_WIDTH = 5.0  # standard deviations at which a bounded number's law is truncated
WITHOUT_SCALE = ("1", "s", "1/s", "samples")  # units of numbers that do not depend on the units of output and command
LEAST_WHITE = 1e-3  # probability that a residual is white, below which its correlation is reported
OUTSIDE_LAW = (
    3.0  # standard deviations of an estimate beyond the middle 99.8 % of its law, from which it is reported as outside
)


class ResidualNoise(NamedTuple):
    """The noise of a channel's residual."""

    white: float  # probability that it is white
    share: float  # share of its variance that is correlated, in the likeliest noise; 0: it is white
    time: float  # lag at which the correlation of that share has fallen to 1/e [s]
    explained: Explained  # the residual beside noise and output

    @classmethod
    def of(cls, posterior: NoisePosterior, explained: Explained) -> "ResidualNoise":
        """The noise of a channel, from its posterior law and from the residual beside noise and output."""
        likeliest = posterior.likeliest
        return cls(posterior.white, likeliest.share, correlation_time(likeliest), explained)

    def summary(self) -> dict[str, float]:
        """The noise as plain data for JSON; sizes are in the output's unit, times in s."""
        return {
            "rms": self.explained.residual,
            "noise": self.explained.noise,
            "output_std": self.explained.output,
            "unexplained_share": self.explained.unexplained,
            "independent_samples": self.explained.independent,
            "white_probability": self.white,
            "correlated_share": self.share,
            "correlation_time": self.time,
        }


def correlation_doubts(study: Study, noise: Mapping[str, ResidualNoise]) -> tuple[SignalWarning, ...]:
    """The doubts about residuals that are hardly white; none if the study declares random disturbances.

    Args:
        study: The study.
        noise: The noise of the residual by name of the channel.
    """
    if declares_noise(study):
        return ()
    warnings = []
    for channel, residual in noise.items():
        if residual.white >= LEAST_WHITE:
            continue
        name = signal_name(channel, "y")
        text = (
            f"the residual of {name} is correlated, over {residual.time:.3g} s: it is white with a probability of "
            f"{residual.white:.1g}, and the study has no random disturbance. If an estimator or a filter made {name}, "
            "or gusts moved the vehicle, the intervals count it. If the study lacks a force or a lag, such as drag "
            "that grows with the square of the speed, estimates may be wrong by several intervals"
        )
        warnings.append(SignalWarning(name, "correlated-residual", text))
    return tuple(warnings)


class RivalMinimum(NamedTuple):
    """A minimum of the residual that is not the best one."""

    starts: int  # number of starts of the search that end there
    values: dict[str, float]  # the numbers there
    ratio: float  # its weighted residual, as a multiple of that of the best minimum


@dataclass(frozen=True)
class Fitted:
    """Numbers estimated from a flight."""

    study: Study
    names: tuple[str, ...]  # of the n numbers
    estimates: np.ndarray  # shape (n,)
    scaled: np.ndarray  # estimates on the scale of the fit: the logarithm where the law is logarithmic, shape (n,)
    covariance: np.ndarray  # on that scale, shape (n, n)
    noise: dict[str, ResidualNoise]  # of the residual by channel, of those with enough readings
    unidentified: dict[str, float]  # numbers that keep their laws, with their deviation from the flight over the law's
    samples: int  # of the log that count
    simulated: int  # samples of the simulation
    held_samples: dict[str, int]  # of these, samples at which the log lacks a command, by signal
    between: str  # what commands do between two logged values
    replayed: tuple[str, ...]  # channels whose commands are those of the analysed controller for the logged outputs
    starts: int  # of the search
    starts_here: int  # that end in the best minimum
    rivals: tuple[RivalMinimum, ...]
    simulations: int
    cut: str  # why the search ended before it was complete; empty: it is complete
    stopped: bool  # whether the user or a limit of time ended it, so that no further fit followed
    doubts: tuple[SignalWarning, ...]  # reasons to doubt it

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations on the scale of the fit, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    def interval(self, level: float = 0.9) -> np.ndarray:
        """Two-sided confidence intervals of the numbers, clipped to their admissible ranges, shape (n, 2)."""
        half_width = special.ndtri(0.5 + 0.5 * level) * self.deviations
        ends = np.stack([self.scaled - half_width, self.scaled + half_width], axis=1)
        intervals = []
        for name, pair in zip(self.names, ends, strict=True):
            quantity = self.study.numbers[name].quantity
            lowest = max(bound for bound in (quantity.above, quantity.at_least, -math.inf) if bound is not None)
            highest = min(bound for bound in (quantity.below, quantity.at_most, math.inf) if bound is not None)
            intervals.append(np.clip(from_fit_scale(self.study.laws[name], pair), lowest, highest))
        return np.array(intervals)

    def law(self, name: str) -> Law:
        """The proposed law of a number: log-normal if its law in the study is logarithmic, else normal.

        A normal law is truncated to the admissible range, if the number has one or is a parameter of the study.
        """
        place = self.names.index(name)
        mean = float(self.scaled[place])
        std = float(self.deviations[place])
        if self.study.laws[name].logarithmic:
            return Law("lognormal", (mean, std))
        quantity = with_sign(self.study.numbers[name].quantity, self.study.laws[name])
        bounds = (quantity.above, quantity.at_least, quantity.below, quantity.at_most)
        if all(bound is None for bound in bounds) and name not in self.study.parameter_names:
            return Law("normal", (mean, std))
        return Law("truncated_normal", (mean, std, *truncation(quantity, mean, std)))

    def correlations(self) -> dict[str, float]:
        """Rank correlations of the estimates by pair of names, as a study's table ``[correlation]`` has them.

        For normal laws with the linear correlation r, the rank correlation is 6/pi asin(r/2).
        """
        linear = self.covariance / np.outer(self.deviations, self.deviations)
        ranks = {}
        for i, row_name in enumerate(self.names):
            for j, column_name in enumerate(self.names[:i]):
                ranks[f"{row_name}, {column_name}"] = float(6.0 / math.pi * math.asin(0.5 * linear[i, j]))
        return ranks

    def outside_laws(self) -> dict[str, str]:
        """Numbers whose estimates lie clearly outside their laws in the study, each with a factor in words.

        The factor is that of another unit, with which the estimate lies inside its law. It is empty if there is no
        such factor, or if it is not the same for all these numbers.
        """
        units = [unit for channel in self.study.units for unit in (channel.output, channel.of("u"))]
        outside = {}
        for name, value, scaled, deviation in zip(
            self.names, self.estimates, self.scaled, self.deviations, strict=True
        ):
            law = self.study.laws[name]
            ends = law.quantile(np.array([0.001, 0.999]))
            low, high = fit_scale(law, ends)
            if scaled < low - OUTSIDE_LAW * deviation or scaled > high + OUTSIDE_LAW * deviation:
                has_scale = value != 0.0 and self.study.numbers[name].quantity.unit not in WITHOUT_SCALE
                outside[name] = factor_text(ends / value, units) if has_scale else ""
        return outside if len(set(outside.values())) == 1 else dict.fromkeys(outside, "")

    @property
    def untried_parts(self) -> str:
        """The reason for which parts that the study may lack were not tried; empty if they were tried."""
        if len(self.study.loop.channels) > 1:
            return "the study has several channels"
        return "the search was stopped" if self.stopped else ""

    @property
    def warnings(self) -> tuple[SignalWarning, ...]:
        """The reasons to doubt the estimates: all doubts, estimates outside their laws, and a search that was cut."""
        warnings = list(self.doubts)
        for name, factor in self.outside_laws().items():
            text = f"the estimate of {name} lies outside its law: compare units, columns and start of the log"
            if factor:
                text += f"; {factor} it lies within, as if an output or a command were logged in another unit"
            warnings.append(SignalWarning(name, "estimate-outside-law", text))
        if self.cut:
            remark = "these are the best numbers so far, others may be better. Repeat it with more simulations"
            warnings.append(SignalWarning("", "early-end", f"the search ended early, {self.cut}: {remark}"))
        return tuple(warnings)

    def toml(self) -> str:
        """The proposed laws as TOML, one line for each entry; a number in a list comes with the whole list."""
        table: dict[str, Json] = {}
        for name in self.names:
            law = self.law(name)
            enclosing = enclosing_list(self.study.table, name)
            if enclosing is not None:
                list_name, entries = enclosing
                if not has_dotted(table, list_name):
                    set_dotted(table, list_name, copy.deepcopy(entries))
            elif name in self.study.parameter_names:  # keeps its unit and meaning
                short = name.partition(".")[2]
                set_dotted(table, name, copy.deepcopy(self.study.table[PARAMETERS][short]))
            set_dotted(table, name, {law.kind: list(law.arguments)})
        correlations = self.correlations()
        if correlations:
            table["correlation"] = correlations
        return toml_entries(table)

    def summary(self) -> dict[str, Json]:
        """The estimates, their laws and the warnings as plain data for JSON."""
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
        units = zip(self.study.loop.channels, self.study.units, strict=True)
        return {
            "study": self.study.name,
            "samples": self.samples,
            "simulated_samples": self.simulated,
            "study_samples": self.study.loop.steps,
            "held_commands": self.held_samples,
            "between_commands": self.between,
            "replayed": list(self.replayed),
            "numbers": numbers,
            "correlation": self.correlations(),
            "noise": {channel: noise.summary() for channel, noise in self.noise.items()},
            "noise_unit": {channel: unit.output for channel, unit in units},
            "starts": self.starts,
            "starts_here": self.starts_here,
            "simulations": self.simulations,
            "search_cut": self.cut,
            "untried_parts": self.untried_parts,
            "other_minima": [rival._asdict() for rival in self.rivals],
            "warned": bool(self.warnings),
            "warnings": [asdict(warning) for warning in self.warnings],
            "kept": {name: width if math.isfinite(width) else None for name, width in self.unidentified.items()},
            "toml": self.toml(),
        }


def with_sign(quantity: Quantity, law: Law) -> Quantity:
    """The quantity, bounded by 0 if all values of a law have the same sign and the quantity has no bound on that side.

    A parameter whose inverse counts must not change its sign.

    Args:
        quantity: The quantity.
        law: The law of the number in the study.
    """
    low, high = law.support
    if low > 0.0 and quantity.above is None and quantity.at_least is None:
        return replace(quantity, above=0.0)
    if high < 0.0 and quantity.below is None and quantity.at_most is None:
        return replace(quantity, below=0.0)
    return quantity


def truncation(quantity: Quantity, mean: float, std: float) -> tuple[float, float]:
    """Ends of a truncated law: ``LAW_WIDTH`` deviations either side of the mean, within the quantity's range.

    Args:
        quantity: The quantity, with the bounds of its admissible range.
        mean: Mean of the normal law before truncation.
        std: Standard deviation of that law.
    """
    low = mean - LAW_WIDTH * std
    high = mean + LAW_WIDTH * std
    if quantity.above is not None:
        low = max(low, quantity.above + BOUND_MARGIN * (mean - quantity.above))
    if quantity.at_least is not None:
        low = max(low, quantity.at_least)
    if quantity.below is not None:
        high = min(high, quantity.below - BOUND_MARGIN * (quantity.below - mean))
    if quantity.at_most is not None:
        high = min(high, quantity.at_most)
    return low, high
