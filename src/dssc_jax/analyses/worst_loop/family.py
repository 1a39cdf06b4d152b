"""The linearised loop at any point of the box."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from dssc_jax.analyses.worst_loop.box import Box
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.linearisation.equilibria import RestingLoop
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.engine.linearisation.smooth_parts import Finding

BATCH_POINTS = 64  # points that are linearised at once
KEYS = 8  # draws whose random keys are compared
SAME = 1e-9  # largest relative difference of matrices that count as equal
PROBES = 4  # points from which each number is moved, to see whether it matters
ANY_SAMPLE = 1  # at rest every sample after the first, 0, has the same linear loop
DIGITS = 12  # decimal digits of a coordinate; points that agree in them are one

Evaluate = Callable[[np.ndarray], np.ndarray]
"""Points of shape (n, sides) -> [[A, B], [C, 0]] there, shape (n, states + channels, states + channels)."""
Case = TypeVar("Case")
"""What a search finds of a broken loop."""
RemainingPoints = Callable[[], int]
"""() -> the number of points that may still be evaluated."""


class LoopFamily:
    """The linearised loop at points of the box. Each point is linearised only once, and points in batches.

    Args:
        resting: The undisturbed loop of the study.
        box: The box of the uncertain numbers.
        findings: The :class:`~dssc_jax.engine.linearisation.smooth_parts.Finding` of each part at the operating
            points, the same for all draws, shape (parts,).
        advance: Called with the number of points that were linearised.
    """

    def __init__(self, resting: RestingLoop, box: Box, findings: np.ndarray, advance: Callable[[int], None]) -> None:
        """Start with an empty cache of linearised points; nothing is linearised yet."""
        self.resting = resting
        self.advance = advance
        self.box = box
        self.findings = findings
        self.cache: list[StateMatrices] = []
        self.row_of_point: dict[bytes, int] = {}  # row of the cache for each point, by the bytes of the point
        self.patterns: dict[bytes, StateMatrices] = {}  # one loop of the cache for each zero_pattern

    def at(self, points: np.ndarray) -> StateMatrices:
        """Matrices of the loop at points of shape (n, sides); NaN at a point without an equilibrium.

        Only points that are not in the cache are linearised.
        """
        points = np.round(points, DIGITS) + 0.0  # one key for 0.0 and -0.0
        keys = [point.tobytes() for point in points]
        new_by_key = {key: point for key, point in zip(keys, points, strict=True) if key not in self.row_of_point}
        new_points = list(new_by_key.values())
        for first in range(0, len(new_points), BATCH_POINTS):
            self.store(np.array(new_points[first : first + BATCH_POINTS]))
        return stack_loops([self.cache[self.row_of_point[key]] for key in keys])

    def store(self, batch: np.ndarray) -> None:
        """Linearise the loop at new points, and store the matrices in the cache.

        Args:
            batch: The points, shape (n, sides), n at most :data:`BATCH_POINTS`.
        """
        filling = np.repeat(batch[-1:], BATCH_POINTS - len(batch), axis=0)  # all batches have one shape
        draw_0 = np.zeros(BATCH_POINTS, int)  # all points have the random key of draw 0
        matrices = self.linearise(np.concatenate([batch, filling]), draw_0)
        for row, point in enumerate(batch):
            self.row_of_point[point.tobytes()] = len(self.cache)
            loop = StateMatrices(*(part[row] for part in matrices))
            self.cache.append(loop)
            self.patterns.setdefault(zero_pattern(loop), loop)
        self.advance(len(self.cache))

    def seen_loops(self, drawn: StateMatrices) -> StateMatrices:
        """The loops of the draws, and one loop for each pattern of zeros among the points linearised so far.

        The pattern of zeros in A, B and C tells which states have an effect. Some states have an effect only at some
        points, such as a delay's memory of a command sent long ago.

        Args:
            drawn: The loops of the draws that have an operating point.
        """
        representatives = [loop for loop in self.patterns.values() if np.isfinite(loop.a).all()]
        if not representatives:
            return drawn
        pairs = zip(drawn, stack_loops(representatives), strict=True)
        return StateMatrices(*(np.concatenate(pair) for pair in pairs))

    def states_at(self, drawn: StateMatrices, place: int) -> np.ndarray:
        """Indices of the states that carry a signal from a break point back to it, in a draw or at a linearised point.

        Args:
            drawn: The loops of the draws that have an operating point.
            place: Index of the break point.
        """
        loops = self.seen_loops(drawn)
        all_loops = np.ones(len(loops.a), bool)
        return loops.loop_states(place, all_loops)

    def remaining_points(self, limit: int) -> int:
        """Number of points that may still be linearised if all searches together may take ``limit`` points."""
        return max(0, limit - len(self.cache))

    def allowance(self, points: int) -> RemainingPoints:
        """Allow ``points`` further points, and return a function that says how many of them are left."""
        return partial(self.remaining_points, len(self.cache) + points)

    def linearise(self, points: np.ndarray, indices: np.ndarray) -> StateMatrices:
        """Linearise the loop at points of shape (n, sides); NaN where there is no equilibrium.

        A part that rests on a boundary of its smooth range (a corner) is linearised as on the inner side of it.

        Args:
            points: The points, shape (n, sides).
            indices: Index of the draw whose random key is used at each point, shape (n,).
        """
        values = self.box.values(points)
        states, matrices, is_settled, _ = self.resting.settle(values, indices)
        if np.any(self.findings == Finding.CORNER):
            findings = np.broadcast_to(self.findings, (len(points), self.findings.size))
            matrices = self.resting.linearise(values, indices, states, ANY_SAMPLE, findings)
        gaps = np.where(is_settled, 0.0, np.nan)[:, None, None]  # added, NaN makes a matrix NaN
        return StateMatrices(matrices.next_states, matrices.a + gaps, matrices.b + gaps, matrices.c + gaps)

    def require_no_other_uncertainty(self) -> None:
        """Require that the uncertain numbers alone determine the linearised loop.

        The check compares the loops in the middle of the box for several random keys.

        Raises:
            ConfigError: The loop depends on the random key of a draw, too.
        """
        centre = np.zeros((BATCH_POINTS, len(self.box.sides)))
        draws = np.arange(BATCH_POINTS) % KEYS
        matrices = self.linearise(centre, draws)
        for part in (matrices.a, matrices.b, matrices.c):
            if not np.allclose(part, part[:1], rtol=SAME, atol=SAME, equal_nan=True):
                raise ConfigError(
                    self.resting.study.source,
                    "has a loop that differs between draws with the same numbers, as with a sensor's jitter, so that "
                    "its worst case has no bound; `loop_margins` has its margins over the draws",
                )


def stack_loops(loops: Sequence[StateMatrices]) -> StateMatrices:
    """The matrices of several single loops, stacked along a new first dimension."""
    return StateMatrices(*(np.stack(parts) for parts in zip(*loops, strict=True)))


def zero_pattern(loop: StateMatrices) -> bytes:
    """A key of the pattern of zeros in A, B and C of one loop; loops with the same pattern have the same key."""
    masks = [np.packbits(matrix != 0.0) for matrix in (loop.a, loop.b, loop.c)]
    return b"".join(mask.tobytes() for mask in masks)


class BrokenFamily:
    """The loop broken at one place or at several at once, as a function of the numbers that change it.

    Args:
        family: The whole loop over the whole box.
        state_indices: Indices of the states that carry a signal from the break points around the loop.
        places: Indices of the break points.
    """

    def __init__(self, family: LoopFamily, state_indices: np.ndarray, places: Sequence[int]) -> None:
        """Find the sides of the box that change this broken loop."""
        self.family = family
        self.state_indices = state_indices
        self.places = list(places)
        self.sides = self._influential_sides()

    @property
    def sample_time(self) -> float:
        """The sample time T_s of the loop [s]."""
        return self.family.resting.study.config.loop.sample_time

    @property
    def names(self) -> tuple[str, ...]:
        """Dotted names of the numbers that change this loop."""
        return tuple(self.family.box.sides[side].name for side in self.sides)

    def in_whole_box(self, points: np.ndarray) -> np.ndarray:
        """Convert points of shape (n, sides) to points of the whole box, shape (n, sides of the box).

        Numbers that do not change this loop get the coordinate 0, the middle of their ranges.
        """
        result = np.zeros((len(points), len(self.family.box.sides)))
        result[:, self.sides] = points
        return result

    def numbers(self, point: np.ndarray) -> dict[str, float]:
        """The numbers that change this loop, at one point of shape (sides,), by dotted name."""
        (whole_point,) = self.in_whole_box(point[None])
        numbers = self.family.box.numbers(whole_point)
        return {name: numbers[name] for name in self.names}

    def has_operating_point(self, point: np.ndarray) -> bool:
        """Whether the loop has an equilibrium at one point, shape (sides,), at which no limit opens the loop."""
        matrices = self.family.at(self.in_whole_box(point[None]))
        (is_open,) = matrices.is_open()
        return bool(np.isfinite(matrices.a).all() and not is_open)

    def at(self, points: np.ndarray) -> np.ndarray:
        """[[A, B], [C, 0]] of this broken loop at points of shape (n, sides).

        Returns:
            Shape (n, states + places, states + places); NaN at a point without an equilibrium.
        """
        return self.break_loops(self.family.at(self.in_whole_box(points)))

    def break_loops(self, matrices: StateMatrices) -> np.ndarray:
        """Extract this broken loop from n whole loops: [[A, B], [C, 0]], shape (n, states + places, states + places).

        Args:
            matrices: Matrices of the whole loops, with all states and all break points.
        """
        states = self.state_indices
        places = self.places
        a = matrices.a[:, states][:, :, states]
        b = matrices.b[:, states][:, :, places]
        c = matrices.c[:, places][:, :, states]
        zeros = np.zeros((len(a), len(places), len(places)))
        upper_rows = np.concatenate([a, b], axis=2)
        lower_rows = np.concatenate([c, zeros], axis=2)
        return np.concatenate([upper_rows, lower_rows], axis=1)

    def _influential_sides(self) -> list[int]:
        """Indices of the sides of the box that change this loop.

        Each number alone is moved from several random points. A number without any effect there is left out.
        """
        sides = len(self.family.box.sides)
        starts = np.random.default_rng(0).uniform(-0.5, 0.5, (PROBES, sides))
        moved = np.repeat(starts[:, None], sides, axis=1)  # shape (PROBES, sides, sides): a point for each moved number
        moved[:, range(sides), range(sides)] += 0.5
        reference = self.break_loops(self.family.at(starts))
        variants = self.break_loops(self.family.at(moved.reshape(-1, sides)))
        variants = variants.reshape(PROBES, sides, *reference.shape[1:])
        limit = SAME * (1e-3 + np.abs(reference).max(axis=0))
        is_unchanged = np.abs(variants - reference[:, None]) <= limit  # False where there is no equilibrium
        is_influential = np.any(~is_unchanged, axis=(0, 2, 3))  # at any start, in any entry of the matrix
        return np.flatnonzero(is_influential).tolist()


def with_all_states(
    broken: BrokenFamily, states_of: Callable[[], np.ndarray], search: Callable[[BrokenFamily], Case]
) -> Case:
    """Search a broken loop, and repeat the search with more states until no further state is found to matter.

    Args:
        broken: The broken loop, with the states that are known before the search.
        states_of: () -> indices of the states that matter at any point linearised so far, shape (states,).
        search: (broken loop) -> its worst case.
    """
    while True:
        case = search(broken)
        states = states_of()
        if np.array_equal(states, broken.state_indices):
            return case
        broken = BrokenFamily(broken.family, states, broken.places)
