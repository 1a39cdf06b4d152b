"""A study that runs again whenever its numbers move: failures with their interval, fans of signals, worst draw."""

import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
from typing import NamedTuple, TypeAlias

import numpy as np

from dssc_jax.closed_loop.requirements import violated, worst_slack
from dssc_jax.core.signals import Outcome
from dssc_jax.design import certification
from dssc_jax.engine.batching import values_of_draws
from dssc_jax.engine.sampling import Arrays
from dssc_jax.exploration.sliders import (
    CLOCK_SLIDER,
    Positions,
    Slider,
    admitted,
    changes_of,
    live_extents,
    sliders_of,
)
from dssc_jax.exploration.worker import Stale
from dssc_jax.results.result import interval_method
from dssc_jax.runs.recorded_draws import RecordedDraws, SignalKey, all_draws
from dssc_jax.statistics import CONFIDENCE, describe_probability
from dssc_jax.study import Study
from dssc_jax.study.tables import to_toml

PLACE = ("x", "y", "z")
ATTITUDE = ("phi", "theta", "psi")
"""Channels and signals of a vehicle that can be shown in three dimensions."""
FAN_LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)  # of the fans
DRAWS = 1000
VEHICLE_DRAWS = 64
BATCH = 256  # draws between two checks for a newer move
VEHICLE_BATCH = 16
QUIET_SECONDS = 0.3  # a shorter run shows no progress
PROGRAMS = 6  # compiled programs to keep, one for each sample time

Notice: TypeAlias = Callable[[str], None]
"""Called with a description of the work in progress."""


class Fan(NamedTuple):
    """Quantiles of a signal over time, of the draws that are still running."""

    values: np.ndarray  # at FAN_LEVELS, NaN where no draw is running, shape (levels, samples)
    running: np.ndarray  # number of draws still running, shape (samples,)


@dataclass(frozen=True)
class LiveRun:
    """All draws of a study at one position of its sliders."""

    study: Study  # as it stands, without a sweep; it reproduces this run
    results: Arrays  # metrics, slacks, outcome and signals of every draw
    values: Arrays  # of the uncertain numbers in every draw
    times: np.ndarray  # of the signals' samples [s]
    _fans: dict[str, Fan] = field(default_factory=dict)

    @property
    def failed(self) -> np.ndarray:
        """Whether each draw failed, shape (draws,)."""
        return self.results["outcome"] != Outcome.OK

    @property
    def probability(self) -> float:
        """The share of draws that failed."""
        return float(self.failed.mean())

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound of the failure probability, by the method that fits the study's draws."""
        low, high = interval_method(self.study).failure_interval(self.failed, CONFIDENCE)
        return float(low), float(high)

    @cached_property
    def statement(self) -> str:
        """Failures, draws, probability and interval in words."""
        return describe_probability(self.failed, interval_method(self.study))

    @cached_property
    def by_requirement(self) -> list[tuple[str, int]]:
        """Each requirement with the number of draws that violate it."""
        counts = []
        for requirement in self.study.requirements:
            violations = violated(self.results[requirement.name])
            counts.append((requirement.text, int(violations.sum())))
        return counts

    @property
    def ended_early(self) -> int:
        """Number of draws that did not stay finite, or left the range of the plant's model."""
        return int(np.isfinite(self.results["failed_at"]).sum())

    @cached_property
    def order(self) -> np.ndarray:
        """Draws from the worst to the best: by their end if it was early, then by their smallest slack."""
        ended = np.nan_to_num(self.results["failed_at"], nan=np.inf)
        return np.lexsort((ended, self.slack))

    @cached_property
    def slack(self) -> np.ndarray:
        """Smallest relative slack of each draw; without requirements, minus the largest recorded |error|."""
        if self.study.requirements:
            return worst_slack(self.study.requirements, self.results)
        errors = [np.abs(self.signal(name)) for name in error_names(self.study)]
        largest = np.max([np.nanmax(error, axis=1, initial=0.0) for error in errors], axis=0)
        return np.where(np.isfinite(self.results["failed_at"]), -np.inf, -largest)

    def signal(self, name: str) -> np.ndarray:
        """A recorded signal of every draw, shape (draws, samples)."""
        return self.results[SignalKey(name)]

    def fan(self, name: str) -> Fan:
        """Quantiles of a signal over time."""
        if name not in self._fans:
            sorted_signal = np.sort(self.signal(name), axis=0)  # NaN are last
            running_counts = np.count_nonzero(~np.isnan(sorted_signal), axis=0)
            rows = np.floor(np.outer(FAN_LEVELS, np.maximum(running_counts - 1, 0))).astype(int)
            self._fans[name] = Fan(np.take_along_axis(sorted_signal, rows, axis=0), running_counts)
        return self._fans[name]

    @cached_property
    def certificate(self) -> str:
        """The verdict of Theorem 1 on the loop, in one line."""
        mark = certification.mark(self.study)
        if mark.certified is None:
            return f"Theorem 1 does not apply: {mark.reason}"
        return f"Theorem 1 {'certifies' if mark.certified else 'does not certify'} the loop without lag and sampling"

    def toml(self) -> str:
        """The study file that reproduces this run."""
        return to_toml(self.study.table)


