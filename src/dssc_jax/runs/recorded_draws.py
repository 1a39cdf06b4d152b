"""Many draws at once, with their signals over time: one compiled program for any values of chosen numbers."""

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from dssc_jax.closed_loop.draw import simulate_recorded
from dssc_jax.closed_loop.margin_measures import margins_of
from dssc_jax.engine.batching import Engine, Lane, evaluate, results_of
from dssc_jax.engine.sampling import Arrays, draw, draw_key
from dssc_jax.runs.trajectory import trajectory_columns
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
        live: Numbers that every batch sets anew, with the lowest and the highest value. Both are checked like values of
            a sweep. A number whose value is a law in the batch's own study is drawn from that law.
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
        axes = {name: sorted(set(extent)) for name, extent in live.items()}
        self.study = study.override({"sweep": axes})
        self.signals = tuple(signals)
        self.every = max(1, -(-study.loop.steps // samples))
        self._engine = Engine(self.study, lanes, program=self._program)

    @property
    def times(self) -> np.ndarray:
        """Times of the recorded samples [s]."""
        return np.arange(0, self.study.loop.steps, self.every) * self.study.loop.sample_time

    def compile(self) -> None:
        """Compile the program now rather than with the first batch."""
        self._engine.compiled()

    def batches(self, study: Study, indices: np.ndarray) -> Iterator[Arrays]:
        """Simulate draws in batches, so that a caller may stop between two.

        Args:
            study: The study with its present values; it differs from the compiled one in live numbers and in the
                arguments of laws only.
            indices: Draw indices, shape (n,).

        Yields:
            Results of a batch as of :class:`dssc_jax.engine.evaluation.Evaluator`, and for each :class:`SignalKey` an
            array of shape (lanes, samples), NaN once a draw has ended.
        """
        values = draw(study, indices)
        fixed = study.leaves()
        for start in range(0, len(indices), self._engine.lanes):
            batch = slice(start, start + self._engine.lanes)
            count = len(indices[batch])
            columns = {
                name: values[name][batch] if name in values else np.full(count, fixed[name])
                for name in self._engine.names
            }
            yield self._masked(evaluate(self._engine, columns, indices[batch]))

    def _masked(self, results: Arrays) -> Arrays:
        """Signals are NaN from the end of a draw on."""
        ended = np.fmin(results["failed_at"], results.get("settled_at", np.inf))
        has_ended = self.times >= ended[:, None]
        return {
            name: np.where(has_ended, np.nan, array) if isinstance(name, SignalKey) and has_ended.any() else array
            for name, array in results.items()
        }

    def _program(self, study: Study) -> Lane:
        """The program of a lane."""

        def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[Any, Any]:
            key = draw_key(study.config.seed, index)
            margins = {name: values[name] for name in margins_of(study.measures)}
            criteria = study.measures, study.requirements
            run, recorded = simulate_recorded(study.loop, study.params(values), key, *criteria, self.every, margins)
            columns = trajectory_columns(study, recorded)
            signals = {SignalKey(name): columns[name] for name in self.signals}
            # JAX would sort the keys of a plain dict, which are not comparable
            return OrderedDict([*results_of(study, run).items(), *signals.items()])

        return lane


def all_draws(batches: Sequence[Arrays]) -> Arrays:
    """The results of several batches as one."""
    return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}
