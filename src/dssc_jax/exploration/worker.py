"""Do work in the background, by a thread that serves the newest request only."""

import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

Stale: TypeAlias = Callable[[], bool]
"""Whether a newer request has come."""

Work: TypeAlias = Callable[[Stale], None]
"""Does the work of a request; may stop when the request is stale."""


def never_stale() -> bool:
    """Return False, for work that no newer request replaces."""
    return False


class Worker:
    """A thread that serves the newest of several requests; an older request becomes stale.

    The thread starts with the first request and ends with :meth:`close`.
    """

    def __init__(self) -> None:
        """Begin without a thread and without requests."""
        self._changed = threading.Condition()  # guards the fields below; notified when one of them changes
        self._pending: Work | None = None  # the newest work, until it begins
        self._newest = 0  # number of the newest request, counted from 1
        self._closed = False
        self._busy = False
        self._thread: threading.Thread | None = None

    def submit(self, work: Work) -> None:
        """Request work; it replaces a request that has not begun, and makes the running one stale.

        A closed worker ignores the request.
        """
        with self._changed:
            if self._closed:
                return
            self._pending = work
            self._newest += 1
            if self._thread is None:
                self._thread = threading.Thread(target=self._serve, name="explore", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no request is pending or running, and return whether that is so.

        Args:
            timeout: Longest time to wait [s]; None: no limit.
        """
        with self._changed:
            return self._changed.wait_for(lambda: self._pending is None and not self._busy, timeout)

    def close(self) -> None:
        """Drop pending work, make running work stale, and end the thread after it."""
        with self._changed:
            self._closed = True
            self._pending = None
            self._newest += 1
            self._changed.notify_all()

    def _serve(self) -> None:
        """Wait for work and do it, again and again until the worker is closed."""
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._pending is not None or self._closed)
                work = self._pending
                number = self._newest
                if work is None:  # the worker is closed
                    return
                self._pending = None
                self._busy = True
            try:
                work(partial(self._is_stale, number))
            except Exception:  # reported as of a thread that ends, but this one serves newer requests
                threading.excepthook(threading.ExceptHookArgs((*sys.exc_info(), threading.current_thread())))

    def _is_stale(self, number: int) -> bool:
        """Whether a newer request than the one with this number has come, or the worker is closed."""
        return self._newest != number
