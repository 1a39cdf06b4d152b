"""The fixed tables of the study file, validated by pydantic before any model is looked up."""

import math
from typing import Annotated, Any, Literal, NamedTuple, Optional

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints, create_model, model_validator

from dssc_jax.closed_loop.metrics.step_response import crossing
from dssc_jax.closed_loop.metrics.window import Window, window_defaults, window_entries
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.parsed_values import (
    parse_axis,
    parse_finite,
    parse_finite_or_text,
    parse_free_parameter,
    parse_points,
    parse_range,
    parse_tuning_limit,
    parse_unit_text,
)

STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)


LONGEST_PHRASE = 60
"""Largest number of characters in a meaning."""
MOST_LANES = 10**9
"""Largest number of draws at all points of a sweep together."""
Phrase = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f]+$", max_length=LONGEST_PHRASE)]
Finite = Annotated[float, BeforeValidator(parse_finite)]
OptionalFinite: Any = Optional[Finite]  # noqa: UP045  (a type at run time)
Bound = Annotated[float | str, BeforeValidator(parse_finite_or_text)]
Unit = Annotated[str, BeforeValidator(parse_unit_text)]


class SettledTable(BaseModel):
    """``[loop.settled]``: the rule that ends a settled draw before its full duration."""

    model_config = STRICT
    error: Finite = Field(gt=0.0, description="largest |e| of a settled loop, in the output's unit")
    hold: Finite = Field(gt=0.0, description="time for which |e| stays below it [s], rounded up to whole samples")
    after: Finite = Field(default=0.0, ge=0.0, description="`hold` counts from this time on [s]")


class LoopTable(BaseModel):
    """``[loop]``: duration, sampling, integration and precision."""

    model_config = STRICT
    duration: Finite = Field(gt=0.0, description="simulated time [s]")
    sample_time: Finite = Field(gt=0.0, description="period of the controller, T_s [s]")
    substeps: int = Field(default=1, ge=1, le=1000, description="integrator's steps in each sample")
    integrator: Literal["rk4", "euler"] = Field(
        default=Integrator.RK4.value, description="method of the plant's integration"
    )
    precision: Literal[32, 64] = Field(default=64, description="bits of the simulation's numbers")
    settled: SettledTable | None = Field(default=None, description="rule that ends a draw which has settled")

    @model_validator(mode="after")
    def _check_clock(self) -> "LoopTable":
        """Require that the duration is a whole number of sample times, at least one and fewer than 2^31."""
        if self.sample_time > self.duration:
            raise ValueError(f"sample_time must be <= duration = {self.duration:g} s, got {self.sample_time:g}")
        ratio = self.duration / self.sample_time
        if not ratio < 2**31:
            raise ValueError(f"duration/sample_time must be below 2^31 samples, got {ratio:g}")
        if abs(ratio - self.steps) > 1e-6 * ratio:
            quotient = f"{self.duration:g}/{self.sample_time:g}"
            raise ValueError(f"duration must be a whole number of sample times, got {quotient}")
        if self.settled and self.settled.hold < self.sample_time:
            raise ValueError(f"settled.hold must be >= sample_time = {self.sample_time:g} s, got {self.settled.hold:g}")
        return self

    @property
    def steps(self) -> int:
        """Number of samples of a flight."""
        return round(self.duration / self.sample_time)


def window_fields(inherited: bool) -> dict[str, Any]:
    """Pydantic's type and field for each entry of a window, by the entry's key in a table.

    Args:
        inherited: Whether an absent entry has the value in ``[metrics]``, rather than a default of its own.
    """
    defaults = window_defaults()
    fields = {}
    for entry in window_entries().values():
        bounds: dict[str, Any] = dict(entry.bounds)
        if not inherited and not entry.absent:  # an entry with a number as its default
            default = defaults[entry.key]
            fields[entry.key] = (Finite, Field(default=default, description=entry.meaning, **bounds))
            continue
        value_if_absent = "that of `[metrics]`" if inherited else entry.absent
        meaning = f"{entry.meaning}; absent: {value_if_absent}"
        fields[entry.key] = (OptionalFinite, Field(default=None, description=meaning, **bounds))
    return fields


