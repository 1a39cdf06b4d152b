"""Design files: ``[bounds]``, and ``[parameters]`` to check or ``[free]`` from which parameters are synthesised."""

from pathlib import Path
from typing import Any, NamedTuple

from dssc_jax.design import Bounds, Free, Parameters, Recipe, synthesise
from dssc_jax.errors import ConfigError, meant
from dssc_jax.study.components import Component, as_table, parse_params
from dssc_jax.study.tables import read_toml


class DesignFile(NamedTuple):
    """What a design file says."""

    name: str
    bounds: Bounds
    parameters: Parameters


TABLES = ("name", "recipe", "bounds", "parameters", "free")


def load_design(path: str | Path) -> DesignFile:
    """Read a design file.

    Args:
        path: A TOML file with ``[bounds]`` and one of ``[parameters]`` and ``[free]``; ``recipe`` is ``strict``
            (default) or ``printed`` and belongs to ``[free]``.

    Raises:
        ConfigError: file, dotted path, rule and value of the first thing that is wrong.
    """
    try:
        return parse_design(read_toml(path), Path(path).stem)
    except ConfigError as error:
        raise (error if error.where == str(path) else error.within(str(path))) from None


def parse_design(table: dict[str, Any], name: str) -> DesignFile:
    """The content of a design file."""
    for key in table:
        if key not in TABLES:
            raise ConfigError(key, f"unknown name; {meant(key, TABLES)}")
    name = table.get("name", name)
    if not isinstance(name, str):
        raise ConfigError("name", f"must be text, got {name!r}")
    if "recipe" in table and "parameters" in table:
        raise ConfigError("recipe", "belongs to [free]; the parameters are given")
    if ("parameters" in table) == ("free" in table):
        raise ConfigError("", "needs [bounds] and exactly one of [parameters] and [free]")
    bounds = plain(table, Bounds, "bounds")
    try:
        bounds = bounds.prepare()
    except ConfigError as error:
        raise error.within_path("bounds") from None
    if "parameters" in table:
        return DesignFile(name, bounds, plain(table, Parameters, "parameters"))
    recipe = table.get("recipe", Recipe.STRICT.value)
    if recipe not in list(Recipe):
        raise ConfigError("recipe", f"must be strict or printed, got {recipe!r}")
    return DesignFile(name, bounds, synthesise(bounds, plain(table, Free, "free"), Recipe(recipe)))


def plain(table: dict[str, Any], kind: type, path: str) -> Any:
    """A table of plain numbers as an instance of its parameter type."""
    if path not in table:
        raise ConfigError(path, "is required and missing")
    return parse_params(as_table(table[path], path), kind, path, Component(path, kind, None))
