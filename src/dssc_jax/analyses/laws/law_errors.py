"""How wrong the laws may be before more than a stated share of all draws fails.

The same draws give three kinds of statements. Within a divergence (total variation, Kullback-Leibler, chi-square) the
true law of everything that is drawn may be any law at all. Guaranteed shifts and widenings hold whatever set of draws
fails. The third kind weights the draws by the density of a changed law: the weighted failures tell how far all means,
or all widths, may be wrong in the worst direction, and for one law at a time, which law matters most.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy import special

import dssc_jax.plotting as plotting
from dssc_jax.analyses.conditions import criterion_of, require_share
from dssc_jax.analyses.defaults import LIMIT
from dssc_jax.analyses.laws.all_changes import AllChanges
from dssc_jax.analyses.laws.answer import (
    Estimates,
    FailureShare,
    Guaranteed,
    Knowledge,
    LawError,
    LawErrorsAnswer,
    WeightedAnswer,
)
from dssc_jax.analyses.laws.fresh_changes import FreshLimits, fresh_limits
from dssc_jax.analyses.laws.fresh_draws import FreshDraws
from dssc_jax.analyses.laws.law_tables import (
    DIRECTIONS,
    FAILING,
    KNOWLEDGE,
    MEDIAN_ENDS,
    NOT_CLEAR,
    TABLE,
    law_errors_dataset,
)
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import Result
from dssc_jax.results.scored_draws import ScoredDraws
from dssc_jax.results.stated_errors import NO_LAW, StatedAmounts, StatedError, confidence_of
from dssc_jax.runs.run import run
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.statistics.any_failures import AnyFailures
from dssc_jax.statistics.divergence_balls import BALLS
from dssc_jax.statistics.law_changes import Shift, Widening
from dssc_jax.statistics.worst_changes import largest_change
from dssc_jax.study import Study
from dssc_jax.study.laws import Law

UNCHANGED_WIDTH = 1.0  # relative width of a law that is not widened


@dataclass(eq=False)
class LawErrors(Analysis):
    """How wrong the laws may be before more than a stated share of all draws fails.

    The dataset has along ``number``, for each number whose law can be changed:

    * ``shift`` and ``widening``, how far this law alone may be wrong with 95 % confidence, ``shift_estimate`` and
      ``widening_estimate``, the same without the draws' uncertainty, and ``worst_shift``, its part in the worst shift
      of all means;
    * ``towards``: 1 if larger values fail, -1 if smaller ones do, 0 if neither is clear;
    * ``removed`` and ``changes``, with ``_low`` and ``_high``: the value of knowing in which of ``parts`` parts of its
      law the number lies;
    * ``failing_low``, ``failing_median`` and ``failing_high``: levels of the law in failed draws, with the interval
      ``failing_median_low`` to ``failing_median_high`` of the median.

    Along ``size``, the size of a shift of all means, it has three curves: ``shifted``, the worst failure probability by
    the weights, ``shifted_limit``, its upper limit, and ``shifted_guaranteed``, an upper limit that holds whatever set
    of draws fails. Along ``width``, the relative width of all laws, it has ``widened``, ``widened_limit`` and
    ``widened_guaranteed`` with the same meanings.

    Args:
        limit: Largest failure probability allowed.
        failures: Failed draws.
        draws: Number of draws.
        interval: Interval of the failure probability.
        interval_method: Method of that interval.
        guaranteed: Changes within which the limit is kept whatever set of draws fails.
        weights: What the weights say of a shift of all means and of a widening of all laws.
        stated: Intervals of the failure probability if the laws are wrong by stated amounts.
        fresh: What new draws say; None if none were asked for, or if no draw fails, so that no direction is the worst.
        seconds: Computing time [s].
    """

    kind = "laws"
    title = "How wrong the laws may be"
    table = (TABLE,)

    limit: float
    failures: int
    draws: int
    interval: tuple[float, float]
    interval_method: str
    guaranteed: Guaranteed
    weights: dict[str, WeightedAnswer]
    stated: list[StatedError]
    fresh: FreshLimits | None
    seconds: float

    @property
    def headline(self) -> str:
        """How wrong all means or all widths may be before the limit is exceeded, in one line."""
        share = f"{100 * self.limit:g} %"
        low, high = self.interval
        if high > self.limit:
            probability_text = f"failure probability in [{low:.3g}, {high:.3g}]"
            return f"more than {share} may fail even under the assumed laws: {probability_text}"
        answer = self.answer
        return (
            f"at most {share} fail while all means are at most {answer.mean_shift:.3g} standard deviations wrong, or "
            f"all laws at most {answer.widening:.3g} times as wide ({100 * CONFIDENCE:g} % confidence)"
        )

    def figure(self) -> Figure:
        """Plot the failure probability over changes of all laws, and how far each law alone may be wrong."""
        return plotting.law_errors(self)

    @property
    def answer(self) -> LawErrorsAnswer:
        """How wrong the laws may be, together and one by one, as ``summary.json`` has it.

        The weights and the guarantee each give a bound of a shift and of a widening. Each bound is wrong with a
        probability of at most 2.5 %, so the larger of the two is wrong with a probability of at most 5 %.
        """
        probability = self.failures / self.draws
        estimated_radii = {name: ball.largest_radius(probability, self.limit) for name, ball in BALLS.items()}
        radii = {name: ball.largest_radius(self.interval[1], self.limit) for name, ball in BALLS.items()}
        shift = self.weights["mean_shift"]
        widening = self.weights["widening"]
        guaranteed_widening = self.guaranteed.widening or UNCHANGED_WIDTH
        return LawErrorsAnswer(
            requirements=criterion_of(self.study),
            limit=self.limit,
            draws=self.draws,
            confidence=CONFIDENCE,
            failure=FailureShare(self.failures, probability, self.interval, self.interval_method),
            **radii,
            mean_shift=max(shift.bound, self.guaranteed.mean_shift),
            widening=max(widening.bound, guaranteed_widening),
            guaranteed=self.guaranteed,
            estimates=Estimates(**estimated_radii, mean_shift=shift.estimate, widening=widening.estimate),
            weights=self.weights,
            most_important=self.most_important(),
            measure_next=self.measure_next(),
            by_law=self.by_law(),
            stated=self.stated,
            fresh=self.fresh,
            seconds=self.seconds,
        )

    def most_important(self) -> str | None:
        """The number whose mean needs the smallest shift before the failure probability reaches the limit.

        The shifts compared are the estimates. None if no shift of a single mean reaches the limit.
        """
        shifts = self.dataset["shift_estimate"].values
        if np.isnan(shifts).all():
            return None
        return str(self.dataset[TABLE].values[np.nanargmin(shifts)])

    def measure_next(self) -> str | None:
        """The number that is most worth measuring: knowing it removes the largest share of the variance of failure.

        Only numbers count whose share has an interval above 0; None if there is no such number.
        """
        is_known_to_remove = self.dataset["removed_low"].values > 0.0
        if not is_known_to_remove.any():
            return None
        removed = np.where(is_known_to_remove, self.dataset["removed"].values, -np.inf)
        return str(self.dataset[TABLE].values[removed.argmax()])

    def by_law(self) -> dict[str, LawError]:
        """How wrong each law may be while all other laws are right, by name of the number."""
        rows = {}
        for name in map(str, self.dataset[TABLE].values):
            row = self.dataset.sel({TABLE: name})
            shift = float(row["shift"])
            towards = int(row["towards"])
            law = self.study.laws[name]
            shifted_median = None
            if towards != NOT_CLEAR:
                shifted_median = float(law.quantile(special.ndtr(towards * shift)))
            rows[name] = LawError(
                mean_shift=shift,
                mean_shift_estimate=none_if_nan(float(row["shift_estimate"])),
                towards=DIRECTIONS[towards],
                widening=float(row["widening"]),
                widening_estimate=none_if_nan(float(row["widening_estimate"])),
                median=law.median,
                shifted_median=shifted_median,
                in_worst_shift=float(row["worst_shift"]),
                failing=failing_values(law, row),
                failing_median_interval=failing_median_interval(law, row),
                knowledge=read_knowledge(row),
            )
        return rows


def none_if_nan(value: float) -> float | None:
    """The value, or None in place of NaN, which JSON does not have."""
    return None if np.isnan(value) else value


def failing_values(law: Law, row: xr.Dataset) -> tuple[float, float, float] | None:
    """The 5 %, 50 % and 95 % quantile of a number in failed draws, in its unit; None if no draw fails.

    Args:
        law: Law of the number.
        row: The number's row of the dataset; it has these quantiles as levels of the number's law.
    """
    low, middle, high = (float(law.quantile(row[name].values)) for name in FAILING)
    return None if np.isnan(middle) else (low, middle, high)


def failing_median_interval(law: Law, row: xr.Dataset) -> tuple[float, float] | None:
    """The interval of a number's median in failed draws, in its unit; None if too few draws fail.

    Args:
        law: Law of the number.
        row: The number's row of the dataset; it has the ends of the interval as levels of the number's law.
    """
    low, high = (float(law.quantile(row[name].values)) for name in MEDIAN_ENDS)
    return None if np.isnan(low) else (low, high)


def read_knowledge(row: xr.Dataset) -> Knowledge | None:
    """Read from the dataset what it is worth to know in which part of its law a number lies.

    None if too few draws failed.

    Args:
        row: The number's row of the dataset.
    """
    values = {name: float(row[name]) for name in KNOWLEDGE}
    if values["parts"] == 0.0:
        return None
    return Knowledge(
        parts=int(values["parts"]),
        removed=values["removed"],
        removed_interval=(values["removed_low"], values["removed_high"]),
        changes=values["changes"],
        changes_interval=(values["changes_low"], values["changes_high"]),
    )


def laws(
    subject: Study | Result,
    *,
    limit: float = LIMIT,
    within: Mapping[str, float] | None = None,
    shift: float | None = None,
    widening: float | None = None,
    fresh: int = 0,
    progress: ProgressCallback | None = None,
) -> LawErrors:
    """Find how wrong the laws may be before more than a share of all draws fails.

    Args:
        subject: A result without a sweep, or a study, which is simulated first; its own sweep is ignored.
        limit: Largest failure probability allowed, in (0, 1).
        within: Amounts by which the laws may be wrong, for which the interval of the failure probability is wanted:
            ``total_variation``, ``kl`` or ``chi_square``, each >= 0.
        shift: Amount of a shift of all means, >= 0 [standard deviations], for which that interval is wanted.
        widening: Relative width of all laws, >= 1, for which that interval is wanted.
        fresh: Number of new draws that are simulated under each changed law; 0: none.
        progress: Called with the simulations done.

    Raises:
        ConfigError: An argument is out of range, no law can be changed, the result has a sweep, or its draws are not
            independent.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/motor.toml").override({"draws": 400, "loop.sample_time": 0.01})
        >>> found = dj.laws(study, limit=0.5)
        >>> 0.0 < found.answer.kl < found.answer.estimates.kl
        True
    """
    began = time.perf_counter()
    require_share("limit", limit)
    if fresh < 0:
        raise ConfigError("fresh", f"must be 0 or more, got {fresh}")
    amounts = StatedAmounts(within or {}, shift, widening)
    result = result_of(subject, progress)
    study = result.study
    draws = ScoredDraws.of(study, result.failed.values)
    if not draws.names:
        raise ConfigError(study.source, NO_LAW)
    low, high = result.method.failure_interval(draws.failed).tolist()
    bounds = draws.bounds((low, high))
    confidence = confidence_of(result.method)
    shift_of_all = shift_of_all_means(draws, bounds, confidence, limit)
    widening_of_all = widening_of_all_laws(draws, bounds, confidence, limit)
    changes = (shift_of_all, widening_of_all)
    free = draws.free(draws.names)
    guaranteed = Guaranteed(bounds.largest_shift(free, limit), bounds.largest_widening(free, limit))
    new = FreshDraws(study, len(draws.failed), fresh, progress)  # no simulation before its first use
    return LawErrors(
        study,
        law_errors_dataset(draws, shift_of_all, widening_of_all, bounds, limit),
        limit=limit,
        failures=int(np.count_nonzero(draws.failed)),
        draws=len(draws.failed),
        interval=(low, high),
        interval_method=result.method.name,
        guaranteed=guaranteed,
        weights={kind.draws.change.name: WeightedAnswer.of(kind.largest, kind.draws.change) for kind in changes},
        stated=amounts.errors(draws, (low, high), confidence),
        fresh=fresh_limits(new, changes, limit) if fresh and draws.failed.any() else None,
        seconds=time.perf_counter() - began,
    )


def shift_of_all_means(draws: ScoredDraws, bounds: AnyFailures, confidence: float, limit: float) -> AllChanges:
    """Shifts of all means: the largest one that keeps the limit, and limits for any size [standard deviations].

    Args:
        draws: The draws of the result with their scores.
        bounds: Bounds that hold whatever set of draws fails.
        confidence: Confidence of statements from the weights.
        limit: Largest failure probability allowed.
    """
    free = draws.free(draws.names)
    shifts = draws.weighted(Shift, confidence)

    def limit_at(size: float) -> float:
        """Upper limit of the failure probability after any shift of this size, whatever set of draws fails."""
        _, high = bounds.interval_after_shift(free, size)
        return high

    return AllChanges(shifts, largest_change(shifts, limit), bounds.largest_shift(free, limit), limit_at)


def widening_of_all_laws(draws: ScoredDraws, bounds: AnyFailures, confidence: float, limit: float) -> AllChanges:
    """Widenings of all laws: the largest one that keeps the limit, and limits for any size.

    The size of a widening is the natural logarithm of the relative width.

    Args:
        draws: The draws of the result with their scores.
        bounds: Bounds that hold whatever set of draws fails; none for widenings if the laws are correlated.
        confidence: Confidence of statements from the weights.
        limit: Largest failure probability allowed.
    """
    free = draws.free(draws.names)
    widenings = draws.weighted(Widening, confidence)
    guaranteed_width = bounds.largest_widening(free, limit) or UNCHANGED_WIDTH

    def limit_at(size: float) -> float:
        """Upper limit of the failure probability after any widening of this size, whatever set of draws fails.

        NaN if the laws are correlated.
        """
        interval = bounds.interval_after_widening(free, math.exp(size))
        return math.nan if interval is None else interval[1]

    return AllChanges(widenings, largest_change(widenings, limit), math.log(guaranteed_width), limit_at)


def result_of(subject: Study | Result, progress: ProgressCallback | None) -> Result:
    """The subject itself if it is a result; otherwise the result of running the study without its sweep.

    Args:
        subject: The result or the study.
        progress: Called with the simulations done.

    Raises:
        ConfigError: A result has a sweep, or draws are not independent.
    """
    study = subject.study if isinstance(subject, Result) else subject
    require_independent(study, "a bound from the draws' weights")
    if isinstance(subject, Study):
        return run(subject.without_sweep(), progress=progress, check=False)
    if study.axes:
        remedy = "give the study, whose sweep is ignored, or the result of `run`"
        raise ConfigError(study.source, f"has a sweep over {', '.join(study.axes)}; {remedy}")
    return subject
