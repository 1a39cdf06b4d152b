"""Design files: ``[bounds]`` with ``[parameters]`` to check, or with ``[free]`` or ``[goal]`` for synthesis."""

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
"""Values of free parameters that neither [free] gives nor the search varies (assumed)."""
REQUIRED_FREE = set(Free._fields) - set(Free._field_defaults)
"""Fields of [free] without a default."""
RUNNABLE = 1e-3
"""Sampling period [s] that a design must permit unless [goal] states another one."""


def interval_of(value: object) -> tuple[float, float]:
    """Parse the list [low, high] of two finite numbers; their order is not checked.

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
        parameters: Parameters of Table 1, as given in the file, synthesised or optimised.
        free: The free parameters of the synthesis; None if the file gives the parameters.
        goal: The goal of the optimisation; None without an optimisation.
        modulation: Numbers of the modulation rho; None if the file does not give them.
        edges: Sentences on optimised parameters that lie at an end of their range.
    """

    name: str
    bounds: Bounds
    parameters: Parameters
    free: Free | None = None
    goal: DesignGoal | None = None
    modulation: Modulation | None = None
    edges: tuple[str, ...] = ()


class GoalTable(BaseModel):
    """``[goal]``: the goal of the optimised design, and the ranges in which the free parameters are sought."""

    model_config = STRICT
    criterion: str | None = None
    residual: Real | None = Field(default=None, gt=0.0)
    sample_time: Real = Field(default=RUNNABLE, ge=0.0)
    vary: dict[str, Range] = {}


DESIGN_TABLES = ("name", "recipe", "bounds", "parameters", "free", "goal", "modulation")


def load_design(path: str | Path, *, complete: bool = True) -> DesignFile:
    """Read a design file, and synthesise or optimise its parameters if it does not give them.

    Args:
        path: A TOML file with ``[bounds]`` and ``[parameters]`` or ``[free]``; ``recipe`` is ``strict`` (default) or
            ``printed`` and belongs to ``[free]``. With ``[goal]``, parameters that ``[free]`` does not fix are
            optimised.
        complete: Whether ``[free]`` without ``[goal]`` must give every parameter. If not, ``[free]`` may be absent or
            incomplete: missing parameters are optimised by :func:`default_criterion` for a sampling period of 1 ms.

    Raises:
        ConfigError: The file is not valid; the message has file, dotted path, rule and value of the first error.
    """
    table = read_toml(path)
    try:
        return parse_design(table, Path(path).stem, complete)
    except ConfigError as error:
        raise error.within(str(path)) from None


def parse_design(table: TomlTable, name: str, complete: bool = True) -> DesignFile:
    """Parse the content of a design file, and synthesise or optimise its parameters if it does not give them.

    Args:
        table: Content of the file.
        name: Name of the design if the content has none.
        complete: As in :func:`load_design`.

    Raises:
        ConfigError: The content is not valid; the message has dotted path, rule and value of the first error.
    """
    require_design_tables(table, complete)
    name = table.get("name", name)
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
        return DesignFile(name, bounds, synthesise(bounds, free, Recipe(recipe)), free, modulation=modulation)
    if "recipe" in table:
        raise ConfigError("recipe", "has no meaning where the free parameters are sought; designs are strict then")
    found = searched_parameters(table, bounds)
    return DesignFile(
        name=name,
        bounds=bounds,
        parameters=synthesise(bounds, found.free),
        free=found.free,
        goal=found.goal,
        modulation=modulation,
        edges=found.edges,
    )


def require_design_tables(table: TomlTable, complete: bool) -> None:
    """Require that every table is known, that the name is text, and that no two tables exclude each other.

    Args:
        table: Content of the file.
        complete: Whether the file must have one of ``[parameters]``, ``[free]`` and ``[goal]``.

    Raises:
        ConfigError: A name is unknown, the design's name is not text, or tables exclude each other or are missing.
    """
    for key in table:
        if key not in DESIGN_TABLES:
            raise ConfigError(key, f"unknown name; {nearest(key, DESIGN_TABLES)}")
    name = table.get("name", "")
    if not isinstance(name, str):
        raise ConfigError("name", f"must be text, got {name!r}")
    for key in ("recipe", "goal", "free"):
        if key in table and "parameters" in table:
            raise ConfigError(key, "cannot be combined with [parameters]")
    if complete and not table.keys() & {"parameters", "free", "goal"}:
        raise ConfigError("", "needs [bounds] and one of [parameters], [free] and [goal]")


