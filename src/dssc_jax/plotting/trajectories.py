"""Figures of one draw over time."""

import math
from collections.abc import Callable, Sequence
from typing import TypedDict, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType
from mpl_toolkits.mplot3d import Axes3D

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, label, panel, styled, title
from dssc_jax.plotting.thinning import spaced_indices, thinned

ROUNDING_NOISE = 1e-9
"""Signals below this share of the largest output of their channel are rounding noise."""
SIGNAL_COLOURS = (BLUE, ORANGE, GREEN, RED, GREY)
ROTOR_COLOURS = (BLUE, ORANGE, GREEN, GREY)  # red is the limit
TIME_CONSTANTS = {"tau_m": (r"$\tau_m$", GREEN), "tau_av": (r"$\tau_{av}$", ORANGE)}
"""Legend and colour of each state-dependent time constant, by its signal."""
PATH_HEIGHT = 4.2  # of the row with the path [inch]
ROW_HEIGHT = 2.3  # of every other row of a flight [inch]
WIND = ("wind_x", "wind_y", "wind_z")
"""Signals with the components of the wind."""


@styled
def trajectory(run: xr.Dataset) -> Figure:
    """Plot one draw over time: output, error, sigma, command, and the controller's state-dependent functions, if any.

    For a plant of several channels, each channel has one row, with its command on the left and its error on the right.

    Args:
        run: The return value of ``simulate`` or ``replay``.
    """
    if "y" not in run:
        return flight(run)
    panels: list[Callable[[Axes, xr.Dataset], None]] = [output, error, sliding_variable, command]
    if "k_o" in run:
        panels.append(gain)
    if any(name in run for name in TIME_CONSTANTS):
        panels.append(time_constants)
    rows = math.ceil(len(panels) / 2)
    figure = Figure(figsize=(11.5, 4.0 * rows), layout="constrained")
    axes = figure.subplots(rows, 2, sharex=True).ravel()
    for ax, draw in zip(axes, panels, strict=False):
        draw(ax, run)
        ax.legend(loc="best", frameon=False)
    for empty in axes[len(panels) :]:
        empty.set_axis_off()
    for ax in axes[max(0, len(panels) - 2) : len(panels)]:
        ax.set_xlabel("time [s]")
        ax.tick_params(labelbottom=True)
    title(figure, trajectory_title(run))
    return figure


def output(ax: Axes, run: xr.Dataset) -> None:
    """Draw the output and its desired value."""
    line(ax, run, "y_ref", GREY, "desired $y_m$", linestyle="--")
    line(ax, run, "y", BLUE, "output $y$")
    ax.set_ylabel(signal_label(run, "y"))


def error(ax: Axes, run: xr.Dataset) -> None:
    """Draw the output error."""
    line(ax, run, "e", BLUE, "error $e$")
    ax.set_ylabel(rf"error $e$ {bracketed_unit(run, 'e')}")


def sliding_variable(ax: Axes, run: xr.Dataset) -> None:
    """Draw the sliding variable sigma."""
    line(ax, run, "sigma", ORANGE, r"$\sigma = \dot e + l_0 e$")
    ax.set_ylabel(rf"$\sigma$ {bracketed_unit(run, 'sigma')}")


def command(ax: Axes, run: xr.Dataset) -> None:
    """Draw the robust command and the total command."""
    line(ax, run, "u_total", GREY, "total $u + u_n$", linewidth=1.0)
    line(ax, run, "u", RED, "robust $u$")
    ax.set_ylabel(signal_label(run, "u_total"))


