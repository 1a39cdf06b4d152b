"""Study files as plain tables: reading, writing, changes by dotted name, merging."""

import copy
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError, errors_in_file, errors_under
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.laws import is_law
from dssc_jax.study.separators import toml_hint

PARAMETERS = "parameters"
DESCRIPTION = ("unit", "meaning")
"""Entries of a parameter's table besides its value."""
KEYED_BY_NAMES = ("sweep", "correlation", "tune.parameters", "tune.objective", "tune.limits", "tune.over")
"""Tables whose keys are dotted names themselves, which TOML requires in quotes."""
LARGEST_FILE = 2**20  # bytes of a study file
LONGEST_INDEX = 9  # most digits of an index in a dotted name
DEEPEST = 32  # most levels of tables within tables, and most parts of a dotted name
DOTTED_NAME = rf"(?:[^\s.=,\[\]{{}}]++[ \t]*+\.[ \t]*+){{{DEEPEST}}}"
LONG_NAME = re.compile(rf"^[ \t\[]*+{DOTTED_NAME}|[{{,][ \t]*+{DOTTED_NAME}", re.MULTILINE)
"""A dotted name that is too long; it is refused before parsing, since that takes a time quadratic in its length."""


def read_toml(path: str | Path) -> TomlTable:
    """Read and parse a TOML file.

    Raises:
        ConfigError: The file cannot be read, is too large, or is not TOML.
    """
    place = str(path)
    text = toml_text(path)
    if LONG_NAME.search(text):
        raise ConfigError(place, f"has a dotted name of more than {DEEPEST} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ConfigError(place, f"is nested too deeply, at most {DEEPEST} levels are taken") from None
    except ValueError as error:  # TOMLDecodeError, or the error of an integer with too many digits
        raise ConfigError(place, f"is not valid TOML: {error}{toml_hint(text, str(error))}") from error


def toml_text(path: str | Path) -> str:
    """Read the text of a TOML file, with plain line ends.

    Raises:
        ConfigError: The file cannot be read, is too large, or is not UTF-8.
    """
    place = str(path)
    try:
        content = files.read_bytes(path, LARGEST_FILE + 1)
    except OSError as error:
        raise ConfigError(place, f"cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # a null character in the path
        raise ConfigError(place, f"cannot be read: {error}") from error
    if len(content) > LARGEST_FILE:
        raise ConfigError(place, f"is larger than a study can be ({LARGEST_FILE} bytes)")
    try:
        return content.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise ConfigError(place, f"is not UTF-8 text: {error.reason} at byte {error.start}") from error


def require_shallow(table: Mapping[str, object]) -> None:
    """Require that tables and lists are nested at most :data:`DEEPEST` levels deep.

    Raises:
        ConfigError: Tables or lists are nested deeper.
    """
    level: list[Any] = [table]  # all tables and lists at one depth
    for _ in range(DEEPEST):
        next_level: list[Any] = []
        for value in level:
            if isinstance(value, Mapping):
                next_level.extend(value.values())
            elif isinstance(value, list | tuple):
                next_level.extend(value)
        if not next_level:
            return
        level = next_level
    raise ConfigError("", f"is nested too deeply, at most {DEEPEST} levels are taken")


def to_toml(table: Mapping[str, object]) -> str:
    """Write the text of the study file with this table."""
    return tomli_w.dumps(dict(table))


def inline_toml(value: object) -> str:
    """TOML of a value on one line, such as ``{ uniform = [0.8, 1.2] }``."""
    if isinstance(value, Mapping):
        return f"{{ {', '.join(toml_entry(name, inner) for name, inner in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(inline_toml, value))}]"
    return toml_entry("x", value).removeprefix("x = ")


def toml_entry(name: str, value: object) -> str:
    """TOML of an entry on one line: ``name = value``, with the name in quotes if TOML requires them."""
    if isinstance(value, Mapping | list | tuple):
        quoted_name, _, _ = tomli_w.dumps({name: 0}).partition(" = ")
        return f"{quoted_name} = {inline_toml(value)}"
    return tomli_w.dumps({name: value}).strip()


def toml_entries(table: Mapping[str, object], section: str = "") -> str:
    """TOML of a table and the tables within it, with one line for each law, list or number.

    Args:
        table: Content of the section.
        section: Dotted name of the section, for its header; empty for the top of the file.
    """
    tables = {name: inner for name, inner in table.items() if isinstance(inner, Mapping) and not is_law(inner)}
    lines = [toml_entry(name, value) for name, value in table.items() if name not in tables]
    if lines and section:
        lines.insert(0, f"[{section}]")
    texts = ["\n".join(lines) + "\n"] if lines else []
    for name, content in tables.items():
        texts.append(toml_entries(content, f"{section}.{name}" if section else name))
    return "\n".join(text for text in texts if text)


def is_index(part: str) -> bool:
    """Whether a part of a dotted name is the index of a list's item, such as ``0`` or ``12``."""
    return part.isascii() and part.isdecimal() and len(part) <= LONGEST_INDEX


def index_in(container: object, part: str) -> int | None:
    """Index of the list's item to which a part of a dotted name refers, by the item's entry ``name`` or by its index.

    The result is None if the container is no list or has no such item.
    """
    if not isinstance(container, list):
        return None
    for index, item in enumerate(container):
        if isinstance(item, Mapping) and item.get("name") == part:
            return index
    return int(part) if is_index(part) and int(part) < len(container) else None


def set_dotted(table: TomlTable, name: str, value: object) -> None:
    """Set ``table[a][b][c]`` for the name ``a.b.c``, in place; missing tables are created.

    The name refers to items of a list by index, or by the entry ``name`` of an item. If the table does not state the
    list, a table of items by index takes its place; :func:`with_default` later merges it with the default list.

    Raises:
        ConfigError: The name has an empty part, or leads through a number or beyond the end of a list.
    """
    for section in KEYED_BY_NAMES:
        if name.startswith(f"{section}."):
            set_by_name(table, section, name.removeprefix(f"{section}.").strip("\"'"), value)
            return
    *parents, key = name.split(".")
    if parents == [PARAMETERS] and isinstance(table.get(PARAMETERS), dict):
        value = with_description(value, table[PARAMETERS].get(key))
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
    """Set an entry of a section whose keys are dotted names themselves, in place.

    Raises:
        ConfigError: The section, or a table around it, is no table.
    """
    inner_table: Any = table
    for part in section.split("."):
        inner_table = inner_table.setdefault(part, {})
        if not isinstance(inner_table, dict):
            raise ConfigError(section, f"must be a table, got {inner_table!r}")
    inner_table[key] = value


def entry_or_new_table(container: Any, part: str, parents: Sequence[str], name: str) -> Any:
    """Content of a table or list under one part of a dotted name; a missing entry becomes an empty table.

    Args:
        container: Table or list.
        part: Part of the dotted name.
        parents: Parts of the name before this part, for messages.
        name: The whole name, for messages.

    Raises:
        ConfigError: The container is neither a table nor a list with such an item.
    """
    index = index_in(container, part)
    if index is not None:
        return container[index]
    if not isinstance(container, dict):
        raise ConfigError(name, no_such_part(container, parents, part))
    if isinstance(container.get(part), str):  # a kind that is stated without a table
        container[part] = {"kind": container[part]}
    return container.setdefault(part, {})


def no_such_part(container: object, parents: Sequence[str], part: str) -> str:
    """Text of a message that a container has no entry for a part of a dotted name.

    Args:
        container: List, or a value that contains nothing.
        parents: Parts of the name that lead to the container.
        part: The next part.
    """
    if not isinstance(container, list):
        return f"leads nowhere: '{part}' is not in a table"
    names = [str(item["name"]) for item in container if isinstance(item, Mapping) and "name" in item]
    named = f", or their names {', '.join(names)}" if names else ""
    return f"{'.'.join(parents)} has {indices_text(len(container))}{named}; got '{part}'"


def indices_text(count: int) -> str:
    """State the number of entries of a list, and their indices."""
    match count:
        case 0:
            return "no entry"
        case 1:
            return "1 entry, whose index is 0"
        case _:
            return f"{count} entries, whose indices are 0 to {count - 1}"


def is_entries(value: object) -> bool:
    """Whether a value is a table of list entries by index, such as ``{"1": 0.5}``."""
    return isinstance(value, Mapping) and bool(value) and all(is_index(str(key)) for key in value)


def with_entries(values: Sequence[Any], entries: Mapping[str, Any]) -> list[Any]:
    """Merge new entries into a list by their index; all other entries stay.

    Args:
        values: The list.
        entries: New entries by index, such as ``{"1": 0.5}``.

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
    """Value of a field: a table of entries by index changes a default list; any other value replaces the default.

    Raises:
        ConfigError: The default list has no such index.
    """
    if not is_entries(value) or not isinstance(default, list | tuple):
        return value
    if not default:
        raise ConfigError("", "has no entry by default; state the list in the study first")
    return with_entries(default, value)


def with_description(value: object, former_content: object) -> object:
    """New content of a parameter, with the unit and the meaning that its former content states.

    If the new content is a table other than a law, it stays as it is, with the unit and meaning that it states itself.
    """
    states_description = isinstance(value, dict) and not is_law(value)
    if states_description or not isinstance(former_content, dict):
        return value
    description = {key: former_content[key] for key in DESCRIPTION if key in former_content}
    if not description:
        return value
    content = dict(value) if isinstance(value, dict) else {"value": value}
    return content | description


def with_changes(table: Mapping[str, object], changes: Mapping[str, object], source: str) -> TomlTable:
    """Copy a study's table with other values, by dotted name.

    Args:
        table: Table of the study.
        changes: New values by dotted name, such as ``{"plant.k_p": 2.0}``.
        source: Origin of the table, for messages.

    Raises:
        ConfigError: The table is nested too deeply, or a name leads nowhere.
    """
    with errors_in_file(source):
        require_shallow(table)
        new_table = copy.deepcopy(dict(table))
        for name, value in changes.items():
            set_dotted(new_table, name, copy.deepcopy(value))  # a later name may lead into it
    return new_table


def merge_tables(common: TomlTable, override: TomlTable) -> TomlTable:
    """Merge each entry of ``override`` into a copy of ``common``, by the rules of :func:`merge_values`."""
    merged = dict(common)
    for name, value in override.items():
        with errors_under(name):
            merged[name] = merge_values(merged.get(name), value)
    return merged


def merge_values(inherited: Any, value: Any) -> Any:
    """Merge a value into an inherited value.

    A table is merged into a table of the same kind, unless one of them is a law. Entries by index are merged into a
    list. Any other value replaces the inherited one.

    Raises:
        ConfigError: The list has no such index.
    """
    are_tables = isinstance(value, dict) and isinstance(inherited, dict)
    if not are_tables or is_law(value) or is_law(inherited):
        return with_default(value, inherited)
    return merge_tables(inherited, value) if has_kind_of(value, inherited) else value


def has_kind_of(override: Mapping[str, object], inherited: Mapping[str, object]) -> bool:
    """Whether a table has the same kind as the table that it overrides, or states no kind."""
    return override.get("kind", inherited.get("kind")) == inherited.get("kind")


def stands_alone(override: TomlTable, common: TomlTable) -> bool:
    """Whether a channel's table replaces the common table of all channels, because it has another kind.

    A common table without a kind is never replaced: it contains values that channels of several kinds share.
    """
    return "kind" in common and not has_kind_of(override, common)


def common_table(table: TomlTable, channels: Collection[str]) -> TomlTable:
    """Select the entries of a section that all channels share: those that are not the table of a channel."""
    return {name: value for name, value in table.items() if name not in channels}


def channel_table(common: TomlTable, override: TomlTable) -> TomlTable:
    """Table of one channel: its own table merged into the common one, or its own table alone if the kind differs."""
    if stands_alone(override, common):
        return dict(override)
    return merge_tables(common, override)


def has_dotted(table: TomlTable, name: str) -> bool:
    """Whether a table states the entry with a dotted name.

    A value other than a table on the way to the entry, such as a list, counts as a statement of the entry.
    """
    node: Any = table
    for part in name.split("."):
        if not isinstance(node, dict):
            return True
        if part not in node:
            return False
        node = node[part]
    return True


def enclosing_list(table: Mapping[str, object], name: str) -> tuple[str, list[Any]] | None:
    """Name and content of the outermost list that contains the entry with a dotted name; None if no list does."""
    node: Any = table
    parts = name.split(".")
    for depth, part in enumerate(parts):
        if isinstance(node, list):
            return ".".join(parts[:depth]), node
        node = node.get(part) if isinstance(node, Mapping) else None
    return None
