"""Where a part of the loop has a derivative: each part declares it, and analyses read it before they linearise.

Where no derivative exists, JAX gives a wrong number without a warning: the derivative of a clip at its corner is 1/2,
and that of a quantiser is 0. A part without a declaration is therefore refused.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import Any, NamedTuple, TypeAlias

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Params


class SmoothExtent(StrEnum):
    """Where a part has a derivative in its state and inputs."""

    EVERYWHERE = "everywhere"
    PIECEWISE = "piecewise"
    NOWHERE = "nowhere"


Substitution: TypeAlias = Callable[[Params], tuple[Any, Params]]
"""``(params) -> (part, params)``: from the parameters of a part, the part that stands for it, with its parameters."""


class Smoothness(NamedTuple):
    """Declares where a part has a derivative, and which part an analysis linearises where it has none.

    Args:
        extent: ``everywhere``; ``piecewise``: except on boundaries such as a limit; ``nowhere``: no derivative is
            useful, as with a quantiser or a switching law.
        meaning: Words that follow the part's name: the boundaries of a piecewise part, or the reason why a part is
            smooth nowhere. With a substitute, a description of it, which the output of an analysis repeats.
        substitute: ``(params) -> (part, params)``: the smooth part that is differentiated instead, with a state of the
            same structure. For a piecewise part, it is the part on the inner side of the boundaries, and replaces the
            original at an operating point on a boundary. For a part that is smooth nowhere, it always replaces the
            original. None: the analysis refuses the part.
    """

    extent: SmoothExtent
    meaning: str = ""
    substitute: Substitution | None = None


Declaration: TypeAlias = Smoothness | Callable[[Params], Smoothness] | None
"""The field ``smooth`` of a part: a :class:`Smoothness`, or a function that returns one for the part's parameters;
None: not declared."""

# meanings of a Smoothness that several parts share
MEAN_GAIN = (
    "its mean gain 1, with an error of at most half a step; the describing function reaches 4/pi, so that a gain "
    "margin below 1.27 does not exclude a limit cycle of about one step"
)
"""The meaning of a part that rounds to a resolution, and for which a linearisation takes a gain of 1."""

SWITCHES = "switches at the origin and has no linearisation there; a describing function covers it where declared"
"""The meaning of a switching law, which an analysis cannot linearise."""

SMOOTH = Smoothness(SmoothExtent.EVERYWHERE)
"""A part with a derivative at every point, such as a linear one."""


def piecewise(meaning: str, substitute: Substitution | None = None) -> Smoothness:
    """Return the declaration of a part that has a derivative except on boundaries, such as a saturation.

    Args:
        meaning: The boundaries, in words that follow the part's name.
        substitute: Gives the part on the inner side of the boundaries; None: none is declared.
    """
    return Smoothness(SmoothExtent.PIECEWISE, meaning, substitute)


def not_smooth(meaning: str, substitute: Substitution | None = None) -> Smoothness:
    """Return the declaration of a part without a useful derivative, such as a quantiser.

    Args:
        meaning: The reason, in words that follow the part's name; with a substitute, a description of that.
        substitute: Gives the smooth part that is differentiated instead; None: an analysis refuses the part.
    """
    return Smoothness(SmoothExtent.NOWHERE, meaning, substitute)


def declared_smoothness(part: object, params: Params) -> Smoothness:
    """Return the smoothness that a part declares, given the part's parameters.

    Args:
        part: An instance of a contract, or any object with the field ``smooth``.
        params: Parameters of the part, in which laws may stand for numbers.

    Raises:
        ConfigError: The part declares nothing, or something that is not a :class:`Smoothness`.
    """
    declaration = getattr(part, "smooth", None)
    smoothness = declaration(params) if callable(declaration) else declaration
    if smoothness is None:
        raise ConfigError(
            "",
            "does not declare where it is smooth, so the loop is not linearised; set the field smooth of the "
            f"{type(part).__name__}: smooth=SMOOTH if it has a derivative everywhere, else piecewise(...) or "
            "not_smooth(...) (docs/extending.md)",
        )
    if not isinstance(smoothness, Smoothness):
        raise ConfigError("", f"must declare a Smoothness in its field smooth, such as SMOOTH, got {smoothness!r}")
    return smoothness
