"""The article's figures, and those that it does not show."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from benchmarks.paper.loops import AXES, CASE_1, KAPPA_1, KAPPA_2, RHO, ROOT, Runs
from benchmarks.paper.monte_carlo import Columns, Flights
from benchmarks.paper.signals import SECONDS, lost
from dssc_jax import plotting

FIGURES = ROOT / "docs" / "figures"
SYMBOLS = {"x": "x", "y": "y", "z": "z", "psi": r"\psi"}
LENGTHS = {"x": "m", "y": "m", "z": "m", "psi": "rad"}


def panels(rows: int, columns: int, size: tuple[float, float], **options: Any):
    """A figure in the project's style, with its axes."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def draw_figure_3(full: xr.Dataset, simple: xr.Dataset) -> Figure:
    """Efforts on the left, errors on the right."""
    figure, ax = panels(4, 2, (12.0, 11.0), sharex=True)
    for row, axis in enumerate(AXES):
        unit = LENGTHS[axis]
        for column, (name, symbol) in enumerate((("u", "u"), ("e", "e"))):
            panel = ax[row, column]
            panel.plot(full["t"], full[f"{axis}_{name}"], color=plotting.BLUE, label="full UAV, wind")
            panel.plot(simple["t"], simple[f"{axis}_{name}"], color=plotting.RED, label="simplified, d", linewidth=1.3)
            panel.axvline(SECONDS, color=plotting.GREY, linestyle=":")
            panel.set_ylabel(f"${symbol}_{{{SYMBOLS[axis]}}}$ [{unit}{'/s' if name == 'u' else ''}]")
    key(figure, ax[0, 0])
    ax[0, 0].set_title("robust command")
    ax[0, 1].set_title("tracking error")
    label_time(ax)
    return figure


def key(figure: Figure, panel: Any) -> None:
    """One legend for all panels."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)


def label_time(ax: np.ndarray) -> None:
    """The time under the last row."""
    for panel in ax[-1]:
        panel.set_xlabel("time [s]")


def draw_figure_4(full: xr.Dataset, simple: xr.Dataset) -> Figure:
    """The state-dependent functions of both models."""
    figure, ax = panels(4, 2, (12.0, 11.0), sharex=True)
    for row, axis in enumerate(AXES):
        for column, (name, symbol, unit) in enumerate((("k_o", "k_o", "1/s"), ("tau_m", r"\tau_m", "s"))):
            panel = ax[row, column]
            panel.plot(full["t"], full[f"{axis}_{name}"], color=plotting.BLUE, linewidth=1.2, label="full UAV")
            panel.plot(simple["t"], simple[f"{axis}_{name}"], color="black", linestyle="--", label="simplified")
            panel.axvline(SECONDS, color=plotting.GREY, linestyle=":")
            panel.set_ylabel(f"${symbol}$, ${SYMBOLS[axis]}$ [{unit}]")
    key(figure, ax[0, 0])
    label_time(ax)
    return figure


def draw_figure_5(printed: Runs, kept: Runs) -> Figure:
    """Commands and errors of DSSC, with both readings of kappa_m, and of the clipped STA."""
    figure, ax = panels(4, 2, (12.0, 11.0), sharex="col")
    shown = (
        (printed["STA clipped"], plotting.RED, 1.2, r"STA clipped to $\pm\rho$ of DSSC"),
        (printed["DSSC"], plotting.BLUE, 1.4, r"DSSC, $\kappa_m = \kappa_1/\kappa_2$"),
        (kept["DSSC"], "black", 1.6, r"DSSC, $\kappa_m$ of Case 1"),
    )
    for row, axis in enumerate(AXES):
        unit = LENGTHS[axis]
        for run, colour, thick, about in shown:
            ax[row, 0].plot(run["t"], run[f"{axis}_u"], color=colour, linewidth=thick, label=about)
            ax[row, 1].plot(run["t"], run[f"{axis}_e"], color=colour, linewidth=thick)
        ax[row, 0].set(ylabel=f"$u_{{{SYMBOLS[axis]}}}$ [{unit}/s]", xlim=(20.0, 30.0))
        ax[row, 0].set_ylim(-1.15 * RHO[axis], 1.15 * RHO[axis])
        ax[row, 1].set_ylabel(f"$e_{{{SYMBOLS[axis]}}}$ [{unit}]")
    ax[0, 0].set_title("robust command, 20 s to 30 s")
    ax[0, 1].set_title("tracking error, whole run")
    key(figure, ax[0, 0])
    end = lost(printed["STA"])
    if end:
        figure.supxlabel(f"The unlimited STA is not shown: {end}.", fontsize=12)
    label_time(ax)
    return figure


def draw_monte_carlo(values: Columns, dssc: Flights, other: Flights) -> Figure:
    """DSSC's oscillation over the clipped STA's, a point a draw, over kappa_m; coloured by the rotors' lag."""
    figure, ax = panels(2, 2, (12.0, 8.5), sharex=True)
    ratio = np.where(dssc.lost | other.lost, np.nan, (dssc.swing / other.swing).T)
    for panel, axis, points in zip(ax.flat, AXES, ratio, strict=True):
        lag = 1e3 * values["plant.vehicle.motor_lag"]
        dots = panel.scatter(values["kappa_m"], points, c=lag, s=14.0, cmap="viridis", norm=LogNorm())
        panel.axhline(0.5, color=plotting.GREY, linestyle=":")
        for value, colour in ((KAPPA_1 / KAPPA_2, plotting.BLUE), (CASE_1, "black")):
            panel.axvline(value, color=colour, linestyle="--", linewidth=1.2)
        panel.set(xscale="log", yscale="log", title=f"${SYMBOLS[axis]}$")
    for panel in ax[-1]:
        panel.set_xlabel(r"$\kappa_m$ [s (m/s)$^{-1/2}$]; dashed: $\kappa_1/\kappa_2$ and Case 1's")
    for panel in ax[:, 0]:
        panel.set_ylabel("oscillation, DSSC over clipped STA")
    bar = figure.colorbar(dots, ax=ax, label="rotors' time constant [ms]", ticks=[5, 10, 20, 40], format="%g")
    bar.minorticks_off()
    return figure


