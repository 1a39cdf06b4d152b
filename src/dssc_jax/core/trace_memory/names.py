"""Names for what this package computes from given things: equal names, equal results.

A name is a digest of the package's sources, of the versions below it, of JAX's settings and of the things: numbers,
containers, parameters, models, and functions with all that they close over. What it cannot describe completely has no
name, such as a model of the user's own: its code, and what that calls, may change without notice.

Code that was changed in the running process only, as by assigning to a module's function, is not seen.
"""

import functools
import hashlib
import platform
import types
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

import dssc_jax
from dssc_jax.core import files

DESCRIBED = ("dssc_jax", "jax", "jaxlib", "numpy", "scipy", "builtins", "collections", "functools")
"""Packages whose functions and types a name describes, by sources or version."""

PLAIN = tuple("biufc")
"""Kinds of the types of arrays whose bytes describe them."""

VERSIONED = ("jax", "jaxlib", "numpy", "scipy", "llvmlite")


class Undescribed(Exception):
    """A thing that a name cannot describe completely."""


def name_of(*things: Any) -> str | None:
    """A name for what this package computes from things in this process; None if there is none."""
    sources = sources_digest()
    if sources is None:
        return None
    digest = hashlib.sha256()
    try:
        for part in description_parts((sources, versions(), sorted(jax.config.values.items()), things), ()):
            digest.update(f"{len(part)}:".encode() + part)
    except Undescribed:
        return None
    return digest.hexdigest()


@cache
def sources_digest() -> str | None:
    """A digest of the package's sources; None if they have changed since this process imported the package."""
    root = package_root()
    digest = hashlib.sha256()
    sources = package_sources()
    for file in sources:
        about = file.stat()
        if max(about.st_mtime, about.st_ctime) >= dssc_jax.IMPORTED:
            return None
        digest.update(f"{file.relative_to(root)}:{about.st_size}:".encode() + files.read_bytes(file))
    return digest.hexdigest() if sources else None


def package_root() -> Path:
    """The package's folder."""
    return Path(dssc_jax.__file__).parent


def package_sources() -> list[Path]:
    """The package's modules; none if it is imported from an archive."""
    return sorted(package_root().rglob("*.py"))


@cache
def versions() -> tuple[str, ...]:
    """Versions of Python and of the packages that take part in a trace."""
    return platform.python_version(), *map(version, VERSIONED)


def description_parts(thing: Any, ancestors: tuple[int, ...]) -> Iterator[bytes]:
    """Bytes that describe a thing, in parts.

    Args:
        thing: What to describe.
        ancestors: id() of every object that contains the thing, from the outermost.

    Raises:
        Undescribed: It has no complete description.
    """
    if id(thing) in ancestors:  # a function that closes over itself: how many levels above
        yield f"above {len(ancestors) - ancestors.index(id(thing))}".encode()
        return
    yield place(type(thing))
    match thing:
        case type():
            yield place(thing)
        case Enum():
            yield thing.name.encode()
        case None | bool() | int() | float() | complex() | str() | bytes():
            yield repr(thing).encode()
        case np.ndarray() | np.generic() | jax.Array():
            yield from array_parts(thing)
        case _:
            inside = consists_of(thing)
            yield str(len(inside)).encode()
            for part in inside:
                yield from description_parts(part, (*ancestors, id(thing)))


@cache
def place(kind: type) -> bytes:
    """Where a type is defined.

    Raises:
        Undescribed: Outside of :data:`DESCRIBED`, or within a function, which may define another at each call.
    """
    if package_of(kind.__module__) not in DESCRIBED or "<locals>" in kind.__qualname__:
        raise Undescribed(kind)
    return f"{kind.__module__}.{kind.__qualname__}".encode()


def package_of(module: str) -> str:
    """The package that a module belongs to."""
    return module.partition(".")[0]


def array_parts(array: Any) -> Iterator[bytes]:
    """Type, shape and numbers of an array."""
    if getattr(array.dtype, "kind", "") not in PLAIN:
        raise Undescribed(array.dtype)
    numbers = np.asarray(array)
    yield f"{numbers.dtype.str} {numbers.shape}".encode()
    yield np.ascontiguousarray(numbers).tobytes()


def consists_of(thing: Any) -> list[Any]:
    """What a container, a function or an object of a known type consists of.

    Raises:
        Undescribed: Its parts are not known.
    """
    match thing:
        case tuple() | list():
            return list(thing)
        case Mapping():
            return [part for item in thing.items() for part in item]
        case functools.partial():
            return [thing.func, thing.args, thing.keywords]
        case types.MethodType():
            return [thing.__func__, thing.__self__]
        case types.FunctionType():
            return function_parts(thing)
        case types.BuiltinFunctionType() | np.ufunc():
            return [thing.__name__]
        case jax.ShapeDtypeStruct():
            return [thing.shape, str(thing.dtype)]
        case _ if hasattr(type(thing), "model_fields"):  # of pydantic
            return [thing.model_extra, *(getattr(thing, name) for name in type(thing).model_fields)]
        case _ if is_dataclass(thing):
            return [getattr(thing, field.name) for field in fields(thing) if field.compare]
        case _ if hasattr(thing, "__wrapped__"):  # compiled or cached
            return [thing.__wrapped__]
    raise Undescribed(thing)


def function_parts(function: types.FunctionType) -> list[Any]:
    """Where a function's code is, and the values that it has from its definition.

    Raises:
        Undescribed: Its code is outside of :data:`DESCRIBED`.
    """
    module, code = function.__globals__["__name__"], function.__code__  # a decorator may have changed __module__
    if package_of(module) not in DESCRIBED:
        raise Undescribed(function)
    closed_over = [cell.cell_contents for cell in function.__closure__ or ()]
    given = closed_over, function.__defaults__, function.__kwdefaults__
    return [module, code.co_qualname, str(list(code.co_positions())), *given]
