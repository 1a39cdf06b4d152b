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

from dssc_jax.controllers import CONTROLLERS, DIFFERENTIATORS
from dssc_jax.environment import DISTURBANCES, REFERENCES, SENSORS, TRAJECTORIES, WINDS
from dssc_jax.errors import ConfigError, meant
from dssc_jax.integrators import Integrator
from dssc_jax.loop import Loop, LoopParams, start, step
from dssc_jax.metrics import BRIEF, METRICS, Measure, Scope, Window, available, first_sample
from dssc_jax.plants import PLANTS
from dssc_jax.requirements import Requirement
from dssc_jax.study.components import Component, as_table, explain, parse_component, parse_number
from dssc_jax.study.laws import Law, is_law
from dssc_jax.study.schema import LoopTable, MetricsTable, PlotTable, RequirementTable, StudyTable
from dssc_jax.types import Quantity, Scalar, single
from dssc_jax.uav import UAV
from dssc_jax.unmodelled import UNMODELLED

REGISTRIES = {
    "plant": {**PLANTS, "uav": single(UAV, "the full UAV: rigid body, rotors, aerodynamics, inner loops (1)")},
    "reference": REFERENCES,
    "trajectory": TRAJECTORIES,
    "controller": CONTROLLERS,
    "sensor": SENSORS,
    "differentiator": DIFFERENTIATORS,
    "unmodelled": UNMODELLED,
    "disturbance": DISTURBANCES,
    "wind": WINDS,
}
PER_CHANNEL = ("controller", "sensor", "differentiator", "unmodelled", "disturbance")
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
    plant = parse_component(config.plant, REGISTRIES["plant"], "plant")
    channels = plant.model.channels or ("",)
    several = len(channels) > 1
    trajectories = REGISTRIES["trajectory" if several else "reference"]
    wholes = {
        "plant": plant,
        "reference": parse_component(config.reference, trajectories, "reference"),
        "wind": parse_component(config.wind, REGISTRIES["wind"], "wind"),
    }
    if not several and wholes["wind"].kind != "none":
        raise ConfigError("wind.kind", f"the plant '{plant.kind}' does not fly; use a disturbance")
    parts = {slot: parse_channels(getattr(config, slot), slot, channels) for slot in PER_CHANNEL}
    for name, gains in zip(channels, parts["controller"], strict=True):
        if "l0" not in gains.params._fields:
            path = f"controller.{name}" if name else "controller"
            raise ConfigError(path, "the gains need the field l0, which defines sigma = e' + l0 e")
    loop = Loop(
        plant=plant.model,
        reference=wholes["reference"].model,
        wind=wholes["wind"].model,
        **{slot: tuple(part.model for part in column) for slot, column in parts.items()},
        channels=channels,
        sample_time=config.loop.sample_time,
        steps=config.loop.steps,
        substeps=config.loop.substeps,
        integrator=Integrator(config.loop.integrator),
    )
    template = LoopParams(
        **{slot: part.params for slot, part in wholes.items()},
        **{slot: tuple(part.params for part in column) for slot, column in parts.items()},
    )
    everything = [*wholes.values(), *(part for column in parts.values() for part in column)]
    short = {long: brief for part in everything for long, brief in part.short.items()}
    quantities = {short.get(name, name): q for part in everything for name, q in part.quantities.items()}
    names = available(*info_fields(loop, template))
    measures, requirements = measured(config, names, several)
    study = Study(table, source, config, loop, template, quantities, short, measures, requirements)
    check_axes(study)
    return study


def parse_channels(table: dict[str, Any], slot: str, channels: tuple[str, ...]) -> list[Component]:
    """One component a channel. A table ``[controller.x]`` overrides what ``[controller]`` says for all.

    A number that a channel does not override is one number for all channels: one draw of its law, one axis.
    """
    registry = REGISTRIES[slot]
    common = {name: value for name, value in table.items() if name not in channels}
    found = []
    for index, channel in enumerate(channels):
        own = as_table(table.get(channel, {}), f"{slot}.{channel}") if channel else {}
        path = f"{slot}.{channel}" if own else slot
        part = parse_component(merged(common, own), registry, path)
        place = f"{slot}.{index}"  # where the template has it
        short = {}
        for name in part.quantities:
            rest = name.removeprefix(path)
            brief = part.short.get(name, name)
            if own and not has_dotted(own, brief.removeprefix(f"{path}.")):
                brief = f"{slot}{brief.removeprefix(path)}"
            short[f"{place}{rest}"] = brief
        part.quantities = {f"{place}{name.removeprefix(path)}": q for name, q in part.quantities.items()}
        part.short = short
        found.append(part)
    return found


