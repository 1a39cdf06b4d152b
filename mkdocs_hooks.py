"""What the site's build adds to mkdocs: roles of cross-references in docstrings are not shown as text."""

import re
from typing import Any

ROLE = re.compile(r":(?:class|data|func|meth|mod):(?=<code>)")


def on_page_content(html: str, **_: Any) -> str:
    """Take ``:class:`` and its like away before the code that they stand for."""
    return ROLE.sub("", html)
