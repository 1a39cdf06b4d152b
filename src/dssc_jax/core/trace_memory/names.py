"""Names of results in the cache: equal names imply equal results.

A name is a digest of the package's sources, of the versions of the libraries, of JAX's settings and of the subjects on
which the result depends: numbers, containers, parameters, models, and functions with all that they close over. Some
subjects have no name because they cannot be described completely. An example is a model of the user's own: its code,
and the code that it calls, may change without notice.

A change of code in the running process alone, such as an assignment to a function's name in a module, is not noticed.
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
"""Packages whose functions and types can be described: their code is fixed by sources or version."""

PLAIN = tuple("biufc")
"""NumPy's kinds of dtypes whose bytes describe an array: truth values, integers, unsigned, real and complex numbers."""

VERSIONED = ("jax", "jaxlib", "numpy", "scipy", "llvmlite")
"""Libraries whose versions are part of a name."""


class Undescribed(Exception):
    """A subject that a name cannot describe completely."""


def cache_key(*subjects: Any) -> str | None:
    """Return the name under which the cache keeps a result that depends on the subjects and on this package's code.

    Returns:
        A digest in hexadecimal; None if a subject cannot be described, or if the package's files have changed since
        their import.
    """
    sources = sources_digest()
    if sources is None:
        return None
    digest = hashlib.sha256()
    try:
        for part in description_parts((sources, versions(), sorted(jax.config.values.items()), subjects), ()):
            digest.update(f"{len(part)}:".encode() + part)
    except Undescribed:
        return None
    return digest.hexdigest()


@cache
def sources_digest() -> str | None:
    """Return the digest of the package's source files in hexadecimal, computed once in a process.

    The result is None if there are no source files, or if one may have changed since this process imported the package.
    """
    root = package_root()
    digest = hashlib.sha256()
    sources = package_sources()
    for file in sources:
        status = file.stat()
        if max(status.st_mtime, status.st_ctime) >= dssc_jax.IMPORTED:
            return None
        digest.update(f"{file.relative_to(root)}:{status.st_size}:".encode() + files.read_bytes(file))
    return digest.hexdigest() if sources else None


def package_root() -> Path:
    """Return the folder of the package dssc_jax."""
    return Path(dssc_jax.__file__).parent


def package_sources() -> list[Path]:
    """Return the package's source files, sorted; an empty list if the package is imported from an archive."""
    return sorted(package_root().rglob("*.py"))


@cache
def versions() -> tuple[str, ...]:
    """Return the versions of Python and of the libraries that take part in a trace."""
    return platform.python_version(), *map(version, VERSIONED)


def description_parts(subject: Any, ancestors: tuple[int, ...]) -> Iterator[bytes]:
    """Yield the description of a subject as pieces of bytes: its type, then its value or the description of its parts.

    Args:
        subject: The object.
        ancestors: ``id`` of every object that contains the subject, outermost first. A subject that is among these, as
            in a function that closes over itself, is described by its distance.

    Raises:
        Undescribed: The subject has no complete description.
    """
    if id(subject) in ancestors:  # a function that closes over itself: the number of levels up
        yield f"above {len(ancestors) - ancestors.index(id(subject))}".encode()
        return
    yield qualified_name(type(subject))
    match subject:
        case type():
            yield qualified_name(subject)
        case Enum():
            yield subject.name.encode()
        case None | bool() | int() | float() | complex() | str() | bytes():
            yield repr(subject).encode()
        case np.ndarray() | np.generic() | jax.Array():
            yield from array_parts(subject)
        case _:
            parts = parts_of(subject)
            yield str(len(parts)).encode()
            for part in parts:
                yield from description_parts(part, (*ancestors, id(subject)))


@cache
def qualified_name(kind: type) -> bytes:
    """Return the module and name of a type.

    Raises:
        Undescribed: The type belongs to no package of :data:`DESCRIBED`, or is defined in a function, which may define
            a different one at each call.
    """
    if package_of(kind.__module__) not in DESCRIBED or "<locals>" in kind.__qualname__:
        raise Undescribed(kind)
    return f"{kind.__module__}.{kind.__qualname__}".encode()


def package_of(module: str) -> str:
    """Return the package that a module belongs to."""
    return module.partition(".")[0]


def array_parts(array: Any) -> Iterator[bytes]:
    """Describe an array by its dtype, shape and numbers.

    Raises:
        Undescribed: The dtype is not one of :data:`PLAIN`; that of random keys is an example.
    """
    if getattr(array.dtype, "kind", "") not in PLAIN:
        raise Undescribed(array.dtype)
    numbers = np.asarray(array)
    yield f"{numbers.dtype.str} {numbers.shape}".encode()
    yield np.ascontiguousarray(numbers).tobytes()


def parts_of(subject: Any) -> list[Any]:
    """Return the parts that determine a container, a function, or an object of another supported type.

    Raises:
        Undescribed: The type is not supported.
    """
    match subject:
        case tuple() | list():
            return list(subject)
        case Mapping():
            return [part for item in subject.items() for part in item]
        case functools.partial():
            return [subject.func, subject.args, subject.keywords]
        case types.MethodType():
            return [subject.__func__, subject.__self__]
        case types.FunctionType():
            return function_parts(subject)
        case types.BuiltinFunctionType() | np.ufunc():
            return [subject.__name__]
        case jax.ShapeDtypeStruct():
            return [subject.shape, str(subject.dtype)]
        case _ if hasattr(type(subject), "model_fields"):  # of pydantic
            return [subject.model_extra, *(getattr(subject, name) for name in type(subject).model_fields)]
        case _ if is_dataclass(subject):
            return [getattr(subject, field.name) for field in fields(subject) if field.compare]
        case _ if hasattr(subject, "__wrapped__"):  # compiled or cached
            return [subject.__wrapped__]
    raise Undescribed(subject)


def function_parts(function: types.FunctionType) -> list[Any]:
    """Return the parts that determine a function: the place of its code, the values it closes over, and its defaults.

    The place stands for the code itself, because the digest of the sources or the version of a library fixes the code.

    Raises:
        Undescribed: The code belongs to no package of :data:`DESCRIBED`.
    """
    module = function.__globals__["__name__"]  # a decorator may have changed __module__
    if package_of(module) not in DESCRIBED:
        raise Undescribed(function)
    code = function.__code__
    place = [module, code.co_qualname, str(list(code.co_positions()))]
    closed_over = [cell.cell_contents for cell in function.__closure__ or ()]
    return [*place, closed_over, function.__defaults__, function.__kwdefaults__]
