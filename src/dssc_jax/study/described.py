"""A study whose code is not loaded; descriptions stored in the results folder replace its models.

Reading a result requires names, units and meanings, but no models. A folder whose study refers to ``module:object``
stores them with the study, so that reading it does not run anyone's code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from dssc_jax.closed_loop.loop import Loop
from dssc_jax.closed_loop.metrics import Metric, Scope
from dssc_jax.closed_loop.signal_metrics import SampledSignal
from dssc_jax.core.contracts import NoParams, Plant
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.units import ANGLE, POSITION, ChannelUnits
from dssc_jax.study.build import info_fields, signals_of, time_fields, validate_fixed, with_constants
from dssc_jax.study.code import code_names, describe_code
from dssc_jax.study.components import as_table
from dssc_jax.study.laws import Law, parse_law
from dssc_jax.study.measuring import PACKAGE_METRICS, available_metrics, kinds_of, parse_measures
from dssc_jax.study.native import native_files
from dssc_jax.study.numbers import Number
from dssc_jax.study.parameters import ParameterTable
from dssc_jax.study.study import Study
from dssc_jax.study.tables import PARAMETERS

REMEDY = "`trust_code` (in Python: dj.load(folder, trust_code=True))"
NATIVE_REMEDY = "`allow_native` (in Python: dj.allow_native(FILE))"
NO_EXTRA_FIELDS = ConfigDict(extra="forbid")


class DescribedNumber(BaseModel):
    """A number of the loop as JSON: its value, law or expression, and its meaning."""

    model_config = NO_EXTRA_FIELDS
    value: float | dict[str, list[float | list[float]]] | str
    unit: str
    meaning: str


class DescribedSignal(BaseModel):
    """A signal of the loop: its unit and meaning."""

    model_config = NO_EXTRA_FIELDS
    unit: str
    meaning: str


class DescribedMetric(BaseModel):
    """A metric from the study's own code: its meaning and scope."""

    model_config = NO_EXTRA_FIELDS
    unit: str
    meaning: str
    needs: tuple[str, ...]
    scope: Scope


class Description(BaseModel):
    """Information about a study that only the models provide and readers need.

    ``units`` are units and meanings of output and command in each channel. ``fields`` are the names in each
    channel's info, ``seen`` those in the plant's info, ``signals`` all that requirements can name. ``certified`` and
    ``silence`` are the results of Theorem 1 at every point of the sweep.
    """

    model_config = NO_EXTRA_FIELDS
    channels: tuple[str, ...]
    angles: tuple[str, ...]
    units: tuple[tuple[str, str, str, str], ...] | None = None
    numbers: dict[str, DescribedNumber]
    fields: dict[str, tuple[str, ...]]
    seen: tuple[str, ...]
    signals: dict[str, DescribedSignal]
    metrics: dict[str, DescribedMetric]
    certified: Any
    silence: str


@dataclass(frozen=True)
class Unloaded:
    """Placeholder for a model; using it raises an error that names the code that was not loaded.

    Args:
        error: The error to raise.
    """

    error: ConfigError

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise self.error

    def __iter__(self) -> Any:
        raise self.error

    def __call__(self, *_: object) -> Any:
        """Raise the error, since nothing can be computed."""
        raise self.error


