"""The base class of the pages: a status line, panes of text, and tasks in the background."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, ParamSpec, TypeVar

import htpy as h
import numpy as np
import panel as pn
from panel.io.document import hold
from panel.viewable import Viewable

from dssc_jax.exploration.worker import Stale, Work, Worker, never_stale

WORST_DRAW = "worst draw"
MEDIAN_DRAW = "median draw"
RANDOM_DRAW = "random draw"
"""The three choices of a draw, see :meth:`Page.choose`."""
PAGE_STYLE = """
:host { font-size: 15px; }
p.error { color: #a00000; font-weight: 600; }
p.headline { font-size: 20px; font-weight: 600; margin: 0; }
p { margin: 2px 0; }
"""
"""Style sheet of the panes of text."""

Answer = TypeVar("Answer")
Arguments = ParamSpec("Arguments")


class Page(ABC):
    """A page for the browser, a notebook or a program.

    Args:
        background: Whether tasks run in threads, as on a served page, where a newer task replaces an older one. Without
            threads, a change of the page returns when its task is done.
    """

    def __init__(self, background: bool = False) -> None:
        """Make the threads, which start with their first task, and an empty status line."""
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
        """Return the worst, the median or a random draw.

        Args:
            choice: :data:`WORST_DRAW`, :data:`MEDIAN_DRAW` or :data:`RANDOM_DRAW`.
            order: Draws from the worst to the best.
        """
        if choice == WORST_DRAW:
            return int(order[0])
        if choice == MEDIAN_DRAW:
            return int(order[len(order) // 2])
        return int(self._random.integers(len(order)))

    def run_task(self, task: Work) -> None:
        """Run a task, in a thread if the page has a background."""
        run_or_submit(task, self._worker)

    def run_second_task(self, task: Work) -> None:
        """Run a task in a second thread, so that tasks of :meth:`run_task` do not wait for it."""
        run_or_submit(task, self._second_worker)

    def show_later(self, compute: Callable[[], Answer], show: Callable[[Answer], None]) -> None:
        """Compute an answer in the second thread, and show it unless a newer request has come.

        Args:
            compute: Computes the answer.
            show: Shows it on the page.
        """

        def task(stale: Stale) -> None:
            """Compute the answer and show it."""
            answer = compute()
            if not stale():
                self.update(show, answer)

        self.run_second_task(task)

    def update(
        self, change: Callable[Arguments, None], *arguments: Arguments.args, **options: Arguments.kwargs
    ) -> None:
        """Change the page from any thread; the browser receives all changes of one call together.

        Args:
            change: Function that changes the page.
            arguments: Positional arguments of the function.
            options: Keyword arguments of the function.
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

    def show_status(self, text: str) -> None:
        """Show a text in the status line."""
        self.status.object = markup(h.p(role="status")[text])

    def show_error(self, text: str) -> None:
        """Show a text in the status line as an error."""
        self.status.object = markup(h.p(".error", role="alert")[text])

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no task is running, and return whether that is so; after a timeout, a task may still run.

        Args:
            timeout: Longest time to wait for each thread [s]; None: no limit.
        """
        return all(worker is None or worker.wait(timeout) for worker in (self._worker, self._second_worker))

    def close(self) -> None:
        """End the page's threads."""
        for worker in (self._worker, self._second_worker):
            if worker is not None:
                worker.close()


def run_or_submit(task: Work, worker: Worker | None) -> None:
    """Run a task in a worker's thread; without a worker, run it at once.

    A task that runs at once never becomes stale.

    Args:
        task: The task.
        worker: The worker; None: there is none.
    """
    if worker is None:
        task(never_stale)
    else:
        worker.submit(task)


def html_pane(text: str) -> pn.pane.HTML:
    """Make a pane of HTML text in the style of the pages."""
    return pn.pane.HTML(text, stylesheets=[PAGE_STYLE])


def markup(element: h.Element) -> str:
    """Write an element as HTML text, in which all strings are escaped."""
    return "".join(element.iter_chunks())
