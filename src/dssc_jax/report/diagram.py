"""The closed loop of a study as a block diagram."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import htpy as h

from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in, section_of

WIDTH = 158  # of a block [px]
HEIGHT = 66  # of a block [px]
GAP = 44  # between blocks [px]
UPPER_ROW = 34  # upper edge of the blocks in the upper row [px]
FORWARD_ROW = 150  # likewise, in the row of the forward path
FEEDBACK_ROW = 256  # likewise, in the row of the feedback
MARGIN = 14  # around the diagram [px]
RADIUS = 9  # of a junction [px]
LINE_LENGTH = 24
"""Largest number of characters in a line of a block."""
ABSENT = ("none", "ideal")
"""Kinds of parts that do nothing, and have no block."""
ALWAYS = ("reference", "plant", "controller")
"""Parts that every loop has."""
BASELINE_SKIP = 16  # between two lines of text in a block [px]
NAMES = {
    "reference": "reference",
    "controller": "controller",
    "unmodelled": "unmodelled",
    "plant": "plant",
    "disturbance": "disturbance d",
    "wind": "wind",
    "sensor": "sensor",
    "differentiator": "differentiator",
}
"""Title of the block of each part of the loop."""
MIDDLE = FORWARD_ROW + HEIGHT // 2
"""Height of the forward path."""


@dataclass
class Drawing:
    """The elements drawn so far; coordinates are in pixels, x to the right and y downwards."""

    elements: list[h.Element] = field(default_factory=list)

    def block(self, x: int, y: int, title: str, lines: Sequence[str] = ()) -> None:
        """Add a block with a title and up to two lines below it.

        Args:
            x: Left edge [px].
            y: Upper edge [px].
            title: The title.
            lines: The lines; empty ones are left out, and long ones are shortened.
        """
        texts = [title, *(shorten(line) for line in lines if line)]
        baseline = y + HEIGHT // 2 - BASELINE_SKIP // 2 * (len(texts) - 1) + 5  # the lines stand around the middle
        labels = []
        for i, text in enumerate(texts):
            label = h.text(class_="title" if i == 0 else "line", x=x + WIDTH // 2, y=baseline)
            labels.append(label[text])
            baseline += BASELINE_SKIP
        frame = h.rect(".block", x=x, y=y, width=WIDTH, height=HEIGHT, rx=6)
        self.elements.append(h.g[h.title[" ".join((title, *lines))], frame, labels])

    def arrow(self, *points: tuple[int, int], label: str = "") -> None:
        """Add a line through points with an arrowhead at the last point, and a label beside its first segment."""
        path = "M" + "L".join(f"{x} {y}" for x, y in points)  # move to the first point, draw lines to the others
        self.elements.append(h.path(".wire", d=path, marker_end="url(#arrow)"))
        (x1, y1), (x2, y2), *_ = points
        is_vertical = x1 == x2
        if label and is_vertical:
            self.signal(x1 + 7, (y1 + y2) // 2 + 4, label)
        elif label:
            self.signal((x1 + x2) // 2, y1 - 7, label)

    def signal(self, x: int, y: int, name: str) -> None:
        """Add the name of a signal at a place in the drawing.

        Args:
            x: Horizontal position [px].
            y: Vertical position [px].
            name: The name.
        """
        self.elements.append(h.text(".signal", x=x, y=y)[name])

    def junction(self, x: int, y: int) -> None:
        """Add a circle in which signals are summed."""
        self.elements.append(h.circle(".sum", cx=x, cy=y, r=RADIUS))
        self.elements.append(h.text(".plus", x=x, y=y + 5)["+"])


def diagram(study: Study) -> h.Element:
    """The block diagram of a study's loop as an SVG element."""
    drawing = Drawing()
    drawing.block(MARGIN, FORWARD_ROW, NAMES["reference"], block_lines(study, "reference"))
    controller = MARGIN + WIDTH + GAP
    drawing.arrow((controller - GAP, MIDDLE), (controller, MIDDLE), label="yₘ")
    drawing.block(controller, FORWARD_ROW, NAMES["controller"], block_lines(study, "controller"))
    plant = draw_inputs(drawing, study, controller)
    drawing.block(plant, FORWARD_ROW, NAMES["plant"], block_lines(study, "plant"))
    if present_kinds(study, "wind"):
        drawing.block(plant, UPPER_ROW, NAMES["wind"], block_lines(study, "wind"))
        drawing.arrow((plant + WIDTH // 2, UPPER_ROW + HEIGHT), (plant + WIDTH // 2, FORWARD_ROW))
    end = plant + WIDTH
    drawing.arrow((end, MIDDLE), (end + GAP + MARGIN, MIDDLE))
    drawing.signal(end + GAP, MIDDLE - 9, "y")
    bottom = draw_feedback(drawing, study, end + GAP // 2, controller + WIDTH // 2)
    if len(study.loop.channels) > 1:
        text = f"Everything but reference, wind and plant is there in each channel: {', '.join(study.loop.channels)}."
        bottom += 2 * MARGIN
        drawing.elements.append(h.text(".note", x=MARGIN, y=bottom)[text])
    has_upper_row = has_nominal(study) or present_kinds(study, "disturbance") or present_kinds(study, "wind")
    top = UPPER_ROW if has_upper_row else FORWARD_ROW
    width = end + GAP + 2 * MARGIN
    box = f"0 {top - MARGIN} {width} {bottom - top + 2 * MARGIN}"
    head = h.marker("#arrow", viewBox="0 0 8 8", refX=8, refY=4, markerWidth=8, markerHeight=8, orient="auto")
    definitions = h.defs[head[h.path(".head", d="M0 0L8 4L0 8z")]]
    svg = h.svg(".diagram", role="img", aria_label=diagram_text(study), viewBox=box, width=width)
    return svg[definitions, drawing.elements]


def draw_inputs(drawing: Drawing, study: Study, controller: int) -> int:
    """Draw the forward path from the controller to the plant: nominal control, unmodelled dynamics, disturbance.

    Parts that the study does not have are left out.

    Args:
        drawing: The drawing.
        study: The study.
        controller: Left edge of the controller's block.

    Returns:
        Left edge of the plant's block.
    """
    x = controller + WIDTH
    upper_x = controller  # where the upper row is free
    if has_nominal(study):
        x = draw_addition(drawing, x, upper_x, "nominal control", (), ("u", "uₙ"))
        upper_x = x
    if present_kinds(study, "unmodelled"):
        drawing.arrow((x, MIDDLE), (x + GAP, MIDDLE), label="uₚ" if has_nominal(study) else "u")
        drawing.block(x + GAP, FORWARD_ROW, NAMES["unmodelled"], block_lines(study, "unmodelled"))
        x += GAP + WIDTH
        upper_x = x - WIDTH
    if present_kinds(study, "disturbance"):
        x = draw_addition(drawing, x, upper_x, NAMES["disturbance"], block_lines(study, "disturbance"), ("", "d"))
    drawing.arrow((x, MIDDLE), (x + GAP, MIDDLE))
    return x + GAP


def draw_addition(
    drawing: Drawing, x: int, upper_x: int, title: str, lines: Sequence[str], signals: tuple[str, str]
) -> int:
    """Draw a block in the upper row whose signal is added to the forward path.

    Args:
        drawing: The drawing.
        x: Present end of the forward path.
        upper_x: Left edge of the block.
        title: Title of the block.
        lines: Lines below the title.
        signals: Name of the signal along the path, and name of the block's signal; empty: no name.

    Returns:
        The new end of the forward path.
    """
    path_signal, block_signal = signals
    block_end = upper_x + WIDTH
    upper_middle = UPPER_ROW + HEIGHT // 2
    junction = max(x + GAP, block_end + GAP)
    drawing.block(upper_x, UPPER_ROW, title, lines)
    drawing.arrow((x, MIDDLE), (junction - RADIUS, MIDDLE), label=path_signal)
    drawing.signal(block_end + GAP // 2, upper_middle - 7, block_signal)
    drawing.arrow((block_end, upper_middle), (junction, upper_middle), (junction, MIDDLE - RADIUS))
    drawing.junction(junction, MIDDLE)
    return junction + RADIUS


def draw_feedback(drawing: Drawing, study: Study, start: int, target: int) -> int:
    """Draw the feedback from the output to the controller, through sensor and differentiator if the study has them.

    Args:
        drawing: The drawing.
        study: The study.
        start: Horizontal position at which the feedback leaves the output [px].
        target: Horizontal position at which the feedback enters the controller from below [px].

    Returns:
        Lower edge of the feedback [px].
    """
    drawing.elements.append(h.circle(".node", cx=start, cy=MIDDLE, r=3))
    slots = [slot for slot in ("sensor", "differentiator") if present_kinds(study, slot)]
    row = FEEDBACK_ROW + HEIGHT // 2 if slots else FEEDBACK_ROW
    points = [(start, MIDDLE), (start, row)]
    for i, slot in enumerate(slots):
        right = start - GAP - i * (WIDTH + GAP)
        drawing.arrow(*points, (right, row))
        drawing.block(right - WIDTH, FEEDBACK_ROW, NAMES[slot], block_lines(study, slot))
        points = [(right - WIDTH, row)]
    drawing.arrow(*points, (target, row), (target, FORWARD_ROW + HEIGHT))
    return FEEDBACK_ROW + HEIGHT if slots else FEEDBACK_ROW


def diagram_text(study: Study) -> str:
    """Describe the block diagram in one sentence, for readers who cannot see it."""
    slots = [slot for slot in NAMES if slot in ALWAYS or present_kinds(study, slot)]
    parts = [f"{NAMES[slot]} {part_kind(study, slot)}" for slot in slots]
    nominal = ", with a nominal part added to the command" if has_nominal(study) else ""
    return f"Block diagram of the closed loop: {', '.join(parts)}{nominal}. The output is fed back to the controller."


def block_lines(study: Study, slot: str) -> list[str]:
    """The lines below the title of a block: the part's kind, and its numbers that are uncertain (~) or swept (⇄).

    If there are more than two such numbers, only their count is given.
    """
    table = getattr(study.config, slot)
    functions = table.get("functions") if isinstance(table, dict) else None
    functions_kind = f": {functions['kind']}" if isinstance(functions, dict) and "kind" in functions else ""
    section = f"{section_of(study.config, slot)}."
    marks = [f"~ {last_field(name)}" for name in study.uncertain if name.startswith(section)]
    swept_names: dict[str, None] = {}  # each once, in the order of the axes
    for axis in study.axes:
        swept_names |= dict.fromkeys(study.followers(axis))
    for name in swept_names:
        if name.startswith(section):
            marks.append(f"⇄ {last_field(name)}")
    numbers = "  ".join(marks) if len(marks) <= 2 else f"~ {len(marks)} uncertain or swept"
    return [part_kind(study, slot) + functions_kind, numbers]


def last_field(name: str) -> str:
    """The last part of a dotted name, such as "k_p" of "plant.k_p"."""
    return name.rpartition(".")[2]


def part_kind(study: Study, slot: str) -> str:
    """The kind of a part of the loop; if channels or measured signals have different parts, the kinds of all of them.

    Args:
        study: The study.
        slot: The kind of part, such as ``controller``.
    """
    table = getattr(study.config, section_of(study.config, slot))
    common_kind = kind_in(study.config, slot)
    is_common = isinstance(table, list) or ("kind" in table and common_kind not in ABSENT)
    if is_common:
        return common_kind
    kinds = ", ".join(present_kinds(study, slot))
    return kinds or common_kind


def present_kinds(study: Study, slot: str) -> list[str]:
    """The kinds of a part that has an effect, each kind once.

    The part may be set for all channels, for single channels, or for measured signals.

    Args:
        study: The study.
        slot: The kind of part, such as ``sensor``.
    """
    section = getattr(study.config, section_of(study.config, slot))
    parts = section
    if isinstance(section, dict):  # the part of all channels, with tables of single channels in it
        parts_of_channels = [part for part in section.values() if isinstance(part, dict)]
        parts = [section, *parts_of_channels]
    kinds = dict.fromkeys(part.get("kind") for part in parts)
    return [kind for kind in kinds if kind is not None and kind not in ABSENT]


def has_nominal(study: Study) -> bool:
    """Whether the controller has a nominal part, by the names of the controller's numbers."""
    names = [name for name in study.leaves() if name.startswith("controller.")]
    return any("nominal" in name.split(".") for name in names)


def shorten(text: str) -> str:
    """Cut a text to the length of a line in a block."""
    return text if len(text) <= LINE_LENGTH else f"{text[: LINE_LENGTH - 1]}…"
