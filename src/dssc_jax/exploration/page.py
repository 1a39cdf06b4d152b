"""What all pages have in common: work in the background, and a line that tells what is going on."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any

import htpy as h
import panel as pn
from panel.io.document import hold
from panel.viewable import Viewable

from dssc_jax.exploration.latest import Latest, Work

WORST_DRAW, MEDIAN_DRAW, RANDOM_DRAW = "worst draw", "median draw", "random draw"
PAGE_STYLE = """
:host { font-size: 15px; }
p.error { color: #a00000; font-weight: 600; }
p.headline { font-size: 20px; font-weight: 600; margin: 0; }
p { margin: 2px 0; }
"""


class Page(ABC):
    """A page for the browser, a notebook or a program.

    Args:
        background: Whether to work in a thread, in which newer work replaces older work; a served page does. Otherwise
            a change of the page returns when its work is done.
    """

    def __init__(self, background: bool = False) -> None:
        self._latest, self._later = (Latest(), Latest()) if background else (None, None)
        self._document = pn.state.curdoc if background else None
        self.status = html_pane("")

    @property
    @abstractmethod
    def view(self) -> Viewable:
        """The page for Panel."""

    def _repr_mimebundle_(self, *args: Any, **options: Any) -> Any:
        """How a notebook shows the page."""
        return self.view._repr_mimebundle_(*args, **options)

    def work(self, task: Work) -> None:
        """Do some work, in the background if the page has one."""
        if self._latest is None:
            task(lambda: False)
        else:
            self._latest.submit(task)

    def work_later(self, task: Work) -> None:
        """Do some work beside which newer work runs at once."""
        if self._later is None:
            task(lambda: False)
        else:
            self._later.submit(task)

    def update(self, act: Callable[..., None], *arguments: Any) -> None:
        """Change the page, from whatever thread; the browser receives what one call changes at once."""
        if self._document is None:
            act(*arguments)
        else:
            self._document.add_next_tick_callback(partial(self._at_once, act, *arguments))

    def _at_once(self, act: Callable[..., None], *arguments: Any) -> None:
        with hold(self._document):
            act(*arguments)

    def say(self, text: str) -> None:
        """Tell what is going on."""
        self.status.object = markup(h.p(role="status")[text])

    def complain(self, text: str) -> None:
        """Tell what went wrong."""
        self.status.object = markup(h.p(".error", role="alert")[text])

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until nothing is running; see :meth:`dssc_jax.exploration.latest.Latest.wait`."""
        return all(latest is None or latest.wait(timeout) for latest in (self._latest, self._later))

    def close(self) -> None:
        """End the page's threads."""
        for latest in (self._latest, self._later):
            if latest is not None:
                latest.close()


def html_pane(text: str) -> pn.pane.HTML:
    """A pane of the pages' style."""
    return pn.pane.HTML(text, stylesheets=[PAGE_STYLE])


def markup(element: h.Element) -> str:
    """An element as plain text of HTML, in which all strings are escaped."""
    return "".join(element.iter_chunks())
