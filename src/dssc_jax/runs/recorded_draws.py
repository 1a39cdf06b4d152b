"""Simulation of many draws with some of their signals over time, by one compiled program.

Some numbers of the study may change from batch to batch, as when a user moves a slider.
"""

import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from dssc_jax.engine.batching import Engine, Lane, evaluate, results_of
from dssc_jax.engine.sampling import Arrays, draw
from dssc_jax.runs.trajectory import recorded_lane, trajectory_columns
from dssc_jax.study import Study


class SignalKey(NamedTuple):
    """Key of a recorded signal among the results of a lane, which have texts as keys otherwise.

    Args:
        name: Name of the signal's column in a trajectory, such as ``y`` or ``x_e``.
    """

    name: str


class RecordedDraws:
    """A study compiled once, whose draws are simulated together with some of their signals.

    Args:
        study: The study; its own sweep is ignored.
        live: Lowest and highest value of each number that batches may set. Both ends are checked like values of a
            sweep. A number that has a law in the study of a batch is drawn from this law.
        signals: Names of the signals to record.
        samples: Largest number of samples to record of each signal.
        lanes: Largest number of draws that run together.

    Raises:
        ConfigError: A name is not a number of the loop, or an end is not admissible.
    """

    def __init__(
        self,
        study: Study,
        live: Mapping[str, tuple[float, float]],
        signals: Sequence[str],
        samples: int = 300,
        lanes: int = 256,
    ) -> None:
        """Check the live numbers, and make the engine for a study in which they are swept."""
        axes = {name: sorted(set(extent)) for name, extent in live.items()}
        self.study = study.override({"sweep": axes})
        self.signals = tuple(signals)
        self.every = max(1, math.ceil(study.loop.steps / samples))  # samples from one recorded sample to the next
        self._engine = Engine(self.study, lanes, program=self._program)

    @property
    def times(self) -> np.ndarray:
        """Times of the recorded samples [s], shape (samples,)."""
        return np.arange(0, self.study.loop.steps, self.every) * self.study.loop.sample_time

    def compile(self) -> None:
        """Compile the program at once, rather than with the first batch."""
        self._engine.compiled()

    def batches(self, study: Study, indices: np.ndarray) -> Iterator[Arrays]:
        """Simulate draws in batches, so that a caller may stop between two of them.

        Args:
            study: The study with the present values; only live numbers and arguments of laws may differ from those of
                the compiled study.
            indices: Draw indices, shape (n,).

        Yields:
            Results of a batch as from :class:`dssc_jax.engine.evaluation.Evaluator`, and for each :class:`SignalKey`
            an array of shape (lanes, samples) that is NaN once a draw has ended.
        """
        drawn = draw(study, indices)
        stated = study.leaves()
        for start in range(0, len(indices), self._engine.lanes):
            batch = slice(start, start + self._engine.lanes)
            count = len(indices[batch])
            columns = {}
            for name in self._engine.names:
                columns[name] = drawn[name][batch] if name in drawn else np.full(count, stated[name])
            yield self._with_ends(evaluate(self._engine, columns, indices[batch]))

    def _with_ends(self, results: Arrays) -> Arrays:
        """Copy the results of a batch, with NaN in the signals from the end of each draw on."""
        ends = np.fmin(results["failed_at"], results.get("settled_at", np.inf))
        has_ended = self.times >= ends[:, None]
        if not has_ended.any():
            return results
        masked = {}
        for name, array in results.items():
            masked[name] = np.where(has_ended, np.nan, array) if isinstance(name, SignalKey) else array
        return masked

    def _program(self, study: Study) -> Lane:
        """Return the program of a lane, whose results include the recorded signals."""
        simulate = recorded_lane(study, self.every)

        def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[Any, Any]:
            """The results of a draw by name, and each recorded signal by its :class:`SignalKey`."""
            run, recorded = simulate(values, index)
            columns = trajectory_columns(study, recorded)
            signals = {SignalKey(name): columns[name] for name in self.signals}
            # JAX would sort the keys of a plain dict, which are not comparable
            return OrderedDict([*results_of(study, run).items(), *signals.items()])

        return lane
