"""Results of traces in the user's cache, each under a name that describes everything on which the result depends."""

from collections.abc import Callable
from typing import Any, TypeVar

from dssc_jax.core.trace_memory.facts import decode, encode
from dssc_jax.core.trace_memory.names import cache_key
from dssc_jax.lanes.program_cache import cache_directory, cached

T = TypeVar("T")


def cached_by_subjects(label: str, compute: Callable[[], T], *subjects: Any) -> T:
    """Read a result from the user's cache; compute and store it if it is not there.

    Args:
        label: Label of the result, such as ``signature``.
        compute: Computes the result, a tree that :func:`dssc_jax.core.trace_memory.facts.encode` can write.
        subjects: Everything on which the result depends, apart from this package's code. If :func:`cache_key` cannot
            describe a subject, the result is computed and not stored.
    """
    key = None if cache_directory() is None else cache_key(label, *subjects)
    if key is None:
        return compute()
    return decode(cached(f"{label}-{key}", lambda: encode(compute())))
