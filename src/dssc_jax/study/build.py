"""Construction of a study from its table: models, parameters, numbers, metrics and requirements."""

from collections.abc import Hashable, Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
from pydantic import ValidationError

from dssc_jax.closed_loop.infos import fields_of, first_infos
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.closed_loop.metrics.signal_metrics import SampledSignal, sampled_signals
from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.closed_loop.rehearsal import rehearse
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import quantities_of
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.trace_memory.memory import cached_by_subjects
from dssc_jax.core.units import ChannelUnits
from dssc_jax.study.actuators import require_one_form
from dssc_jax.study.available_metrics import AvailableMetrics, available_metrics, metric_kinds
from dssc_jax.study.components import as_table
from dssc_jax.study.laws import nominal_params
from dssc_jax.study.measuring import parse_measures
from dssc_jax.study.numbers import Number, merge_numbers, parameter_numbers
from dssc_jax.study.parameters import TEXTS, ParameterTable
from dssc_jax.study.parts import parse_parts
from dssc_jax.study.schema import StudyTable
from dssc_jax.study.sections import FIXED_TABLES, with_section
from dssc_jax.study.settled_checks import (
    require_changes_before_settling,
    require_seen_signals,
    require_whole_windows,
)
from dssc_jax.study.slots import TABLES
from dssc_jax.study.sweeps import check_axes, check_swept_parts
from dssc_jax.study.table_errors import first_error
from dssc_jax.study.tables import PARAMETERS


def validate_fixed(table: TomlTable) -> StudyTable:
    """Validate the tables of a study whose fields do not depend on a kind, such as ``[loop]`` and ``[metrics]``.

    Raises:
        ConfigError: An entry is not valid.
    """
    try:
        return StudyTable.model_validate(table)
    except ValidationError as error:
        raise first_error(error, valid_names(error)) from None


def valid_names(error: ValidationError) -> Iterable[str]:
    """Names that are valid in the table of pydantic's first error; a message proposes the nearest of them."""
    path = [str(part) for part in error.errors()[0]["loc"]]  # sections, then the name; empty for a rule of the study
    sections = path[:-1]
    if ".".join(sections) in FIXED_TABLES:  # such as loop.settled
        return FIXED_TABLES[".".join(sections)].model_fields
    if sections and sections[0] in FIXED_TABLES:  # such as requirement.0
        return FIXED_TABLES[sections[0]].model_fields
    return StudyTable.model_fields


def with_constants(table: TomlTable, parameters: ParameterTable) -> TomlTable:
    """Copy a study's table with a number in place of each expression, except in the parts of the loop.

    The parts of the loop keep their expressions, since these may depend on uncertain parameters. The numbers in all
    other tables must be known before tracing.

    Raises:
        ConfigError: An expression is not valid, or depends on a law.
    """
    unchanged_names = {*TABLES, *TEXTS, "compare", PARAMETERS}
    constants = {}
    for name, value in table.items():
        constants[name] = value if name in unchanged_names else parameters.constants(value, name)
    return constants


class StudyContent(NamedTuple):
    """Content of a parsed study; :class:`dssc_jax.study.Study` has the same fields, and documents them."""

    config: StudyTable
    loop: Loop
    template: LoopParams
    units: tuple[ChannelUnits, ...]
    numbers: dict[str, Number]
    measures: tuple[Measure, ...]
    requirements: tuple[Requirement, ...]


def build(table: TomlTable) -> StudyContent:
    """Parse the table of a study into its loop, parameters, numbers, metrics and requirements.

    Raises:
        ConfigError: The table is not valid; the message has the path, the rule and the value of the first error. If a
            name is in the wrong section, the message names the right section.
    """
    try:
        return parse_content(table)
    except ConfigError as error:
        raise with_section(error, table) from None