@styled
def signals(run: xr.Dataset, names: Sequence[str], ax: Axes | None = None) -> Figure:
    """Plot signals of one draw over time, each labelled with its meaning; signals with the same unit share a panel.

    Args:
        run: The return value of ``simulate`` or ``replay``.
        names: Variables of the trajectory, at most five.
        ax: Axes to draw into, if all signals have one unit; None: a new figure.

    Raises:
        KeyError: The trajectory has no such signal.
        ValueError: There are more signals than distinguishable colours, or several units for the given axes.
    """
    if len(names) > len(SIGNAL_COLOURS):
        raise ValueError(f"shows at most {len(SIGNAL_COLOURS)} signals, got {len(names)}")
    units = list(dict.fromkeys(bracketed_unit(run, name) for name in names))
    if ax is not None and len(units) > 1:
        raise ValueError(f"axes have one unit, got signals in {', '.join(units)}; leave `ax` out for a panel each")
    if len(units) < 2:
        figure, first = panel(ax)
        axes = [first]
    else:
        figure = Figure(figsize=(SLIDE[0], 3.0 * len(units)), layout="constrained")
        axes = list(figure.subplots(len(units), 1, sharex=True))
    for name, colour in zip(names, SIGNAL_COLOURS[: len(names)], strict=True):
        ax_of_unit = axes[units.index(bracketed_unit(run, name))]
        line(ax_of_unit, run, name, colour, label(run[name].attrs) or name)
    for ax_of_unit, unit in zip(axes, units, strict=True):
        ax_of_unit.set_ylabel(unit)
        ax_of_unit.legend(loc="best", frameon=False)
    axes[-1].set_xlabel("time [s]")
    return figure


class LineOptions(TypedDict, total=False):
    """Width [point] and style of a line."""

    linewidth: float
    linestyle: LineStyleType


def line(ax: Axes, run: xr.Dataset, name: str, colour: str, text: str, **options: Unpack[LineOptions]) -> None:
    """Draw one signal over time, thinned to as many points as a figure can show.

    Args:
        ax: Axes to draw into.
        run: The trajectory.
        name: Name of the signal.
        colour: Colour of the line.
        text: Legend of the line.
        options: Further options of the line.
    """
    time, values = thinned(run["t"].values, run[name].values)
    ax.plot(time, values, color=colour, label=text, **options)


def bracketed_unit(run: xr.Dataset, name: str) -> str:
    """The unit of a signal in brackets."""
    return f"[{run[name].attrs['units']}]"


def signal_label(run: xr.Dataset, name: str) -> str:
    """An axis label of an output or a command: its meaning and unit.

    The symbol at the end of the meaning and the word "total" at its start are left out.
    """
    attributes = run[name].attrs
    meaning = attributes["long_name"].removesuffix(" y").removesuffix(" u + u_n").removeprefix("total ")
    return label({"long_name": meaning, "units": attributes["units"]})


def flight(run: xr.Dataset) -> Figure:
    """Plot a plant of several channels: path, attitude and other signals of a vehicle, then commands and errors.

    A channel whose error and command are only rounding noise is left out, and the title names it.
    """
    channels = [str(name).removesuffix("_y_ref") for name in run if str(name).endswith("_y_ref")]
    active = [channel for channel in channels if not is_noise(run, channel)] or channels
    is_vehicle = all(name in run for name in ("x_y", "y_y", "z_y", "phi", "theta"))
    panels = vehicle_panels(run) if is_vehicle else []
    heights: list[float] = []  # of the rows of the figure
    if is_vehicle:
        panel_rows = math.ceil(len(panels) / 2)
        heights = [PATH_HEIGHT] + [ROW_HEIGHT] * panel_rows
    first_channel_row = len(heights)
    heights += [ROW_HEIGHT] * len(active)
    figure = Figure(figsize=(11.5, sum(heights) + 1.0), layout="constrained")
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
    if is_vehicle:
        path_in_space(figure.add_subplot(grid[0, 0], projection="3d"), run)
        path_from_above(figure.add_subplot(grid[0, 1]), run)
    time_axes: list[Axes] = []
    for index, draw in enumerate(panels):
        row = 1 + index // 2
        column = index % 2
        ax = figure.add_subplot(grid[row, column])
        draw(ax, run)
        time_axes.append(ax)
    for row, channel in enumerate(active, first_channel_row):
        left = figure.add_subplot(grid[row, 0])
        right = figure.add_subplot(grid[row, 1])
        channel_panels(left, right, run, channel)
        if channel == active[0]:
            left.legend(loc="best", frameon=False)
        time_axes += [left, right]
    last_row = time_axes[-2:]
    for ax in last_row:
        ax.set_xlabel("time [s]")
    for ax in time_axes:
        mark_events(ax, run, with_names=ax in last_row)
    omitted = [channel for channel in channels if channel not in active]
    remark = f"\nnot shown: {', '.join(omitted)}, whose error and command are rounding noise" if omitted else ""
    title(figure, trajectory_title(run) + remark)
    return figure


