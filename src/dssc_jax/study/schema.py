"""The study file's fixed tables: what pydantic validates before any model is looked up."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from dssc_jax.core.errors import nearest
from dssc_jax.core.integrators import Integrator
from dssc_jax.study.laws import is_number

STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)


def finite_number(value: Any) -> float:
    """A finite number."""
    if not is_number(value):
        raise ValueError(f"must be a finite number, got {value!r}")
    return float(value)


Finite = Annotated[float, BeforeValidator(finite_number)]


class SettledTable(BaseModel):
    """``[loop.settled]``: when a draw is over before its time."""

    model_config = STRICT
    error: Finite = Field(gt=0.0)
    hold: Finite = Field(gt=0.0)
    after: Finite = Field(default=0.0, ge=0.0)


class LoopTable(BaseModel):
    """``[loop]``: the clock."""

    model_config = STRICT
    duration: Finite = Field(gt=0.0)
    sample_time: Finite = Field(gt=0.0)
    substeps: int = Field(default=1, ge=1, le=1000)
    integrator: Literal["rk4", "euler"] = Integrator.RK4.value
    precision: Literal[32, 64] = 64
    settled: SettledTable | None = None

    @model_validator(mode="after")
    def _clock(self) -> "LoopTable":
        if self.sample_time > self.duration:
            raise ValueError(f"sample_time must be <= duration = {self.duration:g} s, got {self.sample_time:g}")
        ratio = self.duration / self.sample_time
        if not ratio < 2**31:
            raise ValueError(f"duration/sample_time must be below 2^31 samples, got {ratio:g}")
        if abs(ratio - self.steps) > 1e-6 * ratio:
            ratio = f"{self.duration:g}/{self.sample_time:g}"
            raise ValueError(f"duration must be a whole number of sample times, got {ratio}")
        if self.settled and self.settled.hold < self.sample_time:
            raise ValueError(f"settled.hold must be >= sample_time = {self.sample_time:g} s, got {self.settled.hold:g}")
        return self

    @property
    def steps(self) -> int:
        """Number of samples."""
        return round(self.duration / self.sample_time)


class MetricsTable(BaseModel):
    """``[metrics]``: the window of the metrics that every run reports."""

    model_config = STRICT
    after: Finite = Field(default=0.0, ge=0.0)
    settling_band: Finite = Field(default=0.05, gt=0.0)
    names: list[str] | None = None


class RequirementTable(BaseModel):
    """``[[requirement]]``: a bound of a metric. Field names are the file's."""

    model_config = STRICT
    metric: str
    after: Finite | None = Field(default=None, ge=0.0)
    settling_band: Finite | None = Field(default=None, gt=0.0)
    max: Finite | None = None
    min: Finite | None = None

    @model_validator(mode="after")
    def _one_bound(self) -> "RequirementTable":
        if (self.max is None) == (self.min is None):
            raise ValueError("needs exactly one of max and min")
        return self


class PlotTable(BaseModel):
    """``[plot]``: what the sweep's figure shows."""

    model_config = STRICT
    metric: str | None = None
    slope: bool = False


MOST_VALUES, MOST_LANES = 10**6, 10**9
AXES = ("linspace", "logspace", "values")


def parse_axis(value: Any) -> tuple[float, ...]:
    """Values of a sweep axis: a list, ``{ values = [...] }``, ``{ linspace = [lo, hi, n] }`` or ``logspace``.

    Raises:
        ValueError: the rule that is broken, and the value found.
    """
    if isinstance(value, list | tuple):
        value = {"values": list(value)}
    if not isinstance(value, dict) or len(value) != 1:
        raise ValueError(f"must be a list or one of {{ linspace | logspace = [lo, hi, count] }}, got {value!r}")
    ((kind, arguments),) = value.items()
    if kind not in AXES:
        raise ValueError(f"'{kind}' is not a spacing; {nearest(kind, AXES)}")
    if not isinstance(arguments, list) or not arguments or not all(is_number(item) for item in arguments):
        raise ValueError(f"{kind} takes a list of finite numbers, got {arguments!r}")
    if kind == "values":
        return tuple(float(item) for item in arguments)
    if len(arguments) != 3 or not isinstance(arguments[2], int) or arguments[2] < 1:
        raise ValueError(f"{kind} takes [lo, hi, count] with a whole count >= 1, got {arguments}")
    low, high, count = arguments
    if count > MOST_VALUES:
        raise ValueError(f"{kind} takes at most {MOST_VALUES} values, got {count}")
    if count > 1 and not low < high:
        raise ValueError(f"{kind} needs lo < hi, got {arguments}")
    if kind == "logspace":
        if low <= 0:
            raise ValueError(f"logspace needs 0 < lo, got {arguments}")
        return tuple(float(item) for item in np.geomspace(low, high, count))
    return tuple(float(item) for item in np.linspace(low, high, count))


def parse_range(value: Any) -> tuple[float, float]:
    """The interval ``[low, high]`` of a positive number.

    Raises:
        ValueError: the rule that is broken, and the value found.
    """
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(is_number(end) for end in value):
        raise ValueError(f"must be [low, high], got {value!r}")
    if not 0.0 < value[0] < value[1]:
        raise ValueError(f"holds no number: [low, high] needs 0 < low < high, got {value!r}")
    return float(value[0]), float(value[1])


