"""The plain reference program, which checks stored results, and the sensitivity of lanes to rounding.

The engine rewrites a lane before compilation. A check with the same program would repeat an error of that step, so the
original lane runs here, under ``jit(vmap(...))`` only. Two programs round differently, and a loop that chatters or
diverges amplifies the difference. To measure this amplification, a lane runs again with every number changed in its
last bits.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from dssc_jax.core.native.fmu_instances import require_no_faults
from dssc_jax.engine.batching import Lanes, lane_numbers, lane_of_study
from dssc_jax.engine.linearisation.margin_values import margin_values
from dssc_jax.engine.plain import plain_options
from dssc_jax.engine.sampling import Arrays
from dssc_jax.statistics.order import typical_size
from dssc_jax.study import Study

TOLERANCE = {64: 1e-9, 32: 2e-3}
"""Relative deviation, by precision [bits], that rounding explains in a loop that does not amplify it.

Different programs, compilers and machines contract multiply-adds differently.
"""

SHIFT = {64: 2.0**-48, 32: 2.0**-20}
"""Relative change, by precision [bits], of every number that tests a lane's sensitivity: a few rounding errors."""

RESTING = {64: 1e-12, 32: 1e-6}  # by precision: most size of a metric at rest, relative to the largest metric
COPIES = 4  # copies of a lane, whose numbers are changed in different directions
ROUNDING_FACTOR = 100.0  # allowed deviation over that of the copies, because rounding acts in every operation
UNDECIDED_BEYOND = 1e-2  # allowed deviation beyond which a lane is no evidence
MOST_CHANGE = UNDECIDED_BEYOND / ROUNDING_FACTOR  # by rounding, of a lane that is evidence

VERDICTS = {
    "agrees": "agrees with the stored values (largest relative deviation {:.1g})",
    "differs": "DIFFERS from the stored values by more than rounding explains (relative deviation {:.1g})",
    "undecided": "proves nothing, since rounding alone changes the result (relative deviation {:.1g})",
}
"""Text of each verdict on recomputed values, as a format of the largest relative deviation."""


class Agreement(NamedTuple):
    """How well stored values of n lanes agree with recomputed values.

    Args:
        deviation: Largest relative deviation of a value in each lane, shape (n,); infinite where outcomes differ.
        variable: Name of the variable with the largest deviation in each lane, shape (n,).
        allowed: Deviation that rounding explains in each lane, shape (n,).
    """

    deviation: np.ndarray
    variable: np.ndarray
    allowed: np.ndarray

    @property
    def decided(self) -> np.ndarray:
        """Whether each lane is evidence, because rounding alone hardly changes the lane, shape (n,)."""
        return self.allowed <= UNDECIDED_BEYOND

    @property
    def verdict(self) -> str:
        """The verdict, a key of :data:`VERDICTS`.

        It is ``differs`` if the deviation of a lane that is evidence exceeds what rounding explains, ``undecided`` if
        no lane is evidence, and otherwise ``agrees``.
        """
        is_unexplained = self.decided & (self.deviation > self.allowed)
        if np.any(is_unexplained):
            return "differs"
        return "agrees" if self.decided.any() else "undecided"


def plain_results(study: Study, values: Mapping[str, np.ndarray], draws: np.ndarray) -> Arrays:
    """Metrics, slacks and outcome of n lanes by the plain program, by name, shape (n,) each.

    Args:
        study: The study.
        values: Swept and drawn numbers of the lanes, shape (n,) each.
        draws: Draw index of each lane, shape (n,).
    """
    values = {**values, **margin_values(study)(dict(values), draws)}
    with jax.enable_x64(study.config.loop.precision == 64):
        lanes = {name: jnp.asarray(column, jnp.result_type(float)) for name, column in values.items()}
        batch = jax.jit(jax.vmap(lane_of_study(study, axis_name=None)), compiler_options=plain_options())
        results = jax.tree.map(np.asarray, batch(lanes, np.asarray(draws, np.uint32)))
    require_no_faults()
    return results


