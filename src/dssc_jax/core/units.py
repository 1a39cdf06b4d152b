"""Units of a channel's signals, and the units of numbers that follow from them.

Models and metrics do not know with which plant a study combines them. Their units contain two symbols: ``y``, the unit
of the plant's output, and ``u``, the unit of its command. ``y/s^2`` is the unit of y'', and ``y/(s^2 u)`` that of the
high-frequency gain. :meth:`ChannelUnits.of` replaces the symbols by the plant's own units and reduces the result.
"""

import math
import re
from fractions import Fraction
from functools import cache
from typing import NamedTuple, TypeAlias

OUTPUT = "y"
COMMAND = "u"
POWER = r"\^(?P<power>-?\d+|\(-?\d+(?:/\d+)?\))"  # ^2, ^-1 or ^(1/2)
TOKEN = re.compile(rf"\s*(?:(?P<symbol>[^\W\d_]+|[%°]\w*|1)(?:{POWER})?|(?P<mark>[/()]))\s*")
CLOSING = re.compile(rf"\)(?:{POWER})?\s*")

PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6, "G": 1e9}
PREFIXED = ("m", "s", "A", "N", "Pa", "J", "W", "V", "F", "H", "Hz", "ohm", "C", "T", "rad")
"""Units of the SI that are written with prefixes."""
OTHER_UNITS = {  # each with its size in a unit of the SI
    "cm": (1e-2, "m"),
    "deg": (math.radians(1.0), "rad"),
    "rpm": (math.tau / 60.0, "rad/s"),
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
}

Powers: TypeAlias = dict[str, Fraction]
"""Exponent of each base unit, in the order in which the units were first named."""


class ChannelUnits(NamedTuple):
    """Units and meanings of one channel's output and command.

    A plant that declares no units keeps the symbols: the unit of its errors is then written ``y``.

    Args:
        output: Unit of the output y.
        command: Unit of the command u.
        output_meaning: What the output is, such as ``shaft speed``.
        command_meaning: What the command is, such as ``armature voltage``.

    Example:
        >>> motor = ChannelUnits("rad/s", "V", "shaft speed", "armature voltage")
        >>> motor.of("y/(s^2 u)"), motor.of("u^2 s"), motor.of("u (y/s)^(-1/2)")
        ('rad/(s^3 V)', 'V^2 s', 'V s rad^(-1/2)')
        >>> motor.describe("largest output error")
        'largest shaft speed error'
    """

    output: str = OUTPUT
    command: str = COMMAND
    output_meaning: str = "output"
    command_meaning: str = "command"

    def of(self, unit: str) -> str:
        """Return a unit in which this channel's units replace the symbols ``y`` and ``u``.

        Args:
            unit: A unit such as ``y/s^2``, or several with commas between them.
        """
        return ", ".join(substitute_units(part, self.output, self.command) for part in unit.split(", "))

    def describe(self, meaning: str) -> str:
        """Return a meaning in which this channel's meanings replace the words ``output`` and ``command``."""
        replacements = {"output": self.output_meaning, "command": self.command_meaning}
        return re.sub(r"\b(output|command)\b", lambda match: replacements[match[0]], meaning)


UNNAMED_UNITS = ChannelUnits()
"""The units of a plant that names none."""

POSITION = ChannelUnits("m", "m/s")
"""A position driven by a velocity command, as in the article's class (5)-(8)."""

ANGLE = ChannelUnits("rad", "rad/s")
"""An angle driven by a rate command."""


@cache
def substitute_units(unit: str, output: str, command: str) -> str:
    """Replace the symbols ``y`` and ``u`` in a unit by two units, and reduce the result.

    Args:
        unit: The unit; a unit without these symbols is returned unchanged.
        output: Unit in place of ``y``.
        command: Unit in place of ``u``.
    """
    if not re.search(rf"\b({OUTPUT}|{COMMAND})\b", unit):
        return unit
    replacements = {OUTPUT: parse_unit(output), COMMAND: parse_unit(command)}
    total: Powers = {}
    for symbol, power in parse_unit(unit).items():
        multiply(total, replacements.get(symbol, {symbol: Fraction(1)}), power)
    return unit_text_of(total)


def multiply(total: Powers, factor: Powers, power: Fraction) -> None:
    """Multiply a unit, in place, by a factor to a power: add ``power`` times the factor's exponents to ``total``."""
    for symbol, exponent in factor.items():
        total[symbol] = total.get(symbol, Fraction(0)) + power * exponent


