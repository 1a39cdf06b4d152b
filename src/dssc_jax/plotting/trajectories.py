"""Figures of one draw over time."""

from collections.abc import Sequence

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, label, panel, styled, title
from dssc_jax.plotting.thinning import thinned

CYCLE = (BLUE, ORANGE, GREEN, RED, GREY)


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
    """Plot commands and errors of every channel."""
    channels = [str(name).removesuffix("_y_ref") for name in run if str(name).endswith("_y_ref")]
    figure = Figure(figsize=(11.5, 2.3 * len(channels) + 1.0), layout="constrained")
    rows = figure.subplots(len(channels), 2, sharex=True, squeeze=False)
    for (left, right), channel in zip(rows, channels, strict=True):
        line(left, run, f"{channel}_u_total", GREY, "total $u + u_n$", linewidth=1.2)
        line(left, run, f"{channel}_u", RED, "robust $u$", linewidth=1.2)
        line(right, run, f"{channel}_e", BLUE, "error")
        left.set_ylabel(f"{channel}: command [{run[f'{channel}_u'].attrs['units']}]")
        right.set_ylabel(f"{channel}: error [{run[f'{channel}_e'].attrs['units']}]")
    rows[0, 0].legend(loc="best", frameon=False)
    for ax in rows[-1]:
        ax.set_xlabel("time [s]")
    title(figure, how_it_ended(run))
    return figure


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
