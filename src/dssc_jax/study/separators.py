"""Hints for frequent mistakes: wrong separators in options and in study files."""

import re

SEPARATORS = re.compile(r"\s*(?::|,|;|\.\.+|\bto\b|\s)\s*")


def separator_hint(text: str, parts: int) -> str:
    """Hint for a wrong option ``NAME=A:B:...``: the text with the right separators, if only these are wrong.

    Args:
        text: Text of the option, as typed.
        parts: Number of numbers that must follow the name.

    Returns:
        End of a message; empty without a hint.
    """
    match = re.fullmatch(r"\s*([^\s=:]+)\s*[=:\s]\s*(.+?)\s*", text)
    if match is None:
        return ""
    name = match.group(1).replace("/", ".")
    values = [part for part in SEPARATORS.split(match.group(2)) if part]
    ending = ""
    if values[-1:] == ["log"]:
        values = values[:-1]
        ending = ":log"
    are_numbers = all(re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", value) for value in values)
    corrected_text = f"{name}={':'.join(values)}{ending}"
    if not are_numbers or len(values) != parts or corrected_text == text:
        return ""
    return f"; did you mean '{corrected_text}'?"


def toml_hint(text: str, complaint: str) -> str:
    """Hint for a TOML file that does not parse: the line, and the separator that it lacks.

    Args:
        text: Content of the file.
        complaint: Message of the parser, with ``at line N``.

    Returns:
        End of a message; empty if the complaint names no line.
    """
    match = re.search(r"at line (\d+)", complaint)
    lines = text.splitlines()
    if match is None or int(match.group(1)) > len(lines):
        return ""
    line = lines[int(match.group(1)) - 1].strip()
    line_text = f"; the line is: {line[:60]}"
    if re.match(r"[\w.\"-]+\s*:", line):
        return f"{line_text}; '=' separates a name from its value"
    unquoted_line = re.sub(r"\"[^\"]*\"|'[^']*'|#.*", "", line)
    if ";" in unquoted_line:
        return f"{line_text}; ',' separates the items of a list"
    if re.search(r"\d,\d", unquoted_line) and "[" not in unquoted_line:
        return f"{line_text}; '.' is the decimal point"
    return line_text
