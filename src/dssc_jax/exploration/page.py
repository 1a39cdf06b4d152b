"""Base class of the pages: status line, panes of text, and work in the background."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, ParamSpec, TypeVar

import htpy as h
import numpy as np
import panel as pn
from panel.io.document import hold
from panel.viewable import Viewable

from dssc_jax.exploration.worker import Stale, Work, Worker

WORST_DRAW = "worst draw"
MEDIAN_DRAW = "median draw"
RANDOM_DRAW = "random draw"
PAGE_STYLE = """
:host { font-size: 15px; }
p.error { color: #a00000; font-weight: 600; }
p.headline { font-size: 20px; font-weight: 600; margin: 0; }
p { margin: 2px 0; }
"""

Answer = TypeVar("Answer")
Arguments = ParamSpec("Arguments")


class Page(ABC):
    """A page for the browser, a notebook or a program.

    Args:
        background: Whether work happens in threads, in which newer work replaces older work, as on a served page. If
            not, a change of the page returns when its work is done.
    """

    def __init__(self, background: bool = False) -> None:
        self._worker = Worker() if background else None
        self._second_worker = Worker() if background else None
        self._document = pn.state.curdoc if background else None
        self._random = np.random.default_rng(0)
        self.status = html_pane("")

    @property
    @abstractmethod
    def view(self) -> Viewable:
        """The page for Panel."""

    def _repr_mimebundle_(self, *args: Any, **options: Any) -> Any:
        """The page as the value of a notebook's cell."""
        return self.view._repr_mimebundle_(*args, **options)

    def choose(self, choice: str, order: np.ndarray) -> int:
        """Select the worst, the median or a random draw.

        Args:
            choice: :data:`WORST_DRAW`, :data:`MEDIAN_DRAW` or :data:`RANDOM_DRAW`.
            order: Draws from the worst to the best.
        """
        places = {WORST_DRAW: 0, MEDIAN_DRAW: len(order) // 2}
        return int(order[places[choice]] if choice in places else self._random.integers(len(order)))

    def work(self, task: Work) -> None:
        """Do a task, in a thread if the page works in the background."""
        do(task, self._worker)

    def work_aside(self, task: Work) -> None:
        """Do a task in a second thread, so that it does not delay those of :meth:`work`."""
        do(task, self._second_worker)

    def show_aside(self, compute: Callable[[], Answer], show: Callable[[Answer], None]) -> None:
        """Compute an answer in the second thread, and show it unless a newer request has come."""

        def task(stale: Stale) -> None:
            answer = compute()
            if not stale():
                self.update(show, answer)

        self.work_aside(task)

    def update(
        self, change: Callable[Arguments, None], *arguments: Arguments.args, **options: Arguments.kwargs
    ) -> None:
        """Change the page from any thread; the browser receives all changes of one call together.

        Args:
            change: Function that changes the page.
            arguments: Its arguments.
            options: Its keyword arguments.
        """
        if self._document is None:
            change(*arguments, **options)
        else:
            self._document.add_next_tick_callback(partial(self._change, change, *arguments, **options))

    def _change(
        self, change: Callable[Arguments, None], *arguments: Arguments.args, **options: Arguments.kwargs
    ) -> None:
        """Change the page in the thread of the server."""
        with hold(self._document):
            change(*arguments, **options)

    def say(self, text: str) -> None:
        """Show a text as the status."""
        self.status.object = markup(h.p(role="status")[text])

    def complain(self, text: str) -> None:
        """Show an error as the status."""
        self.status.object = markup(h.p(".error", role="alert")[text])

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no work is running, at most for a timeout [s]; return whether that came true."""
        return all(worker is None or worker.wait(timeout) for worker in (self._worker, self._second_worker))

    def close(self) -> None:
        """End the page's threads."""
        for worker in (self._worker, self._second_worker):
            if worker is not None:
                worker.close()


def do(task: Work, worker: Worker | None) -> None:
    """Let a worker do a task; without a worker, do it at once."""
    if worker is None:
        task(lambda: False)
    else:
        worker.submit(task)


def html_pane(text: str) -> pn.pane.HTML:
    """A pane of HTML text in the style of the pages."""
    return pn.pane.HTML(text, stylesheets=[PAGE_STYLE])


def markup(element: h.Element) -> str:
    """An element as HTML text, in which all strings are escaped."""
    return "".join(element.iter_chunks())