class BoundedMetric(BaseModel):
    """The subject of a requirement: a metric, a margin or a formula."""

    model_config = STRICT
    metric: str | None = Field(default=None, description="the bounded metric")
    signal: str | None = Field(
        default=None,
        description="the signal of `rms` and its like, as a trajectory names it; absent: the metric has its own",
    )
    margin: str | None = Field(default=None, description="the bounded margin of the linearised loop, such as `phase`")
    at: str | None = Field(
        default=None, description="where the loop is broken for a margin; absent: at the command of the only channel"
    )
    formula: str | None = Field(default=None, description="a formula of signal temporal logic that must be true")
    name: str | None = Field(
        default=None,
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,59}$",
        description="name of a formula in results; absent: `formula_1` for the first requirement, and so on",
    )
    smoothing: Finite | None = Field(
        default=None,
        ge=0.0,
        description="width of the smooth minimum in a formula's derivatives, in its unit; 0: the minimum itself",
    )


UsualWindow: Any = create_model("UsualWindow", __config__=STRICT, **window_fields(inherited=False))
RequiredWindow: Any = create_model("RequiredWindow", __base__=BoundedMetric, **window_fields(inherited=True))


class MetricsTable(UsualWindow):
    """``[metrics]``: the window of the metrics that every run reports."""

    names: list[str] | None = Field(default=None, description="metrics to report; absent: the usual ones")

    @property
    def window(self) -> Window:
        """Window of all metrics, unless a requirement states a window of its own."""
        return Window.of(self.model_dump())


class SubjectRule(NamedTuple):
    """The entries of a requirement that belong to one subject: a metric, a margin or a formula.

    Args:
        entries: Names of the entries.
        reason: Why other entries do not belong to the subject, in words; empty: they belong to another subject.
    """

    entries: set[str]
    reason: str


SUBJECTS = {
    "metric": SubjectRule({"metric", "signal", "max", "min", *(entry.key for entry in window_entries().values())}, ""),
    "formula": SubjectRule({"formula", "name", "smoothing"}, "a formula holds its own times and bounds"),
    "margin": SubjectRule({"margin", "at", "max", "min"}, "a margin is that of the linearised loop, before the flight"),
}
"""Possible subjects of a requirement by name, with their entries."""


class RequirementTable(RequiredWindow):
    """``[[requirement]]``: a bound of a metric or a margin, or a formula that must be true."""

    max: Bound | None = Field(default=None, description='upper bound; of a margin also with a unit, as `"6 dB"`')
    min: Bound | None = Field(default=None, description="lower bound; of a margin also with a unit")

    @model_validator(mode="after")
    def _check_subject(self) -> "RequirementTable":
        """Require exactly one subject, no entries of other subjects, and the bound that the subject needs."""
        subjects = [name for name in SUBJECTS if getattr(self, name) is not None]
        if len(subjects) != 1:
            raise ValueError("needs a metric, a margin or a formula, and only one of them")
        subject = subjects[0]
        foreign_entries = sorted(self.model_fields_set - SUBJECTS[subject].entries)
        if foreign_entries:
            owner = next(name for name, rule in SUBJECTS.items() if foreign_entries[0] in rule.entries)
            explanation = SUBJECTS[subject].reason or f"only a {owner} has these entries"
            raise ValueError(f"{explanation}; take out {', '.join(foreign_entries)}")
        if subject != "formula" and (self.max is None) == (self.min is None):
            raise ValueError("needs exactly one of max and min")
        for name in ("max", "min"):
            value = getattr(self, name)
            if subject == "metric" and isinstance(value, str):
                raise ValueError(f"{name} must be a finite number, got {value!r}; only a margin takes a unit")
        return self

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """Upper bound, then lower bound of a metric; None for an absent bound."""
        upper = None if self.max is None else float(self.max)
        lower = None if self.min is None else float(self.min)
        return upper, lower

    def window(self, usual: Window) -> Window:
        """Window of the requirement; its absent entries are taken from ``usual``, the window of ``[metrics]``."""
        return Window.of(self.model_dump(), usual)


class EnvelopeTable(BaseModel):
    """``[[envelope]]``: bounds of a signal over time, straight between their points, which every draw must keep."""

    model_config = STRICT
    signal: Literal["y", "e", "sigma", "u", "u_total"] = Field(default="y", description="the bounded signal")
    channel: str | None = Field(default=None, description="its channel; required where there are several")
    upper: Annotated[tuple[tuple[float, float], ...], BeforeValidator(parse_points)] = Field(
        default=(), description="points [time, value] of the upper bound; before and after them there is none"
    )
    lower: Annotated[tuple[tuple[float, float], ...], BeforeValidator(parse_points)] = Field(
        default=(), description="points [time, value] of the lower bound"
    )

    @model_validator(mode="after")
    def _check_bounds(self) -> "EnvelopeTable":
        """Require at least one bound, and a lower bound that never exceeds the upper one."""
        if not self.upper and not self.lower:
            raise ValueError("needs upper or lower, or both")
        crossing_time = crossing(self.lower, self.upper)
        if crossing_time is not None:
            raise ValueError(f"the lower bound must not exceed the upper one, which it does at {crossing_time:g} s")
        return self


