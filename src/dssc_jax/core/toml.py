"""Tables of a TOML file."""

from typing import Any, TypeAlias

TomlTable: TypeAlias = dict[str, Any]
"""A table: strings, numbers, truth values, lists and tables by name; the schema of the study decides which."""
