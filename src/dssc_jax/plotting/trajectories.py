"""Figures of one draw over time."""

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, styled, title


@styled
def trajectory(run: xr.Dataset) -> Figure:
    """One draw over time: output, error, command, and the state-dependent functions where there are any.

    A plant of several channels is shown by commands on the left and errors on the right, a row a channel.

    Args:
        run: What ``simulate`` or ``replay`` returned.
    """
    if "y" not in run:
        return flight(run)
    figure = Figure(figsize=(11.5, 8.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True)
    t = run["t"].values
    panels[0, 0].plot(t, run["y_ref"], color=GREY, linestyle="--", label="desired $y_m$")
    panels[0, 0].plot(t, run["y"], color=BLUE, label="output $y$")
    panels[0, 0].set_ylabel("output [m]")
    panels[0, 1].plot(t, run["e"], color=BLUE, label="error $e$ [m]")
    panels[0, 1].plot(t, run["sigma"], color=ORANGE, label=r"$\sigma = \dot e + l_0 e$ [m/s]")
    panels[0, 1].set_ylabel("error")
    panels[1, 0].plot(t, run["u_total"], color=GREY, linewidth=1.0, label="total $u + u_n$")
    panels[1, 0].plot(t, run["u"], color=RED, label="robust $u$")
    panels[1, 0].set_ylabel("command [m/s]")
    state_dependent(panels[1, 1], run)
    for ax in panels.flat:
        if ax.has_data():
            ax.legend(loc="best", frameon=False)
    for ax in panels[1]:
        ax.set_xlabel("time [s]")
    title(figure, how_it_ended(run))
    return figure


def flight(run: xr.Dataset) -> Figure:
    """Commands and errors of every channel."""
    channels = [str(name).removesuffix("_y_ref") for name in run if str(name).endswith("_y_ref")]
    figure = Figure(figsize=(11.5, 2.3 * len(channels) + 1.0), layout="constrained")
    rows = figure.subplots(len(channels), 2, sharex=True, squeeze=False)
    for (left, right), channel in zip(rows, channels, strict=True):
        for name, colour, text in (("u_total", GREY, "total $u + u_n$"), ("u", RED, "robust $u$")):
            left.plot(run["t"], run[f"{channel}_{name}"], color=colour, linewidth=1.2, label=text)
        right.plot(run["t"], run[f"{channel}_e"], color=BLUE)
        left.set_ylabel(f"{channel}: command [{run[f'{channel}_u'].attrs['units']}]")
        right.set_ylabel(f"{channel}: error [{run[f'{channel}_e'].attrs['units']}]")
    rows[0, 0].legend(loc="best", frameon=False)
    for ax in rows[-1]:
        ax.set_xlabel("time [s]")
    title(figure, how_it_ended(run))
    return figure


def state_dependent(ax: Axes, run: xr.Dataset) -> None:
    """k_o and the time constants, on a logarithmic axis; the sliding margin is not theirs to show."""
    shown = {"k_o": ("$k_o$ [1/s]", BLUE), "tau_m": (r"$\tau_m$ [s]", GREEN), "tau_av": (r"$\tau_{av}$ [s]", ORANGE)}
    for name, (text, colour) in shown.items():
        if name in run:
            ax.semilogy(run["t"], run[name], color=colour, label=text)
    ax.set_ylabel("state-dependent functions")
    if not ax.has_data():
        ax.set_axis_off()


def how_it_ended(run: xr.Dataset) -> str:
    """A trajectory's title."""
    ended = str(run.attrs.get("outcome_meaning", "")).replace("_", " ")
    return f"{run.attrs.get('study', '')}, draw {run.attrs.get('draw', 0)}: {ended}"
