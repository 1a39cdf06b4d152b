"""Simulate all draws of a study again whenever one of its sliders moves, by a program that is compiled once."""

import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
from typing import NamedTuple, TypeAlias

import numpy as np

from dssc_jax.closed_loop.metrics.requirements import violated, worst_slack
from dssc_jax.core.signals import Outcome
from dssc_jax.design import certification
from dssc_jax.engine.batching import join_batches, values_of_draws
from dssc_jax.engine.sampling import Arrays
from dssc_jax.exploration.positions import Positions, study_changes
from dssc_jax.exploration.sliders import CLOCK_SLIDER, Slider, admissible_sliders, live_extents, sliders_of
from dssc_jax.exploration.worker import Stale, never_stale
from dssc_jax.results.result import interval_method
from dssc_jax.runs.recorded_draws import RecordedDraws, SignalKey
from dssc_jax.statistics import CONFIDENCE, describe_probability
from dssc_jax.study import Study
from dssc_jax.study.tables import to_toml

POSITION = ("x", "y", "z")
"""Channels of a vehicle's position."""
ATTITUDE = ("phi", "theta", "psi")
"""Signals of a vehicle's attitude."""
FAN_LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Levels of the quantiles of a fan."""
DRAWS = 1000
"""Usual number of draws."""
VEHICLE_DRAWS = 64
"""Usual number of draws of a plant of several channels."""
BATCH = 256
"""Number of draws after which a run checks whether a newer move has made it stale."""
VEHICLE_BATCH = 16
"""The same number for a plant of several channels."""
QUIET_SECONDS = 0.3
"""Time [s] after which a run shows its progress."""
PROGRAMS = 6
"""Number of compiled programs that are kept, one for each sample time."""


def ignore_notice(text: str) -> None:
    """Do nothing with a description of the work: the notice of a caller who wants none."""


Notice: TypeAlias = Callable[[str], None]
"""Called with a description of the work in progress."""


class Fan(NamedTuple):
    """Quantiles of a signal over time, over the draws that are still running.

    Args:
        values: Quantiles at :data:`FAN_LEVELS`, shape (levels, samples); NaN once no draw is running.
        running: Number of draws that are still running, shape (samples,).
    """

    values: np.ndarray
    running: np.ndarray


@dataclass(frozen=True)
class LiveRun:
    """A run of all draws of a study at one position of its sliders.

    Args:
        study: The study at that position, without a sweep. A run of this study gives the same results.
        results: Metrics, slacks, outcome and signals of all draws, by name.
        values: Drawn values of the uncertain numbers, by name, shape (draws,) each.
        times: Times of the signals' samples [s], shape (samples,).
    """

    study: Study
    results: Arrays
    values: Arrays
    times: np.ndarray
    _fans: dict[str, Fan] = field(default_factory=dict)

    @property
    def failed(self) -> np.ndarray:
        """Whether each draw failed, shape (draws,)."""
        return self.results["outcome"] != Outcome.OK

    @property
    def probability(self) -> float:
        """Share of the draws that failed."""
        return float(self.failed.mean())

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound of the failure probability, by the method that fits the study's draws."""
        low, high = interval_method(self.study).failure_interval(self.failed, CONFIDENCE)
        return float(low), float(high)

    @cached_property
    def statement(self) -> str:
        """A sentence with the number of failures, the failure probability and its interval."""
        return describe_probability(self.failed, interval_method(self.study))

    @cached_property
    def by_requirement(self) -> list[tuple[str, int]]:
        """The text of each requirement, with the number of draws that violate it."""
        counts = []
        for requirement in self.study.requirements:
            violations = violated(self.results[requirement.name])
            counts.append((requirement.text, int(violations.sum())))
        return counts

    @property
    def ended_early(self) -> int:
        """Number of draws that became non-finite, or left the range of the plant's model."""
        return int(np.isfinite(self.results["failed_at"]).sum())

    @cached_property
    def order(self) -> np.ndarray:
        """Indices of the draws from the worst to the best, by smallest slack.

        Of draws with equal slack, the one that ended earlier comes first.
        """
        end_times = np.nan_to_num(self.results["failed_at"], nan=np.inf)  # NaN: the draw ran to its end
        return np.lexsort((end_times, self.slack))

    @cached_property
    def slack(self) -> np.ndarray:
        """Smallest relative slack of each draw, shape (draws,).

        Without requirements, it is minus the largest |error|, or -inf for a draw that ended early.
        """
        if self.study.requirements:
            return worst_slack(self.study.requirements, self.results)
        errors = [np.abs(self.signal(name)) for name in error_signals(self.study)]
        largest = np.max([np.nanmax(error, axis=1, initial=0.0) for error in errors], axis=0)
        return np.where(np.isfinite(self.results["failed_at"]), -np.inf, -largest)

    def signal(self, name: str) -> np.ndarray:
        """A recorded signal of every draw, shape (draws, samples)."""
        return self.results[SignalKey(name)]

    def fan(self, name: str) -> Fan:
        """Quantiles of a signal over time, over the draws that are still running."""
        if name not in self._fans:
            sorted_signal = np.sort(self.signal(name), axis=0)  # draws that have ended are NaN, which come last
            running_counts = np.count_nonzero(~np.isnan(sorted_signal), axis=0)
            last_rows = np.maximum(running_counts - 1, 0)
            rows = np.floor(np.outer(FAN_LEVELS, last_rows)).astype(int)
            self._fans[name] = Fan(np.take_along_axis(sorted_signal, rows, axis=0), running_counts)
        return self._fans[name]

    @cached_property
    def certificate(self) -> str:
        """A sentence with the verdict of Theorem 1 on the loop, or the reason why it does not apply."""
        mark = certification.mark(self.study)
        if mark.certified is None:
            return f"Theorem 1 does not apply: {mark.reason}"
        return f"Theorem 1 {'certifies' if mark.certified else 'does not certify'} the loop without lag and sampling"

    def toml(self) -> str:
        """The study of this run as TOML."""
        return to_toml(self.study.table)


