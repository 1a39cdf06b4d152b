"""Many flights in given winds by one compiled program, and the worst value of each signal in a flight.

A wind is a table of vectors at the times of a grid. Where the wind may jump, each vector holds until the next time (the
kind ``piecewise``). Where its rate is bounded, the vectors are the knots of a cubic spline (the kind ``spline``), which
stays within every bound on the knots and on their differences.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import unit_and_meaning
from dssc_jax.core.signals import Outcome
from dssc_jax.core.toml import TomlTable
from dssc_jax.engine.batching import BLOCK, medians
from dssc_jax.engine.evaluation import Derivative, Evaluator, GradientEvaluator
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study

AXES = ("x", "y", "z")
KINDS = ("error_max", "error_rate_max", "sigma_max", "tilt_max", "rotor_thrust_max", "rotor_thrust_min")
"""The metrics of a flight that are its signals."""
SMALLEST = ("rotor_thrust_min",)
"""The metrics of which the smallest value is the worst."""
REPLACED = ("requirement", "envelope", "metrics", "sweep", "plot", "tune", "compare", "correlation")
"""Tables of a study that do not matter for a flight in a given wind."""
BEYOND = 3
"""Knots of a spline besides a knot for each segment: before the flight, at its end and after it."""


class WindGrid(NamedTuple):
    """The times at which a wind has a vector: the start of each segment of a flight, or the knots of a spline.

    Args:
        interval: Time between two vectors [s].
        size: Number of vectors.
        smooth: Whether the vectors are knots of a spline; otherwise each vector holds for the interval.
    """

    interval: float
    size: int
    smooth: bool

    @classmethod
    def of(cls, study: Study, segments: int, smooth: bool) -> "WindGrid":
        """The grid that divides a study's flight into at most ``segments`` segments of whole samples.

        A smooth grid has :data:`BEYOND` further knots.

        Args:
            study: The study, for its number of samples and its sample time.
            segments: Largest number of segments.
            smooth: Whether the vectors are the knots of a spline.
        """
        samples = math.ceil(study.loop.steps / segments)  # in a segment
        count = math.ceil(study.loop.steps / samples)
        size = count + BEYOND if smooth else count
        return cls(samples * study.loop.sample_time, size, smooth)

    @property
    def times(self) -> np.ndarray:
        """Times of the vectors [s], shape (size,); the first knot of a spline lies one interval before the flight."""
        first = -1.0 if self.smooth else 0.0  # in intervals
        return (np.arange(self.size) + first) * self.interval

    @property
    def names(self) -> list[str]:
        """Dotted names of the numbers of a wind, component by component: ``wind.x.0``, ``wind.x.1``, ..."""
        names = []
        for axis in AXES:
            names += [f"wind.{axis}.{place}" for place in range(self.size)]
        return names

    def table(self, columns: Sequence[Sequence[object]]) -> TomlTable:
        """The table ``[wind]`` of a study that flies in a wind of this grid.

        Args:
            columns: Values or laws of w_x, of w_y and of w_z at the times, ``size`` entries each.
        """
        components = {axis: list(column) for axis, column in zip(AXES, columns, strict=True)}
        if self.smooth:
            return {"kind": "spline", "interval": self.interval, "at": float(self.times[0]), **components}
        return {"kind": "piecewise", "times": self.times.tolist(), **components}

    def values(self, winds: np.ndarray) -> Arrays:
        """The numbers of n winds by their dotted names, shape (n,) each.

        Args:
            winds: The winds [m/s], shape (n, size, 3).
        """
        rows = np.moveaxis(winds, 2, 1).reshape(len(winds), -1)  # in the order of the names
        return dict(zip(self.names, rows.T, strict=True))


class Signal(NamedTuple):
    """A metric of a flight that a wind can drive to its worst value.

    Args:
        measure: The metric.
        sign: 1 if the largest value is the worst, -1 if the smallest is.
    """

    measure: Measure
    sign: float

    @classmethod
    def of(cls, measure: Measure) -> "Signal":
        """The signal of a metric, whose worst value is the largest or the smallest, depending on its kind."""
        return cls(measure, sign=-1.0 if measure.kind in SMALLEST else 1.0)


@dataclass
class WindFlights:
    """A study that is compiled once, and then simulated in any winds and with any values of its uncertain numbers.

    The study's own wind, sweep, metrics and requirements are replaced. All flights have the in-loop noise of draw 0.

    Args:
        study: The study.
        grid: Times at which the winds have vectors.
        lanes: Largest number of flights in a batch.
        compiled_study: The study that is compiled, whose wind is a table of free numbers.

    Raises:
        ConfigError: The plant does not fly, or a number of the wind is uncertain.
    """

    study: Study
    grid: WindGrid
    lanes: int = BLOCK
    compiled_study: Study = field(init=False)

    def __post_init__(self) -> None:
        """Prepare two programs: one without derivatives, one with derivatives by every number of wind and vehicle."""
        self.compiled_study = flying_study(self.study, self.grid)
        self.signals = {measure.name: Signal.of(measure) for measure in self.compiled_study.measures}
        self.numbers = [name for name in self.compiled_study.laws if not name.startswith("wind.")]
        self._plain = Evaluator(self.compiled_study, {}, self.lanes)
        self._with_gradients = GradientEvaluator(
            self.compiled_study, {}, self.lanes, names=[*self.grid.names, *self.numbers]
        )

    def __call__(self, winds: np.ndarray, numbers: Mapping[str, np.ndarray]) -> Arrays:
        """Fly once in each wind.

        Args:
            winds: The winds [m/s], shape (n, size, 3).
            numbers: Value of each uncertain number, shape (n,) each.

        Returns:
            The value of each signal by name, and ``outcome``, shape (n,) each. A flight that ends early has the worst
            value of every signal, inf or -inf.
        """
        draws = np.zeros(len(winds), int)  # the noise of draw 0
        results = self._plain(draws, self.grid.values(winds) | dict(numbers))
        ended_early = results["outcome"] != Outcome.OK
        values = {"outcome": results["outcome"]}
        for name, signal in self.signals.items():
            values[name] = np.where(ended_early, signal.sign * np.inf, results[name])
        return values

    def with_slopes(self, winds: np.ndarray, numbers: Mapping[str, np.ndarray], names: Sequence[str]) -> "Slopes":
        """Fly once in each wind, and differentiate one signal of each flight by the wind and the uncertain numbers.

        Args:
            winds: The winds [m/s], shape (n, size, 3).
            numbers: Value of each uncertain number, shape (n,) each.
            names: The signal of each flight, n names.

        Returns:
            The derivatives; 0 in place of NaN.
        """
        draws = np.zeros(len(winds), int)  # the noise of draw 0
        results = self._with_gradients(draws, self.grid.values(winds) | dict(numbers))

        def slopes_by(number: str) -> np.ndarray:
            """Derivative of each flight's own signal by a number, shape (n,); 0 in place of NaN."""
            slopes = [results[Derivative(name, number)][flight] for flight, name in enumerate(names)]
            return np.nan_to_num(np.array(slopes))

        columns = np.stack([slopes_by(name) for name in self.grid.names], axis=1)
        by_wind = np.moveaxis(columns.reshape(len(winds), len(AXES), self.grid.size), 1, 2)
        return Slopes(by_wind, {name: slopes_by(name) for name in self.numbers})


