"""Style shared by all figures: palette, scales, labels."""

import textwrap
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import wraps
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeAlias, TypeVar

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter

from dssc_jax.core import files
from dssc_jax.results.schema import name_with_unit
from dssc_jax.study import Study

# Okabe and Ito's palette, distinguishable with any colour vision
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
RED = "#D55E00"
VIOLET = "#CC79A7"
SKY = "#56B4E9"
YELLOW = "#F0E442"
GREY = "#6b6b6b"
DARK = "#333333"
PIXELS_PER_INCH = 140
"""Resolution of a PNG file."""
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
    "savefig.dpi": PIXELS_PER_INCH,
    "svg.fonttype": "none",  # text stays text: readers search and edit it, and a file is half as large
    "figure.autolayout": False,  # each figure names its layout, and has none once it is laid out; see arrange
    "figure.constrained_layout.use": False,
}
FAST_PNG = {"compress_level": 3}
"""Options of the PNG encoder: two thirds of the usual time, for a file 4 % larger."""
SLIDE = (11.5, 5.6)
"""Width and height of a figure for a slide [inch]."""
PANEL = (6.4, 4.6)
"""Width and height of a single panel [inch]."""
SMALL = (4.6, 3.8)
"""Width and height of a small panel [inch]."""
DRAWABLE = np.float64(1e100)  # a float would become infinite beside float32
"""Numbers of this magnitude and above overflow in matplotlib's axes, and are not drawn."""
TITLE_DENSITY = 8.0
"""Characters of a title per inch."""
LOG_SPAN = 8.0
"""Ratio of the largest to the smallest positive value above which an axis is logarithmic."""
Direction: TypeAlias = Literal["x", "y"]
DrawingArguments = ParamSpec("DrawingArguments")
Drawing = TypeVar("Drawing")


def styled(draw: Callable[DrawingArguments, Drawing]) -> Callable[DrawingArguments, Drawing]:
    """Decorate a drawing function: it then draws in the project's style, and leaves the caller's style unchanged."""

    @wraps(draw)
    def draw_in_style(*args: DrawingArguments.args, **options: DrawingArguments.kwargs) -> Drawing:
        """Draw in the project's style."""
        with rc_context(STYLE):
            return draw(*args, **options)

    return draw_in_style


def panel(ax: Axes | None, size: tuple[float, float] = PANEL) -> tuple[Figure, Axes]:
    """The axes to draw into, and their figure.

    Args:
        ax: The axes; None: the axes of a new figure.
        size: Width and height of a new figure [inch].
    """
    if ax is None:
        ax = Figure(figsize=size, layout="constrained").subplots()
    figure = ax.get_figure(root=True)
    assert figure is not None  # axes that were removed from theirs are not drawn into
    return figure, ax


def label(attributes: Mapping[str, object]) -> str:
    """The long name of a variable with its unit, for matplotlib: dollar signs are escaped.

    Args:
        attributes: Attributes of the variable: ``long_name`` and ``units``.
    """
    text = name_with_unit(str(attributes.get("long_name", "")), str(attributes.get("units", "")))
    return text.replace("$", r"\$")


def axis_label(name: str, attributes: Mapping[str, object]) -> str:
    """An axis label: a dotted name, and below it the long name and the unit."""
    return f"{name}\n{textwrap.fill(label(attributes), 42)}"


def study_title(study: Study) -> str:
    """The description of a study, or its name if it has none."""
    return study.config.description or study.name


def title(figure: Figure, text: str) -> None:
    """Set a title, wrapped to the width of the figure.

    Users write parts of the title, so ``$`` starts no mathematics.
    """
    width = int(TITLE_DENSITY * figure.get_figwidth())
    lines = [textwrap.fill(line, width) for line in text.splitlines()]
    figure.suptitle("\n".join(lines), parse_math=False)


def drawable(values: np.ndarray) -> np.ndarray:
    """Values that fit on an axis; larger magnitudes are replaced by NaN, see :data:`DRAWABLE`."""
    return np.where(np.abs(values) < DRAWABLE, values, np.nan)


def is_log(values: np.ndarray) -> bool:
    """Whether an axis of values should be logarithmic: they are positive and span more than :data:`LOG_SPAN`."""
    finite = values[np.isfinite(values)]
    return finite.size > 2 and finite.min() > 0 and finite.max() / finite.min() > LOG_SPAN


