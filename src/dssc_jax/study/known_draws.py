"""The study of one draw whose numbers are known, with the controllers of the study from which it comes."""

from collections.abc import Mapping

import numpy as np
from jax.tree_util import tree_leaves, tree_structure

from dssc_jax.study.laws import UncertainValue
from dssc_jax.study.study import Study

POINT = "point"
"""The law of a number that is known, with another nominal value."""


def study_of_draw(study: Study, numbers: Mapping[str, float]) -> Study:
    """A study with numbers in place of laws, in which a draw flies as it did among all draws.

    Some values follow from nominal numbers when a study is read, such as the gains of a fitted controller and the mass
    that an inner loop believes. They stay those of the study: where plain numbers would change them, laws ``point``
    state each number beside its nominal value.

    Args:
        study: The study, without a sweep.
        numbers: Values of numbers that have laws in it, by dotted name.

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
    """Whether all that is no law in a study's template is the same in that of another one."""
    if tree_structure(study.template) != tree_structure(plain.template):
        return False
    for leaf, plain_leaf in zip(tree_leaves(study.template), tree_leaves(plain.template), strict=True):
        if not isinstance(leaf, UncertainValue) and not np.array_equal(leaf, plain_leaf):  # a record is an array
            return False
    return True