def parse_unit(text: str) -> Powers:
    """Parse the exponents of a unit such as ``N m``, ``rad/s^2`` or ``V (y/s)^(-1/2)``.

    A slash divides by the next factor alone.

    Raises:
        ValueError: The text is not a product of powers.
    """
    with_powers = re.sub(r"(?<=[^\W\d_])(?=\d)", "^", text)  # m^2 for m2
    hint = f"; exponents are written as in {with_powers!r}" if with_powers != text else ""
    message = f"must be a product of powers such as rad/s, N m or kg m^2, got {text!r}{hint}"
    try:
        powers, end = parse_product(text, 0)
    except (StopIteration, ZeroDivisionError):
        raise ValueError(message) from None
    if end != len(text):
        raise ValueError(message)
    return powers


def scaled_symbols(text: str) -> dict[str, tuple[float, str]]:
    """Return the symbols in a unit that stand for a multiple of an SI unit, each with the factor and the SI unit.

    Example:
        >>> scaled_symbols("uH/ohm"), scaled_symbols("kg m^2")
        ({'uH': (1e-06, 'H')}, {})
    """
    symbols = {}
    for symbol in parse_unit(text):
        if symbol in OTHER_UNITS:
            symbols[symbol] = OTHER_UNITS[symbol]
        elif symbol[0] in PREFIXES and symbol[1:] in PREFIXED:
            symbols[symbol] = (PREFIXES[symbol[0]], symbol[1:])
    return symbols


def parse_product(text: str, position: int) -> tuple[Powers, int]:
    """Parse the product of powers that begins at a position of a text.

    The product ends at a closing parenthesis, at the end of the text, or before text that is no part of a unit.

    Returns:
        The exponents of the product, and the position of its end.

    Raises:
        StopIteration: A factor or a parenthesis is missing.
    """
    total: Powers = {}
    sign = 1  # -1: the next factor stands behind a slash
    while True:
        token = TOKEN.match(text, position)
        if token is None or token["mark"] in ("/", ")"):
            raise StopIteration
        position = token.end()
        if token["mark"] == "(":
            factor, position = parse_product(text, position)
            closing = CLOSING.match(text, position)
            if closing is None:
                raise StopIteration
            position = closing.end()
            power = closing["power"]
        else:
            factor = {} if token["symbol"] == "1" else {token["symbol"]: Fraction(1)}
            power = token["power"]
        multiply(total, factor, sign * Fraction((power or "1").strip("()")))
        token = TOKEN.match(text, position)
        if token is None or token["mark"] == ")":
            return total, position
        sign = 1
        if token["mark"] == "/":  # holds for the next factor alone
            sign = -1
            position = token.end()


def unit_text_of(powers: Powers) -> str:
    """Return a unit as text, such as ``m/s^2``, ``rad/(s^3 V)`` or ``(m/s)^(1/2)``; ``1`` if it is dimensionless.

    The root of a rate is written as one factor, such as ``(m/s)^(1/2)``, because the square-root functions of DSSC
    depend on |sigma|^(1/2).
    """
    powers = {symbol: power for symbol, power in powers.items() if power}
    roots = [symbol for symbol, power in powers.items() if power.denominator == 2 and symbol != "s"]
    group = ""  # the root of a rate
    if len(roots) == 1 and powers.get("s", Fraction(0)).denominator == 2:
        (root,) = roots
        half = Fraction(1, 2) if powers[root] > 0 else Fraction(-1, 2)
        group = f"({root}/s)^({half})"
        powers = dict(powers)
        powers[root] -= half
        powers["s"] += half
    numerators = []
    denominators = []
    negative_roots = []
    for symbol, power in powers.items():
        if power > 0:
            numerators.append(power_text(symbol, power))
        elif power < 0 and power.denominator == 1:
            denominators.append(power_text(symbol, -power))
        elif power < 0:
            negative_roots.append(power_text(symbol, power))
    numerators += negative_roots
    if group:
        numerators.append(group)
    numerator = " ".join(numerators) or "1"
    if not denominators:
        return numerator
    denominator = " ".join(denominators)
    return f"{numerator}/{denominator}" if len(denominators) == 1 else f"{numerator}/({denominator})"


def power_text(symbol: str, power: Fraction) -> str:
    """Return one factor of a unit as text, such as ``s``, ``s^2`` or ``V^(1/2)``."""
    if power == 1:
        return symbol
    return f"{symbol}^{power}" if power.denominator == 1 else f"{symbol}^({power})"