class LiveStudy:
    """A study with sliders, compiled for all of their positions.

    Args:
        study: The study.
        names: Numbers to move; None: see :func:`dssc_jax.exploration.sliders.sliders_of`.
        draws: Number of draws; None: 1,000, for a vehicle 64, or the study's own if they are points of a design.

    Raises:
        ConfigError: A number cannot be moved, or the number of draws is not admissible.
    """

    def __init__(self, study: Study, names: Sequence[str] | None = None, draws: int | None = None) -> None:
        self.vehicle = len(study.loop.channels) > 1
        default = VEHICLE_DRAWS if self.vehicle else DRAWS
        if not study.config.independent:
            default = study.config.draws
        count = draws or default
        self.swept = study.override({"draws": count})
        self.ranged = self.swept.without_sweep()
        self.base = self.ranged.with_laws({name: law.middle for name, law in self.ranged.ranged_laws.items()})
        self.sliders: list[Slider] = admitted(self.base, sliders_of(self.swept, names))
        self._programs: OrderedDict[float, RecordedDraws] = OrderedDict()
        self._compiling = Lock()

    @property
    def start(self) -> dict[Slider, float]:
        """The positions that describe the study itself; a swept number stands at its own value, or its law's median."""
        return {slider: slider.start for slider in self.sliders}

    def at(self, positions: Positions) -> Study:
        """The study that positions describe.

        Raises:
            ConfigError: The study is not valid there; the message gives the number and its rule.
        """
        return self.base.override(changes_of(self.swept, positions))

    def ranged_at(self, positions: Positions) -> Study:
        """The study that positions describe, with the ranges of its laws' arguments instead of single laws.

        Raises:
            ConfigError: The study is not valid there.
        """
        return self.at(positions).with_laws(self.ranged.ranged_laws)

    def run(
        self, positions: Positions, stale: Stale = lambda: False, progress: Notice = lambda _: None
    ) -> LiveRun | None:
        """Simulate all draws at positions of the sliders; None if a newer request has made the run stale.

        Raises:
            ConfigError: The study is not valid there.
        """
        study = self.at(positions)
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
        return LiveRun(study, all_draws(batches), values_of_draws(study, slice(0, count)), program.times)

    @cached_property
    def first(self) -> LiveRun:
        """The run at the sliders' start."""
        run = self.run(self.start)
        assert run is not None  # nothing makes it stale
        return run

    def compile(self) -> None:
        """Compile the program that all pages share, by the run at the sliders' start."""
        _ = self.first

    def _program(self, study: Study, progress: Notice) -> RecordedDraws:
        """The compiled program for a study's sample time."""
        sample_time = study.loop.sample_time
        with self._compiling:  # tabs share the programs
            if sample_time not in self._programs:
                progress("compiling")
                compiled_study = self.base.override({CLOCK_SLIDER: sample_time})
                extents = live_extents(self.sliders)
                batch = VEHICLE_BATCH if self.vehicle else BATCH
                program = RecordedDraws(compiled_study, extents, recorded_signals(study), lanes=batch)
                program.compile()
                self._programs[sample_time] = program
                if len(self._programs) > PROGRAMS:
                    self._programs.popitem(last=False)
            self._programs.move_to_end(sample_time)
            return self._programs[sample_time]


def error_names(study: Study) -> list[str]:
    """The error signal of every channel."""
    return [f"{channel}_e" if channel else "e" for channel in study.loop.channels]


def flies(study: Study) -> bool:
    """Whether a study's plant is a vehicle with place and attitude."""
    return set(PLACE) <= set(study.loop.channels) and set(ATTITUDE) <= set(study.loop.quantities)


def recorded_signals(study: Study) -> list[str]:
    """Signals to record: output, desired output, error and total command of every channel; a vehicle's attitude."""
    names = ("y", "y_ref", "e", "u_total")
    signals = [f"{channel}_{name}" if channel else name for channel in study.loop.channels for name in names]
    return [*signals, *ATTITUDE] if flies(study) else signals
