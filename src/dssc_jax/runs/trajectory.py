"""Trajectories of single draws: ``simulate`` for a study, and ``replay`` for a stored result, which it checks."""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import TYPE_CHECKING, TypeAlias

import jax
import numpy as np
import xarray as xr

from dssc_jax.closed_loop.draw import Run, simulate_recorded
from dssc_jax.closed_loop.loop import signal_name
from dssc_jax.closed_loop.sample import Recorded
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.named import quantity_of, signals_in
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import Quantity, nominal, quantities_of, unit_and_meaning
from dssc_jax.engine import kernels
from dssc_jax.engine.batching import lane_names, margins_in, values_of_draws
from dssc_jax.engine.linearisation.margin_values import margin_values
from dssc_jax.engine.reference import Agreement, agreement
from dssc_jax.engine.sampling import draw_key
from dssc_jax.results.schema import outcome_codes, variables, verdict
from dssc_jax.runs.design_choice import warn_of_open_choice
from dssc_jax.study import Study, takes_file

if TYPE_CHECKING:
    from dssc_jax.results.result import Result

MOST_SAMPLES = 5_000_000  # of a trajectory
SIGNALS = {
    "y": Quantity("y", "output y"),
    "y_dot": Quantity("y/s", "output's derivative y'"),
    "y_ref": Quantity("y", "desired output y_m"),
    "e": Quantity("y", "output error e"),
    "sigma": Quantity("y/s", "sigma = e' + l_0 e"),
    "y_measured": Quantity("y", "output y as the controller sees it"),
    "y_dot_measured": Quantity("y/s", "output's derivative y' as the controller sees it"),
    "sigma_measured": Quantity("y/s", "sigma as the controller sees it"),
    "u": Quantity("u", "robust command u"),
    "u_total": Quantity("u", "total command u + u_n"),
}
"""Unit and meaning of the signals that every channel has; controllers and plants declare those of their infos."""


RecordedLane: TypeAlias = Callable[[dict[str, jax.Array], jax.Array], tuple[Run, Recorded]]
"""``(numbers of the lane by name, draw index) -> result and recorded samples of the draw``."""


def lane_values(study: Study, draw: int, point: Mapping[str, float]) -> dict[str, float]:
    """Values of the uncertain and swept numbers, by name, of one draw at a point of the sweep.

    Raises:
        ConfigError: The draw is not in the study, or ``point`` does not have the names of the sweep.
    """
    require_draw(study, draw, study.source)
    require_swept(study, point)
    missing = [name for name in study.axes if name not in point]
    if missing:
        raise ConfigError(study.source, f"the point needs a value of {', '.join(missing)}")
    columns = values_of_draws(study, slice(draw, draw + 1))  # shape (1,) each
    values = {name: float(column[0]) for name, column in columns.items()}
    return {**values, **point}


def require_draw(study: Study, draw: int, source: str) -> None:
    """Require that a study has a draw with this index.

    Args:
        study: The study.
        draw: Index of the draw.
        source: The study's file or the results folder, for the message.

    Raises:
        ConfigError: The study has no such draw.
    """
    if not 0 <= draw < study.config.draws:
        raise ConfigError(source, f"draw must be in 0 .. {study.config.draws - 1}, got {draw}")


def require_swept(study: Study, names: Iterable[str]) -> None:
    """Require that a study sweeps the numbers with these names.

    Raises:
        ConfigError: A number is not swept.
    """
    for name in names:
        if name not in study.axes:
            raise ConfigError(study.source, f"'{name}' is not swept; {nearest(name, study.axes)}")


@takes_file
def simulate(study: Study, draw: int = 0, *, point: Mapping[str, float] | None = None, every: int = 1) -> xr.Dataset:
    """Simulate one draw and return its trajectory.

    Args:
        study: The study, or its file.
        draw: Index of the draw.
        point: Value of each swept parameter; None: the sweep is ignored.
        every: Number of samples from one recorded sample to the next.

    Returns:
        The signals over ``t`` [s]: y, y_dot, y_ref, e, sigma, u, u_total, and the signals that controller and plant
        report. Attributes contain the drawn values and how the draw ended.

    Raises:
        ConfigError: ``draw``, ``point`` or ``every`` is out of range.

    Warns:
        DesignWarning: With ``sampling = "auto"``, a run chooses the design of its draws, and may have another draw.
    """
    warn_of_open_choice(study)
    record = recorder(study if point else study.without_sweep(), every)
    return record(draw, point or {})


