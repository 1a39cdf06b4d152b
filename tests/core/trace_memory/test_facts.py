"""Trees of plain values survive a file."""

from collections import OrderedDict
from typing import NamedTuple

import numpy as np
import pytest

from dssc_jax.core.trace_memory.facts import decode, encode
from dssc_jax.core.trace_memory.names import Undescribed
from dssc_jax.core.vectors import Vec3
from dssc_jax.engine.evaluation import Derivative


class Foreign(NamedTuple):
    x: int


@pytest.mark.parametrize(
    "tree",
    [
        None,
        (1, 2.5, True, "text", None, [1, [2]], ()),
        {"a": (1,), Derivative("error", "mu"): {}, 3: "3"},
        OrderedDict([("z", Vec3(1.0, (2,), Vec3(0, 0, 0))), ("a", [])]),
        (np.dtype(np.float32), np.dtype(bool), np.dtype(np.uint32)),
        {"tuple": 1, "dtype": 2, "dict": [[1, 2]]},
    ],
    ids=str,
)
def test_a_tree_is_restored_with_its_types(tree):
    def typed(part):
        inside = part.items() if isinstance(part, dict) else part if isinstance(part, list | tuple) else ()
        return type(part), [typed(each) for each in inside]

    again = decode(encode(tree))
    assert again == tree
    assert typed(again) == typed(tree)


@pytest.mark.parametrize("tree", [Foreign(1), [{1, 2}], {"a": np.zeros(2)}, ({1j},), b"bytes"], ids=str)
def test_nothing_else_is_written(tree):
    with pytest.raises(Undescribed):
        encode(tree)
