"""The closed loop as a block diagram, drawn from the slots that a study fills."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import htpy as h

from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in, section_of

WIDTH = 158  # of a block
HEIGHT = 66
GAP = 44  # between blocks
FORWARD_ROW = 150  # upper edges of the rows of blocks
UPPER_ROW = 34
FEEDBACK_ROW = 256
MARGIN = 14
RADIUS = 9  # of a junction
LINE_LENGTH = 24  # characters across a block
ABSENT = ("none", "ideal")
ALWAYS = ("reference", "plant", "controller")  # blocks of every loop
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


@dataclass
class Drawing:
    """Blocks and lines drawn so far, and their extent."""

    parts: list[h.Element] = field(default_factory=list)

    def block(self, x: int, y: int, title: str, lines: Sequence[str]) -> None:
        """Add a block with its title and up to two lines below."""
        texts = [title, *(shortened(line) for line in lines if line)]
        first_baseline = y + HEIGHT // 2 - 8 * (len(texts) - 1) + 5
        labels = []
        for i, text in enumerate(texts):
            label = h.text(class_="title" if i == 0 else "line", x=x + WIDTH // 2, y=first_baseline + 16 * i)
            labels.append(label[text])
        frame = h.rect(".block", x=x, y=y, width=WIDTH, height=HEIGHT, rx=6)
        self.parts.append(h.g[h.title[" ".join((title, *lines))], frame, labels])

    def arrow(self, *points: tuple[int, int], label: str = "") -> None:
        """Add a line through points with an arrowhead at the last; the label is above its first stretch."""
        x, y = points[0]
        x2, y2 = points[1]
        path = "M" + "L".join(f"{a} {b}" for a, b in points)
        self.parts.append(h.path(".wire", d=path, marker_end="url(#arrow)"))
        if label:
            label_at = (x + 7, (y + y2) // 2 + 4) if x == x2 else ((x + x2) // 2, y - 7)
            self.parts.append(h.text(".signal", x=label_at[0], y=label_at[1])[label])

    def junction(self, x: int, y: int) -> None:
        """Add a circle in which signals are summed."""
        self.parts.append(h.circle(".sum", cx=x, cy=y, r=RADIUS))
        self.parts.append(h.text(".plus", x=x, y=y + 5)["+"])


def part_kind(study: Study, slot: str) -> str:
    """The kind that a slot of the study holds; without one for all, those of its channels and measured signals."""
    table = getattr(study.config, section_of(study.config, slot))
    common = kind_in(study.config, slot)
    is_common = isinstance(table, list) or ("kind" in table and common not in ABSENT)
    return common if is_common else ", ".join(present_kinds(study, slot)) or common


def present_kinds(study: Study, slot: str) -> list[str]:
    """The kinds of a slot's parts other than ``none``: for all channels, in one of them, or of a measured signal."""
    table = getattr(study.config, section_of(study.config, slot))
    parts = table if isinstance(table, list) else [table, *(part for part in table.values() if isinstance(part, dict))]
    kinds = (part.get("kind") for part in parts)
    return [kind for kind in dict.fromkeys(kinds) if kind not in (None, *ABSENT)]


def has_nominal(study: Study) -> bool:
    """Whether the controller has a nominal part."""
    return any("nominal" in name.split(".") for name in within(study.leaves(), "controller"))


def notes(study: Study, slot: str) -> list[str]:
    """The text below a block's title: its kind, and which of its numbers are uncertain or swept."""
    table = getattr(study.config, slot)
    functions = table.get("functions") if isinstance(table, dict) else None
    inner = f": {functions['kind']}" if isinstance(functions, dict) and "kind" in functions else ""
    section = section_of(study.config, slot)
    marks = [f"~ {name.rpartition('.')[2]}" for name in within(study.uncertain, section)]
    swept = [follower for name in study.axes for follower in study.followers(name)]
    marks += [f"⇄ {name.rpartition('.')[2]}" for name in within(dict.fromkeys(swept), section)]
    numbers = "  ".join(marks) if len(marks) <= 2 else f"~ {len(marks)} uncertain or swept"
    return [part_kind(study, slot) + inner, numbers]


def within(names: Iterable[str], slot: str) -> list[str]:
    """The dotted names that belong to a slot."""
    return [name for name in names if name.startswith(f"{slot}.")]


def shortened(text: str) -> str:
    """Text shortened to fit into a block."""
    return text if len(text) <= LINE_LENGTH else f"{text[: LINE_LENGTH - 1]}…"


def words(study: Study) -> str:
    """The diagram in one sentence."""
    slots = [slot for slot in NAMES if slot in ALWAYS or present_kinds(study, slot)]
    parts = [f"{NAMES[slot]} {part_kind(study, slot)}" for slot in slots]
    nominal = ", with a nominal part added to the command" if has_nominal(study) else ""
    return f"Block diagram of the closed loop: {', '.join(parts)}{nominal}. The output is fed back to the controller."


