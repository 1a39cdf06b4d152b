"""Margins that a study requires, of the linearised loop of each lane, at any values of its uncertain numbers.

Every lane is linearised at its equilibrium, on a grid of frequencies of its own. So its margins depend on its own
numbers alone, and neither on the block that it lies in nor on how many draws there are.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dssc_jax.closed_loop.break_points import place_names
from dssc_jax.closed_loop.loop import Loop
from dssc_jax.closed_loop.margin_measures import margins_of
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.engine.linearisation.operating_points import RestingLoop, lane_loop
from dssc_jax.engine.linearisation.part_slopes import examination
from dssc_jax.engine.linearisation.response import margin_angles, named_margins, response_of
from dssc_jax.engine.linearisation.smooth_parts import Finding, declared_places, require_smooth_at
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study

BATCH_LANES = 2048  # linearised at once
STEP = 1e-4  # step of a difference, relative to the number


class ClosedLoops(NamedTuple):
    """The states that matter at a break point, of some lanes.

    Args:
        a: Shape (n, states, states).
        b: Shape (n, states).
        c: Shape (n, states).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


@dataclass(frozen=True)
class LoopOfStudy:
    """A study by the content that decides its compiled margins: its table, and its loop.

    Args:
        table: Hash of the table.
        loop: The models and the clock.
        study: The study.
    """

    table: str
    loop: Loop
    study: Study = field(compare=False)


def margin_values(study: Study) -> "MarginValues":
    """The :class:`MarginValues` of a study; those of the last few studies stay compiled."""
    return compiled_margins(LoopOfStudy(study.hash, study.loop, study))


@lru_cache(maxsize=4)
def compiled_margins(key: LoopOfStudy) -> "MarginValues":
    """See :func:`margin_values`."""
    return MarginValues(key.study)


class MarginValues:
    """The required margins of a study as a compiled function of its uncertain and swept numbers.

    Args:
        study: The study.

    Raises:
        ConfigError: A margin is required, and a part of the loop does not declare where it is smooth.
    """

    def __init__(self, study: Study) -> None:
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
        """Every required margin of each lane by the name of its measure, shape (n,).

        A lane whose loop is unstable has the value at the limit of stability. One without an equilibrium has NaN, and
        so has one that rests beyond a limit which opens the loop.

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
        """Derivative of every required margin with respect to one number, by central differences, shape (n,).

        A margin that is infinite has the derivative 0.

        Args:
            values: As for a call.
            indices: As for a call.
            name: The number.
        """
        column = np.asarray(values[name], float)
        size = np.abs(column)
        step = STEP * np.where(size > 0.0, size, np.max(size, initial=0.0) or 1.0)
        ends = (np.where(size > 0.0, column - step, column), column + step)
        low, high = (self(values | {name: end}, indices) for end in ends)
        slopes = {}
        for margin in self.margins:
            with np.errstate(invalid="ignore"):
                slope = (high[margin] - low[margin]) / (ends[1] - ends[0])
            slopes[margin] = np.where(np.isfinite(slope), slope, 0.0)
        return slopes

    def _batch(self, values: Arrays, indices: np.ndarray) -> Arrays:
        """The margins of some lanes."""
        states, matrices, is_settled, _ = self.resting.settle(values, indices)
        is_beyond = np.zeros(len(is_settled), bool)
        if is_settled.any():
            states = np.where(is_settled[:, None], states, states[is_settled][0])
            findings = self.examine(values, indices, states, 1)
            findings = self.resting.linearise.resolve_open_loops(values, indices, states, 1, findings)
            require_smooth_at(self.study, self.resting.places, findings[is_settled])
            is_beyond = np.any(findings == Finding.BEYOND, axis=1)
            if np.any(findings == Finding.CORNER):
                matrices = self.resting.linearise(values, indices, states, 1, findings)
        places = place_names(self.study.loop.channels)
        by_place: dict[str, Arrays] = {}
        for margin in self.margins.values():
            if margin.place not in by_place:
                fields = {m.kind.field: m.kind.neutral for m in self.margins.values() if m.place == margin.place}
                by_place[margin.place] = self._at(matrices, is_settled, is_beyond, places.index(margin.place), fields)
        return {name: by_place[margin.place][margin.kind.field] for name, margin in self.margins.items()}

    def _at(
        self,
        matrices: StateMatrices,
        is_settled: np.ndarray,
        is_beyond: np.ndarray,
        point: int,
        neutral: dict[str, float],
    ) -> Arrays:
        """The margins at one break point.

        Args:
            matrices: Matrices of the batch.
            is_settled: Which lanes have an equilibrium, shape (n,).
            is_beyond: Which of them rest beyond the boundary of a part, shape (n,).
            point: Index of the break point.
            neutral: The margins' values at the limit of stability.
        """
        loop_states = matrices.returning(point)
        is_settled = is_settled & (np.any(loop_states, axis=1) | ~is_beyond)
        columns = {field: np.where(is_settled, value, np.nan) for field, value in neutral.items()}
        for mask in np.unique(loop_states[is_settled], axis=0):
            lanes = np.flatnonzero(is_settled & np.all(loop_states == mask, axis=1))
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
