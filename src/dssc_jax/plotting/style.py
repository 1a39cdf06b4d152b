"""Style shared by all figures: palette, scales, labels."""

import textwrap
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter

from dssc_jax.core import files

# Okabe and Ito's palette, distinguishable with any colour vision
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#6b6b6b"
DARK = "#333333"
VIOLET, SKY, YELLOW = "#CC79A7", "#56B4E9", "#F0E442"
STYLE: dict[Any, Any] = {
    "font.size": 13,
    "axes.titlesize": 14,
    "axes.labelsize": 13,
    "legend.fontsize": 12,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.8,
    "savefig.dpi": 140,
    "svg.fonttype": "none",  # text stays text: readers search and edit it, and a file is half as large
    "figure.autolayout": False,  # each figure names its layout, and has none once it is laid out; see arrange
    "figure.constrained_layout.use": False,
}
FAST_PNG: dict[str, Any] = {"pil_kwargs": {"compress_level": 3}}
"""Two thirds of the time, and a file 4 % larger."""
SLIDE, PANEL, SMALL = (11.5, 5.6), (6.4, 4.6), (4.6, 3.8)  # inches
DRAWABLE = np.float64(1e100)  # larger numbers overflow in matplotlib's axes; float32 would make a float infinite
TITLE_DENSITY = 8.0  # characters of a title per inch
LOG_SPAN = 8.0  # axes whose positive values span more than this ratio are logarithmic
DrawingArguments = ParamSpec("DrawingArguments")
Drawn = TypeVar("Drawn")


def styled(draw: Callable[DrawingArguments, Drawn]) -> Callable[DrawingArguments, Drawn]:
    """Decorate a function to draw in the project's style, leaving the caller's style unchanged."""

    @wraps(draw)
    def wrapper(*args: DrawingArguments.args, **options: DrawingArguments.kwargs) -> Drawn:
        with rc_context(STYLE):
            return draw(*args, **options)

    return wrapper


def panel(ax: Axes | None, size: tuple[float, float] = PANEL) -> tuple[Figure, Axes]:
    """The axes to draw into, and their figure; a new figure if none are given."""
    if ax is None:
        ax = Figure(figsize=size, layout="constrained").subplots()
    figure = ax.get_figure(root=True)
    assert figure is not None  # axes that were removed from theirs are not drawn into
    return figure, ax


def label(about: dict[str, Any]) -> str:
    """Long name with unit; a dollar sign does not start mathematics."""
    unit, name = about.get("units", ""), str(about.get("long_name", ""))
    return (name if unit in ("", "1") else f"{name} [{unit}]").replace("$", r"\$")


def named(name: str, about: dict[str, Any]) -> str:
    """An axis label: the dotted name and its meaning."""
    return f"{name}\n{textwrap.fill(label(about), 42)}"


def title(figure: Figure, text: str) -> None:
    """Set a title in the user's own words: wrapped to the figure's width, and not interpreted as mathematics."""
    width = int(TITLE_DENSITY * figure.get_figwidth())
    figure.suptitle("\n".join(textwrap.fill(line, width) for line in text.splitlines()), parse_math=False)


def is_log(values: np.ndarray) -> bool:
    """Whether an axis should be logarithmic."""
    positive = values[np.isfinite(values)]
    return positive.size > 2 and positive.min() > 0 and positive.max() / positive.min() > LOG_SPAN


def set_scale(ax: Axes, values: np.ndarray, which: str = "x") -> None:
    """Make an axis logarithmic if it should be; see :func:`set_log`."""
    if is_log(values):
        set_log(ax, values, which)


def set_log(ax: Axes, values: np.ndarray, which: str = "x") -> None:
    """Make an axis logarithmic; see :func:`set_log_ticks`."""
    (ax.set_xscale if which == "x" else ax.set_yscale)("log")
    positive = values[np.isfinite(values)]
    set_log_ticks(ax.xaxis if which == "x" else ax.yaxis, positive.min(), positive.max())


def set_log_ticks(axis: Axis, low: float, high: float) -> None:
    """Label a logarithmic axis with plain numbers, more of them if the range is short."""
    decades = np.log10(high / low)
    subs = (1.0, 2.0, 5.0) if decades < 1.3 else (1.0, 3.0) if decades < 2.0 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def probability_top(largest: float, margin: float = 0.06) -> float:
    """Upper end of an axis of probabilities: all of it, or what the data need if they stay below one half."""
    return max(largest, 1e-6) * (1.0 + margin) if largest < 0.5 else 1.0 + 0.5 * margin


def fit_probability(ax: Axes, largest: float, margin: float = 0.06) -> None:
    """Let the y axis show probabilities, in per cent, from zero to what the data need."""
    top = probability_top(largest, margin) if margin else largest
    ax.set_ylim(-0.03 * top, top)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def write(figure: Figure, path: Path) -> Path:
    """Save a figure in the format that its name ends in."""
    form = path.suffix.lower().removeprefix(".")
    with rc_context(STYLE), files.replacing(path) as file:
        arrange(figure)
        figure.savefig(file, format=form, **FAST_PNG if form == "png" else {})
    return path


def write_png_and_svg(figure: Figure, png: Path, svg: Path, within: Path | None = None) -> None:
    """Save a figure as PNG and SVG; a thread compresses the one while the other is drawn.

    Args:
        figure: The figure.
        png: One file.
        svg: The other one.
        within: As for :func:`dssc_jax.core.files.replacing`.
    """
    with ExitStack() as stack:
        stack.enter_context(rc_context(STYLE))
        image_file = stack.enter_context(files.replacing(png, within))
        drawing_file = stack.enter_context(files.replacing(svg, within))
        compressing = stack.enter_context(ThreadPoolExecutor(1))
        arrange(figure)
        figure.set_dpi(STYLE["savefig.dpi"])
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        image = canvas.buffer_rgba()
        compressed = compressing.submit(
            imsave, image_file, image, format="png", dpi=figure.dpi, origin="upper", **FAST_PNG
        )
        figure.savefig(drawing_file, format="svg")
        compressed.result()


def arrange(figure: Figure) -> None:
    """Lay a figure out once, for all files that it is written to; matplotlib would do so twice for each."""
    engine = figure.get_layout_engine()
    if engine is not None:
        figure.set_dpi(STYLE["savefig.dpi"])
        engine.execute(figure)
        figure.set_layout_engine(None)