def diagram(study: Study) -> h.Element:
    """The loop as an SVG element: the forward path from reference to output, its inputs, and the feedback."""
    drawing = Drawing()
    middle = FORWARD_ROW + HEIGHT // 2
    drawing.block(MARGIN, FORWARD_ROW, NAMES["reference"], notes(study, "reference"))
    x = MARGIN + WIDTH
    drawing.arrow((x, middle), (x + GAP, middle), label="yₘ")
    controller = x + GAP
    drawing.block(controller, FORWARD_ROW, NAMES["controller"], notes(study, "controller"))
    x = controller + WIDTH
    upper_x = x - WIDTH  # where the upper row is free
    if has_nominal(study):
        x = add(drawing, x, middle, "nominal control", [], upper_x, "u", "uₙ")
        upper_x = x
    if present_kinds(study, "unmodelled"):
        drawing.arrow((x, middle), (x + GAP, middle), label="uₚ" if has_nominal(study) else "u")
        drawing.block(x + GAP, FORWARD_ROW, NAMES["unmodelled"], notes(study, "unmodelled"))
        x += GAP + WIDTH
        upper_x = x - WIDTH
    if present_kinds(study, "disturbance"):
        x = add(drawing, x, middle, NAMES["disturbance"], notes(study, "disturbance"), upper_x, "", "d")
    drawing.arrow((x, middle), (x + GAP, middle))
    plant = x + GAP
    drawing.block(plant, FORWARD_ROW, NAMES["plant"], notes(study, "plant"))
    if present_kinds(study, "wind"):
        drawing.block(plant, UPPER_ROW, NAMES["wind"], notes(study, "wind"))
        drawing.arrow((plant + WIDTH // 2, UPPER_ROW + HEIGHT), (plant + WIDTH // 2, FORWARD_ROW))
    end = plant + WIDTH
    drawing.arrow((end, middle), (end + GAP + MARGIN, middle))
    drawing.parts.append(h.text(".signal", x=end + GAP, y=middle - 9)["y"])
    bottom = feed_back(drawing, study, end + GAP // 2, middle, controller + WIDTH // 2)
    if len(study.loop.channels) > 1:
        text = f"Everything but reference, wind and plant is there in each channel: {', '.join(study.loop.channels)}."
        bottom += 2 * MARGIN
        drawing.parts.append(h.text(".note", x=MARGIN, y=bottom)[text])
    above = has_nominal(study) or present_kinds(study, "disturbance") or present_kinds(study, "wind")
    top = UPPER_ROW if above else FORWARD_ROW
    size = (end + GAP + 2 * MARGIN, bottom - top + 2 * MARGIN)
    head = h.marker("#arrow", viewBox="0 0 8 8", refX=8, refY=4, markerWidth=8, markerHeight=8, orient="auto")
    box = f"0 {top - MARGIN} {size[0]} {size[1]}"
    return h.svg(".diagram", role="img", aria_label=words(study), viewBox=box, width=size[0])[
        h.defs[head[h.path(".head", d="M0 0L8 4L0 8z")]], drawing.parts
    ]


def add(
    drawing: Drawing, x: int, middle: int, title: str, lines: Sequence[str], upper_x: int, path_label: str, label: str
) -> int:
    """Add a block in the upper row whose signal is added to the forward path.

    Returns:
        Where the path continues.
    """
    node = max(x + GAP, upper_x + WIDTH + GAP)
    drawing.block(upper_x, UPPER_ROW, title, lines)
    drawing.arrow((x, middle), (node - RADIUS, middle), label=path_label)
    drawing.parts.append(h.text(".signal", x=upper_x + WIDTH + GAP // 2, y=UPPER_ROW + HEIGHT // 2 - 7)[label])
    drawing.arrow((upper_x + WIDTH, UPPER_ROW + HEIGHT // 2), (node, UPPER_ROW + HEIGHT // 2), (node, middle - RADIUS))
    drawing.junction(node, middle)
    return node + RADIUS


def feed_back(drawing: Drawing, study: Study, start: int, middle: int, target: int) -> int:
    """Draw the feedback from the output, through sensor and differentiator if there are any, into the controller.

    Returns:
        The lowest point.
    """
    drawing.parts.append(h.circle(".node", cx=start, cy=middle, r=3))
    slots = [slot for slot in ("sensor", "differentiator") if present_kinds(study, slot)]
    row = FEEDBACK_ROW + HEIGHT // 2 if slots else FEEDBACK_ROW
    points = [(start, middle), (start, row)]
    for i, slot in enumerate(slots):
        right = start - GAP - i * (WIDTH + GAP)
        drawing.arrow(*points, (right, row))
        drawing.block(right - WIDTH, FEEDBACK_ROW, NAMES[slot], notes(study, slot))
        points = [(right - WIDTH, row)]
    drawing.arrow(*points, (target, row), (target, FORWARD_ROW + HEIGHT))
    return FEEDBACK_ROW + HEIGHT if slots else FEEDBACK_ROW