@dataclass(frozen=True, repr=False)
class Described(Study):
    """A study from its description, which can be read like any other but not simulated or changed.

    Args:
        code: File and digest, at the time of the run, of each module that the study refers to.
        description: The rest.
        refusal: The message when a simulation is requested.
    """

    code: JsonObject
    description: Description
    refusal: ConfigError

    @classmethod
    def of(cls, table: Mapping[str, object], source: str, code: JsonObject, content: object) -> "Described":
        """Build a study from its table and the result of :func:`describe_study`.

        Raises:
            ConfigError: they do not fit, or are damaged.
        """
        try:
            description = Description.model_validate(content)
            parameters = ParameterTable.of(as_table(table.get(PARAMETERS, {}), PARAMETERS))
            numbers = numbers_of(description, parameters)
            verdicts = np.asarray(description.certified or False, dtype=bool)
        except ValueError as error:  # pydantic's is one
            complaint = " ".join(str(error).split())
            raise ConfigError(source, f"is damaged: its description of the study's code: {complaint}") from None
        rule = f"runs code that was not loaded: {describe_code(table, code)}; {remedy_for(table)} loads it"
        unloaded: Any = Unloaded(refusal := ConfigError(source, rule))
        channels = description.channels
        angles = description.angles
        plant = Plant(
            params=NoParams,
            init=unloaded,
            derivative=unloaded,
            measure=unloaded,
            input_gain=unloaded,
            channels=channels,
            angles=angles,
        )
        default_units = tuple(ANGLE if name in angles else POSITION for name in channels or ("",))
        units = default_units
        if description.units is not None:
            units = tuple(ChannelUnits(*texts) for texts in description.units)
        if len(units) != len(default_units):
            raise ConfigError(source, "is damaged: its description is not that of its study")
        metrics_of_user = {
            name: Metric(a.unit, a.meaning, update=unloaded, value=unloaded, needs=a.needs, scope=a.scope)
            for name, a in description.metrics.items()
        }
        metrics = PACKAGE_METRICS | metrics_of_user
        try:
            config = validate_fixed(with_constants(dict(table), parameters))
            names = available_metrics(description.fields, description.seen, metrics)
            signals = {
                name: SampledSignal(signal.unit, signal.meaning, unloaded)
                for name, signal in description.signals.items()
            }
            measures, requirements = parse_measures(
                config, names, metrics, channels or ("",), units, signals, parameters.constant
            )
        except ConfigError as error:
            raise error.within(source) from None
        shape = tuple(len(values) for values in config.sweep.values())
        loop = Loop(plant, *[unloaded] * 7, channels=channels or ("",), **time_fields(config))
        is_consistent = numbers.keys() >= config.sweep.keys() and tuple(description.fields) == loop.channels
        if not is_consistent or (verdicts.shape or shape) != shape:
            raise ConfigError(source, "is damaged: its description is not that of its study")
        return cls(
            table=dict(table),
            source=source,
            config=config,
            loop=loop,
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
        """Always refuse, because other values need the models.

        Raises:
            ConfigError: always.
        """
        raise self.refusal


def remedy_for(table: Mapping[str, object]) -> str:
    """The options with which the code that a study refers to is loaded."""
    native = [NATIVE_REMEDY] if native_files(table) else []
    return " and ".join([REMEDY] * bool(code_names(table)) + native)


def numbers_of(description: Description, parameters: ParameterTable) -> dict[str, Number]:
    """Every number of the loop; its paths are unknown without the models."""
    numbers = {}
    for name, description_of_number in description.numbers.items():
        quantity = Quantity(description_of_number.unit, description_of_number.meaning)
        match description_of_number.value:
            case dict(law):
                numbers[name] = Number.of(name, quantity, parse_law(law))
            case str(text):
                numbers[name] = Number.of(name, quantity, parameters.expression(text))
            case value:
                numbers[name] = Number.of(name, quantity, value)
    return numbers


def describe_study(study: Study, certified: np.ndarray | None, silence: str) -> JsonObject:
    """The data that :meth:`Described.of` needs in addition to a study's table, for JSON.

    Args:
        study: The study, with its models.
        certified: Whether Theorem 1 holds at each point of the sweep; None if it does not apply.
        silence: Why it does not apply; empty without the functions of Table 1.
    """
    numbers = {}
    for name, number in study.numbers.items():
        law = number.value
        quantity = number.quantity
        value = law.table if isinstance(law, Law) else law
        value = number.expression.text if number.expression else value
        numbers[name] = {"value": value, "unit": quantity.unit, "meaning": quantity.meaning}
    fields, vehicle_fields = info_fields(study.loop, study.template)
    metrics_of_user = {name: metric for name, metric in kinds_of(study.config).items() if name not in PACKAGE_METRICS}
    return {
        "channels": list(study.loop.plant.channels),
        "angles": list(study.loop.plant.angles),
        "units": [list(units) for units in study.units],
        "numbers": numbers,
        "fields": {name: list(names) for name, names in fields.items()},
        "seen": list(vehicle_fields),
        "signals": {
            name: {"unit": signal.unit, "meaning": signal.meaning}
            for name, signal in signals_of(study.loop, study.template, study.units).items()
        },
        "metrics": {
            name: {"unit": m.unit, "meaning": m.meaning, "needs": list(m.needs), "scope": m.scope.value}
            for name, m in metrics_of_user.items()
        },
        "certified": None if certified is None else certified.tolist(),
        "silence": silence,
    }


def stored_study(manifest: JsonObject, source: str, trust_code: bool = False) -> Study:
    """The study of a folder, which may come from anyone: the code it refers to is loaded only on request.

    Args:
        manifest: The folder's manifest: ``study`` and, if that refers to code, ``code`` and ``described``.
        source: Its location, for messages.
        trust_code: Import the code that the study refers to.

    Raises:
        ConfigError: It is not valid, or it refers to code and was written before descriptions were stored.
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
