"""A study whose code is not loaded: a description in the results folder takes the place of its models.

Reading a result requires names, units and meanings, but no models. If a study refers to code, its results folder stores
this description, so that reading the folder does not run the code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from dssc_jax.closed_loop.loop import Loop
from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.closed_loop.metrics.signal_metrics import SampledSignal
from dssc_jax.closed_loop.metrics.streaming import Measure, Metric, Scope
from dssc_jax.core.contracts import NoParams, Plant
from dssc_jax.core.errors import ConfigError, errors_in_file
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.units import ChannelUnits
from dssc_jax.study.available_metrics import PACKAGE_METRICS, AvailableMetrics, available_metrics, metric_kinds
from dssc_jax.study.build import info_fields, signals_of, validate_fixed, with_constants
from dssc_jax.study.code import code_names, describe_code
from dssc_jax.study.components import as_table
from dssc_jax.study.laws import Law, parse_law
from dssc_jax.study.measuring import parse_measures
from dssc_jax.study.native import native_files
from dssc_jax.study.numbers import Number
from dssc_jax.study.parameters import ParameterTable
from dssc_jax.study.parts import time_fields
from dssc_jax.study.schema import StudyTable
from dssc_jax.study.study import Study
from dssc_jax.study.tables import PARAMETERS

REMEDY = "`trust_code` (in Python: dj.load(folder, trust_code=True))"
NATIVE_REMEDY = "`allow_native` (in Python: dj.allow_native(FILE))"
NO_EXTRA_FIELDS = ConfigDict(extra="forbid")


class DescribedNumber(BaseModel):
    """A number of the loop, for JSON: unit, meaning and value.

    The value is a plain number, the table of a law, or the text of an expression.
    """

    model_config = NO_EXTRA_FIELDS
    value: float | dict[str, list[float | list[float]]] | str
    unit: str
    meaning: str


class DescribedSignal(BaseModel):
    """A signal of the loop, for JSON: unit and meaning."""

    model_config = NO_EXTRA_FIELDS
    unit: str
    meaning: str


class DescribedMetric(BaseModel):
    """A metric from the study's code, for JSON: unit, meaning, scope, and the fields of an info that it needs."""

    model_config = NO_EXTRA_FIELDS
    unit: str
    meaning: str
    needs: tuple[str, ...]
    scope: Scope


class Description(BaseModel):
    """Names, units and meanings that a reader of results needs, in place of the models that define them.

    Args:
        channels: Names of the channels; empty for a plant with one channel.
        angles: Names of the channels whose output is an angle.
        units: Fields of :class:`ChannelUnits` for each channel: units of output and command, then their meanings.
        numbers: Numbers of the loop by name.
        fields: Names of the fields in the controller's info, by channel.
        seen: Names of the fields in the plant's info.
        signals: Signals that requirements can name.
        metrics: Metrics of the study's code by name.
        certified: Whether Theorem 1 holds at each point of the sweep, nested lists; None if the theorem does not apply.
        silence: Why Theorem 1 does not apply, in words; empty if it applies, or without the functions of Table 1.
    """

    model_config = NO_EXTRA_FIELDS
    channels: tuple[str, ...]
    angles: tuple[str, ...]
    units: tuple[tuple[str, str, str, str], ...]
    numbers: dict[str, DescribedNumber]
    fields: dict[str, tuple[str, ...]]
    seen: tuple[str, ...]
    signals: dict[str, DescribedSignal]
    metrics: dict[str, DescribedMetric]
    certified: Any
    silence: str


@dataclass(frozen=True)
class UnloadedModel:
    """Placeholder for a model whose code was not loaded; every use of it raises an error.

    Args:
        error: Error to raise, which names the code.
    """

    error: ConfigError

    def __getattr__(self, name: str) -> Any:
        """Raise the error for any attribute.

        Names that begin with two underscores raise AttributeError instead, so that copying and pickling work.
        """
        if name.startswith("__"):
            raise AttributeError(name)
        raise self.error

    def __iter__(self) -> Any:
        """Raise the error when the placeholder is iterated, as a tuple of the channels' models would be."""
        raise self.error

    def __call__(self, *_: object) -> Any:
        """Raise the error when the placeholder is called, as a model's function would be."""
        raise self.error


