"""Hints for frequent mistakes: wrong separators in options and in study files."""

import re

OPTION = re.compile(r"\s*(?P<name>[^\s=:]+)\s*[=:\s]\s*(?P<values>.+?)\s*")
"""An option ``NAME=A:B:...``; a colon or a blank may stand in place of ``=``."""
SEPARATORS = re.compile(r"\s*(?::|,|;|\.\.+|\bto\b|\s)\s*")
"""Separators that users write between the numbers of an option; only ``:`` is right."""
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
NAME_WITH_COLON = re.compile(r"[\w.\"-]+\s*:")
QUOTED_OR_COMMENT = re.compile(r"\"[^\"]*\"|'[^']*'|#.*")
DECIMAL_COMMA = re.compile(r"\d,\d")
LONGEST_LINE = 60
"""Largest number of characters of a line that a message quotes."""


def separator_hint(text: str, parts: int) -> str:
    """Hint for a wrong option ``NAME=A:B:...``: the text with the right separators, if only its separators are wrong.

    Args:
        text: Text of the option, as typed.
        parts: Number of numbers that must follow the name.

    Returns:
        End of a message; empty if there is no hint.
    """
    match = OPTION.fullmatch(text)
    if match is None:
        return ""
    name = match["name"].replace("/", ".")
    values = [value for value in SEPARATORS.split(match["values"]) if value]
    ending = ""
    if values and values[-1] == "log":  # a logarithmic axis, as in NAME=1:100:20:log
        values.pop()
        ending = ":log"
    corrected_text = f"{name}={':'.join(values)}{ending}"
    are_numbers = all(NUMBER.fullmatch(value) for value in values)
    if not are_numbers or len(values) != parts or corrected_text == text:
        return ""
    return f"; did you mean '{corrected_text}'?"


def toml_hint(text: str, complaint: str) -> str:
    """Hint for a TOML file that does not parse: the wrong line, and the right separator if the mistake is known.

    Args:
        text: Content of the file.
        complaint: Message of the parser, with ``at line N``.

    Returns:
        End of a message; empty if the complaint names no line.
    """
    match = re.search(r"at line (\d+)", complaint)
    if match is None:
        return ""
    number = int(match[1])  # from 1
    lines = text.splitlines()
    if number > len(lines):
        return ""
    line = lines[number - 1].strip()
    line_text = f"; the line is: {line[:LONGEST_LINE]}"
    if NAME_WITH_COLON.match(line):
        return f"{line_text}; '=' separates a name from its value"
    unquoted_line = QUOTED_OR_COMMENT.sub("", line)
    if ";" in unquoted_line:
        return f"{line_text}; ',' separates the items of a list"
    if DECIMAL_COMMA.search(unquoted_line) and "[" not in unquoted_line:
        return f"{line_text}; '.' is the decimal point"
    return line_text