def parse_free(value: Any) -> tuple[float, float] | float:
    """A free parameter's interval, or the positive number at which it stays."""
    if isinstance(value, list | tuple):
        return parse_range(value)
    if not is_number(value) or not value > 0:
        raise ValueError(f"must be a number > 0, or [low, high] to vary it, got {value!r}")
    return float(value)


def parse_limit(value: Any) -> float | str:
    """A bound > 0, or the word ``start``."""
    if value != "start" and (not is_number(value) or not value > 0):
        raise ValueError(f"must be a number > 0, or 'start' for what the start has, got {value!r}")
    return value if value == "start" else float(value)


class TuneTable(BaseModel):
    """``[tune]``: which numbers are chosen, for what, within which limits, and how they are sought.

    ``slack`` is the relative slack that Theorem 1's inequalities must keep; ``smoothing`` [m/s] the first width of the
    smoothed sign in the derivatives' program; ``derivatives`` says how they are computed.
    """

    model_config = STRICT
    parameters: dict[str, Annotated[tuple[float, float], BeforeValidator(parse_range)]] = {}
    certified: bool = False
    free: dict[str, Annotated[tuple[float, float] | float, BeforeValidator(parse_free)]] = {}
    objective: dict[str, Finite]
    aggregate: Literal["mean", "cvar", "worst"] = "cvar"
    level: Finite = Field(default=0.95, gt=0.0, lt=1.0)
    limits: dict[str, Annotated[float | str, BeforeValidator(parse_limit)]] = {}
    slack: Finite | None = Field(default=None, ge=0.0, le=10.0)
    optimiser: str = "adam"
    derivatives: Literal["forward", "reverse"] = "forward"
    smoothing: Finite | None = Field(default=None, gt=0.0)
    learning_rate: Finite = Field(default=0.1, gt=0.0)
    schedule: Literal["cosine", "constant"] = "cosine"
    steps: int = Field(default=100, ge=1, le=100_000)
    draws: int = Field(default=128, ge=2, le=10**6)
    batch: int | None = Field(default=None, ge=2)
    validation: int = Field(default=128, ge=2, le=10**6)
    patience: int = Field(default=8, ge=1)
    seed: int | None = Field(default=None, ge=0, lt=2**32)


class StudyTable(BaseModel):
    """The whole file. Tables of models stay as they are here; the registries know their fields."""

    model_config = STRICT
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")
    description: str = ""
    seed: int = Field(default=0, ge=0, lt=2**32)
    draws: int = Field(default=1, ge=1, le=10**8)
    sampling: Literal["random", "sobol", "lhs"] = "random"
    replicates: int = Field(default=8, ge=8, le=1024)
    correlation: dict[str, Finite] = {}
    loop: LoopTable
    plant: dict[str, Any]
    controller: dict[str, Any]
    reference: dict[str, Any] = {"kind": "zero"}
    sensor: dict[str, Any] = {"kind": "ideal"}
    differentiator: dict[str, Any] = {"kind": "none"}
    unmodelled: dict[str, Any] = {"kind": "none"}
    disturbance: dict[str, Any] = {"kind": "none"}
    wind: dict[str, Any] = {"kind": "none"}
    compare: dict[str, dict[str, Any]] = {}
    metrics: MetricsTable = MetricsTable()
    requirement: list[RequirementTable] = []
    tune: TuneTable | None = None
    sweep: dict[str, Annotated[tuple[float, ...], BeforeValidator(parse_axis)]] = {}
    plot: PlotTable = PlotTable()

    @model_validator(mode="after")
    def _size(self) -> "StudyTable":
        lanes = self.draws * math.prod(len(values) for values in self.sweep.values())
        if lanes > MOST_LANES:
            raise ValueError(f"draws times sweep points must be <= {MOST_LANES:.0e}, got {lanes:.3g}")
        return self

    @model_validator(mode="after")
    def _design(self) -> "StudyTable":
        if self.sampling == "random":
            if "replicates" in self.model_fields_set:
                raise ValueError("replicates belong to sampling = 'sobol' or 'lhs'; random draws have none")
            return self
        share, rest = divmod(self.draws, self.replicates)
        if self.sampling == "lhs" and (rest or share < 2):
            nearest = self.replicates * max(2, round(self.draws / self.replicates))
            raise ValueError(
                f"with sampling = 'lhs' draws must be a multiple of replicates = {self.replicates}, at least two a "
                f"replicate, got {self.draws}; the nearest is {nearest}"
            )
        if self.sampling == "sobol" and (rest or share < 2 or share & (share - 1)):
            nearest = self.replicates * 2 ** max(1, round(math.log2(self.draws / self.replicates)))
            raise ValueError(
                f"with sampling = 'sobol' draws must be replicates times a power of two, {self.replicates} * 2^m with "
                f"m >= 1, got {self.draws}; the nearest is {nearest}"
            )
        return self
