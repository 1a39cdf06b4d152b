"""The study of one draw, with its numbers in place of laws and with the controllers of the whole study."""

from collections.abc import Mapping

import numpy as np
from jax.tree_util import tree_leaves, tree_structure

from dssc_jax.study.laws import UncertainValue
from dssc_jax.study.study import Study

POINT = "point"
"""Name of the law of a single value with another nominal value."""


def study_of_draw(study: Study, numbers: Mapping[str, float]) -> Study:
    """A study with numbers in place of laws, in which a draw flies exactly as it did among all draws.

    Some values follow from nominal numbers when a study is read, such as the gains of a fitted controller or the mass
    that an inner loop assumes. If plain numbers would change these values, each number becomes a law ``point``, which
    states it beside its nominal value.

    Args:
        study: Study without a sweep.
        numbers: Values of the draw's numbers, by dotted name.

    Raises:
        ConfigError: The study is not valid with these numbers.
    """
    plain = study.override({"correlation": {}, **numbers})
    if has_same_nominal_values(study, plain):
        return plain
    points = {}
    for name, value in numbers.items():
        law = study.laws.get(name)
        points[name] = value if law is None else {POINT: [value, law.nominal]}
    return study.override({"correlation": {}, **points})


def has_same_nominal_values(study: Study, plain: Study) -> bool:
    """Whether two studies agree in all leaves of the template that are no laws in the first one."""
    if tree_structure(study.template) != tree_structure(plain.template):
        return False
    for leaf, plain_leaf in zip(tree_leaves(study.template), tree_leaves(plain.template), strict=True):
        if isinstance(leaf, UncertainValue):
            continue
        if not np.array_equal(leaf, plain_leaf):  # a recorded signal is an array
            return False
    return True
