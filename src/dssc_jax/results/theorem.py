"""Theorem 1 applied to the study of a result, computed when it is shown and never during a run."""

from typing import TYPE_CHECKING

from dssc_jax.study import Study
from dssc_jax.study.tables import merged

if TYPE_CHECKING:
    from dssc_jax.design.certification import Mark

TABLE_1 = "vgsta"
"""Kind of the functions of Table 1."""


def has_table_1(study: Study) -> bool:
    """Whether a channel's controller is DSSC with the functions of Table 1."""
    common = study.config.controller
    tables = [common]
    for channel in study.loop.channels:
        override = common.get(channel)
        if isinstance(override, dict):
            tables.append(merged(common, override))
    kinds = [(table.get("kind"), table.get("functions", {}).get("kind")) for table in tables]
    return ("dssc", TABLE_1) in kinds


def theorem_mark(study: Study) -> "Mark | None":
    """Theorem 1's mark of every point of a study's sweep; None without the functions of Table 1."""
    if not has_table_1(study):
        return None
    from dssc_jax.design.certification import mark  # a result whose certificate nobody asks for does not load it

    return mark(study)