class UnitsTable(BaseModel):
    """``[units]``: units and meanings of the plant's output and command; ``[units.z]`` is for channel z alone."""

    model_config = STRICT
    output: Unit | None = Field(default=None, description="unit of the output y; absent: the plant's own")
    command: Unit | None = Field(default=None, description="unit of the command u; absent: the plant's own")
    output_meaning: Phrase | None = Field(default=None, description="what the output is, such as `shaft speed`")
    command_meaning: Phrase | None = Field(default=None, description="what the command is, such as `armature voltage`")


class PlotTable(BaseModel):
    """``[plot]``: content of the figure of a sweep."""

    model_config = STRICT
    metric: str | None = Field(default=None, description="the metric to show; absent: that of the first requirement")
    slope: bool = Field(default=False, description="whether to fit a slope in double-logarithmic axes")


class TuneTable(BaseModel):
    """``[tune]``: the numbers to tune, their objective and limits, and the search."""

    model_config = STRICT
    parameters: dict[str, Annotated[tuple[float, float], BeforeValidator(parse_range)]] = Field(
        default={}, description="interval of each number that is tuned"
    )
    certified: bool = Field(default=False, description="whether Theorem 1 chooses the gains")
    proved: bool = Field(default=False, description="whether the sampled loop is proved at every accepted point")
    aim: Literal["objective", "proved_error", "proved_up_to"] = Field(
        default="objective",
        description="what is optimised: `objective` on the draws, the proved bound of |e|, or the end of the proofs",
    )
    over: dict[str, Annotated[tuple[float, float], BeforeValidator(parse_range)]] = Field(
        default={}, description="the number along which `proved_up_to` proves, from its low end on"
    )
    free: dict[str, Annotated[tuple[float, float] | float, BeforeValidator(parse_free_parameter)]] = Field(
        default={}, description="free parameter of the theorem: its interval, or its fixed value"
    )
    objective: dict[str, Finite] = Field(description="weight of each metric in the objective")
    aggregate: Literal["mean", "cvar", "worst"] = Field(default="cvar", description="how draws are combined")
    level: Finite = Field(default=0.95, gt=0.0, lt=1.0, description="level of `cvar`")
    limits: dict[str, Annotated[float | str, BeforeValidator(parse_tuning_limit)]] = Field(
        default={}, description="bound of other metrics; `start`: their value at the start"
    )
    slack: Finite | None = Field(
        default=None, ge=0.0, le=10.0, description="relative slack that every inequality of Theorem 1 keeps"
    )
    optimiser: str = Field(default="adam", description="search method")
    derivatives: Literal["forward", "reverse"] = Field(
        default="forward", description="mode of automatic differentiation"
    )
    smoothing: Finite | None = Field(
        default=None, gt=0.0, description="first width of the smoothed sign in the derivatives [m/s]"
    )
    learning_rate: Finite = Field(
        default=0.1, gt=0.0, description="step length, in the scaled logarithm of the numbers"
    )
    schedule: Literal["cosine", "constant"] = Field(default="cosine", description="course of the learning rate")
    steps: int = Field(default=100, ge=1, le=100_000, description="iterations at most")
    draws: int = Field(default=128, ge=2, le=10**6, description="training draws")
    batch: int | None = Field(default=None, ge=2, description="training draws of one iteration; absent: all")
    validation: int = Field(default=128, ge=2, le=10**6, description="draws that choose the best iterate")
    patience: int = Field(default=8, ge=1, description="validations without progress before the search ends")
    seed: int | None = Field(
        default=None, ge=0, lt=2**32, description="seed of the training draws; absent: the study's plus one"
    )


