"""Show the flight of a vehicle in three dimensions over time, with other draws as ghosts, in Bokeh.

A script in the browser projects all paths for the time of the slider and the direction of view.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from bokeh.events import MouseWheel, Pan
from bokeh.layouts import column
from bokeh.layouts import row as side_by_side
from bokeh.models import ColumnDataSource, CustomJS, Div, LayoutDOM, Range1d, Slider, Toggle
from bokeh.plotting import figure

from dssc_jax.core import files
from dssc_jax.engine.sampling import Arrays
from dssc_jax.exploration.live import ATTITUDE, POSITION, LiveRun, recorded_signals
from dssc_jax.plotting.style import BLUE, DARK, GREY, ORANGE, drawable
from dssc_jax.runs.recorded_draws import SignalKey
from dssc_jax.study import Study

SCRIPT = files.read_text(Path(__file__).with_name("flight_view.js"))
"""JavaScript of all functions that callbacks in the browser call."""
FRAME = 900, 460
"""Width and height of the view [px]."""
VIEW = {"azimuth": -1.0, "elevation": 0.45}
"""Direction from which the flight is seen at first [rad]: from the south-east, above."""
FLOOR_LINES = 11
"""Number of lines of the floor in each direction."""
TAIL = 0.02
"""Share of the positions at each end of an axis that may lie outside the view."""
LAYERS = ("floor", "ghosts", "points", "marks", "flown", "wanted", "craft")
"""Parts of the picture that the script projects, each with a data source of its own."""
LEGEND = (
    "thin blue: draws that pass; orange: draws that fail, with a cross from the moment on at which that was certain; "
    "black: the chosen draw, as far as it has flown; dashed grey: where it should fly. Drag turns the view, the wheel "
    "magnifies. The vehicle is drawn larger than it is: red arm forward, green up."
)


class FlightView:
    """The flights of a run over time: the selected draw with its attitude, all others as ghosts."""

    def __init__(self) -> None:
        """Make the figure and its widgets; until :meth:`show`, all flights stay at the origin."""
        one_line: dict[str, Any] = {name: [[0.0, 0.0]] for name in POSITION}
        names = ("t", *POSITION, *ATTITUDE, *(f"{axis}_ref" for axis in POSITION))
        selected_flight: dict[str, Any] = {name: [0.0] for name in names}
        view: dict[str, Any] = {name: [value] for name, value in VIEW.items()}
        view |= {"cx": [0.0], "cy": [0.0], "cz": [0.0], "span": [1.0]}
        self.scene = ColumnDataSource(view)
        self.tracks = ColumnDataSource({**one_line, "colour": [BLUE], "mark": [-1]})
        self.selected_flight = ColumnDataSource(selected_flight)
        self.floor = ColumnDataSource(one_line)
        self.layers = {name: ColumnDataSource({"across": [], "upward": [], "colour": []}) for name in LAYERS}
        self.slider = Slider(start=0.0, end=1.0, value=1.0, step=0.01, title="time [s]", width=FRAME[0] - 120)
        self.button = Toggle(label="play", width=80)
        self.title = Div(text="", disable_math=True, width=FRAME[0])
        self.figure = self._figure()
        self._connect()

    def _figure(self) -> figure:
        """Make a figure without axes, whose layers the script fills."""
        width, height = FRAME
        plot = figure(
            frame_width=width,
            frame_height=height,
            tools="save",
            x_range=Range1d(start=-1.0, end=1.0),
            y_range=Range1d(start=-height / width, end=height / width),
            output_backend="canvas",
        )
        plot.axis.visible = False
        plot.grid.visible = False
        plot.toolbar.logo = None
        layers = self.layers
        plot.multi_line("across", "upward", source=layers["floor"], color=GREY, alpha=0.25)
        plot.multi_line("across", "upward", source=layers["ghosts"], color="colour", alpha=0.3)
        plot.line("across", "upward", source=layers["wanted"], color=GREY, line_dash="dashed", line_width=2)
        plot.scatter("across", "upward", source=layers["points"], color="colour", size=5, alpha=0.8)
        plot.line("across", "upward", source=layers["flown"], color=DARK, line_width=2.5)
        plot.scatter("across", "upward", source=layers["marks"], marker="x", color=ORANGE, size=12, line_width=3)
        plot.multi_line("across", "upward", source=layers["craft"], color="colour", line_width=3)
        return plot

    def _connect(self) -> None:
        """Let the slider, the mouse and new data call the functions of the script."""
        sources = {"scene": self.scene, "tracks": self.tracks, "flight": self.selected_flight, "floor": self.floor}
        arguments = {**sources, "slider": self.slider, "layers": self.layers}
        names = ", ".join(arguments)
        redraw = CustomJS(args=arguments, code=f"{SCRIPT}\ndraw({{{names}}})")
        for source in sources.values():
            source.js_on_change("data", redraw)
        self.slider.js_on_change("value", redraw)
        turn = CustomJS(args={"scene": self.scene}, code=f"{SCRIPT}\nturn(scene, cb_obj.delta_x, cb_obj.delta_y)")
        ranges = {"ranges": [self.figure.x_range, self.figure.y_range]}
        self.figure.js_on_event(Pan, turn)
        self.figure.js_on_event(MouseWheel, CustomJS(args=ranges, code=f"{SCRIPT}\nmagnify(ranges, cb_obj.delta)"))
        play_arguments = {"button": self.button, "slider": self.slider}
        self.button.js_on_change("active", CustomJS(args=play_arguments, code=f"{SCRIPT}\nplay(button, slider)"))
        self.figure.js_on_change("inner_width", redraw)  # once the page has its layout

    @property
    def layout(self) -> LayoutDOM:
        """The view with title, slider and legend."""
        legend = Div(text=LEGEND, disable_math=True, width=FRAME[0])
        return column(self.title, side_by_side(self.button, self.slider), self.figure, legend)

    def show(self, run: LiveRun, row: int, name: str | None = None) -> None:
        """Show the draws of a run.

        Args:
            run: The run.
            row: Row of the selected draw, which is shown with its attitude.
            name: Name of the selected draw; None: its row.
        """
        paths = {axis: compact(run.signal(f"{axis}_y")) for axis in POSITION}
        self._set_scene(paths)
        marks = [failure_sample(run, index) for index in range(run.failed.size)]
        colours = [ORANGE if failed else BLUE for failed in run.failed]
        self.tracks.data = {**{axis: list(values) for axis, values in paths.items()}, "colour": colours, "mark": marks}
        selected_flight: dict[str, Any] = {"t": run.times}
        for axis in POSITION:
            selected_flight[axis] = paths[axis][row]
            selected_flight[f"{axis}_ref"] = compact(run.signal(f"{axis}_y_ref")[row])
        for angle in ATTITUDE:
            selected_flight[angle] = run.signal(angle)[row]
        end = float(run.times[-1])
        stood_at_end = self.slider.value >= self.slider.end
        time = end if stood_at_end else min(self.slider.value, end)
        self.slider.update(end=end, step=end / max(len(run.times) - 1, 1), value=time)
        self.selected_flight.data = selected_flight
        verdict = "fails" if run.failed[row] else "passes"
        self.title.text = f"{run.failed.size} flights; draw {name or row} {verdict}"

    def _set_scene(self, paths: dict[str, np.ndarray]) -> None:
        """Set centre, scale and floor of the view by nearly all positions; a draw that flies away does not count.

        Args:
            paths: Positions of all draws along each axis [m], shape (draws, samples).
        """
        ranges = [usual_range(values) for values in paths.values()]
        span = 0.6 * max(*(high - low for low, high in ranges), 0.5)
        centre = [0.5 * (low + high) for low, high in ranges]
        lowest, _ = ranges[2]
        scene: dict[str, Any] = {name: self.scene.data[name] for name in VIEW}  # the direction stays
        for axis, value in zip(POSITION, centre, strict=True):
            scene[f"c{axis}"] = [value]
        scene["span"] = [span]
        self.scene.data = scene
        width, height = FRAME
        half = 1.1 * span
        self.figure.x_range.update(start=-half * width / height, end=half * width / height)
        self.figure.y_range.update(start=-half, end=half)
        self.floor.data = floor_lines(centre, lowest, span)


def recorded_flights(study: Study, flights: Sequence[xr.Dataset]) -> LiveRun:
    """Return a run whose draws are recorded flights of a vehicle.

    Args:
        study: The study.
        flights: The flights, in the order of the draws; all have the same samples.
    """
    requirements = study.requirements
    names = ["outcome", "failed_at", *(requirement.name for requirement in requirements)]
    names += [requirement.violation_name for requirement in requirements]
    results: Arrays = {name: np.array([flight.attrs[name] for flight in flights]) for name in names}
    for signal in recorded_signals(study):
        results[SignalKey(signal)] = np.stack([flight[signal].values for flight in flights])
    return LiveRun(study, results, {}, flights[0]["t"].values)


def usual_range(values: np.ndarray) -> tuple[float, float]:
    """Return the ends of the range of nearly all positions along an axis [m]; 0 and 0 if no position is finite."""
    finite_values = values[np.isfinite(values)]
    if not finite_values.size:
        return 0.0, 0.0
    low, high = np.quantile(finite_values, [TAIL, 1.0 - TAIL])
    return float(low), float(high)


def failure_sample(run: LiveRun, draw: int) -> int:
    """Return the index of the sample at which a draw fails: its early end or its first violation; -1 if it passes.

    The index is at most that of the last sample with a finite position, so that the view can show the vehicle there.
    """
    if not run.failed[draw]:
        return -1
    times = [float(run.results["failed_at"][draw])]  # NaN if it ran to its end
    for requirement in run.study.requirements:
        times.append(float(run.results[requirement.violation_name][draw]))  # not finite if it is not violated
    finite_times = [time for time in times if np.isfinite(time)]
    failure_time = min(finite_times, default=run.times[-1])
    samples_with_position = np.flatnonzero(np.isfinite(run.signal("x_y")[draw]))
    last_sample = int(samples_with_position[-1]) if samples_with_position.size else 0
    return min(last_sample, int(np.searchsorted(run.times, failure_time)))


def floor_lines(centre: list[float], height: float, span: float) -> dict[str, Any]:
    """Return the ends of the lines of a square grid below the flights [m], by axis.

    Args:
        centre: Centre of the flights [m], shape (3,).
        height: Height of the grid [m].
        span: Scale of the view [m]; the extent of the grid is proportional to it.
    """
    half = 1.2 * span
    x_ends = [centre[0] - half, centre[0] + half]
    y_ends = [centre[1] - half, centre[1] + half]
    lines: dict[str, list[list[float]]] = {"x": [], "y": [], "z": []}
    for offset in np.linspace(-half, half, FLOOR_LINES).tolist():
        x = centre[0] + offset
        y = centre[1] + offset
        lines["x"] += [x_ends, [x, x]]  # a line along x, and one along y
        lines["y"] += [[y, y], y_ends]
        lines["z"] += [[height, height], [height, height]]
    return lines


def compact(values: np.ndarray) -> np.ndarray:
    """Convert values to what a figure can draw, as float32, so that the browser receives half as much data."""
    return drawable(values).astype(np.float32)
