"""Figures of one draw over time."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, label, panel, styled, title
from dssc_jax.plotting.thinning import picked, thinned

STILL = 1e-9  # of a signal's size: what is smaller is rounding noise
CYCLE = (BLUE, ORANGE, GREEN, RED, GREY)
ROTOR_COLOURS = (BLUE, ORANGE, GREEN, GREY)  # red is the limit
WIND = ("wind_x", "wind_y", "wind_z")


@styled
def trajectory(run: xr.Dataset) -> Figure:
    """Plot one draw over time: output, error, command, and the state-dependent functions if there are any.

    For a plant of several channels, commands are on the left and errors on the right, with one row for each channel.

    Args:
        run: The return value of ``simulate`` or ``replay``.
    """
    if "y" not in run:
        return flight(run)
    figure = Figure(figsize=(11.5, 8.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True)
    line(panels[0, 0], run, "y_ref", GREY, "desired $y_m$", linestyle="--")
    line(panels[0, 0], run, "y", BLUE, "output $y$")
    panels[0, 0].set_ylabel(signal_label(run, "y"))
    line(panels[0, 1], run, "e", BLUE, f"error $e$ {bracketed_unit(run, 'e')}")
    line(panels[0, 1], run, "sigma", ORANGE, rf"$\sigma = \dot e + l_0 e$ {bracketed_unit(run, 'sigma')}")
    panels[0, 1].set_ylabel(rf"error $e$ {bracketed_unit(run, 'e')}, $\sigma$ {bracketed_unit(run, 'sigma')}")
    line(panels[1, 0], run, "u_total", GREY, "total $u + u_n$", linewidth=1.0)
    line(panels[1, 0], run, "u", RED, "robust $u$")
    panels[1, 0].set_ylabel(signal_label(run, "u_total"))
    state_dependent(panels[1, 1], run)
    for ax in panels.flat:
        if ax.has_data():
            ax.legend(loc="best", frameon=False)
    for ax in panels[1]:
        ax.set_xlabel("time [s]")
    title(figure, how_it_ended(run))
    return figure


@styled
def signals(run: xr.Dataset, names: Sequence[str], ax: Axes | None = None) -> Figure:
    """Plot signals of one draw over time, each labelled with its meaning and unit.

    Args:
        run: The return value of ``simulate`` or ``replay``.
        names: Variables of the trajectory, at most five.
        ax: Axes to draw into; None: a new figure.

    Raises:
        KeyError: the trajectory has no such signal.
        ValueError: there are more signals than distinguishable colours.
    """
    if len(names) > len(CYCLE):
        raise ValueError(f"shows at most {len(CYCLE)} signals, got {len(names)}")
    figure, ax = panel(ax)
    for name, colour in zip(names, CYCLE[: len(names)], strict=True):
        line(ax, run, name, colour, label(run[name].attrs) or name)
    ax.set(xlabel="time [s]", ylabel=", ".join(dict.fromkeys(f"[{run[name].attrs['units']}]" for name in names)))
    ax.legend(loc="best", frameon=False)
    return figure


def line(ax: Axes, run: xr.Dataset, name: str, colour: str, text: str, **look: object) -> None:
    """Draw one signal, with as many points as a page can show."""
    ax.plot(*thinned(run["t"].values, run[name].values), color=colour, label=text, **look)  # type: ignore[arg-type]


def bracketed_unit(run: xr.Dataset, name: str) -> str:
    """A signal's unit in brackets."""
    return f"[{run[name].attrs['units']}]"


def signal_label(run: xr.Dataset, name: str) -> str:
    """A signal's meaning without its symbol, and its unit."""
    words = run[name].attrs["long_name"].removesuffix(" y").removesuffix(" u + u_n").removeprefix("total ")
    return label({"long_name": words, "units": run[name].attrs["units"]})