class Slopes(NamedTuple):
    """Derivatives of one signal of each of n flights; the signal may differ between flights.

    Args:
        wind: Derivatives by the vectors of the wind, shape (n, size, 3).
        numbers: Derivatives by each uncertain number, shape (n,) each.
    """

    wind: np.ndarray
    numbers: dict[str, np.ndarray]


def require_certain_wind(study: Study) -> None:
    """Refuse a wind with uncertain numbers, since a search varies the wind itself.

    Raises:
        ConfigError: A number of the wind has a law.
    """
    uncertain = [name for name in study.laws if name.startswith("wind.")]
    if uncertain:
        raise ConfigError(uncertain[0], "is uncertain; the wind's bounds must be numbers")


def flying_study(study: Study, grid: WindGrid) -> Study:
    """The study with a wind of free numbers on a grid, and with all signals as its metrics.

    The tables in :data:`REPLACED`, which do not matter for a single flight, are removed.

    Args:
        study: The study.
        grid: Times at which the wind has vectors.

    Raises:
        ConfigError: The plant does not fly, or a number of its wind is uncertain.
    """
    require_certain_wind(study)
    table = {name: value for name, value in study.table.items() if name not in REPLACED}
    free = [{"uniform": [-1.0, 1.0]}] * grid.size  # a law makes a number free; its range does not matter
    loop = dict(study.table["loop"])
    loop.pop("settled", None)
    changes = {"loop": loop, "wind": grid.table((free, free, free)), "metrics": {"names": list(KINDS)}}
    return Study.from_table(table | changes, study.source)


