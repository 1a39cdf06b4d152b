"""Print the failure probability under laws that are wrong by amounts that the user states."""

from collections.abc import Iterable

from dssc_jax.console.terminal import show_table
from dssc_jax.results.stated_errors import StatedError
from dssc_jax.statistics import rounded_probability


def show_stated(errors: Iterable[StatedError]) -> None:
    """Print the intervals of the failure probability for each stated amount; print nothing if no amount is stated."""
    rows = []
    for error in errors:
        weighted = interval_text(error.weighted_interval) if error.weighted_interval else error.weights_refused
        guaranteed = interval_text(error.interval) if error.interval else "none, correlated"
        rows.append((error.text, guaranteed, weighted))
    if rows:
        show_table(("laws wrong by", "failure probability, whatever draws fail", "by the draws' weights"), rows)


def interval_text(interval: tuple[float, float]) -> str:
    """Format an interval of a probability; a bound below 1 is never rounded to 1."""
    low, high = map(rounded_probability, interval)
    return f"[{low}, {high}]"