@dataclass(frozen=True, repr=False)
class Described(Study):
    """A study whose models are replaced by a description; it can be read, but neither simulated nor changed.

    Args:
        code: File and digest of the study's code at the time of the run.
        description: Names, units and meanings from the models.
        refusal: Error that is raised when a simulation or a change is requested.
    """

    code: JsonObject
    description: Description
    refusal: ConfigError

    @classmethod
    def of(cls, table: Mapping[str, object], source: str, code: JsonObject, content: object) -> "Described":
        """Build a study from its table and its description.

        Args:
            table: Table of the study.
            source: Location of the folder, for messages.
            code: File and digest of the study's code at the time of the run.
            content: Result of :func:`describe_study`.

        Raises:
            ConfigError: The table and the description do not belong together, or are damaged.
        """
        try:
            description = Description.model_validate(content)
            parameters = ParameterTable.from_toml(as_table(table.get(PARAMETERS, {}), PARAMETERS))
            numbers = described_numbers(description, parameters)
            verdicts = np.asarray(description.certified or False, dtype=bool)  # False: Theorem 1 does not apply
        except ValueError as error:  # pydantic's ValidationError is one
            complaint = " ".join(str(error).split())
            raise ConfigError(source, f"is damaged: its description of the study's code: {complaint}") from None
        mismatch = ConfigError(source, "is damaged: its description is not that of its study")
        rule = f"runs code that was not loaded: {describe_code(table, code)}; {remedy_for(table)} loads it"
        refusal = ConfigError(source, rule)
        unloaded: Any = UnloadedModel(refusal)
        channels = description.channels or ("",)
        units = tuple(ChannelUnits(*texts) for texts in description.units)
        if len(units) != len(channels):
            raise mismatch
        with errors_in_file(source):
            config = validate_fixed(with_constants(dict(table), parameters))
            measures, requirements = described_measures(description, config, units, parameters, unloaded)
        sweep_shape = tuple(len(values) for values in config.sweep.values())
        has_swept_numbers = numbers.keys() >= config.sweep.keys()
        has_channels = tuple(description.fields) == channels
        if not has_swept_numbers or not has_channels or verdicts.shape not in ((), sweep_shape):
            raise mismatch
        return cls(
            table=dict(table),
            source=source,
            config=config,
            loop=described_loop(description, channels, config, unloaded),
            template=unloaded,
            units=units,
            numbers=numbers,
            measures=measures,
            requirements=requirements,
            code=code,
            description=description,
            refusal=refusal,
        )

    def override(self, changes: Mapping[str, object]) -> Study:
        """Refuse all changes, because they need the models.

        Raises:
            ConfigError: Always.
        """
        raise self.refusal


def described_loop(description: Description, channels: tuple[str, ...], config: StudyTable, unloaded: Any) -> Loop:
    """A loop with the channels and the clock of a study, and a placeholder for each of its models.

    Args:
        description: Description of the models.
        channels: Names of the channels; one empty name for a plant with one channel.
        config: Fixed tables of the study, with the clock.
        unloaded: Placeholder of type :class:`UnloadedModel`.
    """
    plant = Plant(
        params=NoParams,
        init=unloaded,
        derivative=unloaded,
        measure=unloaded,
        input_gain=unloaded,
        channels=description.channels,
        angles=description.angles,
    )
    return Loop(
        plant=plant,
        reference=unloaded,
        wind=unloaded,
        controller=unloaded,
        sensor=unloaded,
        differentiator=unloaded,
        unmodelled=unloaded,
        disturbance=unloaded,
        channels=channels,
        **time_fields(config),
    )


def described_measures(
    description: Description,
    config: StudyTable,
    units: tuple[ChannelUnits, ...],
    parameters: ParameterTable,
    unloaded: Any,
) -> tuple[tuple[Measure, ...], tuple[Requirement, ...]]:
    """Measures and requirements of a study, with a placeholder for every function of a model that is not loaded.

    Args:
        description: Description of the models.
        config: Fixed tables of the study.
        units: Units and meanings of each channel.
        parameters: Parameters of the study.
        unloaded: Placeholder of type :class:`UnloadedModel`.

    Raises:
        ConfigError: The study names a metric or a signal that the description does not have.
    """
    kinds = dict(PACKAGE_METRICS)
    for name, metric in description.metrics.items():
        kinds[name] = Metric(
            metric.unit, metric.meaning, update=unloaded, value=unloaded, needs=metric.needs, scope=metric.scope
        )
    signals = {}
    for name, signal in description.signals.items():
        signals[name] = SampledSignal(signal.unit, signal.meaning, unloaded)
    loop_metrics = AvailableMetrics(
        names=available_metrics(description.fields, description.seen, kinds),
        kinds=kinds,
        channels=description.channels or ("",),
        units=units,
        default_window=config.metrics.window,
    )
    return parse_measures(config, loop_metrics, signals, parameters.constant)


