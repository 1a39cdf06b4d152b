"""Lowest and highest failure probability over all laws whose arguments lie within ranges: a probability box.

The draws come from a mixture of the laws of the box, and are simulated once. The weights of the draws give the failure
probability under every law of the box, so that a search finds the best and the worst law. New draws of these two laws
check the result.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.conditions import criterion_of, require_share
from dssc_jax.analyses.defaults import LIMIT
from dssc_jax.analyses.laws.ranged_draws import RangedDraws, WeightedLaws, mixture_values
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.engine.batching import BLOCK, Engine, evaluate
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.engine.sampling import draw, unit_points
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import CONFIDENCE, clopper_pearson
from dssc_jax.statistics.worst_changes import LEAST_EFFECTIVE
from dssc_jax.study import Study, takes_file
from dssc_jax.study.laws import LAWS

TABLE = "argument"  # name of the dataset's dimension
COLUMNS = {
    "low": "lowest value of the argument",
    "high": "highest value of the argument",
    "at_lowest": "its value for the lowest failure probability",
    "at_highest": "its value for the highest failure probability",
}
"""Columns of the dataset, with their meanings."""
MOST_DOUBLINGS = 4
"""Largest number of times that the draws are doubled, if their weights are too uneven."""


@dataclass(frozen=True)
class ExtremeLaws:
    """The laws of the box whose failure probability has the smallest lower limit, or the largest upper limit."""

    laws: Annotated[dict[str, dict[str, list[float]]], Quantity("", "the laws, as a study file gives them")]
    probability: Annotated[float, Quantity("1", "failure probability by the weights")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability by the weights")]
    effective: Annotated[float, Quantity("1", "effective number of draws")]
    fresh_failures: Annotated[int, Quantity("1", "new draws of these laws that fail")]
    fresh_interval: Annotated[tuple[float, float], Quantity("1", "exact interval from the new draws")]

    @property
    def agrees(self) -> bool:
        """Whether the intervals by the weights and from the new draws have a value in common."""
        return self.interval[0] <= self.fresh_interval[1] and self.fresh_interval[0] <= self.interval[1]


@dataclass(frozen=True)
class LawRangesAnswer:
    """Lowest and highest failure probability over all laws within their ranges, and the laws that have them."""

    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    limit: Annotated[float, Quantity("1", "largest failure probability allowed")]
    draws: Annotated[int, Quantity("1", "number of draws of the mixture")]
    confidence: Annotated[float, Quantity("1", "confidence of the interval")]
    probability: Annotated[tuple[float, float], Quantity("1", "lowest and highest failure probability, estimates")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval that holds the failure probability of every law")]
    verdict: Annotated[str, Quantity("", "limit kept by all laws, exceeded by all laws, or not decided")]
    verified: Annotated[bool, Quantity("", "whether new draws of the two laws agree with the weights")]
    least_effective: Annotated[float, Quantity("1", "least effective number of draws over the corners of the box")]
    lowest: ExtremeLaws
    highest: ExtremeLaws
    fresh_draws: Annotated[int, Quantity("1", "number of new draws of each of the two laws")]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class LawRanges(Analysis):
    """Lowest and highest failure probability over the box of laws: all laws whose arguments lie within their ranges.

    The dimension ``argument`` of the dataset lists the arguments that are ranges. Along it the dataset has the ends of
    the range, ``low`` and ``high``, and the value of the argument in the law with the lowest failure probability,
    ``at_lowest``, and with the highest, ``at_highest``.

    Args:
        limit: Largest failure probability allowed.
        draws: Number of draws of the mixture.
        least_effective: Least effective number of draws over the corners of the box.
        lowest: The law with the smallest lower limit of the failure probability.
        highest: The law with the largest upper limit of the failure probability.
        fresh_draws: Number of new draws of each of these two laws.
        seconds: Computing time [s].
    """

    kind = "law-ranges"
    title = "The failure probability over ranges of laws"
    table = (TABLE,)

    limit: float
    draws: int
    least_effective: float
    lowest: ExtremeLaws
    highest: ExtremeLaws
    fresh_draws: int
    seconds: float

    @property
    def interval(self) -> tuple[float, float]:
        """Interval that contains the failure probability under every law of the box.

        If new draws contradict the weights at an end, that end is moved outwards to the interval from the new draws.
        """
        low, _ = self.lowest.interval
        _, high = self.highest.interval
        if not self.lowest.agrees:
            low = min(low, self.lowest.fresh_interval[0])
        if not self.highest.agrees:
            high = max(high, self.highest.fresh_interval[1])
        return low, high

    @property
    def verdict(self) -> str:
        """Say in words whether every law of the box keeps the failure probability at the limit or below."""
        low, high = self.interval
        if high <= self.limit:
            return "kept by all laws"
        if low > self.limit:
            return "exceeded by all laws"
        return "not decided"

    @property
    def verified(self) -> bool:
        """Whether new draws of the lowest and of the highest law agree with the weighted draws."""
        return self.lowest.agrees and self.highest.agrees

    @property
    def headline(self) -> str:
        """The interval of the failure probability over all laws and whether the limit is kept, in one line."""
        low, high = self.interval
        check_text = "new draws agree" if self.verified else "NEW DRAWS CONTRADICT THE WEIGHTS"
        return (
            f"failure probability in [{low:.3g}, {high:.3g}] for every law within the ranges "
            f"({100 * CONFIDENCE:g} % confidence; {check_text}); a limit of {100 * self.limit:g} % is {self.verdict}"
        )

    def figure(self) -> Figure:
        """Plot the failure probability of the best and the worst law, and where in the ranges these laws lie."""
        return plotting.law_ranges(self)

    @property
    def answer(self) -> LawRangesAnswer:
        """The lowest and the highest failure probability and their laws, as ``summary.json`` has them."""
        return LawRangesAnswer(
            requirements=criterion_of(self.study),
            limit=self.limit,
            draws=self.draws,
            confidence=CONFIDENCE,
            probability=(self.lowest.probability, self.highest.probability),
            interval=self.interval,
            verdict=self.verdict,
            verified=self.verified,
            least_effective=self.least_effective,
            lowest=self.lowest,
            highest=self.highest,
            fresh_draws=self.fresh_draws,
            seconds=self.seconds,
        )


@takes_file
def law_ranges(
    study: Study, *, limit: float = LIMIT, fresh: int | None = None, progress: ProgressCallback | None = None
) -> LawRanges:
    """Find the lowest and the highest failure probability over all laws whose arguments lie within ranges.

    Args:
        study: A study in which the arguments of at least one law are ranges, ``{ normal = [[0.9, 1.1], 0.1] }``; its
            sweep is ignored. The number of its draws is doubled, up to four times, while the weights are too uneven.
        limit: Largest failure probability allowed, in (0, 1).
        fresh: Number of new draws of each of the two laws found; None: as many as the study has draws.
        progress: Called with the simulations done.

    Raises:
        ConfigError: An argument is out of range, no law has ranges, draws are not independent, or the ranges are too
            wide for the draws.

    Example:
        >>> import dssc_jax as dj
        >>> ranges = {"draws": 400, "disturbance.value": {"uniform": [[-3.0, -2.0], 3.0]}}
        >>> study = dj.Study.load("motor").override(ranges)
        >>> low, high = dj.law_ranges(study).answer.interval
        >>> 0.0 <= low <= high <= 1.0
        True
    """
    began = time.perf_counter()
    require_share("limit", limit)
    fresh_count = study.config.draws if fresh is None else fresh
    if fresh_count < 1:
        raise ConfigError("fresh", f"must be at least 1, got {fresh_count}")
    study = study.without_sweep()
    require_independent(study, "an interval over all laws of a range")
    if not study.ranged_laws:
        rule = "no argument of a law is a range, as in { normal = [[0.9, 1.1], 0.1] }; `laws` answers for single laws"
        raise ConfigError(study.source, rule)
    simulator = DrawSimulator(study, progress)
    draws = simulator.mixture(study.config.draws)
    for _ in range(MOST_DOUBLINGS):
        if draws.trusted:
            break
        draws = simulator.mixture(2 * len(draws.failed))
    require_even_weights(draws, study)
    first_new_draw = len(draws.failed)
    lowest = simulator.check(draws.lowest(), first_new_draw, fresh_count)
    highest = simulator.check(draws.highest(), first_new_draw, fresh_count)
    return LawRanges(
        study,
        law_ranges_dataset(study, lowest, highest),
        limit=limit,
        draws=len(draws.failed),
        least_effective=draws.least_effective,
        lowest=lowest,
        highest=highest,
        fresh_draws=fresh_count,
        seconds=time.perf_counter() - began,
    )


def require_even_weights(draws: RangedDraws, study: Study) -> None:
    """Require weights that are even enough to give the failure probability under every law of the box.

    Args:
        draws: The weighted draws.
        study: The study, for the message.

    Raises:
        ConfigError: The weights are too uneven; the message estimates how many draws would be enough.
    """
    if draws.trusted:
        return
    sufficient_draws = int(np.ceil(len(draws.failed) * LEAST_EFFECTIVE / draws.least_effective))
    rule = (
        f"the ranges of its laws are too wide for {len(draws.failed):,} draws: they are worth "
        f"{draws.least_effective:.0f} draws of some of the laws, and {LEAST_EFFECTIVE:g} are needed; about "
        f"{sufficient_draws:,} draws would do, or narrower ranges"
    )
    raise ConfigError(study.source, rule)


class DrawSimulator:
    """Simulates draws of a study in which arguments of laws are ranges.

    The ranges of all arguments span a box of laws. Draws come from a mixture of laws of the box, or from one law of the
    box for each number.

    Args:
        study: The study.
        progress: Called with the simulations done.
    """

    def __init__(self, study: Study, progress: ProgressCallback | None) -> None:
        """Compile the study with the laws in the middle of the box; values drawn from other laws are passed to it."""
        self.ranged = study.ranged_laws
        middle_laws = {name: law.middle for name, law in self.ranged.items()}  # all arguments in mid-range
        self.middle_study = study.with_laws(middle_laws)
        self.engine = Engine(self.middle_study, min(BLOCK, study.config.draws))
        self.progress = progress
        self.simulation_count = 0
        self.values: dict[str, np.ndarray] = {}
        self.failed = np.empty(0, dtype=bool)

    def mixture(self, count: int) -> RangedDraws:
        """The first ``count`` draws of the mixture; draws that an earlier call simulated are not simulated again."""
        new_indices = np.arange(len(self.failed), count)
        values = draw(self.middle_study, new_indices)
        points = unit_points(self.middle_study, new_indices)  # shape (n, laws)
        for column, name in enumerate(self.middle_study.laws):
            if name in self.ranged:
                values[name] = mixture_values(self.ranged[name], points[:, column])
        self.failed = np.concatenate([self.failed, self.fails(values, new_indices)])
        for name in self.ranged:
            known_values = self.values.get(name, np.empty(0))
            self.values[name] = np.concatenate([known_values, values[name]])
        return RangedDraws(self.ranged, dict(self.values), self.failed, CONFIDENCE)

    def fails(self, values: Mapping[str, np.ndarray], indices: np.ndarray) -> np.ndarray:
        """Simulate draws, and return whether each fails, shape (n,).

        Args:
            values: Value of each uncertain number, shape (n,) each.
            indices: Indices of the draws, which decide the in-loop noise, shape (n,).
        """
        outcomes = evaluate(self.engine, dict(values), indices)["outcome"]
        self.simulation_count += len(indices)
        if self.progress:
            self.progress(self.simulation_count, None)  # the total is not known
        return outcomes != Outcome.OK

    def check(self, estimate: WeightedLaws, start: int, count: int) -> ExtremeLaws:
        """Check the weighted failure probability under some laws of the box, by new draws from these laws.

        Args:
            estimate: The laws, with their failure probability by the weights.
            start: Index of the first new draw.
            count: Number of new draws.
        """
        indices = np.arange(start, start + count)
        failed = self.fails(draw(self.middle_study.with_laws(estimate.laws), indices), indices)
        failures = int(np.count_nonzero(failed))
        low, high = clopper_pearson(failures, count, CONFIDENCE).tolist()
        return ExtremeLaws(
            laws={name: {law.kind: list(law.arguments)} for name, law in estimate.laws.items()},
            probability=estimate.probability,
            interval=estimate.interval,
            effective=estimate.effective,
            fresh_failures=failures,
            fresh_interval=(low, high),
        )


def law_ranges_dataset(study: Study, lowest: ExtremeLaws, highest: ExtremeLaws) -> xr.Dataset:
    """The dataset of :class:`LawRanges`: along ``argument``, each argument of a law that is a range.

    Args:
        study: The study.
        lowest: The laws with the smallest lower limit of the failure probability.
        highest: The laws with the largest upper limit of the failure probability.
    """
    labels = []
    columns: dict[str, list[float]] = {name: [] for name in COLUMNS}
    for name, law in study.ranged_laws.items():
        for place, (low, high) in enumerate(law.ranges):
            if low == high:
                continue  # this argument is a number
            labels.append(f"{name}: {LAWS[law.kind].argument_names[place]}")
            columns["low"].append(low)
            columns["high"].append(high)
            columns["at_lowest"].append(lowest.laws[name][law.kind][place])
            columns["at_highest"].append(highest.laws[name][law.kind][place])
    variables = {}
    for name, meaning in COLUMNS.items():
        variables[name] = (TABLE, np.array(columns[name]), unit_and_meaning("that of the argument", meaning))
    coordinates = {TABLE: (TABLE, labels, {"long_name": "argument of a law"})}
    return xr.Dataset(variables, coords=coordinates, attrs={"title": study.name})
