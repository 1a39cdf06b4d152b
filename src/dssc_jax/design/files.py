"""Design files: ``[bounds]`` with ``[parameters]`` to check, or with ``[free]`` and ``[goal]`` for synthesis."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.toml import TomlTable
from dssc_jax.design import Bounds, Free, Modulation, Parameters, Recipe, derive, synthesise
from dssc_jax.design.bounds import Numbers, require_plain
from dssc_jax.design.feasibility import RANGES, Criterion, DesignGoal, edges, optimise
from dssc_jax.study.components import as_table, parse_params
from dssc_jax.study.parsed_values import parse_finite
from dssc_jax.study.schema import STRICT
from dssc_jax.study.table_errors import first_error
from dssc_jax.study.tables import read_toml

FREE_DEFAULTS = Free(l0=1.0, phi_a=0.1, eps=0.5, delta=1.0, eps_1=1.0, eps_2=0.1, eps_3=1.0)
"""Values of parameters that [free] does not give and the goal does not vary (assumed)."""
REQUIRED_FREE = set(Free._fields) - set(Free._field_defaults)
RUNNABLE = 1e-3  # s; sampling period that a design must allow where no goal is given


def interval_of(value: object) -> tuple[float, float]:
    """Parse two finite numbers, [low, high].

    Raises:
        ValueError: The value has another form.
    """
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(f"must be [low, high], got {value!r}")
    return parse_finite(value[0]), parse_finite(value[1])


Real = Annotated[float, BeforeValidator(parse_finite)]
Range = Annotated[tuple[float, float], BeforeValidator(interval_of)]


class DesignFile(NamedTuple):
    """The content of a design file, and the resulting parameters.

    Args:
        name: The name in the file, or the file's name.
        bounds: The bounds.
        parameters: Given, synthesised or optimised.
        free: The free parameters of the synthesis, if there was one.
        goal: The goal of the optimisation, if there was one.
        modulation: How the loop reaches sliding, if the file gives it.
        edges: Optimised parameters at an end of their range, in words.
    """

    name: str
    bounds: Bounds
    parameters: Parameters
    free: Free | None = None
    goal: DesignGoal | None = None
    modulation: Modulation | None = None
    edges: tuple[str, ...] = ()


class GoalTable(BaseModel):
    """``[goal]``: the goal for the choice of the free parameters."""

    model_config = STRICT
    criterion: str | None = None
    residual: Real | None = Field(default=None, gt=0.0)
    sample_time: Real = Field(default=RUNNABLE, ge=0.0)
    vary: dict[str, Range] = {}


DESIGN_TABLES = ("name", "recipe", "bounds", "parameters", "free", "goal", "modulation")


def load_design(path: str | Path, *, complete: bool = True) -> DesignFile:
    """Read a design file.

    Args:
        path: A TOML file with ``[bounds]`` and ``[parameters]`` or ``[free]``; ``recipe`` is ``strict`` (default) or
            ``printed`` and belongs to ``[free]``. With ``[goal]``, parameters that ``[free]`` does not fix are
            optimised.
        complete: Whether ``[free]`` without ``[goal]`` must give every parameter; otherwise the rest is optimised
            for the smallest guaranteed residual at a sampling period of 1 ms, and ``[free]`` may be absent.

    Raises:
        ConfigError: File, dotted path, rule and value of the first error.
    """
    try:
        return parse_design(read_toml(path), Path(path).stem, complete)
    except ConfigError as error:
        raise (error if error.where == str(path) else error.within(str(path))) from None


def parse_design(table: TomlTable, name: str, complete: bool = True) -> DesignFile:
    """Parse the content of a design file; ``name`` is the design's unless the content has one.

    Raises:
        ConfigError: Dotted path, rule and value of the first error.
    """
    for key in table:
        if key not in DESIGN_TABLES:
            raise ConfigError(key, f"unknown name; {nearest(key, DESIGN_TABLES)}")
    name = table.get("name", name)
    if not isinstance(name, str):
        raise ConfigError("name", f"must be text, got {name!r}")
    for key in ("recipe", "goal", "free"):
        if key in table and "parameters" in table:
            raise ConfigError(key, "cannot be combined with [parameters]")
    if complete and not table.keys() & {"parameters", "free", "goal"}:
        raise ConfigError("", "needs [bounds] and one of [parameters], [free] and [goal]")
    bounds = parsed_numbers(table, Bounds, "bounds")
    with errors_under("bounds"):
        bounds = bounds.prepare()
    modulation = parsed_numbers(table, Modulation, "modulation") if "modulation" in table else None
    if "parameters" in table:
        return DesignFile(name, bounds, parsed_numbers(table, Parameters, "parameters"), modulation=modulation)
    recipe = table.get("recipe", Recipe.STRICT.value)
    if recipe not in list(Recipe):
        raise ConfigError("recipe", f"must be strict or printed, got {recipe!r}")
    is_free_complete = as_table(table.get("free", {}), "free").keys() >= REQUIRED_FREE
    if "goal" not in table and (complete or is_free_complete):
        free = parsed_numbers(table, Free, "free")
        goal = None
        at_edges = ()
    else:
        if "recipe" in table:
            raise ConfigError("recipe", "has no meaning where the free parameters are sought; designs are strict then")
        free, goal, at_edges = searched_parameters(table, bounds)
    return DesignFile(
        name=name,
        bounds=bounds,
        parameters=synthesise(bounds, free, Recipe(recipe)),
        free=free,
        goal=goal,
        modulation=modulation,
        edges=at_edges,
    )


def searched_parameters(table: TomlTable, bounds: Bounds) -> tuple[Free, DesignGoal, tuple[str, ...]]:
    """Optimise the free parameters that ``[free]`` does not fix.

    Returns:
        The free parameters, the goal, and sentences on those at an end of their range.
    """
    try:
        goal_table = GoalTable.model_validate(as_table(table.get("goal", {}), "goal"))
    except ValidationError as error:
        raise first_error(error, GoalTable.model_fields).within_path("goal") from None
    criterion = goal_table.criterion or default_criterion(bounds)
    if criterion not in list(Criterion):
        raise ConfigError("goal.criterion", f"unknown criterion '{criterion}'; {nearest(criterion, list(Criterion))}")
    fixed_numbers = as_table(table.get("free", {}), "free")
    for key in goal_table.vary:
        if key in fixed_numbers:
            raise ConfigError(f"goal.vary.{key}", "is fixed by [free] already")
    start = parsed_numbers({"free": FREE_DEFAULTS._asdict() | fixed_numbers}, Free, "free")
    ranges = {key: box for key, box in RANGES.items() if key not in fixed_numbers} | goal_table.vary
    goal = DesignGoal(Criterion(criterion), goal_table.residual or float("inf"), goal_table.sample_time)
    try:
        optimal_free = optimise(bounds, start, goal, ranges)
    except ConfigError as error:
        raise (error.within_path("goal") if error.where.startswith("vary") else error) from None
    return optimal_free, goal, edges(optimal_free, ranges)


def default_criterion(bounds: Bounds) -> str:
    """The criterion without a stated one: the smallest residual, or the fastest decay if nothing drives the loop."""
    is_driven = derive(bounds, 1.0).beta_m > 0.0 or (bounds.zero_dynamics is not None and bounds.y_m_dot > 0.0)
    return (Criterion.RESIDUAL if is_driven else Criterion.DECAY_RATE).value


def parsed_numbers(table: Mapping[str, object], kind: type[Numbers], path: str) -> Numbers:
    """Parse the table at a path into an instance of its parameter type.

    Raises:
        ConfigError: The table is missing, or a number is not plain, out of its range or of unusable magnitude.
    """
    if path not in table:
        raise ConfigError(path, "is required and missing")
    with errors_under(path):
        numbers, _ = parse_params(as_table(table[path]), kind)
        require_plain(numbers)
    return numbers


def design_toml(design_file: DesignFile) -> str:
    """The text of a design file with the parameters as numbers, and as a comment the table of a study with them."""
    numbers = design_file.bounds._asdict().items()
    bounds = {name: value for name, value in numbers if name != "zero_dynamics" and value != 0.0}
    quoted_name = json.dumps(design_file.name, ensure_ascii=False).replace("\x7f", "\\u007f")
    lines = [f"name = {quoted_name}", "", "[bounds]", *(f"{name} = {value!r}" for name, value in bounds.items())]
    if design_file.bounds.zero_dynamics is not None:
        a, c = (list(part) for part in design_file.bounds.zero_dynamics)
        lines.append(f"zero_dynamics = {{ a = {a}, c = {c} }}")
    lines += ["", "[parameters]", *(f"{name} = {value!r}" for name, value in design_file.parameters._asdict().items())]
    if (modulation := design_file.modulation) is not None:
        lines += ["", "[modulation]", *(f"{name} = {value!r}" for name, value in modulation._asdict().items())]
    comment = [f"# {line}" for line in ["In a study:", *functions_toml(design_file.parameters).splitlines()]]
    return "\n".join([*lines, "", *comment, ""])


def functions_toml(parameters: Parameters) -> str:
    """The controller's table in a study that uses the parameters; k_o = 1 is arbitrary, only k_o tau_av matters."""
    names = {name: "epsilon" if name == "eps" else name for name in Parameters._fields if name != "l0"}
    fields = ", ".join(f"{names[name]} = {getattr(parameters, name)!r}" for name in names)
    return (
        f'[controller]\nkind = "dssc"\nl0 = {parameters.l0!r}\n[controller.functions]\nkind = "vgsta"\nk_o = 1.0\n'
        + fields.replace(", ", "\n")
    )