def usual_draws(study: Study) -> int:
    """Return the number of draws of a page; it is smaller for a vehicle.

    If the study's draws are points of a design, the page keeps the study's number.
    """
    if not study.config.independent:
        return study.config.draws
    return VEHICLE_DRAWS if len(study.loop.channels) > 1 else DRAWS


class LiveStudy:
    """A study with sliders, compiled for all positions of the sliders.

    The object holds three forms of the study, all with the page's number of draws: ``swept`` has its sweep, ``ranged``
    has no sweep, and ``base`` has no sweep and, in place of each range of laws, the single law in its middle.

    Args:
        study: The study.
        names: Numbers that can be moved; None: see :func:`dssc_jax.exploration.sliders.sliders_of`.
        draws: Number of draws; None: see :func:`usual_draws`.

    Raises:
        ConfigError: A number cannot be moved, or the number of draws is not admissible.
    """

    def __init__(self, study: Study, names: Sequence[str] | None = None, draws: int | None = None) -> None:
        """Make the forms of the study and its sliders; nothing is compiled before the first run."""
        self._is_large = len(study.loop.channels) > 1
        self.swept = study.override({"draws": usual_draws(study) if draws is None else draws})
        self.ranged = self.swept.without_sweep()
        self.base = self.ranged.with_laws({name: law.middle for name, law in self.ranged.ranged_laws.items()})
        self.sliders: list[Slider] = admissible_sliders(self.base, sliders_of(self.swept, names))
        self._programs: OrderedDict[float, RecordedDraws] = OrderedDict()
        self._compiling = Lock()  # held while a program is compiled

    @property
    def start(self) -> dict[Slider, float]:
        """The position of each slider that describes the study itself.

        A swept number starts at its value outside of the sweep, or at the median of its law.
        """
        return {slider: slider.start for slider in self.sliders}

    def study_at(self, positions: Positions) -> Study:
        """Return the study at positions of the sliders.

        Raises:
            ConfigError: The study is not valid at these positions; the message names the number and gives the rule.
        """
        return self.base.override(study_changes(self.swept, positions))

    def ranged_study_at(self, positions: Positions) -> Study:
        """Return the study at positions of the sliders, in which arguments of laws are still ranges.

        Raises:
            ConfigError: The study is not valid at these positions.
        """
        return self.study_at(positions).with_laws(self.ranged.ranged_laws)

    def run(self, positions: Positions, stale: Stale = never_stale, progress: Notice = ignore_notice) -> LiveRun | None:
        """Simulate all draws at positions of the sliders.

        Args:
            positions: Position of each slider.
            stale: Returns whether a newer request has come; called after each batch of draws.
            progress: Called with a description of the work, once the work takes longer than :data:`QUIET_SECONDS`.

        Returns:
            The run; None if a newer request has made it stale.

        Raises:
            ConfigError: The study is not valid at these positions.
        """
        study = self.study_at(positions)
        program = self._program(study, progress)
        count = study.config.draws
        batches = []
        finished_draws = 0
        start = time.monotonic()
        for batch in program.batches(study, np.arange(count)):
            batches.append(batch)
            finished_draws += len(batch["outcome"])
            if stale():
                return None
            if time.monotonic() - start > QUIET_SECONDS:
                progress(f"{finished_draws:,} of {count:,} draws")
        return LiveRun(study, join_batches(batches), values_of_draws(study, slice(0, count)), program.times)

    @cached_property
    def first_run(self) -> LiveRun:
        """The run at the start of all sliders."""
        run = self.run(self.start)
        assert run is not None  # nothing makes it stale
        return run

    def compile(self) -> None:
        """Compile the program that all pages share, by the first run."""
        _ = self.first_run

    def _program(self, study: Study, progress: Notice) -> RecordedDraws:
        """Return the program for a study's sample time, and compile it if no kept program has this sample time.

        The sample time is fixed in a program, and all other positions are inputs of it.

        Args:
            study: The study at positions of the sliders.
            progress: Called before the program is compiled.
        """
        sample_time = study.loop.sample_time
        with self._compiling:  # several tabs of the browser share the programs
            if sample_time not in self._programs:
                progress("compiling")
                compiled_study = self.base.override({CLOCK_SLIDER: sample_time})
                extents = live_extents(self.sliders)
                batch = VEHICLE_BATCH if self._is_large else BATCH
                program = RecordedDraws(compiled_study, extents, recorded_signals(study), lanes=batch)
                program.compile()
                self._programs[sample_time] = program
                if len(self._programs) > PROGRAMS:
                    self._programs.popitem(last=False)
            self._programs.move_to_end(sample_time)
            return self._programs[sample_time]


def error_signals(study: Study) -> list[str]:
    """Return the name of each channel's error signal."""
    return [f"{channel}_e" if channel else "e" for channel in study.loop.channels]


def has_vehicle(study: Study) -> bool:
    """Whether the plant of a study is a vehicle with position and attitude."""
    return set(POSITION) <= set(study.loop.channels) and set(ATTITUDE) <= set(study.loop.quantities)


def recorded_signals(study: Study) -> list[str]:
    """Return names of the signals that a page records: output, reference, error and command of each channel.

    For a vehicle, the attitude is recorded, too.
    """
    signals = []
    for channel in study.loop.channels:
        for name in ("y", "y_ref", "e", "u_total"):
            signals.append(f"{channel}_{name}" if channel else name)
    if has_vehicle(study):
        signals.extend(ATTITUDE)
    return signals
