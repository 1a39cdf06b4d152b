"""The tokens of formulas in signal temporal logic: words, numbers and signs."""

import re
from typing import NamedTuple

from dssc_jax.study.expressions import FUNCTIONS, PI

TOKEN = re.compile(r"\s*(?:(?P<word>[A-Za-z_]\w*)|(?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)"
                   r"|(?P<sign><=|>=|->|==|!=|\*\*|[-+*/<>()\[\],]))", re.ASCII)  # fmt: skip
COMPARISONS = ("<", "<=", ">", ">=")
WORDS = ("always", "eventually", "until", "not", "and", "or", "implies")
ARITHMETIC_WORDS = ", ".join((PI, *FUNCTIONS))
LANGUAGE = f"it may hold signals, parameters, numbers, comparisons, {', '.join(WORDS)}, + - * /, {ARITHMETIC_WORDS}"


class Token(NamedTuple):
    """A word, number or sign of a formula, and the position of its first character."""

    text: str
    start: int


def tokens_of(text: str) -> list[Token]:
    """Split the text of a formula into tokens.

    Raises:
        ValueError: A character belongs to no token.
    """
    tokens: list[Token] = []
    position = 0
    while text[position:].strip():
        match = TOKEN.match(text, position)
        if match is None:
            raise ValueError(f"{text[position:].strip()[0]!r} is not admissible in a formula; {LANGUAGE}")
        token = match.group(0).strip()
        tokens.append(Token(token, match.end() - len(token)))
        position = match.end()
    return tokens
