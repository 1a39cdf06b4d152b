"""The margins of the linearised loop that a study requires, for every lane.

Every lane is linearised at its own equilibrium, with its own frequency grid. So the margins of a lane depend only on
the lane's numbers, and neither on its block nor on the number of draws.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dssc_jax.closed_loop.break_points import place_names
from dssc_jax.closed_loop.loop import Loop
from dssc_jax.closed_loop.metrics.margin_measures import margins_of
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.linearisation.equilibria import LATER_SAMPLE, RestingLoop
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.engine.linearisation.operating_points import lane_loop
from dssc_jax.engine.linearisation.part_slopes import examination
from dssc_jax.engine.linearisation.response import margin_angles, named_margins, response_of
from dssc_jax.engine.linearisation.smooth_parts import Finding, declared_places, require_smooth_at
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study

BATCH_LANES = 2048  # most lanes that are linearised at once
STEP = 1e-4  # step of a central difference, relative to the number


class ClosedLoops(NamedTuple):
    """n closed loops x+ = A x + b w, v = c x, with w added at one break point, where v is the signal before the sum.

    The states x are those through which the added signal returns to the break point.

    Args:
        a: A, shape (n, states, states).
        b: b, shape (n, states).
        c: c, shape (n, states).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


@dataclass(frozen=True)
class LoopOfStudy:
    """The key of a study's compiled margins, which two studies share if their tables and loops are equal.

    Args:
        table: Hash of the study's table.
        loop: The models and the clock.
        study: The study, which is not compared.
    """

    table: str
    loop: Loop
    study: Study = field(compare=False)


def margin_values(study: Study) -> "MarginValues":
    """The function that computes the required margins of a study's lanes; the last few studies stay compiled."""
    return compiled_margins(LoopOfStudy(study.hash, study.loop, study))


@lru_cache(maxsize=4)
def compiled_margins(key: LoopOfStudy) -> "MarginValues":
    """The cached part of :func:`margin_values`: compile the margins of the key's study."""
    return MarginValues(key.study)


