"""What all pages have in common: work in the background, and a line with the status."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, ParamSpec, TypeAlias

import htpy as h
import numpy as np
import panel as pn
from panel.io.document import hold
from panel.viewable import Viewable

WORST_DRAW, MEDIAN_DRAW, RANDOM_DRAW = "worst draw", "median draw", "random draw"
PAGE_STYLE = """
:host { font-size: 15px; }
p.error { color: #a00000; font-weight: 600; }
p.headline { font-size: 20px; font-weight: 600; margin: 0; }
p { margin: 2px 0; }
"""

Stale: TypeAlias = Callable[[], bool]
"""Whether a newer request has come."""

Work: TypeAlias = Callable[[Stale], None]

Arguments = ParamSpec("Arguments")


class Worker:
    """A thread that serves the newest of several requests; an older one may stop when it learns that it is stale.

    The thread starts with the first request and ends with :meth:`close`.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._pending: Work | None = None
        self._number = 0
        self._closed = False
        self._busy = False
        self._thread: threading.Thread | None = None

    def submit(self, work: Work) -> None:
        """Request some work; it replaces a request that has not begun, and makes the running one stale."""
        with self._changed:
            if self._closed:
                return
            self._pending = work
            self._number += 1
            if self._thread is None:
                self._thread = threading.Thread(target=self._serve, name="explore", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no request is pending or running, at most for a timeout [s]; whether that came true."""
        with self._changed:
            return self._changed.wait_for(lambda: self._pending is None and not self._busy, timeout)

    def close(self) -> None:
        """Forget pending work, make running work stale, and end the thread after it."""
        with self._changed:
            self._closed = True
            self._pending = None
            self._number += 1
            self._changed.notify_all()

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._pending is not None or self._closed)
                work = self._pending
                number = self._number
                if work is None:
                    return
                self._pending = None
                self._busy = True
            work(partial(self._is_stale, number))

    def _is_stale(self, number: int) -> bool:
        return self._number != number


class Page(ABC):
    """A page for the browser, a notebook or a program.

    Args:
        background: Whether to work in a thread, in which newer work replaces older work; a served page does. Otherwise
            a change of the page returns when its work is done.
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
        """The worst, the median or a random one of draws that are ordered from the worst to the best."""
        places = {WORST_DRAW: 0, MEDIAN_DRAW: len(order) // 2}
        return int(order[places[choice]] if choice in places else self._random.integers(len(order)))

    def work(self, task: Work) -> None:
        """Do some work, in the background if the page has one."""
        do(task, self._worker)

    def work_aside(self, task: Work) -> None:
        """Do some work beside which newer work runs at once."""
        do(task, self._second_worker)

    def update(
        self, change: Callable[Arguments, None], *arguments: Arguments.args, **options: Arguments.kwargs
    ) -> None:
        """Change the page, from whatever thread; the browser receives all changes of one call together."""
        if self._document is None:
            change(*arguments, **options)
        else:
            self._document.add_next_tick_callback(partial(self._change, change, *arguments, **options))

    def _change(
        self, change: Callable[Arguments, None], *arguments: Arguments.args, **options: Arguments.kwargs
    ) -> None:
        with hold(self._document):
            change(*arguments, **options)

    def say(self, text: str) -> None:
        """Show the status."""
        self.status.object = markup(h.p(role="status")[text])

    def complain(self, text: str) -> None:
        """Show an error as the status."""
        self.status.object = markup(h.p(".error", role="alert")[text])

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until nothing is running; see :meth:`Worker.wait`."""
        return all(worker is None or worker.wait(timeout) for worker in (self._worker, self._second_worker))

    def close(self) -> None:
        """End the page's threads."""
        for worker in (self._worker, self._second_worker):
            if worker is not None:
                worker.close()


def do(task: Work, worker: Worker | None) -> None:
    """Let a worker do a task; without one, do it at once."""
    if worker is None:
        task(lambda: False)
    else:
        worker.submit(task)


def html_pane(text: str) -> pn.pane.HTML:
    """A pane of the pages' style."""
    return pn.pane.HTML(text, stylesheets=[PAGE_STYLE])


def markup(element: h.Element) -> str:
    """An element as plain text of HTML, in which all strings are escaped."""
    return "".join(element.iter_chunks())
