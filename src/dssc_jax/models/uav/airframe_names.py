"""Names in PX4 files: parameters whose names are misspelt, and files of frames that are no multirotor."""

import re
from collections.abc import Collection, Iterable

from dssc_jax.core.errors import ConfigError

FRAMES = {
    "vtol": "a VTOL",
    "plane": "a plane",
    "fw": "a plane",
    "rover": "a rover",
    "heli": "a helicopter",
    "airship": "an airship",
    "uuv": "an underwater vehicle",
}
"""Frames that are no multirotor, by a script's class, or by its start-up script rc.._defaults."""
FRAME = re.compile(
    rf"^[ \t]*(?P<line>#[ \t]*@class[ \t]+(?P<kind>{'|'.join(FRAMES)})\b.*"
    rf"|(?:\.|sh)[ \t]+\S*/rc\.(?P<script>{'|'.join(FRAMES)})(?:_\w+)?_defaults\b)",
    re.MULTILINE | re.IGNORECASE,
)
"""A line of a start-up script that makes its vehicle one of them."""


def require_multirotor(text: str) -> None:
    """Require that no line of a start-up script declares another vehicle than a multirotor.

    Raises:
        ConfigError: A line does; the message quotes it.
    """
    line = FRAME.search(text)
    if line is None:
        return
    frame = FRAMES[(line["kind"] or line["script"]).lower()]
    raise ConfigError("", f"must be the file of a multirotor: its line {line['line'].strip()!r} is that of {frame}")


def shortened(name: str) -> set[str]:
    """All names that result when one character is left out."""
    return {name[:i] + name[i + 1 :] for i in range(len(name))}


def exchanged(name: str) -> set[str]:
    """All names that result when two neighbouring characters are exchanged."""
    return {name[:i] + name[i + 1] + name[i] + name[i + 2 :] for i in range(len(name) - 1)}


def misspelt_names(names: Collection[str], known: Iterable[str]) -> list[str]:
    """A sentence for each unknown name that a single typing error may have made of a known one.

    A typing error is one character too many or too few, or two neighbouring characters exchanged. A wrong character
    does not count, because names of PX4 differ from each other by a single character. Of several near known names, only
    those that are not among ``names`` are told; all are, if all are among them.

    Args:
        names: The names to check.
        known: The known names.

    Example:
        >>> misspelt_names(["MPC_THR_HOVR", "MPC_THR_MAX"], ["MPC_THR_HOVER", "MPC_THR_MAX", "MPC_THR_MIN"])
        ['MPC_THR_HOVR is not read: PX4 has MPC_THR_HOVER']
    """
    slips = {right: shortened(right) | exchanged(right) for right in known}
    lines = []
    for name in sorted(set(names) - set(slips)):
        without_one = shortened(name)
        near = [right for right, wrong in slips.items() if name in wrong or right in without_one]
        likely = [right for right in near if right not in names] or near
        if likely:
            lines.append(f"{name} is not read: PX4 has {' or '.join(likely)}")
    return lines