class FoundParameters(NamedTuple):
    """The free parameters that an optimisation found.

    Args:
        free: All free parameters, fixed and optimised.
        goal: The goal of the optimisation.
        edges: Sentences on optimised parameters that lie at an end of their range.
    """

    free: Free
    goal: DesignGoal
    edges: tuple[str, ...]


def searched_parameters(table: TomlTable, bounds: Bounds) -> FoundParameters:
    """Optimise the free parameters that ``[free]`` does not fix, for the goal of ``[goal]``.

    Args:
        table: Content of the design file.
        bounds: The bounds in the file, parsed.

    Raises:
        ConfigError: ``[goal]`` or ``[free]`` is not valid, or no design meets the goal.
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
    return FoundParameters(optimal_free, goal, edges(optimal_free, ranges))


def default_criterion(bounds: Bounds) -> str:
    """Choose the criterion of a goal that states none: the smallest residual, or else the fastest decay.

    If no reference, disturbance or nominal control acts, the residual of every design is 0, and the decay rate decides.
    """
    drives_sliding = derive(bounds, l0=1.0).beta_m > 0.0  # for any l0
    drives_zero_dynamics = bounds.zero_dynamics is not None and bounds.y_m_dot > 0.0
    is_driven = drives_sliding or drives_zero_dynamics
    return (Criterion.RESIDUAL if is_driven else Criterion.DECAY_RATE).value


def parsed_numbers(table: Mapping[str, object], kind: type[Numbers], path: str) -> Numbers:
    """Parse a table of a design file into its parameter type; every number must be plain, without a law.

    Args:
        table: Content of the design file.
        kind: Type of the parameters, such as :class:`Bounds`.
        path: Name of the table in the file.

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
    """The text of a design file with all parameters as numbers; a comment has the table ``[controller]`` of a study."""
    stated_bounds = design_file.bounds._asdict()
    zero_dynamics = stated_bounds.pop("zero_dynamics")
    quoted_name = json.dumps(design_file.name, ensure_ascii=False).replace("\x7f", "\\u007f")  # as TOML requires
    lines = [f"name = {quoted_name}", "", "[bounds]"]
    lines += [f"{name} = {value!r}" for name, value in stated_bounds.items() if value != 0.0]  # 0 is the default
    if zero_dynamics is not None:
        lines.append(f"zero_dynamics = {{ a = {list(zero_dynamics.a)}, c = {list(zero_dynamics.c)} }}")
    lines += ["", "[parameters]"]
    lines += [f"{name} = {value!r}" for name, value in design_file.parameters._asdict().items()]
    if design_file.modulation is not None:
        lines += ["", "[modulation]"]
        lines += [f"{name} = {value!r}" for name, value in design_file.modulation._asdict().items()]
    lines += ["", "# In a study:"]
    lines += [f"# {line}" for line in functions_toml(design_file.parameters).splitlines()]
    return "\n".join([*lines, ""])


def functions_toml(parameters: Parameters) -> str:
    """The text of the table ``[controller]`` of a study that uses the parameters.

    k_o = 1 is an arbitrary choice, since only the product k_o tau_av matters.
    """
    lines = ["[controller]", 'kind = "dssc"', f"l0 = {parameters.l0!r}"]
    lines += ["[controller.functions]", 'kind = "vgsta"', "k_o = 1.0"]
    for name, value in parameters._asdict().items():
        if name != "l0":
            field = "epsilon" if name == "eps" else name
            lines.append(f"{field} = {value!r}")
    return "\n".join(lines)