def flight(run: xr.Dataset) -> Figure:
    """Plot a plant of several channels: the path and the attitude of a vehicle, then commands and errors.

    A channel whose error and command are rounding noise is left out, and named in the title.
    """
    channels = [str(name).removesuffix("_y_ref") for name in run if str(name).endswith("_y_ref")]
    active = [channel for channel in channels if not is_still(run, channel)] or channels
    vehicle = all(name in run for name in ("x_y", "y_y", "z_y", "phi", "theta"))
    panels = vehicle_panels(run) if vehicle else []
    heights = [*([4.2] if vehicle else []), *[2.3] * (-(-len(panels) // 2) + len(active))]
    figure = Figure(figsize=(11.5, sum(heights) + 1.0), layout="constrained")
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
    if vehicle:
        path_in_space(figure.add_subplot(grid[0, 0], projection="3d"), run)
        path_from_above(figure.add_subplot(grid[0, 1]), run)
        for place, draw in enumerate(panels):
            draw(figure.add_subplot(grid[1 + place // 2, place % 2]), run)
    for row, channel in enumerate(active, len(heights) - len(active)):
        left, right = figure.add_subplot(grid[row, 0]), figure.add_subplot(grid[row, 1])
        line(left, run, f"{channel}_u_total", GREY, "total $u + u_n$", linewidth=1.2)
        line(left, run, f"{channel}_u", RED, "robust $u$", linewidth=1.2)
        line(right, run, f"{channel}_e", BLUE, "error")
        left.set_ylabel(f"{channel}: command [{run[f'{channel}_u'].attrs['units']}]")
        right.set_ylabel(f"{channel}: error [{run[f'{channel}_e'].attrs['units']}]")
        if channel == active[0]:
            left.legend(loc="best", frameon=False)
        if channel == active[-1]:
            left.set_xlabel("time [s]")
            right.set_xlabel("time [s]")
    still = [channel for channel in channels if channel not in active]
    note = f"\nnot shown: {', '.join(still)}, whose error and command are rounding noise" if still else ""
    title(figure, how_it_ended(run) + note)
    return figure


def vehicle_panels(run: xr.Dataset) -> list[Callable[[Axes, xr.Dataset], None]]:
    """What else of a vehicle there is to draw over time."""
    there = {
        attitude: True,
        rotors: "rotor_1" in run,
        wind: any(largest_magnitude(run, name) > 0.0 for name in WIND if name in run),
        lift: "thrust" in run,
    }
    return [draw for draw, shown in there.items() if shown]


def is_still(run: xr.Dataset, channel: str) -> bool:
    """Whether a channel's error and command are rounding noise."""
    size = max(1.0, *(largest_magnitude(run, f"{channel}_{name}") for name in ("y", "y_ref")))
    return all(largest_magnitude(run, f"{channel}_{name}") <= STILL * size for name in ("e", "u_total"))


def largest_magnitude(run: xr.Dataset, name: str) -> float:
    """Largest finite magnitude of a signal; 0 if there is none."""
    values = np.abs(run[name].values)
    return float(np.max(values[np.isfinite(values)], initial=0.0))


def path_in_space(ax: Any, run: xr.Dataset) -> None:
    """Draw the path and its reference in three dimensions."""
    shown = picked(run.sizes["t"])
    for suffix, colour, text, style in (("y_ref", GREY, "desired", "--"), ("y", BLUE, "flown", "-")):
        ax.plot(*(run[f"{axis}_{suffix}"].values[shown] for axis in "xyz"), color=colour, label=text, linestyle=style)
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.legend(loc="upper left", frameon=False)


def path_from_above(ax: Axes, run: xr.Dataset) -> None:
    """Draw the path and its reference from above, with equal scales, and mark the start and the end."""
    shown = picked(run.sizes["t"])
    x, y = (run[f"{axis}_y"].values[shown] for axis in "xy")
    ax.plot(run["x_y_ref"].values[shown], run["y_y_ref"].values[shown], color=GREY, linestyle="--", label="desired")
    ax.plot(x, y, color=BLUE, label="flown")
    finite = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if finite.size:
        ax.plot(x[finite[0]], y[finite[0]], "o", color=GREEN, label="start")
        ax.plot(x[finite[-1]], y[finite[-1]], "s", color=RED, label="end")
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.legend(loc="best", frameon=False)


def attitude(ax: Axes, run: xr.Dataset) -> None:
    """Draw roll and pitch in degrees."""
    for name, colour, text in (("phi", BLUE, "roll"), ("theta", ORANGE, "pitch")):
        ax.plot(*thinned(run["t"].values, np.degrees(run[name].values)), color=colour, label=text)
    ax.set_ylabel("attitude [deg]")
    ax.legend(loc="best", frameon=False)


def rotors(ax: Axes, run: xr.Dataset) -> None:
    """Draw the commanded thrust of each rotor and its limit, and shade the time with a rotor at its limit."""
    each = [str(name) for name in run if str(name).startswith("rotor_") and str(name)[6:].isdigit()]
    for place, name in enumerate(each):
        style = "-" if place < len(ROTOR_COLOURS) else ":"
        line(ax, run, name, ROTOR_COLOURS[place % len(ROTOR_COLOURS)], name[6:], linewidth=1.0, linestyle=style)
    time, at_limit = run["t"].values, run["rotor_limited"].values > 0.5
    low, high = ax.get_ylim()
    limit = largest_magnitude(run, "rotor_limit")
    if at_limit.any():
        low, high = min(low, 0.0), max(high, limit)
        look = {"color": RED, "alpha": 0.2, "linewidth": 0.0, "label": "one at its limit"}
        ax.fill_between(time, low, high, where=list(at_limit), **look)
    if high >= limit:
        line(ax, run, "rotor_limit", RED, "limit", linewidth=1.0, linestyle="--")
    ax.set_ylabel("rotor thrust [N]" if high >= limit else f"rotor thrust [N]\n(limit {limit:.3g})")
    ax.legend(loc="best", frameon=False, ncols=3)


def wind(ax: Axes, run: xr.Dataset) -> None:
    """Draw the wind, and mark its onset if it does not blow from the start."""
    for name, colour in zip(WIND, CYCLE[: len(WIND)], strict=True):
        if largest_magnitude(run, name) > 0.0:
            line(ax, run, name, colour, name[-1])
    blowing = np.flatnonzero(np.any([np.abs(run[name].values) > 0.0 for name in WIND], axis=0))
    if blowing[0] > 1:
        onset = float(run["t"].values[blowing[0]])
        ax.axvline(onset, color=GREY, linestyle=":", label=f"onset at {onset:.3g} s")
    ax.set_ylabel("wind [m/s]")
    ax.legend(loc="best", frameon=False, ncols=2)


def lift(ax: Axes, run: xr.Dataset) -> None:
    """Draw the wanted thrust."""
    line(ax, run, "thrust", BLUE, "wanted thrust")
    ax.set_ylabel("wanted thrust [N]")


def state_dependent(ax: Axes, run: xr.Dataset) -> None:
    """Draw k_o and the time constants on a logarithmic axis; the sliding margin is not shown."""
    shown = {"k_o": ("$k_o$", BLUE), "tau_m": (r"$\tau_m$", GREEN), "tau_av": (r"$\tau_{av}$", ORANGE)}
    for name, (text, colour) in shown.items():
        if name in run:
            line(ax, run, name, colour, f"{text} {bracketed_unit(run, name)}")
    if ax.has_data():
        ax.set_yscale("log")
        gain = f"gain {bracketed_unit(run, 'k_o')}, " if "k_o" in run else ""
        ax.set_ylabel(f"functions: {gain}time constants [s]")
    else:
        ax.set_axis_off()


def how_it_ended(run: xr.Dataset) -> str:
    """The title of a trajectory: how the draw ended."""
    return f"{run.attrs.get('study', '')}, draw {run.attrs.get('draw', 0)}: {run.attrs.get('verdict', '')}"