def mark_events(ax: Axes, run: xr.Dataset, with_names: bool) -> None:
    """Mark the times of a draw's events by vertical lines.

    Args:
        ax: Axes to draw into.
        run: The trajectory; without events, nothing is drawn.
        with_names: Whether to write the kind of each event above its line.
    """
    kinds = np.atleast_1d(run.attrs.get("event_kinds", []))
    times = np.atleast_1d(run.attrs.get("event_times", []))
    for kind, time in zip(kinds, times, strict=True):
        ax.axvline(float(time), color=RED, linestyle=":", linewidth=1.2)
        if with_names:
            name = str(kind).replace("_", " ")
            ax.annotate(
                name, (float(time), 1.0), xycoords=("data", "axes fraction"), fontsize=8, color=RED, va="bottom"
            )


def channel_panels(left: Axes, right: Axes, run: xr.Dataset, channel: str) -> None:
    """Draw the commands of a channel into the left axes, and its error into the right axes.

    Args:
        left: Axes of the commands.
        right: Axes of the error.
        run: The trajectory.
        channel: Name of the channel.
    """
    line(left, run, f"{channel}_u_total", GREY, "total $u + u_n$", linewidth=1.2)
    line(left, run, f"{channel}_u", RED, "robust $u$", linewidth=1.2)
    line(right, run, f"{channel}_e", BLUE, "error")
    left.set_ylabel(f"{channel}: command {bracketed_unit(run, f'{channel}_u')}")
    right.set_ylabel(f"{channel}: error {bracketed_unit(run, f'{channel}_e')}")


def vehicle_panels(run: xr.Dataset) -> list[Callable[[Axes, xr.Dataset], None]]:
    """The functions that draw attitude, rotors, wind and thrust of a vehicle.

    A function whose signals are missing in the run is left out.

    Args:
        run: The trajectory.
    """
    panels: list[Callable[[Axes, xr.Dataset], None]] = [attitude]
    if "rotor_1" in run:
        panels.append(rotors)
    if any(largest_magnitude(run, name) > 0.0 for name in WIND if name in run):
        panels.append(wind)
    if "thrust" in run:
        panels.append(thrust)
    return panels


def is_noise(run: xr.Dataset, channel: str) -> bool:
    """Whether a channel's error and command are rounding noise.

    This is the case if both are tiny relative to the largest output or reference, or relative to 1 if these are
    smaller.
    """
    output_size = max(1.0, largest_magnitude(run, f"{channel}_y"), largest_magnitude(run, f"{channel}_y_ref"))
    signal_size = max(largest_magnitude(run, f"{channel}_e"), largest_magnitude(run, f"{channel}_u_total"))
    return signal_size <= ROUNDING_NOISE * output_size


def largest_magnitude(run: xr.Dataset, name: str) -> float:
    """Largest finite magnitude of a signal; 0 if no value is finite."""
    values = np.abs(run[name].values)
    return float(np.max(values[np.isfinite(values)], initial=0.0))


def path_in_space(ax: Axes3D, run: xr.Dataset) -> None:
    """Draw the path and its reference in three dimensions."""
    indices = spaced_indices(run.sizes["t"])
    reference_path = [run[f"{axis}_y_ref"].values[indices] for axis in "xyz"]
    flown_path = [run[f"{axis}_y"].values[indices] for axis in "xyz"]
    ax.plot(*reference_path, color=GREY, label="desired", linestyle="--")
    ax.plot(*flown_path, color=BLUE, label="flown", linestyle="-")
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.legend(loc="upper left", frameon=False)


def path_from_above(ax: Axes, run: xr.Dataset) -> None:
    """Draw the path and its reference from above, with equal scales, and mark start and end."""
    indices = spaced_indices(run.sizes["t"])
    x = run["x_y"].values[indices]
    y = run["y_y"].values[indices]
    ax.plot(run["x_y_ref"].values[indices], run["y_y_ref"].values[indices], color=GREY, linestyle="--", label="desired")
    ax.plot(x, y, color=BLUE, label="flown")
    finite = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if finite.size:
        start = finite[0]
        end = finite[-1]
        ax.plot(x[start], y[start], "o", color=GREEN, label="start")
        ax.plot(x[end], y[end], "s", color=RED, label="end")
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.legend(loc="best", frameon=False)


