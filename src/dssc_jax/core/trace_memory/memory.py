"""What follows from a study alone: kept in the user's cache under a name for all that it follows from."""

from collections.abc import Callable
from typing import Any, TypeVar

from dssc_jax.core.trace_memory.facts import decoded, encoded
from dssc_jax.core.trace_memory.names import name_of
from dssc_jax.lanes.program_cache import cache_directory, cached

T = TypeVar("T")


def remembered(label: str, compute: Callable[[], T], *subjects: Any) -> T:
    """A result that follows from subjects alone: from the user's cache, or computed and stored there.

    Args:
        label: Label of the cached quantity.
        compute: Computes it, as a tree that :func:`dssc_jax.core.trace_memory.facts.encoded` knows.
        subjects: All that it follows from, beside this package's code, as :func:`name_of` describes it.
    """
    name = None if cache_directory() is None else name_of(label, *subjects)
    return compute() if name is None else decoded(cached(f"{label}-{name}", lambda: encoded(compute())))