def recorder(study: Study, every: int = 1, plain: bool = False) -> Callable[[int, Mapping[str, float]], xr.Dataset]:
    """Return a function that computes trajectories of several draws with one compiled program.

    Args:
        study: The study, including its sweep.
        every: Number of samples from one recorded sample to the next.
        plain: Whether to use plain XLA, independent of the program that computes results.

    Returns:
        ``(draw, point) -> trajectory``, a dataset as from :func:`simulate`.

    Raises:
        ConfigError: ``every`` is out of range. The returned function raises it for ``draw`` and ``point``.
    """
    if every < 1:
        raise ConfigError(study.source, f"every must be >= 1, got {every}")
    every = min(every, study.loop.steps)
    sample_count = math.ceil(study.loop.steps / every)
    if sample_count > MOST_SAMPLES:
        rule = f"a trajectory keeps at most {MOST_SAMPLES} samples, got {sample_count}; raise every"
        raise ConfigError(study.source, rule)

    @cache
    def program() -> Callable[..., tuple[Run, Recorded]]:
        """The program of a lane, compiled when the first trajectory is computed."""
        return kernels.compile_single_lane(recorded_lane(study, every), lane_names(study), plain)

    margins_at = margin_values(study)

    def record(draw: int, point: Mapping[str, float]) -> xr.Dataset:
        """The trajectory of a draw at a point of the sweep."""
        values = lane_values(study, draw, point)
        columns = {name: np.array([value]) for name, value in values.items()}
        margins = {name: column[0] for name, column in margins_at(columns, np.array([draw])).items()}
        with arithmetic(study.config.loop.precision):
            run, recorded = program()(values | margins, draw)
        return as_trajectory(study, draw, values, run, recorded)

    return record


def recorded_lane(study: Study, every: int) -> RecordedLane:
    """Return the program of a lane that records every ``every``-th sample."""

    def lane(values: dict[str, jax.Array], index: jax.Array) -> tuple[Run, Recorded]:
        """The draw's result and its recorded samples."""
        key = draw_key(study.config.seed, index)
        criteria = study.measures, study.requirements
        margins = margins_in(study, values)
        return simulate_recorded(study.loop, study.params(values), key, *criteria, every, margins)

    return lane


def as_trajectory(study: Study, draw: int, values: Mapping[str, float], run: Run, recorded: Recorded) -> xr.Dataset:
    """The recorded signals of one draw as a dataset, with units, meanings and how the draw ended.

    Args:
        study: The study.
        draw: Index of the draw.
        values: The draw's uncertain and swept numbers.
        run: The draw's result.
        recorded: The recorded samples of the draw.
    """
    end = np.fmin(run.failed_at, run.settled_at)  # NaN: the draw has its full length
    has_ended = recorded.instant.t >= end  # from there on the state is frozen
    variables_over_time = {}
    for name, column in trajectory_columns(study, recorded).items():
        if has_ended.any() or column.dtype == bool:  # a flag becomes a number, as where it has gaps
            column = np.where(has_ended, np.nan, column)
        variables_over_time[name] = (("t",), column, column_attributes(name, study))
    code = int(run.outcome)
    settled_at = {"settled_at": float(run.settled_at)} if study.loop.settled else {}
    numbers = {**run.metrics, **run.slacks, **run.violated_at}
    return xr.Dataset(
        variables_over_time,
        coords={"t": (("t",), recorded.instant.t, unit_and_meaning("s", "time"))},
        attrs={
            "study": study.name,
            "draw": draw,
            **values,
            **events_in(study, values),
            "outcome": code,
            "outcome_meaning": outcome_codes(study)[code],
            "verdict": verdict(study, code, run.slacks),
            "failed_at": float(run.failed_at),
            **settled_at,
            **{name: float(value) for name, value in numbers.items()},
        },
    )


def events_in(study: Study, values: Mapping[str, float]) -> dict[str, list[str] | list[float]]:
    """Kinds and times [s] of a study's events in a draw, as attributes of a trajectory; empty without events.

    Args:
        study: The study.
        values: The draw's uncertain and swept numbers, by name.
    """
    if not study.config.event:
        return {}
    plain_values = study.leaves()
    values_of_draw = {**study.derived(values), **values}
    kinds = []
    times = []
    for index, table in enumerate(study.config.event):
        kinds.append(str(table.get("kind", "rotor")))
        name = f"event.{index}.at"
        times.append(float(values_of_draw.get(name, nominal(plain_values[name]))))
    return {"event_kinds": kinds, "event_times": times}


def trajectory_columns(study: Study, recorded: Recorded) -> dict[str, np.ndarray]:
    """Every recorded signal over time, by the name of its column, such as ``x_e`` for the error of channel x."""
    columns = {}
    instant = recorded.instant
    for i, channel in enumerate(study.loop.channels):
        measurement = recorded.measurements[i]
        reference = recorded.references[i]
        sample = instant.channels[i]
        signals = {
            "y": measurement.y,
            "y_dot": measurement.y_dot,
            "y_ref": reference.y,
            "e": sample.e,
            "sigma": sample.sigma,
            "y_measured": sample.y_measured,
            "y_dot_measured": sample.y_dot_measured,
            "sigma_measured": sample.sigma_measured,
            "u": sample.u,
            "u_total": sample.u_total,
            **signals_in(sample.info),
        }
        columns |= {signal_name(channel, name): values for name, values in signals.items()}
    for signal, values in zip(study.loop.measures, instant.measured, strict=True):
        columns[f"measured_{signal.name}"] = values
    return columns | signals_in(instant.plant)