def remedy_for(table: Mapping[str, object]) -> str:
    """Options that load the code to which a study refers, in words."""
    remedies = []
    if code_names(table):
        remedies.append(REMEDY)
    if native_files(table):
        remedies.append(NATIVE_REMEDY)
    return " and ".join(remedies)


def described_numbers(description: Description, parameters: ParameterTable) -> dict[str, Number]:
    """Record of each number of the loop by name.

    The records have no paths in the loop's parameters, since these need the models.
    """
    numbers = {}
    for name, entry in description.numbers.items():
        quantity = Quantity(entry.unit, entry.meaning)
        match entry.value:
            case dict(law):
                numbers[name] = Number.of(name, quantity, parse_law(law))
            case str(text):
                numbers[name] = Number.of(name, quantity, parameters.expression(text))
            case value:
                numbers[name] = Number.of(name, quantity, value)
    return numbers


def describe_study(study: Study, certified: np.ndarray | None, silence: str) -> JsonObject:
    """Describe the models of a study for readers without its code, as JSON of :class:`Description`.

    Args:
        study: The study, with its models.
        certified: Whether Theorem 1 holds at each point of the sweep; None if the theorem does not apply.
        silence: Why Theorem 1 does not apply; empty if it applies, or without the functions of Table 1.
    """
    numbers = {}
    for name, number in study.numbers.items():
        value = number.value
        if number.expression:
            value = number.expression.text
        elif isinstance(value, Law):
            value = value.table
        numbers[name] = {"value": value, "unit": number.quantity.unit, "meaning": number.quantity.meaning}
    signals = {}
    for name, signal in signals_of(study.loop, study.template, study.units).items():
        signals[name] = {"unit": signal.unit, "meaning": signal.meaning}
    metrics = {}
    for name, metric in metric_kinds(study.config).items():
        if name not in PACKAGE_METRICS:
            metrics[name] = {
                "unit": metric.unit,
                "meaning": metric.meaning,
                "needs": list(metric.needs),
                "scope": metric.scope.value,
            }
    fields, vehicle_fields = info_fields(study.loop, study.template)
    return {
        "channels": list(study.loop.plant.channels),
        "angles": list(study.loop.plant.angles),
        "units": [list(units) for units in study.units],
        "numbers": numbers,
        "fields": {name: list(names) for name, names in fields.items()},
        "seen": list(vehicle_fields),
        "signals": signals,
        "metrics": metrics,
        "certified": None if certified is None else certified.tolist(),
        "silence": silence,
    }


def stored_study(manifest: JsonObject, source: str, trust_code: bool) -> Study:
    """The study of a results folder.

    A folder may come from anyone, so the study's own modules are imported only on request, and native code only if it
    has been allowed before.

    Args:
        manifest: Manifest of the folder, with ``study`` and, if the study refers to code, ``code`` and ``described``.
        source: Location of the folder, for messages.
        trust_code: Whether to import the code to which the study refers.

    Returns:
        The study; a :class:`Described` one if any of its code is not loaded.

    Raises:
        ConfigError: The study is not valid, or it refers to code and the manifest has no description.
    """
    table = manifest["study"]
    unloaded_files = [native for native in native_files(table) if not native.loaded]
    if not unloaded_files and (trust_code or not code_names(table)):
        return Study.from_table(table, source)
    code = manifest.get("code")
    content = manifest.get("described")
    if not isinstance(code, dict) or content is None:
        rule = f"names code, {describe_code(table)}, and does not describe it; {remedy_for(table)} loads it"
        raise ConfigError(source, rule)
    return Described.of(table, source, code, content)