class MarginValues:
    """The required margins of a study; a call computes them from the numbers of many lanes.

    Args:
        study: The study.

    Raises:
        ConfigError: A margin is required, and a part of the loop does not declare where it is smooth.
    """

    def __init__(self, study: Study) -> None:
        """Prepare the search for equilibria; nothing is prepared for a study that requires no margin."""
        self.study = study
        self.margins = margins_of(study.measures)
        if not self.margins:
            return
        try:
            places = declared_places(study, moving=False)
        except ConfigError as error:
            raise ConfigError(error.where, f"{error.rule}; `{next(iter(self.margins))}` needs it") from None
        self.resting = RestingLoop(study, places)
        self.examine = examination(lane_loop(self.resting.study, places, is_resting=True), places)

    def __call__(self, values: Arrays, indices: np.ndarray) -> Arrays:
        """Every required margin of each lane, by the name of its measure, shape (n,) each.

        A lane with an unstable loop has the value at the limit of stability. A lane has NaN if it has no equilibrium,
        or if it rests beyond a limit that opens the loop.

        Args:
            values: Values of all uncertain and swept numbers, shape (n,) each.
            indices: Draw index of each lane, shape (n,).

        Raises:
            ConfigError: A part of the loop has no derivative at an operating point.
        """
        if not self.margins:
            return {}
        names = [*self.study.axes, *self.study.laws]
        columns: dict[str, list[np.ndarray]] = {name: [] for name in self.margins}
        for first in range(0, len(indices), BATCH_LANES):
            lanes = slice(first, first + BATCH_LANES)
            batch = {name: np.asarray(values[name], float)[lanes] for name in names}
            for name, column in self._batch(batch, indices[lanes]).items():
                columns[name].append(column)
        return {name: np.concatenate(parts) for name, parts in columns.items()}

    def slopes(self, values: Arrays, indices: np.ndarray, name: str) -> Arrays:
        """Derivative of every required margin with respect to a number, by central differences, shape (n,) each.

        The derivative of an infinite margin is 0.

        Args:
            values: Values of all uncertain and swept numbers, shape (n,) each.
            indices: Draw index of each lane, shape (n,).
            name: The number.
        """
        column = np.asarray(values[name], float)
        size = np.abs(column)
        size_at_zero = np.max(size, initial=0.0) or 1.0  # scale of the step for a number that is 0
        step = STEP * np.where(size > 0.0, size, size_at_zero)
        low = np.where(size > 0.0, column - step, column)  # a number that is 0 may have no negative values
        high = column + step
        margins_at_low = self(values | {name: low}, indices)
        margins_at_high = self(values | {name: high}, indices)
        slopes = {}
        for margin in self.margins:
            with np.errstate(invalid="ignore"):
                slope = (margins_at_high[margin] - margins_at_low[margin]) / (high - low)
            slopes[margin] = np.where(np.isfinite(slope), slope, 0.0)
        return slopes

    def _batch(self, values: Arrays, indices: np.ndarray) -> Arrays:
        """The required margins of at most :data:`BATCH_LANES` lanes, by the name of their measure, shape (n,) each.

        Args:
            values: Values of all uncertain and swept numbers, shape (n,) each.
            indices: Draw index of each lane, shape (n,).
        """
        states, matrices, is_settled, _ = self.resting.settle(values, indices)
        is_beyond = np.zeros(len(is_settled), bool)
        if is_settled.any():
            any_equilibrium = states[is_settled][0]  # stands for the state of lanes without one
            states = np.where(is_settled[:, None], states, any_equilibrium)
            findings = self.examine(values, indices, states, LATER_SAMPLE)
            findings = self.resting.linearise.resolve_open_loops(values, indices, states, LATER_SAMPLE, findings)
            require_smooth_at(self.study, self.resting.places, findings[is_settled])
            is_beyond = np.any(findings == Finding.BEYOND, axis=1)
            if np.any(findings == Finding.CORNER):
                matrices = self.resting.linearise(values, indices, states, LATER_SAMPLE, findings)
        names = place_names(self.study.loop.channels)
        neutral_by_place: dict[str, dict[str, float]] = {}
        for margin in self.margins.values():
            neutral_by_place.setdefault(margin.place, {})[margin.kind.field] = margin.kind.neutral
        margins_by_place: dict[str, Arrays] = {}
        for place, neutral in neutral_by_place.items():
            margins_by_place[place] = self._margins_at(matrices, is_settled, is_beyond, names.index(place), neutral)
        return {name: margins_by_place[margin.place][margin.kind.field] for name, margin in self.margins.items()}

    def _margins_at(
        self,
        matrices: StateMatrices,
        is_settled: np.ndarray,
        is_beyond: np.ndarray,
        point: int,
        neutral: dict[str, float],
    ) -> Arrays:
        """The margins at one break point, by field of ``ClassicalMargins``, shape (n,) each.

        Lanes whose signals return to the break point through the same states are computed together. An unstable loop
        has the margins at the limit of stability. A lane without an equilibrium or with an open loop has NaN.

        Args:
            matrices: Matrices of the lanes.
            is_settled: Whether each lane has an equilibrium, shape (n,).
            is_beyond: Whether each lane rests beyond the boundary of a part, shape (n,).
            point: Index of the break point.
            neutral: Value of each margin at the limit of stability.
        """
        loop_states = matrices.returning(point)
        has_loop = is_settled & (np.any(loop_states, axis=1) | ~is_beyond)
        columns = {field: np.where(has_loop, value, np.nan) for field, value in neutral.items()}
        for mask in np.unique(loop_states[has_loop], axis=0):
            lanes = np.flatnonzero(has_loop & np.all(loop_states == mask, axis=1))
            loops = ClosedLoops(
                matrices.a[np.ix_(lanes, mask, mask)],
                matrices.b[lanes][:, mask, point],
                matrices.c[lanes][:, point, mask],
            )
            poles = np.linalg.eigvals(loops.a)
            is_stable = np.max(np.abs(poles), axis=1, initial=0.0) < 1.0
            if not is_stable.any():
                continue
            a, b, c = (part[is_stable] for part in loops)
            angles = margin_angles(a, b, c, poles[is_stable])
            margins = named_margins(response_of(a, b, c), angles, self.study.config.loop.sample_time, columns)
            for name, column in columns.items():
                column[lanes[is_stable]] = margins[name]
        return columns