def merged(common: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """``common`` with ``own`` on top, table by table; a table of another kind, or a law, replaces the common one."""
    result = dict(common)
    for name, value in own.items():
        below = result.get(name)
        if isinstance(value, dict) and isinstance(below, dict) and not is_law(value) and not is_law(below):
            same_kind = value.get("kind", below.get("kind")) == below.get("kind")
            result[name] = merged(below, value) if same_kind else value
        else:
            result[name] = value
    return result


def has_dotted(table: dict[str, Any], name: str) -> bool:
    """Whether a table holds the dotted name, or a part of it that is no table."""
    here: Any = table
    for part in name.split("."):
        if not isinstance(here, dict):
            return True
        if part not in here:
            return False
        here = here[part]
    return True


def info_fields(loop: Loop, template: LoopParams) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Names in each controller's info and in the plant's, found without computing anything."""
    params = jax.tree.map(
        lambda leaf: leaf.median if isinstance(leaf, Law) else leaf, template, is_leaf=lambda x: isinstance(x, Law)
    )

    def first() -> Any:
        key = jax.random.key(0)
        return step(loop, params, key, start(loop, params, key), 0)[1].instant

    instant = jax.eval_shape(first)
    infos = {
        name: getattr(sample.info, "_fields", ()) for name, sample in zip(loop.channels, instant.channels, strict=True)
    }
    return infos, getattr(instant.plant, "_fields", ())


def measured(
    config: StudyTable, names: dict[str, tuple[str, int | None]], several: bool
) -> tuple[tuple[Measure, ...], tuple[Requirement, ...]]:
    """The metrics over the study's window, and one more for each requirement with its own."""
    base = Window(config.metrics.after, config.metrics.settling_band)
    require_samples(config, base, "metrics.after")
    kinds = config.metrics.names if config.metrics.names is not None else default_kinds(several)
    for index, kind in enumerate(kinds):
        if kind not in METRICS:
            raise ConfigError(f"metrics.names.{index}", f"unknown metric '{kind}'; {meant(kind, METRICS)}")
    measures = {name: Measure(name, kind, base, at) for name, (kind, at) in names.items() if kind in kinds}
    requirements = []
    for index, table in enumerate(config.requirement):
        place = f"requirement.{index}"
        if table.metric not in names:
            if table.metric in METRICS and not several:
                needs = ", ".join(METRICS[table.metric].needs)
                raise ConfigError(f"{place}.metric", f"'{table.metric}' needs {needs}, which this loop does not have")
            raise ConfigError(f"{place}.metric", f"unknown metric '{table.metric}'; {meant(table.metric, names)}")
        after = base.after if table.after is None else table.after
        window = Window(after, table.settling_band or base.band)
        require_samples(config, window, f"{place}.after")
        name = table.metric if window == base else f"{table.metric}_after_{after:.12g}"
        if window.band != base.band:
            name += f"_within_{window.band:.12g}"
        measures.setdefault(name, Measure(name, names[table.metric][0], window, names[table.metric][1]))
        requirement = Requirement(measures[name], table.max, table.min)
        if any(requirement.name == other.name for other in requirements):
            raise ConfigError(place, f"'{table.metric}' is bounded on this side already; keep the stricter one")
        requirements.append(requirement)
    if config.plot.metric is not None and config.plot.metric not in measures:
        raise ConfigError(
            "plot.metric", f"unknown metric '{config.plot.metric}'; {meant(config.plot.metric, measures)}"
        )
    return tuple(measures.values()), tuple(requirements)


def require_samples(config: StudyTable, window: Window, place: str) -> None:
    """Require that a sample lies in the window.

    Raises:
        ConfigError: none does.
    """
    if first_sample(window, config.loop.sample_time) >= config.loop.steps:
        last = (config.loop.steps - 1) * config.loop.sample_time
        raise ConfigError(place, f"must be <= the time of the last sample {last:g} s, got {window.after:g}")


def default_kinds(several: bool) -> tuple[str, ...]:
    """Every metric for one channel; for several the brief list, and those of the vehicle."""
    vehicle = tuple(kind for kind, metric in METRICS.items() if metric.scope is Scope.VEHICLE)
    return (*BRIEF, *vehicle) if several else tuple(METRICS)


def check_axes(study: Study) -> None:
    """Every axis is a number of the loop, and every value admissible.

    Raises:
        ConfigError: otherwise.
    """
    if not study.config.sweep:
        return
    for name, values in study.config.sweep.items():
        if name.startswith("loop."):
            raise ConfigError(f"sweep.{name}", "the clock is fixed before tracing; run once per value with --set")
        if name not in study.quantities:
            raise ConfigError(f"sweep.{name}", f"unknown parameter; {meant(name, study.quantities)}")
        if not study.quantities[name].law:
            raise ConfigError(f"sweep.{name}", "is fixed before tracing; run once per value with --set")
        for value in values:
            try:
                parse_number(value, study.quantities[name])
            except ValueError as error:
                raise ConfigError(f"sweep.{name}", str(error)) from None
    prepare_box(study)


def prepare_box(study: Study) -> None:
    """What spans several fields must hold for all swept values: they stand as laws in a trial of every part.

    Raises:
        ConfigError: it does not, or a swept number is one that is used up before tracing.
    """
    table = copy.deepcopy(study.table)
    for name, values in study.config.sweep.items():
        set_dotted(table, name, {"choice": list(values)})
    for slot in {name.split(".")[0] for name in study.config.sweep}:
        try:
            if slot in PER_CHANNEL:
                parse_channels(table[slot], slot, study.loop.channels)
            else:
                registry = "trajectory" if slot == "reference" and len(study.loop.channels) > 1 else slot
                parse_component(table[slot], REGISTRIES[registry], slot)
        except ConfigError as error:
            raise error.within("sweep") from None