def attitude(ax: Axes, run: xr.Dataset) -> None:
    """Draw roll and pitch in degrees."""
    for name, colour, text in (("phi", BLUE, "roll"), ("theta", ORANGE, "pitch")):
        time, angle = thinned(run["t"].values, np.degrees(run[name].values))
        ax.plot(time, angle, color=colour, label=text)
    ax.set_ylabel("attitude [deg]")
    ax.legend(loc="best", frameon=False)


def rotors(ax: Axes, run: xr.Dataset) -> None:
    """Draw the commanded thrust of each rotor and the limit; shade the times at which a rotor is at its limit.

    If the limit is far above all thrusts, the label names it in place of a line.
    """
    endings = [str(name).removeprefix("rotor_") for name in run if str(name).startswith("rotor_")]
    numbers = [ending for ending in endings if ending.isdigit()]  # without rotor_limit and rotor_limited
    for index, number in enumerate(numbers):
        colour = ROTOR_COLOURS[index % len(ROTOR_COLOURS)]
        style = "-" if index < len(ROTOR_COLOURS) else ":"
        line(ax, run, f"rotor_{number}", colour, number, linewidth=1.0, linestyle=style)
    limit = largest_magnitude(run, "rotor_limit")
    bottom, top = ax.get_ylim()
    is_limited = list(run["rotor_limited"].values > 0.5)  # 1 or 0 at each time
    if any(is_limited):
        bottom = min(bottom, 0.0)
        top = max(top, limit)
        text = "one at its limit"
        ax.fill_between(run["t"].values, bottom, top, where=is_limited, color=RED, alpha=0.2, linewidth=0.0, label=text)
    if top >= limit:
        line(ax, run, "rotor_limit", RED, "limit", linewidth=1.0, linestyle="--")
        ax.set_ylabel("rotor thrust [N]")
    else:
        ax.set_ylabel(f"rotor thrust [N]\n(limit {limit:.3g})")
    ax.legend(loc="best", frameon=False, ncols=3)


def wind(ax: Axes, run: xr.Dataset) -> None:
    """Draw the components of the wind, without those that are always 0.

    If the wind does not blow from the start, a line marks its onset.
    """
    for name, colour in zip(WIND, SIGNAL_COLOURS[: len(WIND)], strict=True):
        if largest_magnitude(run, name) > 0.0:
            line(ax, run, name, colour, name.removeprefix("wind_"))
    speeds = np.abs([run[name].values for name in WIND])
    windy_samples = np.flatnonzero((speeds > 0.0).any(axis=0))
    if windy_samples[0] > 1:  # the first two samples count as the start
        onset = float(run["t"].values[windy_samples[0]])
        ax.axvline(onset, color=GREY, linestyle=":", label=f"onset at {onset:.3g} s")
    ax.set_ylabel("wind [m/s]")
    ax.legend(loc="best", frameon=False, ncols=2)


def thrust(ax: Axes, run: xr.Dataset) -> None:
    """Draw the total commanded thrust."""
    line(ax, run, "thrust", BLUE, "wanted thrust")
    ax.set_ylabel("wanted thrust [N]")


def gain(ax: Axes, run: xr.Dataset) -> None:
    """Draw the state-dependent gain k_o on a logarithmic axis."""
    line(ax, run, "k_o", BLUE, "$k_o$")
    ax.set_yscale("log")
    ax.set_ylabel(f"gain $k_o$ {bracketed_unit(run, 'k_o')}")


def time_constants(ax: Axes, run: xr.Dataset) -> None:
    """Draw the state-dependent time constants tau_m and tau_av on a logarithmic axis."""
    for name, (text, colour) in TIME_CONSTANTS.items():
        if name in run:
            line(ax, run, name, colour, text)
    ax.set_yscale("log")
    ax.set_ylabel("time constants [s]")


def trajectory_title(run: xr.Dataset) -> str:
    """The title of a trajectory: study, draw, and how the draw ended."""
    study = run.attrs.get("study", "")
    draw = run.attrs.get("draw", 0)
    return f"{study}, draw {draw}: {run.attrs.get('verdict', '')}"
