"""Small trees of plain values as JSON: numbers, strings, types of arrays, containers, this package's named tuples."""

import importlib
import json
from collections import OrderedDict
from typing import Any

import numpy as np

from dssc_jax.core.trace_memory.names import Undescribed, qualified_name

CONTAINERS = {"tuple": tuple, "dict": dict, "OrderedDict": OrderedDict}
DTYPE = "dtype"


def encode(tree: Any) -> bytes:
    """Return a tree of plain values as JSON text, in bytes.

    Raises:
        Undescribed: The tree contains a value of another type, or a named tuple that cannot be imported.
    """
    return json.dumps(as_plain(tree)).encode()


def decode(content: bytes) -> Any:
    """Return the tree that :func:`encode` has turned into these bytes."""
    return restore(json.loads(content))


def as_plain(tree: Any) -> Any:
    """Return a tree of JSON values. A value of a type that JSON lacks becomes an object with one key, the type's name.

    Raises:
        Undescribed: A value has a type that :func:`restore` does not know.
    """
    match tree:
        case None | bool() | int() | float() | str():
            return tree
        case list():
            return [as_plain(part) for part in tree]
        case np.dtype():
            return {DTYPE: tree.str}
        case tuple() if hasattr(tree, "_fields"):
            return {qualified_name(type(tree)).decode(): [as_plain(part) for part in tree]}
        case tuple():
            return {"tuple": [as_plain(part) for part in tree]}
        case dict():
            return {type(tree).__name__: [[as_plain(key), as_plain(part)] for key, part in tree.items()]}
    raise Undescribed(tree)


def restore(content: Any) -> Any:
    """Return the tree that :func:`as_plain` has turned into this content."""
    if isinstance(content, list):
        return [restore(part) for part in content]
    if not isinstance(content, dict):
        return content
    ((kind, parts),) = content.items()  # an object has one key, the name of its type
    if kind == DTYPE:
        return np.dtype(parts)
    arguments = restore(parts)
    if kind in CONTAINERS:
        return CONTAINERS[kind](arguments)
    module, _, name = kind.rpartition(".")
    return getattr(importlib.import_module(module), name)(*arguments)
