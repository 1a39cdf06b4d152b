"""A study: a validated question, and the closed loop that answers it for one draw."""

import copy
import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
from pydantic import BaseModel, ValidationError

from dssc_jax.controllers import CONTROLLERS
from dssc_jax.environment import DISTURBANCES, REFERENCES
from dssc_jax.errors import ConfigError, meant
from dssc_jax.integrators import Integrator
from dssc_jax.loop import Loop, LoopParams
from dssc_jax.metrics import METRICS, Measure, Window, available
from dssc_jax.plants import PLANTS
from dssc_jax.requirements import Requirement
from dssc_jax.study.components import Component, explain, parse_component, parse_number
from dssc_jax.study.laws import Law
from dssc_jax.study.schema import LoopTable, MetricsTable, PlotTable, RequirementTable, StudyTable
from dssc_jax.types import Quantity, Scalar
from dssc_jax.unmodelled import UNMODELLED

REGISTRIES = {
    "plant": PLANTS,
    "reference": REFERENCES,
    "controller": CONTROLLERS,
    "unmodelled": UNMODELLED,
    "disturbance": DISTURBANCES,
}
FIXED_TABLES: dict[str, type[BaseModel]] = {
    "loop": LoopTable,
    "metrics": MetricsTable,
    "requirement": RequirementTable,
    "plot": PlotTable,
}


@dataclass(frozen=True)
class Study:
    """A validated study.

    Args:
        table: The study file's content, overrides included; what the manifest keeps.
        source: Where it came from, for messages.
        config: The fixed tables.
        loop: The models in their slots, and the clock.
        template: Parameters of the loop; leaves are numbers, and laws where a number is uncertain.
        quantities: Meaning of each number, by dotted name.
        short: Shorter names of numbers, see :class:`Component`.
        measures: What is measured.
        requirements: What is required.
    """

    table: dict[str, Any]
    source: str
    config: StudyTable
    loop: Loop
    template: LoopParams
    quantities: dict[str, Quantity]
    short: dict[str, str]
    measures: tuple[Measure, ...]
    requirements: tuple[Requirement, ...]

    @classmethod
    def load(cls, path: str | Path) -> "Study":
        """Read and validate a study file.

        Args:
            path: A TOML file.

        Raises:
            ConfigError: file, dotted path, rule and value of the first thing that is wrong.
        """
        return cls.from_table(read_toml(path), str(path))

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str = "study") -> "Study":
        """A study from the content of a study file.

        Raises:
            ConfigError: as :meth:`load`.
        """
        try:
            return build(copy.deepcopy(dict(table)), source)
        except ConfigError as error:
            raise error.within(source) from None

    def override(self, changes: Mapping[str, Any]) -> "Study":
        """The study with other values, by dotted name: ``{"controller.functions.tau_av": 0.05}``.

        Raises:
            ConfigError: a name leads nowhere, or the changed study is not valid.
        """
        table = copy.deepcopy(self.table)
        for name, value in changes.items():
            try:
                set_dotted(table, name, value)
            except ConfigError as error:
                raise error.within(self.source) from None
        return Study.from_table(table, self.source)

    def without_sweep(self) -> "Study":
        """The study at its own values."""
        return self.override({"sweep": {}}) if self.config.sweep else self

    @property
    def name(self) -> str:
        """The study's name."""
        return self.config.name

    @property
    def axes(self) -> dict[str, tuple[float, ...]]:
        """Values of each swept parameter."""
        return dict(self.config.sweep)

    @property
    def laws(self) -> dict[str, Law]:
        """The law of each uncertain number that is not swept; a swept value replaces the law."""
        return {name: leaf for name, leaf in self.leaves().items() if isinstance(leaf, Law) and name not in self.axes}

    @property
    def hash(self) -> str:
        """Hash of everything that decides the result."""
        return hashlib.sha256(json.dumps(self.table, sort_keys=True).encode()).hexdigest()

    def leaves(self) -> dict[str, float | Law]:
        """Every number of the loop by dotted name."""
        flat, _ = jax.tree_util.tree_flatten_with_path(self.template, is_leaf=lambda x: isinstance(x, Law))
        return {self._name(path): leaf for path, leaf in flat}

    def params(self, values: Mapping[str, Scalar]) -> LoopParams:
        """The loop's parameters with ``values`` (traced or not) in place of laws and swept numbers."""
        flat, tree = jax.tree_util.tree_flatten_with_path(self.template, is_leaf=lambda x: isinstance(x, Law))
        return tree.unflatten([values.get(self._name(path), leaf) for path, leaf in flat])

    def _name(self, path: tuple[Any, ...]) -> str:
        dotted = ".".join(str(getattr(key, "name", getattr(key, "idx", key))) for key in path)
        return self.short.get(dotted, dotted)