def recompute(study: Study, lanes: Lanes) -> Arrays:
    """Compute every variable of a result at n lanes again by the plain program.

    Args:
        study: The study.
        lanes: Indices of the lanes along each axis of the sweep and along the draws, shape (n,) each.

    Returns:
        The variables by name, shape (n,) each.
    """
    *_, draws = lanes
    values = lane_numbers(study, lanes)
    drawn = {name: values[name] for name in study.laws}
    return drawn | plain_results(study, values, draws)


def perturbed_copies(study: Study, lanes: Lanes) -> list[Arrays]:
    """Results of :data:`COPIES` copies of n lanes by the plain program, with every number changed in its last bits.

    The differences between the copies tell how much the loop amplifies rounding.

    Args:
        study: The study.
        lanes: Indices of the lanes along each axis of the sweep and along the draws, shape (n,) each.

    Returns:
        The results of each copy by name, shape (n,) each.
    """
    *_, draws = lanes
    count = len(draws)
    columns = {}
    for name, number in study.numbers.items():
        may_be_changed = isinstance(number.value, float) and not number.expression and number.quantity.law
        if may_be_changed:
            columns[name] = np.full(count, number.value)
    columns |= lane_numbers(study, lanes)
    rng = np.random.default_rng(0)
    shift = SHIFT[study.config.loop.precision]
    values = {}
    for name, column in columns.items():
        signs = rng.choice([-1.0, 1.0], (COPIES, len(column)))
        values[name] = (column * (1.0 + shift * signs)).ravel()
    results = plain_results(study, values, np.tile(draws, COPIES))
    copies = []
    for first in range(0, COPIES * count, count):
        copies.append({name: array[first : first + count] for name, array in results.items()})
    return copies


def stored_lanes(dataset: xr.Dataset, names: Iterable[str], lanes: Lanes) -> Arrays:
    """Some variables of a stored result at n lanes, by name, shape (n,) each.

    A drawn number does not depend on the sweep, so the result stores it once for each draw.

    Args:
        dataset: The stored result.
        names: Names of the variables.
        lanes: Indices of the lanes along each axis of the sweep and along the draws, shape (n,) each.
    """
    *_, draws = lanes
    columns = {}
    for name in names:
        array = dataset[name]
        is_drawn_number = array.dims == ("draw",)
        columns[name] = array.values[draws] if is_drawn_number else array.values[lanes]
    return columns


def agreement(study: Study, dataset: xr.Dataset, lanes: Lanes, computed: Mapping[str, np.ndarray]) -> Agreement:
    """Compare n lanes of a stored result with the values of another program.

    Lanes that deviate by more than rounding alone explains run again, in copies with changed last bits. The copies tell
    how much of the deviation the loop explains by its own amplification of rounding.

    Args:
        study: The study.
        dataset: The stored result.
        lanes: Indices of the lanes along each axis of the sweep and along the draws, shape (n,) each.
        computed: Variables of the result by the other program, shape (n,) each.
    """
    stored_values = stored_lanes(dataset, computed, lanes)
    sizes = {name: typical_size(dataset[name].values) for name in computed}
    deviations_by_name = deviations(study, sizes, stored_values, computed)
    names = np.array(list(deviations_by_name))
    table = np.stack(list(deviations_by_name.values()))  # shape (variables, n)
    rounding = TOLERANCE[study.config.loop.precision]
    allowed = np.full(table.shape[1], rounding)
    is_doubtful = table.max(0) > rounding
    if is_doubtful.any():
        copies = perturbed_copies(study, tuple(part[is_doubtful] for part in lanes))
        doubtful_values = {name: column[is_doubtful] for name, column in computed.items() if name in copies[0]}
        spreads = {name: np.zeros(len(column)) for name, column in doubtful_values.items()}
        for copy in copies:
            for name, spread in deviations(study, sizes, doubtful_values, copy).items():
                spreads[name] = np.maximum(spreads[name], spread)
        resting = resting_metrics(study, sizes, spreads)
        table[np.isin(names, resting)] = 0.0
        largest_spread = np.zeros(np.count_nonzero(is_doubtful))
        for name, spread in spreads.items():
            if name not in resting:
                largest_spread = np.maximum(largest_spread, spread)
        allowed[is_doubtful] = np.maximum(rounding, ROUNDING_FACTOR * largest_spread)
    return Agreement(table.max(0), names[table.argmax(0)], allowed)