def parse_content(table: TomlTable) -> StudyContent:
    """Parse the table of a study, as :func:`build` does, but with plain errors.

    If a name is in the wrong section, :func:`build` adds the right section to the error.

    Raises:
        ConfigError: The table is not valid.
    """
    parameters = ParameterTable.from_toml(as_table(table.get(PARAMETERS, {}), PARAMETERS))
    config = validate_fixed(with_constants(table, parameters))
    require_one_form(config)
    parts = parse_parts(config, parameters)
    loop = parts.loop(config)
    template = parts.template
    units = parts.units
    kinds = metric_kinds(config)
    fields, vehicle_fields = info_fields(loop, template)
    loop_metrics = AvailableMetrics(
        names=available_metrics(fields, vehicle_fields, kinds),
        kinds=kinds,
        channels=loop.channels,
        units=units,
        default_window=config.metrics.window,
    )
    signals = signals_of(loop, template, units)
    measures, requirements = parse_measures(config, loop_metrics, signals, parameters.constant)
    loop_numbers = merge_numbers(parts.numbers)
    numbers_of_parameters = parameter_numbers(parameters, loop_numbers.values())
    numbers = {number.name: number for number in numbers_of_parameters} | loop_numbers
    check_axes(config, numbers)
    check_swept_parts(table, config, loop, parts.measurable, numbers)
    require_whole_windows(loop, measures, config.envelope)
    require_changes_before_settling(config, numbers)
    require_seen_signals(config, loop, template, numbers, parts.events)
    return StudyContent(
        config=config,
        loop=loop,
        template=template,
        units=units,
        numbers=numbers,
        measures=measures,
        requirements=requirements,
    )


def signals_of(loop: Loop, template: LoopParams, units: tuple[ChannelUnits, ...]) -> dict[str, SampledSignal]:
    """Every signal that a loop computes at a sample, by the name of its column in a trajectory.

    Args:
        loop: The loop.
        template: Parameters of the loop; the leaves may be laws and expressions.
        units: Units and meanings of each channel.
    """
    controller_fields, plant_fields = info_fields(loop, template)
    reports = [quantities_of(model.info) for model in loop.controller]
    return sampled_signals(
        controller_fields, plant_fields, units, reports, loop.quantities, loop.measures, loop.plant.angles
    )


Fields = tuple[dict[str, tuple[str, ...]], tuple[str, ...]]
"""Two results: names of the fields in each controller's info, by channel, and names of those in the plant's info."""


def info_fields(loop: Loop, template: LoopParams) -> Fields:
    """Names of the fields that each controller and the plant report; a trace finds them without computing numbers."""
    leaves, structure = jax.tree.flatten(nominal_params(template))
    hashable_leaves: list[Hashable] = []
    for leaf in leaves:
        is_array = hasattr(leaf, "shape")  # a recorded signal
        hashable_leaves.append(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) if is_array else leaf)
    return traced_fields(loop, structure, tuple(hashable_leaves))


@lru_cache(maxsize=64)
def traced_fields(loop: Loop, structure: Any, leaves: tuple[Hashable, ...]) -> Fields:
    """Names of the fields that each controller and the plant report, from parameters in a form that can be hashed.

    The trace takes most of the time of loading a study. Variants of a study with the same parameters share the cache.

    Args:
        loop: The loop.
        structure: Tree structure of the loop's parameters.
        leaves: Leaves of the parameters, with shape and dtype in place of each array.
    """

    def is_array(leaf: Hashable) -> bool:
        """Whether a leaf stands for an array."""
        return isinstance(leaf, jax.ShapeDtypeStruct)

    def infos_of(arrays: list[jax.Array]) -> tuple[tuple[Any, ...], Any]:
        """Infos of the controllers, and info of the plant, at the first sample, for arrays in place of their shapes."""
        next_array = iter(arrays)
        filled_leaves = [next(next_array) if is_array(leaf) else leaf for leaf in leaves]
        params = jax.tree.unflatten(structure, filled_leaves)
        rehearse(loop, params)
        return first_infos(loop, params)

    def trace_fields() -> Fields:
        """Trace the first sample of the loop, and read the names of the fields."""
        with arithmetic():
            controllers, plant = jax.eval_shape(infos_of, [leaf for leaf in leaves if is_array(leaf)])
        controller_fields = {}
        for channel, info in zip(loop.channels, controllers, strict=True):
            controller_fields[channel] = fields_of(info, "controller")
        return controller_fields, fields_of(plant, "plant")

    return cached_by_subjects("fields", trace_fields, loop, jax.tree.unflatten(structure, leaves))
