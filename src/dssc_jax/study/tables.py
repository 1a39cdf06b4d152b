"""Study files as plain tables: reading, overriding by dotted name, merging."""

import copy
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError, close_names, errors_under
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.laws import is_law
from dssc_jax.study.parsed_values import AXES
from dssc_jax.study.separators import toml_hint

PARAMETERS = "parameters"
DESCRIPTION = ("unit", "meaning")
"""What the table of a parameter holds besides its content."""
KEYED_BY_NAMES = ("sweep", "correlation", "tune.parameters", "tune.objective", "tune.limits", "tune.over")
"""Tables whose keys are dotted names, which TOML wants in quotes."""
LARGEST_FILE = 2**20  # bytes of a study file
DEEPEST = 32  # tables within tables, and names in a dotted name
DOTTED_NAME = rf"(?:[^\s.=,\[\]{{}}]++[ \t]*+\.[ \t]*+){{{DEEPEST}}}"
LONG_NAME = re.compile(rf"^[ \t\[]*+{DOTTED_NAME}|[{{,][ \t]*+{DOTTED_NAME}", re.MULTILINE)
"""Detected before parsing, because the parser's time grows with the square of a dotted name's length."""


def read_toml(path: str | Path) -> TomlTable:
    """The content of a TOML file.

    Raises:
        ConfigError: it cannot be read, is too large, or is not TOML.
    """
    text = ""
    try:
        content = files.read_bytes(path, LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise ConfigError(str(path), f"is larger than a study can be ({LARGEST_FILE} bytes)")
        text = content.decode("utf-8").replace("\r\n", "\n")
        if LONG_NAME.search(text):
            raise ConfigError(str(path), f"has a dotted name of more than {DEEPEST} parts")
        table = tomllib.loads(text)
    except OSError as error:
        raise ConfigError(str(path), f"cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), f"is not UTF-8 text: {error.reason} at byte {error.start}") from error
    except RecursionError:
        raise ConfigError(str(path), f"is nested too deeply, at most {DEEPEST} levels are taken") from None
    except ConfigError:
        raise
    except ValueError as error:  # TOMLDecodeError is one, so are integers too long
        raise ConfigError(str(path), f"is not valid TOML: {error}{toml_hint(text, str(error))}") from error
    return table


def require_shallow(table: Mapping[str, object]) -> None:
    """Require that tables and lists are not nested too deeply.

    Raises:
        ConfigError: They are.
    """
    values: list[Any] = [table]
    for _ in range(DEEPEST):
        values = [
            inner
            for value in values
            if isinstance(value, Mapping | list | tuple)
            for inner in (value.values() if isinstance(value, Mapping) else value)
        ]
        if not values:
            return
    raise ConfigError("", f"is nested too deeply, at most {DEEPEST} levels are taken")


def to_toml(table: Mapping[str, object]) -> str:
    """A study's table as the text of a study file."""
    return tomli_w.dumps(dict(table))


def inline_toml(value: object) -> str:
    """A value of a study's table as TOML on one line."""
    if isinstance(value, Mapping):
        return f"{{ {', '.join(toml_entry(name, inner) for name, inner in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(inline_toml, value))}]"
    return toml_entry("x", value).removeprefix("x = ")


def toml_entry(name: str, value: object) -> str:
    """``name = value`` on one line."""
    if isinstance(value, Mapping | list | tuple):
        return f"{tomli_w.dumps({name: 0}).partition(' = ')[0]} = {inline_toml(value)}"
    return tomli_w.dumps({name: value}).strip()


def toml_entries(table: Mapping[str, object], section: str = "") -> str:
    """A table as TOML with one line for each law, list or number, under the header of its section."""
    tables = {name: inner for name, inner in table.items() if isinstance(inner, Mapping) and not is_law(inner)}
    lines = [toml_entry(name, value) for name, value in table.items() if name not in tables]
    if lines and section:
        lines.insert(0, f"[{section}]")
    entries = "\n".join(lines) + "\n" if lines else ""
    inner = (toml_entries(content, f"{section}.{name}".lstrip(".")) for name, content in tables.items())
    return "\n".join(filter(None, [entries, *inner]))


def is_index(part: str) -> bool:
    """Whether a part of a name is a plain decimal number."""
    return part.isascii() and part.isdecimal() and len(part) < 10


def index_in(container: object, part: str) -> int | None:
    """The item of a list that a part of a dotted name gives; None if it gives none, or there is no list."""
    if not isinstance(container, list):
        return None
    for index, item in enumerate(container):
        if isinstance(item, Mapping) and item.get("name") == part:
            return index
    return int(part) if is_index(part) and int(part) < len(container) else None


def set_dotted(table: TomlTable, name: str, value: object) -> None:
    """Set ``table[a][b][c]`` for the name ``a.b.c``; missing tables are created.

    Items of a list are given by index, or by the entry ``name`` of a table in it. Of a list that the table does not
    state, a table takes the items; the part that has the list adds its defaults (see :func:`with_default`).

    Raises:
        ConfigError: The name has an empty part, or passes through a number, or beyond a list's end.
    """
    for section in KEYED_BY_NAMES:
        if name.startswith(f"{section}."):
            set_by_name(table, section, name.removeprefix(f"{section}.").strip("\"'"), value)
            return
    first_part, _, remainder = name.partition(".")
    if first_part == PARAMETERS and remainder and "." not in remainder and isinstance(table.get(first_part), dict):
        value = with_description(value, table[first_part].get(remainder))
    *parents, key = name.split(".")
    if not all([*parents, key]):
        raise ConfigError(name, "has an empty part; a single dot stands between two parts")
    container: Any = table
    for depth, part in enumerate(parents):
        container = entry_or_new_table(container, part, parents[:depth], name)
    index = index_in(container, key)
    if index is not None:
        container[index] = value
    elif isinstance(container, dict):
        container[key] = value
    else:
        raise ConfigError(name, no_such_part(container, parents, key))


def set_by_name(table: TomlTable, section: str, key: str, value: object) -> None:
    """Set an entry of a section whose keys are dotted names themselves.

    Raises:
        ConfigError: The section, or one that holds it, is no table.
    """
    inner_table: Any = table
    for part in section.split("."):
        inner_table = inner_table.setdefault(part, {})
        if not isinstance(inner_table, dict):
            raise ConfigError(section, f"must be a table, got {inner_table!r}")
    inner_table[key] = value


def entry_or_new_table(container: Any, part: str, parents: Sequence[str], name: str) -> Any:
    """What a container holds under a part of a dotted name; a missing entry of a table is created as a table.

    Raises:
        ConfigError: The container is no table, and no list with such an item.
    """
    index = index_in(container, part)
    if index is not None:
        return container[index]
    if not isinstance(container, dict):
        raise ConfigError(name, no_such_part(container, parents, part))
    if isinstance(container.get(part), str):  # the name of a kind alone, in place of its table
        container[part] = {"kind": container[part]}
    return container.setdefault(part, {})


def no_such_part(container: object, parents: Sequence[str], part: str) -> str:
    """The rule that a part of a dotted name breaks, which the content of its parents does not have."""
    if not isinstance(container, list):
        return f"leads nowhere: '{part}' is not in a table"
    names = [str(item["name"]) for item in container if isinstance(item, Mapping) and "name" in item]
    named = f", or their names {', '.join(names)}" if names else ""
    return f"{'.'.join(parents)} has {indices_text(len(container))}{named}; got '{part}'"


def indices_text(count: int) -> str:
    """How many entries a list has, and their indices, in words."""
    match count:
        case 0:
            return "no entry"
        case 1:
            return "1 entry, whose index is 0"
        case _:
            return f"{count} entries, whose indices are 0 to {count - 1}"


def is_entries(value: object) -> bool:
    """Whether a table holds entries of a list by their indices."""
    return isinstance(value, Mapping) and bool(value) and all(is_index(str(key)) for key in value)


def with_entries(values: Sequence[Any], entries: Mapping[str, Any]) -> list[Any]:
    """A list with other entries, by index; so are those of its rows and tables.

    Raises:
        ConfigError: The list has no such index.
    """
    new_values = list(values)
    for key, entry in entries.items():
        index = int(key)
        if index >= len(new_values):
            raise ConfigError("", f"has {indices_text(len(new_values))}; got '{key}'")
        with errors_under(key):
            new_values[index] = merge_values(new_values[index], entry)
    return new_values


def with_default(value: Any, default: Any) -> Any:
    """A value of a study's table; entries by index alone change the default, if this is a list.

    Raises:
        ConfigError: The default list has no such index.
    """
    if not is_entries(value) or not isinstance(default, list | tuple):
        return value
    if not default:
        raise ConfigError("", "has no entry by default; state the list in the study first")
    return with_entries(default, value)


def quotes_hint(section: str, key: str, value: object) -> str:
    """The end of a message where a name with dots was not quoted, so that TOML read it as tables; else empty.

    Args:
        section: Dotted name of the table.
        key: The key that has no valid value.
        value: What it has.
    """
    if section not in KEYED_BY_NAMES or section == "correlation":  # whose keys are pairs of names
        return ""
    parts = [key]
    while isinstance(value, Mapping) and len(value) == 1:
        (inner,) = value
        if close_names(str(inner), AXES):  # a spacing, perhaps misspelt
            break
        parts.append(str(inner))
        value = value[inner]
    if len(parts) == 1 or (isinstance(value, Mapping) and not value.keys() <= set(AXES)):
        return ""
    return f"; a name with a dot needs quotes: {toml_entry('.'.join(parts), value)}"


def with_description(value: object, former_content: object) -> object:
    """A new content of a parameter with the unit and the meaning of the earlier one, if it has none of its own."""
    description = (
        {key: former_content[key] for key in DESCRIPTION if key in former_content}
        if isinstance(former_content, dict)
        else {}
    )
    if not description or (isinstance(value, dict) and not is_law(value)):
        return value
    return (dict(value) if isinstance(value, dict) else {"value": value}) | description


def with_changes(table: Mapping[str, object], changes: Mapping[str, object], source: str) -> TomlTable:
    """A copy of a table from ``source`` with other values, by dotted name.

    Raises:
        ConfigError: the table nests too deeply, or a name leads nowhere.
    """
    try:
        require_shallow(table)
        new_table = copy.deepcopy(dict(table))
        for name, value in changes.items():
            set_dotted(new_table, name, copy.deepcopy(value))  # a later name may lead into it
    except ConfigError as error:
        raise error.within(source) from None
    return new_table


def merge_tables(common: TomlTable, override: TomlTable) -> TomlTable:
    """``common`` with the values of ``override``; see :func:`merge_values`."""
    result = dict(common)
    for name, value in override.items():
        with errors_under(name):
            result[name] = merge_values(result.get(name), value)
    return result


def merge_values(inherited: Any, value: Any) -> Any:
    """A value that overrides an inherited one: a table changes a table of its kind, entries by index change a list.

    Any other value replaces the inherited one.

    Raises:
        ConfigError: The list has no such index.
    """
    if isinstance(value, dict) and isinstance(inherited, dict) and not is_law(value) and not is_law(inherited):
        return merge_tables(inherited, value) if has_kind_of(value, inherited) else value
    return with_default(value, inherited)


def has_kind_of(override: Mapping[str, object], inherited: Mapping[str, object]) -> bool:
    """Whether a table keeps the kind of the one that it overrides."""
    return override.get("kind", inherited.get("kind")) == inherited.get("kind")


def stands_alone(override: TomlTable, common: TomlTable) -> bool:
    """Whether a channel's table replaces the common one, because it has another kind.

    A common table without a kind holds what channels of several kinds share.
    """
    return "kind" in common and not has_kind_of(override, common)


def channel_table(common: TomlTable, override: TomlTable) -> TomlTable:
    """The table of a channel: the common one with the channel's values, or a table of another kind alone."""
    return dict(override) if stands_alone(override, common) else merge_tables(common, override)


def has_dotted(table: TomlTable, name: str) -> bool:
    """Whether a table contains the dotted name, or a part of it that is not a table."""
    node: Any = table
    for part in name.split("."):
        if not isinstance(node, dict):
            return True
        if part not in node:
            return False
        node = node[part]
    return True


def enclosing_list(table: Mapping[str, object], name: str) -> tuple[str, list[Any]] | None:
    """Dotted name and content of the outermost list that contains the dotted name; None if there is none."""
    node: Any = table
    parts = name.split(".")
    for depth, part in enumerate(parts):
        if isinstance(node, list):
            return ".".join(parts[:depth]), node
        node = node.get(part) if isinstance(node, Mapping) else None
    return None
