"""Templates of the generated texts, in the folder ``templates``.

``@{name}`` stands for a text, ``@@`` for an @. A line with nothing but a placeholder is replaced by all lines of its
text, each with the indentation of the placeholder, and is left out if the text is empty.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from string import Template

from dssc_jax.core import files

FOLDER = Path(__file__).with_name("templates")
LINES = re.compile(r"( *)@\{(\w+)\}")
"""A line with nothing but a placeholder: its indentation and the placeholder's name."""


class TextTemplate(Template):
    """A template with the delimiter @, which is rarer in C and in makefiles than the usual one."""

    delimiter = "@"


def template_text(file: str) -> str:
    """The text of a template file."""
    return files.read_text(FOLDER / file)


def fill(file: str, **values: str | Iterable[str]) -> str:
    """The text of a template file with its placeholders replaced.

    Args:
        file: Name of the template file.
        values: Text, or lines, for each placeholder.
    """
    texts = {name: value if isinstance(value, str) else "\n".join(value) for name, value in values.items()}
    filled_lines = []
    for line in template_text(file).split("\n"):
        placeholder = LINES.fullmatch(line)
        if placeholder is None:
            filled_lines.append(TextTemplate(line).substitute(texts))
            continue
        indentation, name = placeholder.groups()
        if texts[name]:
            inserted_lines = texts[name].removesuffix("\n").split("\n")
            filled_lines += [indentation + text if text else "" for text in inserted_lines]
    return "\n".join(filled_lines)
