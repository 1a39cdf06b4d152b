"""Serve a page to this machine's browser: 127.0.0.1 only, under a path that nobody can guess."""

import secrets
from collections.abc import Callable
from typing import Any

import panel as pn
from bokeh.server.server import Server

LOCAL = "127.0.0.1"
LIFE = 15_000  # ms that a session outlives its closed page
LARGEST_MESSAGE = 64 * 2**20  # bytes


class PageServer:
    """A server of one page. Every tab has a session of its own, which ends when the tab is closed.

    The page's address contains a random token; any other address is not found, and a page of another origin cannot
    connect. Scripts and styles come from this server, and nothing from the network.

    Args:
        make: Makes the page of a session: an object with ``view`` and ``close()``.
        title: Title of the page.
        port: Port; 0: any free one.
    """

    def __init__(self, make: Callable[[], Any], title: str, port: int = 0) -> None:
        self.token = secrets.token_urlsafe(24)
        self._make = make
        pn.extension()
        self._server: Server = pn.io.server.get_server(
            {f"/{self.token}": self._session},
            address=LOCAL,
            port=port,
            title=title,
            use_index=False,
            redirect_root=False,
            check_unused_sessions_milliseconds=LIFE // 3,
            unused_session_lifetime_milliseconds=LIFE,
            websocket_max_message_size=LARGEST_MESSAGE,
        )

    @property
    def url(self) -> str:
        """The page's address, with its token."""
        return f"http://{LOCAL}:{self._server.port}/{self.token}"

    def serve(self) -> None:
        """Serve until the process is told to end, or :meth:`stop` is called."""
        self._server.start()
        self._server.io_loop.start()

    def stop(self) -> None:
        """Stop serving; may be called from any thread."""
        self._server.io_loop.add_callback(self._stop)

    def _stop(self) -> None:
        self._server.stop()
        self._server.io_loop.stop()

    def _session(self) -> Any:
        """The page of a new session."""
        page = self._make()
        pn.state.on_session_destroyed(lambda _: page.close())
        return page.view
