"""Many draws together with their signals over time, by one compiled program.

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
    """Key of a signal over time among a lane's results.

    Args:
        name: A column of a trajectory, such as ``y`` or ``x_e``.
    """

    name: str


class RecordedDraws:
    """A study compiled once, whose draws are simulated together with some of their signals.

    Args:
        study: The study; its own sweep is ignored.
        live: Lowest and highest value of each number that batches set. Both are checked like values of a sweep. A
            number that has a law in a batch's study is drawn from that law.
        signals: Names of the signals to record.
        samples: Most samples to record of each signal.
        lanes: Most draws that run together.

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
        """Check the numbers, and make the engine, in whose study they are swept."""
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
        """Compile the program now, instead of with the first batch."""
        self._engine.compiled()

    def batches(self, study: Study, indices: np.ndarray) -> Iterator[Arrays]:
        """Simulate draws in batches, so that a caller may stop between two of them.

        Args:
            study: The study with the present values; only live numbers and arguments of laws may differ from those of
                the compiled study.
            indices: Draw indices, shape (n,).

        Yields:
            Results of a batch as of :class:`dssc_jax.engine.evaluation.Evaluator`, and for each :class:`SignalKey` an
            array of shape (lanes, samples), NaN once a draw has ended.
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
        """The results of a batch, with signals that are NaN from the end of their draw on."""
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