class StudyTable(BaseModel):
    """The whole study file. The tables of models are validated later, since their kinds define their fields."""

    model_config = STRICT
    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$", description="name of the study and of its results folder"
    )
    description: str = Field(default="", description="one line for people")
    seed: int = Field(default=0, ge=0, lt=2**32, description="seed of all random numbers")
    draws: int = Field(default=1, ge=1, le=10**8, description="draws at each point of the sweep")
    sampling: Literal["random", "sobol", "lhs", "auto"] = Field(
        default="random", description="design of the draws; `auto`: a run chooses it after a pilot"
    )
    replicates: int = Field(
        default=8, ge=8, le=1024, description="independent randomisations of a Sobol or Latin-hypercube design"
    )
    correlation: dict[str, Finite] = Field(
        default={}, description='rank correlation of two uncertain numbers, as `"a, b" = 0.5`'
    )
    parameters: TomlTable = Field(default={}, description="named numbers and laws, for expressions")
    loop: LoopTable = Field(description="clock and precision")
    plant: TomlTable = Field(description="model of the plant")
    controller: TomlTable = Field(description="controller and its gains")
    units: TomlTable = Field(default={}, description="units and meanings of the output and the command")
    reference: TomlTable = Field(default={"kind": "zero"}, description="desired output")
    sensor: TomlTable = Field(default={"kind": "ideal"}, description="model of the sensors")
    differentiator: TomlTable = Field(default={"kind": "none"}, description="estimator of the output's derivative")
    unmodelled: TomlTable = Field(default={"kind": "none"}, description="dynamics between command and plant")
    actuator: list[TomlTable] = Field(
        default=[], description="chain of actuators between command and plant, in order; instead of `[unmodelled]`"
    )
    disturbance: TomlTable | list[TomlTable] = Field(
        default={"kind": "none"}, description="disturbance at the command; several `[[disturbance]]` have their places"
    )
    wind: TomlTable | list[TomlTable] = Field(
        default={"kind": "none"}, description="wind, for a vehicle; several tables `[[wind]]` add up"
    )
    event: list[TomlTable] = Field(default=[], description="what happens to a vehicle at a time")
    compare: dict[str, TomlTable] = Field(default={}, description="gains of other controllers, for `compare`")
    metrics: MetricsTable = Field(default=MetricsTable(), description="metrics and their window")
    requirement: list[RequirementTable] = Field(default=[], description="bounds that a draw must keep")
    envelope: list[EnvelopeTable] = Field(default=[], description="bounds over time that a draw must keep")
    tune: TuneTable | None = Field(default=None, description="problem of `tune`")
    sweep: dict[str, Annotated[tuple[float, ...], BeforeValidator(parse_axis)]] = Field(
        default={}, description="values of swept numbers"
    )
    plot: PlotTable = Field(default=PlotTable(), description="figure of a sweep")

    @model_validator(mode="after")
    def _check_size(self) -> "StudyTable":
        """Require that the draws of all points of the sweep together are not too many."""
        lanes = self.draws * math.prod(len(values) for values in self.sweep.values())
        if lanes > MOST_LANES:
            raise ValueError(f"draws times sweep points must be <= {MOST_LANES:.0e}, got {lanes:.3g}")
        return self

    @property
    def independent(self) -> bool:
        """Whether the draws are independent; those of ``auto`` are, unless a run chooses another design."""
        return self.sampling in ("random", "auto")

    @model_validator(mode="after")
    def _check_design(self) -> "StudyTable":
        """Require that the draws divide into replicates of equal size, a power of two for Sobol points."""
        if self.independent:
            if "replicates" in self.model_fields_set:
                remedy = "random draws have none" if self.sampling == "random" else "'auto' chooses their number"
                raise ValueError(f"replicates belong to sampling = 'sobol' or 'lhs'; {remedy}")
            return self
        share, remainder = divmod(self.draws, self.replicates)  # draws of one replicate
        is_equal_share = remainder == 0 and share >= 2
        is_power_of_two = share & (share - 1) == 0
        if self.sampling == "lhs" and not is_equal_share:
            closest = self.replicates * max(2, round(self.draws / self.replicates))
            raise ValueError(
                f"with sampling = 'lhs' draws must be a multiple of replicates = {self.replicates}, at least two a "
                f"replicate, got {self.draws}; the nearest is {closest}"
            )
        if self.sampling == "sobol" and not (is_equal_share and is_power_of_two):
            closest = self.replicates * 2 ** max(1, round(math.log2(self.draws / self.replicates)))
            raise ValueError(
                f"with sampling = 'sobol' draws must be replicates times a power of two, {self.replicates} * 2^m with "
                f"m >= 1, got {self.draws}; the nearest is {closest}"
            )
        return self
