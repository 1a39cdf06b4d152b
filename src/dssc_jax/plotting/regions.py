"""Figure of the region of two numbers in which enough of all plants meet the requirements."""

import numpy as np
from matplotlib.figure import Figure

from dssc_jax.plotting.style import GREEN, GREY, ORANGE, RED, named, styled, title
from dssc_jax.results.analysis import Analysis

COLOURS_OF_VERDICTS = {0: ("at least 95 % pass", GREEN), 1: ("undecided", ORANGE), 2: ("fewer pass", RED)}


@styled
def region(safe: Analysis) -> Figure:
    """Plot the verdict of every simulated pair, and the pairs that Theorem 1 certifies.

    Args:
        safe: The return value of :func:`dssc_jax.region`.
    """
    data, summary = safe.dataset, safe.summary()
    figure = Figure(figsize=(8.4, 6.2), layout="constrained")
    ax = figure.subplots()
    x, y = np.meshgrid(data["first"].values, data["second"].values, indexing="ij")
    verdict, certified = data["verdict"].values, data["certified"].values
    if certified.any():
        ax.scatter(x[certified], y[certified], marker="s", s=26, facecolor="none", edgecolor=GREY, linewidth=0.8,
                   label="certified by Theorem 1")  # fmt: skip
    for code, (text, colour) in COLOURS_OF_VERDICTS.items():
        here = verdict == code
        ax.scatter(x[here], y[here], s=13, color=colour, label=f"{text}: {np.count_nonzero(here)} pairs")
    first, second = summary["names"]
    ax.set(xlabel=named(first, data["first"].attrs), ylabel=named(second, data["second"].attrs))
    for axis, log in zip((ax.set_xscale, ax.set_yscale), safe.settings()["log"], strict=True):
        axis("log" if log else "linear")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    config = safe.study.config
    level = f"{100 * summary['confidence']:g} % confidence for all pairs together, {summary['draws']} draws"
    title(figure, f"{config.description or config.name}\n{level}")
    return figure
