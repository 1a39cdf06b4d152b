"""Figures of margins: the distribution of critical values, and failure along the walk."""

import textwrap
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from dssc_jax.plotting.style import BLUE, GREEN, GREY, ORANGE, RED, SLIDE, named, styled, title

if TYPE_CHECKING:
    from dssc_jax.analyses.margins import Margins, Walk
    from dssc_jax.design.certification import Reach


@styled
def margin(found: "Margins") -> Figure:
    """Critical values of all draws, with their lower tolerance limit, and the degradation curve with its band.

    Below stands what Theorem 1 says of the same walk.

    Args:
        found: What :func:`dssc_jax.margin` returned.
    """
    figure = Figure(figsize=(SLIDE[0], SLIDE[1] + 0.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    distribution(left, found)
    curve = found.degradation()
    values, text = curve["value"].values, named(found.parameter, curve["value"].attrs)
    level = f"{100 * curve.attrs['confidence']:g} % band over all values together"
    right.fill_between(values, curve["lower"], curve["upper"], color=RED, alpha=0.2, label=level)
    right.plot(values, curve["probability"], "o-", color=RED, label="failed draws")
    right.set(xlabel=text, ylabel="failure probability", ylim=(-0.03, 1.03))
    right.yaxis.set_major_formatter(PercentFormatter(1.0))
    for ax in (left, right):
        if found.walk.log:
            ax.set_xscale("log")
        ax.set_xlim(found.walk.start, found.walk.end)
    certificate(left, found.certificate, found.walk)
    for ax in (left, right):  # above: inside, the lines leave no room
        ax.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    title(figure, f"{found.study.config.description or found.study.name}: {'; '.join(found.criterion)}")
    return figure


def distribution(ax: Axes, found: "Margins") -> None:
    """Share of draws that have failed by each value of the walk; censored ones stand before and beyond it."""
    summary = found.summary()
    critical = found.dataset["critical"].values
    steps = np.sort(critical[~np.isnan(critical)])
    steps = steps if found.walk.end > found.walk.start else steps[::-1]
    draws, before = critical.size, summary["fail_at_start"]
    x = np.concatenate([[found.walk.start], steps, [found.walk.end]])
    y = np.concatenate([[before], before + np.arange(1, len(steps) + 1) / draws, [before + len(steps) / draws]])
    ax.step(x, y, where="post", color=BLUE, label=f"{draws} draws")
    lines = (("median", "median", ":"), ("lower_tolerance", "95 % of draws pass, confidence 95 %", "--"))
    for name, text, style in lines:
        if summary[name] is not None:
            colour = ORANGE if name == "lower_tolerance" else GREY
            ax.axvline(summary[name], color=colour, linestyle=style, label=f"{text}: {summary[name]:.3g}")
    ax.set(xlabel=named(found.parameter, found.dataset["critical"].attrs), ylabel="share of draws at or below")
    if found.walk.end < found.walk.start:
        ax.set_ylabel("share of draws at or above")
    ax.set_ylim(-0.03, 1.03)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def certificate(ax: Axes, reach: "Reach", walk: "Walk") -> None:
    """Where the certificate ends, or an arrow towards it where the axis does not reach it; below, it speaks."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    figure.supxlabel(textwrap.fill(reach.text, 105), fontsize=12, color=GREEN, parse_math=False)
    if reach.value is None:
        return
    text = f"certified as far as {reach.value:.3g}"
    if min(walk.start, walk.end) <= reach.value <= max(walk.start, walk.end):
        ax.axvline(reach.value, color=GREEN, linestyle="-.", label=text)
    else:
        place = {"transform": ax.transAxes, "clip_on": False, "linestyle": "", "markersize": 10}
        ax.plot([0.0], [0.02], marker="<", color=GREEN, label=text, **place)
