"""What a search for the worst draw requires of a study, and the requirements that it leaves out."""

from dssc_jax.analyses.defaults import LEAST_BUDGET, MOST_BUDGET
from dssc_jax.closed_loop.metrics.requirements import counted_places
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.study import Study

NOTHING_TO_SEARCH = (
    "no number is uncertain, and a search changes only numbers with laws: random noise and signals of the loop stay "
    "those of draw 0; give laws, or count the draws that fail by run"
)


def require_falsifiable(study: Study, budget: int) -> None:
    """Require a study in which a search can find a failing draw, and an admissible number of simulations.

    Args:
        study: The study.
        budget: Number of simulations of the search.

    Raises:
        ConfigError: Nothing is uncertain, nothing is required, or the budget is out of range.
    """
    if not study.without_sweep().laws:
        raise ConfigError(study.source, NOTHING_TO_SEARCH)
    if not study.requirements:
        raise ConfigError(study.source, "nothing is required, so nothing can fail; give a [[requirement]]")
    if not LEAST_BUDGET <= budget <= MOST_BUDGET:
        raise ConfigError("budget", f"must be in {LEAST_BUDGET} .. {MOST_BUDGET}, got {budget}")


def require_label(study: Study, requirement: str) -> None:
    """Require a label that names a requirement of the study, or an empty label.

    Args:
        study: The study.
        requirement: Label of the only requirement that counts; empty: all count.

    Raises:
        ConfigError: The study has no requirement with this label.
    """
    if not counted_places(study.requirements, requirement):
        labels = [candidate.label for candidate in study.requirements]
        rule = f"'{requirement}' is not required by this study; {nearest(requirement, labels)}"
        raise ConfigError("requirement", rule)


def without_other_margins(study: Study, requirement: str) -> Study:
    """Remove required margins from the study if only one requirement counts, and it does not bound a margin.

    A margin costs more time than many flights, so a search does not compute margins that it would ignore.

    Args:
        study: The study.
        requirement: Label of the only requirement that counts; empty: all count, and the study stays as it is.
    """
    counted_requirements = [study.requirements[place] for place in counted_places(study.requirements, requirement)]
    if any(required.measure.metric.margin is not None for required in counted_requirements):
        return study
    tables = study.table.get("requirement", [])
    tables_without_margin = []
    for table, parsed in zip(tables, study.config.requirement, strict=True):
        if parsed.margin is None:
            tables_without_margin.append(table)
    if len(tables_without_margin) == len(tables):
        return study
    return study.override({"requirement": tables_without_margin})