def set_scale(ax: Axes, values: np.ndarray, direction: Direction = "x") -> None:
    """Make an axis logarithmic if its values are positive and span a wide range, see :func:`is_log`.

    Args:
        ax: The axes.
        values: All values on the axis.
        direction: Which axis: ``x`` or ``y``.
    """
    if is_log(values):
        set_log(ax, values, direction)


def set_log(ax: Axes, values: np.ndarray, direction: Direction = "x") -> None:
    """Make an axis of values logarithmic, with plain numbers at its ticks.

    Args:
        ax: The axes.
        values: The values, at least one of which is finite; the finite ones must be positive.
        direction: Which axis: ``x`` or ``y``.
    """
    finite = values[np.isfinite(values)]
    if direction == "x":
        ax.set_xscale("log")
        set_log_ticks(ax.xaxis, finite.min(), finite.max())
    else:
        ax.set_yscale("log")
        set_log_ticks(ax.yaxis, finite.min(), finite.max())


def set_log_ticks(axis: Axis, low: float, high: float) -> None:
    """Label a logarithmic axis with plain numbers; the fewer decades it spans, the more numbers each decade has.

    Args:
        axis: The axis.
        low: Lower end of its values.
        high: Upper end of its values.
    """
    decades = np.log10(high / low)
    if decades < 1.3:
        labelled_mantissas = (1.0, 2.0, 5.0)
    elif decades < 2.0:
        labelled_mantissas = (1.0, 3.0)
    else:
        labelled_mantissas = (1.0,)
    axis.set_major_locator(LogLocator(subs=labelled_mantissas))
    axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def probability_top(largest: float, margin: float) -> float:
    """Upper end of an axis of probabilities: just above the largest one if it is below one half, else just above 1.

    Args:
        largest: Largest probability that is drawn.
        margin: Space above the largest probability, relative to it. Above a probability of 1 the space is half as
            large.
    """
    if largest >= 0.5:
        return 1.0 + 0.5 * margin
    return max(largest, 1e-6) * (1.0 + margin)


def fit_probability(ax: Axes, largest: float, margin: float = 0.06) -> None:
    """Set the vertical axis to probabilities in per cent, from 0 to the largest.

    Args:
        ax: The axes.
        largest: Largest probability that is drawn.
        margin: Space above the largest probability, relative to it; 0: the axis ends at ``largest``.
    """
    top = probability_top(largest, margin) if margin else largest
    ax.set_ylim(-0.03 * top, top)
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))


def write(figure: Figure, path: Path) -> Path:
    """Write a figure to a file, in the format of the file's suffix, and return the path."""
    form = path.suffix.lower().removeprefix(".")
    with rc_context(STYLE), files.replacing(path) as file:
        arrange(figure)
        if form == "png":
            figure.savefig(file, format=form, pil_kwargs=FAST_PNG)
        else:
            figure.savefig(file, format=form)
    return path


def write_png_and_svg(figure: Figure, png: Path, svg: Path, within: Path | None) -> None:
    """Write a figure as PNG and SVG; a thread compresses the PNG while the SVG is drawn.

    Args:
        figure: The figure.
        png: Path of the PNG file.
        svg: Path of the SVG file.
        within: As for :func:`dssc_jax.core.files.replacing`.
    """
    with ExitStack() as stack:
        stack.enter_context(rc_context(STYLE))
        image_file = stack.enter_context(files.replacing(png, within))
        drawing_file = stack.enter_context(files.replacing(svg, within))
        executor = stack.enter_context(ThreadPoolExecutor(1))
        arrange(figure)
        figure.set_dpi(PIXELS_PER_INCH)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        image = canvas.buffer_rgba()
        options = {"dpi": figure.dpi, "pil_kwargs": FAST_PNG}
        png_task = executor.submit(imsave, image_file, image, format="png", origin="upper", **options)
        figure.savefig(drawing_file, format="svg")
        png_task.result()


def arrange(figure: Figure) -> None:
    """Compute the layout of a figure once for all files of it; matplotlib would compute it twice for each file."""
    engine = figure.get_layout_engine()
    if engine is not None:
        figure.set_dpi(PIXELS_PER_INCH)
        engine.execute(figure)
        figure.set_layout_engine(None)