def read_toml(path: str | Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        ConfigError: it cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(str(path), f"cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), f"is not UTF-8 text: {error.reason} at byte {error.start}") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(str(path), f"is not valid TOML: {str(error) or 'nested too deeply'}") from error


def set_dotted(table: dict[str, Any], name: str, value: Any) -> None:
    """Set ``table[a][b][c]`` for the name ``a.b.c``; missing tables are made, list items go by index.

    Raises:
        ConfigError: the name passes through a number, or beyond a list's end.
    """
    if name.startswith("sweep."):  # names of axes are dotted themselves
        table.setdefault("sweep", {})[name.removeprefix("sweep.")] = value
        return
    *parents, last = name.split(".")
    here: Any = table
    for part in parents:
        if isinstance(here, list) and part.isdigit() and int(part) < len(here):
            here = here[int(part)]
        elif isinstance(here, dict):
            here = here.setdefault(part, {})
        else:
            raise ConfigError(name, f"leads nowhere: '{part}' is not in a table")
    if isinstance(here, list) and last.isdigit() and int(last) < len(here):
        here[int(last)] = value
    elif isinstance(here, dict):
        here[last] = value
    else:
        raise ConfigError(name, f"leads nowhere: '{last}' is not in a table")


def validate_fixed(table: dict[str, Any]) -> StudyTable:
    """The fixed tables, validated."""
    try:
        return StudyTable.model_validate(table)
    except ValidationError as error:
        location = error.errors()[0]["loc"]
        inside = FIXED_TABLES.get(str(location[0])) if len(location) > 1 else None
        raise explain(error, (inside or StudyTable).model_fields) from None


def build(table: dict[str, Any], source: str) -> Study:
    """Look up and parse every part of a study."""
    config = validate_fixed(table)
    parts: dict[str, Component] = {
        name: parse_component(getattr(config, name), registry, name) for name, registry in REGISTRIES.items()
    }
    if "l0" not in parts["controller"].params._fields:
        raise ConfigError("controller", "the gains need the field l0, which defines sigma = e' + l0 e")
    loop = Loop(
        **{name: part.model for name, part in parts.items()},
        sample_time=config.loop.sample_time,
        steps=config.loop.steps,
        substeps=config.loop.substeps,
        integrator=Integrator(config.loop.integrator),
    )
    short = {long: brief for part in parts.values() for long, brief in part.short.items()}
    quantities = {short.get(name, name): q for part in parts.values() for name, q in part.quantities.items()}
    template = LoopParams(**{name: part.params for name, part in parts.items()})
    measures, requirements = measured(config, info_fields(loop, template))
    study = Study(table, source, config, loop, template, quantities, short, measures, requirements)
    check_axes(study)
    return study


def info_fields(loop: Loop, template: LoopParams) -> tuple[str, ...]:
    """Names in the controller's info, found without computing anything."""
    params = jax.tree.map(lambda _: 1.0, template, is_leaf=lambda x: isinstance(x, Law))

    def first_info() -> Any:
        measurement = loop.plant.measure(params.plant, loop.plant.init(params.plant))
        reference = loop.reference.at(params.reference, 0.0)
        state = loop.controller.init(params.controller, measurement, reference)
        return loop.controller.step(params.controller, state, measurement, reference, loop.sample_time)[2]

    return getattr(jax.eval_shape(first_info), "_fields", ())


def measured(config: StudyTable, fields: tuple[str, ...]) -> tuple[tuple[Measure, ...], tuple[Requirement, ...]]:
    """Every available metric over the study's window, and one more for each requirement with its own."""
    names = available(fields)
    base = Window(config.metrics.after, config.metrics.settling_band)
    if config.metrics.after >= config.loop.duration:
        raise ConfigError("metrics.after", f"must be < duration = {config.loop.duration:g} s, got {base.after:g}")
    measures = {name: Measure(name, name, base) for name in names}
    requirements = []
    for index, table in enumerate(config.requirement):
        place = f"requirement.{index}"
        if table.metric not in METRICS:
            raise ConfigError(f"{place}.metric", f"unknown metric '{table.metric}'; {meant(table.metric, names)}")
        if table.metric not in names:
            needs = ", ".join(METRICS[table.metric].needs)
            raise ConfigError(f"{place}.metric", f"'{table.metric}' needs {needs}, which this controller does not have")
        after = base.after if table.after is None else table.after
        if after >= config.loop.duration:
            raise ConfigError(f"{place}.after", f"must be < duration = {config.loop.duration:g} s, got {after:g}")
        window = Window(after, table.settling_band or base.band)
        name = table.metric if window == base else f"{table.metric}_after_{after:g}"
        if window.band != base.band:
            name += f"_within_{window.band:g}"
        measures.setdefault(name, Measure(name, table.metric, window))
        requirements.append(Requirement(measures[name], table.max, table.min))
    if config.plot.metric is not None and config.plot.metric not in measures:
        raise ConfigError(
            "plot.metric", f"unknown metric '{config.plot.metric}'; {meant(config.plot.metric, measures)}"
        )
    return tuple(measures.values()), tuple(requirements)


def check_axes(study: Study) -> None:
    """Every axis is a number of the loop, and every value admissible.

    Raises:
        ConfigError: otherwise.
    """
    for name, values in study.config.sweep.items():
        if name.startswith("loop."):
            raise ConfigError(f"sweep.{name}", "the clock is fixed before tracing; run once per value with --set")
        if name not in study.quantities:
            raise ConfigError(f"sweep.{name}", f"unknown parameter; {meant(name, study.quantities)}")
        for value in values:
            try:
                parse_number(value, study.quantities[name])
            except ValueError as error:
                raise ConfigError(f"sweep.{name}", str(error)) from None
