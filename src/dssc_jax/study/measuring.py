"""From a study's tables to what is measured and required."""

from dssc_jax.errors import ConfigError, meant
from dssc_jax.metrics import BRIEF, METRICS, Measure, Scope, Window, first_sample
from dssc_jax.requirements import Requirement
from dssc_jax.study.schema import StudyTable


def measured(
    config: StudyTable, names: dict[str, tuple[str, int | None]], several: bool
) -> tuple[tuple[Measure, ...], tuple[Requirement, ...]]:
    """The metrics over the study's window, and one more for each requirement with its own."""
    base = Window(config.metrics.after, config.metrics.settling_band)
    require_samples(config, base, "metrics.after")
    kinds = config.metrics.names if config.metrics.names is not None else default_kinds(several)
    for index, kind in enumerate(kinds):
        if kind not in METRICS:
            raise ConfigError(f"metrics.names.{index}", f"unknown metric '{kind}'; {meant(kind, METRICS)}")
    measures = {name: Measure(name, kind, base, at) for name, (kind, at) in names.items() if kind in kinds}
    requirements = []
    for index, table in enumerate(config.requirement):
        place = f"requirement.{index}"
        if table.metric not in names:
            if table.metric in METRICS and not several:
                needs = ", ".join(METRICS[table.metric].needs)
                raise ConfigError(f"{place}.metric", f"'{table.metric}' needs {needs}, which this loop does not have")
            raise ConfigError(f"{place}.metric", f"unknown metric '{table.metric}'; {meant(table.metric, names)}")
        after = base.after if table.after is None else table.after
        window = Window(after, table.settling_band or base.band)
        require_samples(config, window, f"{place}.after")
        name = table.metric if window == base else f"{table.metric}_after_{after:.12g}"
        if window.band != base.band:
            name += f"_within_{window.band:.12g}"
        measures.setdefault(name, Measure(name, names[table.metric][0], window, names[table.metric][1]))
        requirement = Requirement(measures[name], table.max, table.min)
        if any(requirement.name == other.name for other in requirements):
            raise ConfigError(place, f"'{table.metric}' is bounded on this side already; keep the stricter one")
        requirements.append(requirement)
    if config.plot.metric is not None and config.plot.metric not in measures:
        raise ConfigError(
            "plot.metric", f"unknown metric '{config.plot.metric}'; {meant(config.plot.metric, measures)}"
        )
    return tuple(measures.values()), tuple(requirements)


def require_samples(config: StudyTable, window: Window, place: str) -> None:
    """Require that a sample lies in the window.

    Raises:
        ConfigError: none does.
    """
    if first_sample(window, config.loop.sample_time) >= config.loop.steps:
        last = (config.loop.steps - 1) * config.loop.sample_time
        raise ConfigError(place, f"must be <= the time of the last sample {last:g} s, got {window.after:g}")


def default_kinds(several: bool) -> tuple[str, ...]:
    """Every metric for one channel; for several the brief list, and those of the vehicle."""
    vehicle = tuple(kind for kind, metric in METRICS.items() if metric.scope is Scope.VEHICLE)
    return (*BRIEF, *vehicle) if several else tuple(METRICS)
