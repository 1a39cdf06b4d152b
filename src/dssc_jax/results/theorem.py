"""Theorem 1 applied to the study of a result."""

from typing import TYPE_CHECKING

from dssc_jax.study import Study
from dssc_jax.study.tables import channel_table

if TYPE_CHECKING:
    from dssc_jax.design.certification import Mark

TABLE_1 = "vgsta"
"""Kind of the functions of Table 1 of the article, in ``[controller.functions]``."""


def has_table_1(study: Study) -> bool:
    """Whether the controller of any channel is DSSC with the functions of Table 1, which Theorem 1 concerns."""
    common = study.config.controller
    tables = [common]
    for channel in study.loop.channels:
        override = common.get(channel)
        if isinstance(override, dict):
            tables.append(channel_table(common, override))
    for table in tables:
        functions = table.get("functions")
        if table.get("kind") == "dssc" and isinstance(functions, dict) and functions.get("kind") == TABLE_1:
            return True
    return False


def theorem_mark(study: Study) -> "Mark | None":
    """Verdict of Theorem 1 on each point of a study's sweep; None if no controller has the functions of Table 1."""
    if not has_table_1(study):
        return None
    from dssc_jax.design.certification import mark  # not loaded for a result whose certificate is not shown

    return mark(study)