def draw_figure_6(runs: Runs) -> Figure:
    """The path, and the errors along the three axes."""
    figure = Figure(figsize=(12.5, 7.0), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1.0))
    path = figure.add_subplot(grid[:, 0])
    styles = {"STA": (plotting.BLUE, "--"), "DSSC": (plotting.RED, ":")}
    path.plot(runs["DSSC"]["x_y_ref"], runs["DSSC"]["y_y_ref"], color="black", linewidth=1.2, label="desired")
    for name, (colour, style) in styles.items():
        path.plot(runs[name]["x_y"], runs[name]["y_y"], color=colour, linestyle=style, linewidth=2.2, label=name)
    path.set(xlabel="x, east [m]", ylabel="y, north [m]", aspect="equal")
    path.legend(loc="upper center", bbox_to_anchor=(0.5, 1.09), ncols=3, frameon=False)
    first = None
    for row, axis in enumerate(("x", "y", "z")):
        panel = figure.add_subplot(grid[row, 1], sharex=first)
        first = first or panel
        for name, (colour, style) in styles.items():
            panel.plot(runs[name]["t"], runs[name][f"{axis}_e"], color=colour, linestyle=style, linewidth=2.2)
        panel.axhline(0.0, color="black", linewidth=0.8)
        panel.set_ylabel(f"$e_{axis}$ [m]")
    panel.set_xlabel("time [s]")
    return figure


def draw_efforts(runs: Runs) -> Figure:
    """The curves that the article does not show: the field set-up's commands."""
    figure, ax = panels(3, 1, (12.0, 7.0), sharex=True)
    for row, axis in enumerate(("x", "y", "z")):
        for name, colour, style in (("STA", plotting.BLUE, "--"), ("DSSC", plotting.RED, ":")):
            ax[row, 0].plot(runs[name]["t"], runs[name][f"{axis}_u"], color=colour, linestyle=style, label=name)
        ax[row, 0].set_ylabel(f"$u_{axis}$ [m/s]")
    key(figure, ax[0, 0])
    label_time(ax)
    return figure


def save(figure: Figure, name: str) -> None:
    """Write a figure of the page."""
    plotting.write(figure, FIGURES / f"paper_{name}.png")
