"""The study of one draw: its numbers take the place of laws, and the controllers stay as in the whole study."""

from collections.abc import Mapping

import numpy as np
from jax.tree_util import tree_leaves, tree_structure

from dssc_jax.study.laws import UncertainValue
from dssc_jax.study.study import Study

POINT = "point"
"""Name of the law with a single value, whose nominal value may be another one."""


def study_of_draw(study: Study, numbers: Mapping[str, float]) -> Study:
    """Make the study of one draw, which flies exactly as among all draws of the given study.

    Some values follow from nominal numbers when a study is read, such as the gains of a fitted controller or the mass
    that an inner loop assumes. Plain numbers in place of the laws may change such a value. In this case, each law is
    replaced by a law ``point`` with the draw's number and the nominal value of the former law.

    Args:
        study: Study without a sweep.
        numbers: Values of the draw's numbers, by dotted name.

    Raises:
        ConfigError: The study is not valid with these numbers.
    """
    plain = study.override({"correlation": {}, **numbers})
    if certain_values_agree(study, plain):
        return plain
    points = {}
    for name, value in numbers.items():
        law = study.laws.get(name)
        points[name] = value if law is None else {POINT: [value, law.nominal]}
    return study.override({"correlation": {}, **points})


def certain_values_agree(study: Study, plain: Study) -> bool:
    """Whether every value without a law is the same in a study and in the study with numbers in place of its laws.

    Args:
        study: The study, whose template contains laws.
        plain: The same study with numbers in place of the laws.
    """
    if tree_structure(study.template) != tree_structure(plain.template):
        return False
    for leaf, plain_leaf in zip(tree_leaves(study.template), tree_leaves(plain.template), strict=True):
        if isinstance(leaf, UncertainValue):  # a law, or an expression of parameters with laws
            continue
        if not np.array_equal(leaf, plain_leaf):  # a recorded signal is an array
            return False
    return True