def column_attributes(name: str, study: Study) -> dict[str, str]:
    """Unit and meaning of a trajectory's column, as attributes of a dataset's variable.

    A signal that is not declared has an empty unit, and its name as its meaning.

    Args:
        name: Name of the column, with the channel's name in front if the signal belongs to a channel.
        study: The study.
    """
    channel, _, field = name.partition("_")
    has_channel = channel in study.loop.channels and bool(channel) and bool(field)
    signal = field if has_channel else name
    index = study.loop.channels.index(channel) if has_channel else 0
    units = study.units[index]
    controllers = study.loop.controller
    has_controllers = isinstance(controllers, tuple)  # not those of a study whose code was not loaded
    info = controllers[index].info if has_controllers else None
    quantities = SIGNALS | measured_quantities(study) | quantities_of(info)
    quantity = quantities.get(signal)
    if quantity is None and not has_channel:
        quantity = quantity_of(signal, study.loop.quantities)
    unit = "" if quantity is None else units.of(quantity.unit)
    meaning = signal if quantity is None else units.describe(quantity.meaning)
    return unit_and_meaning(unit, f"{channel}: {meaning}" if has_channel else meaning)


def measured_quantities(study: Study) -> dict[str, Quantity]:
    """Unit and meaning of the column of each measured signal."""
    quantities = {}
    for signal in study.loop.measures:
        quantity = signal.quantity
        quantities[f"measured_{signal.name}"] = Quantity(quantity.unit, f"measured {quantity.meaning}")
    return quantities


def replay(result: "Result", draw: int, *, point: Mapping[str, float] | None = None, every: int = 1) -> xr.Dataset:
    """Simulate one draw of a result again, by the plain program, and compare it with the stored values.

    Args:
        result: A loaded or fresh result.
        draw: Index of the draw.
        point: Value of swept parameters, rounded to the nearest value of the sweep; a parameter that is left out has
            its first value. None: the point at which the draw has its smallest relative slack, or the first point if
            there are no requirements.
        every: Number of samples from one recorded sample to the next.

    Returns:
        A trajectory as from :func:`simulate`. The attribute ``agreement`` is the verdict on the metrics (see
        :class:`dssc_jax.engine.reference.Agreement`), and ``deviation`` is the largest relative deviation of a metric.

    Raises:
        ConfigError: ``draw`` or ``point`` is not in the result.
    """
    study = result.study
    index = point_of(result, draw, point)
    exact = {name: study.axes[name][i] for name, i in index.items()}
    record = recorder(study if exact else study.without_sweep(), every, plain=True)
    trajectory = record(draw, exact)
    comparison = agreement_of(result, trajectory)
    trajectory.attrs["deviation"] = float(comparison.deviation[0])
    trajectory.attrs["agreement"] = comparison.verdict
    return trajectory


def point_of(result: "Result", draw: int, point: Mapping[str, float] | None) -> dict[str, int]:
    """The point of the sweep at which :func:`replay` simulates a draw again: an index along each axis, by name.

    Args:
        result: The result.
        draw: Index of the draw.
        point: Value of swept parameters; a parameter that is left out has its first value. None or empty: the point of
            :func:`worst_point`.

    Raises:
        ConfigError: ``draw`` or ``point`` is not in the result.
    """
    study = result.study
    require_draw(study, draw, str(result.path or study.source))
    require_swept(study, point or {})
    if not point:
        return worst_point(result, draw)
    return {name: nearest_index(values, point.get(name)) for name, values in study.axes.items()}


def agreement_of(result: "Result", run: xr.Dataset) -> Agreement:
    """Compare the metrics of a trajectory with the stored metrics of the same draw.

    Args:
        result: The result.
        run: The trajectory, whose attributes contain draw, swept values and metrics.
    """
    study = result.study
    point = [np.array([axis.index(run.attrs[name])]) for name, axis in study.axes.items()]
    names = [name for name in variables(study) if name in run.attrs]
    trajectory_values = {name: np.array([run.attrs[name]]) for name in names}
    draw = np.array([run.attrs["draw"]])
    return agreement(study, result.dataset, (*point, draw), trajectory_values)


def nearest_index(values: tuple[float, ...], requested: float | None) -> int:
    """Index of the swept value nearest to a requested value; 0 if the requested value is None."""
    if requested is None:
        return 0
    return int(np.argmin(np.abs(np.asarray(values) - requested)))


def worst_point(result: "Result", draw: int) -> dict[str, int]:
    """The point of the sweep at which a draw has its smallest relative slack: an index along each axis, by name.

    The slacks of all requirements are compared, each relative to its scale. If there are no requirements, the result is
    the first point.
    """
    axes = list(result.study.axes)
    requirements = result.study.requirements
    if not axes or not requirements:
        return dict.fromkeys(axes, 0)
    slacks = [result.dataset[rule.name].isel(draw=draw).values / rule.scale for rule in requirements]
    smallest_slack = np.min(slacks, axis=0)  # of all requirements, at each point
    index = np.unravel_index(np.argmin(smallest_slack), smallest_slack.shape)
    return dict(zip(axes, map(int, index), strict=True))