def resting_metrics(study: Study, sizes: Mapping[str, float], spreads: Mapping[str, np.ndarray]) -> list[str]:
    """Names of the metrics that consist of rounding errors only, such as the error of a channel at rest.

    Such a metric is far smaller than the largest metric, and rounding changes it too much for it to be evidence. Units
    do not matter, because the ratio of the two sizes is extreme.

    Args:
        study: The study.
        sizes: Typical size of each variable by name.
        spreads: Relative change of each variable by rounding, shape (n,) each.
    """
    names = [measure.name for measure in study.measures if measure.name in sizes and measure.name in spreads]
    largest = max((sizes[name] for name in names), default=0.0)
    resting = []
    for name in names:
        is_tiny = sizes[name] <= RESTING[study.config.loop.precision] * largest
        if is_tiny and np.max(spreads[name]) > MOST_CHANGE:
            resting.append(name)
    return resting


def deviations(
    study: Study, sizes: Mapping[str, float], stored: Mapping[str, np.ndarray], computed: Mapping[str, np.ndarray]
) -> Arrays:
    """Relative deviation of computed from stored variables, by name, shape (n,) each.

    It is relative to the stored value or to the variable's typical size, whichever is larger. Rounding can move an
    event by one sample, so the change of a variable by one sample is subtracted. Two NaN are equal. The deviation is
    infinite for different outcomes, and where only one of two values is finite.

    Args:
        study: The study.
        sizes: Typical size of each variable by name.
        stored: Stored variables, shape (n,) each.
        computed: The same variables by another program.
    """
    changes_by_sample = sample_changes(study)
    deviations_by_name = {}
    for name, stored_values in stored.items():
        computed_values = np.asarray(computed[name], dtype=stored_values.dtype)
        if name == "outcome":
            deviations_by_name[name] = np.where(stored_values == computed_values, 0.0, np.inf)
            continue
        is_equal = (stored_values == computed_values) | (np.isnan(stored_values) & np.isnan(computed_values))
        with np.errstate(invalid="ignore", over="ignore"):
            difference = np.abs(stored_values.astype(float) - computed_values)
            gap = np.maximum(difference - changes_by_sample.get(name, 0.0), 0.0)
            relative = gap / np.maximum(np.abs(stored_values), sizes[name])
        is_finite = np.isfinite(stored_values) & np.isfinite(computed_values)
        deviations_by_name[name] = np.where(is_equal, 0.0, np.where(is_finite, relative, np.inf))
    return deviations_by_name


def sample_changes(study: Study) -> dict[str, float]:
    """The change of each variable that counts samples if one sample is added, by name, in the variable's unit.

    Times and shares of the time count samples. A little is added to each change for rounding.
    """
    with_rounding = 1.0 + 1e-6
    period = with_rounding * study.loop.sample_time
    one_sample = {"s": period, "1": with_rounding * (1.0 / study.loop.steps)}  # by unit: a time, a share of the time
    changes = {"failed_at": period, "settled_at": period}
    for measure in study.measures:
        if measure.metric.counted:
            changes[measure.name] = one_sample[measure.metric.unit]
    for requirement in study.requirements:
        changes[requirement.violation_name] = period
        if requirement.measure.name in changes:
            changes[requirement.name] = changes[requirement.measure.name]
    return changes