def fly_winds(
    study: Study,
    winds: np.ndarray,
    numbers: Mapping[str, np.ndarray] | None = None,
    *,
    smooth: bool = False,
) -> xr.Dataset:
    """Fly once in each of many given winds, in batches of one compiled program.

    Args:
        study: The study; its own wind, sweep, metrics and requirements are replaced. All flights have the in-loop noise
            of draw 0.
        winds: The winds [m/s], shape (flights, vectors, 3). The vectors divide the flight into equal parts, of whole
            samples; each vector holds over its part. There are fewer vectors than samples.
        numbers: Values of uncertain numbers of the study by dotted name, shape (flights,) each; the others have their
            medians.
        smooth: Whether the vectors are the knots of a cubic spline instead: the first knot a part before the start, the
            second at the start, and the last two at the end and a part after it.

    Returns:
        Along ``flight``: for each channel the largest |e|, |e'| and |sigma| as ``error_max_x``, ``error_rate_max_x``,
        ``sigma_max_x``; ``tilt_max``, ``rotor_thrust_max``, ``rotor_thrust_min``; and ``outcome``, above 0 if
        the flight ended early, whose values are then infinite.

    Raises:
        ConfigError: The winds do not have this shape, a number is unknown, or the plant does not fly.

    Example:
        >>> import numpy as np
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/hover_wind.toml").override({"loop.duration": 5.0})
        >>> winds = np.zeros((2, 10, 3))
        >>> winds[1, :, 0] = 5.0
        >>> dj.fly_winds(study, winds)["error_max_x"].values.round(3).tolist()
        [0.0, 0.317]
    """
    fixed_numbers = dict(numbers or {})
    grid = grid_of_winds(study, np.shape(winds), smooth)
    count = len(winds)
    flights = WindFlights(study, grid, min(BLOCK, count))
    for name in fixed_numbers:
        if name not in flights.numbers:
            raise ConfigError(name, f"is no uncertain number of this study; {nearest(name, flights.numbers)}")
    values = medians(flights.compiled_study) | fixed_numbers
    columns = {name: np.broadcast_to(values[name], (count,)) for name in flights.numbers}
    results = flights(np.asarray(winds, float), columns)
    variables = {}
    for name, signal in flights.signals.items():
        variables[name] = ("flight", results[name], unit_and_meaning(signal.measure.unit, signal.measure.meaning))
    outcome_meaning = "outcome code, above 0 if the flight ended early"
    variables["outcome"] = ("flight", results["outcome"], {"long_name": outcome_meaning})
    return xr.Dataset(variables, attrs={"title": study.name})


def grid_of_winds(study: Study, shape: tuple[int, ...], smooth: bool) -> WindGrid:
    """The grid of times that belongs to winds given as an array.

    Args:
        study: The study.
        shape: Shape of the array, (flights, vectors, 3).
        smooth: Whether the vectors are the knots of a spline.

    Raises:
        ConfigError: The shape is not (flights, vectors, 3), or the vectors do not divide the flight into whole samples.
    """
    more_knots = BEYOND if smooth else 0
    if len(shape) != 3 or shape[2] != len(AXES) or shape[1] <= more_knots:
        raise ConfigError("winds", f"must have the shape (flights, vectors, 3), got {shape}")
    _, vectors, _ = shape
    grid = WindGrid.of(study, vectors - more_knots, smooth)
    if grid.size != vectors:
        rule = f"must divide the {study.loop.steps} samples of the flight into parts of whole samples"
        raise ConfigError("winds", f"{rule}; got {vectors} vectors, of which {grid.size} would do")
    return grid
