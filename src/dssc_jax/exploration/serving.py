"""Serve a page to the browser of this machine: at 127.0.0.1 only, under a path that nobody can guess.

Panel's server has more addresses than the page needs. One of them imports any Python module that a request names.
Therefore a gate before the server admits the requests of the page, and answers all others with "not found".
"""

import html
import re
import secrets
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import panel as pn
from bokeh.server.server import Server
from panel.io.resources import DIST_DIR
from panel.viewable import Viewable
from tornado.httputil import HTTPServerRequest
from tornado.routing import Matcher, PathMatches, Rule
from tornado.web import RequestHandler, StaticFileHandler

from dssc_jax.core import files
from dssc_jax.exploration.page import Page

LOCAL = "127.0.0.1"
HOST_NAMES = (LOCAL, "localhost")
"""Names of this machine in a browser's address; the second one is that of a forwarded port."""
PAGE_PATH = "explore"
"""Last part of the page's address."""
ICON = r"favicon\.ico"
PLAIN_NAME = r"[A-Za-z0-9@_-](?:[A-Za-z0-9@_.^-]|%5E)*"
"""Name of a file or folder that does not begin with a dot; a browser may encode ``^``."""
SCRIPT_OR_STYLE = re.compile(rf"{ICON}|static/(?:{PLAIN_NAME}/)*{PLAIN_NAME}")
"""Path of a file that the page loads."""
FILE_VERSION = re.compile(r"(?:v=[0-9a-z.]+)?")
"""Query of the request of such a file."""
REDIRECT = """<!doctype html>
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={address}">
<title>explore</title>
<a href="{address}">Explore</a>
"""
"""A file that leads a browser to the page."""
SESSION_LIFETIME = 15_000
"""Time [ms] for which a session is kept after its page was closed."""
LARGEST_MESSAGE = 64 * 2**20
"""Largest message of the websocket [byte]."""


class Refused(Matcher):
    """Matches all requests that the page does not need, so that a handler can refuse them.

    A request that the page needs meets four conditions:

    1. The request only reads.
    2. The header Host names this machine.
    3. The path begins with the token, and leads to the page, the page's websocket, a script or a style.
    4. If the request names an origin, as a websocket must, the origin is this server.

    Args:
        token: The secret first part of the path.
        port: Port of the server.
    """

    def __init__(self, token: str, port: int) -> None:
        """Keep the token and the admissible values of the headers Host and Origin."""
        self._token = token.encode()
        self._hosts = [f"{name}:{port}" for name in HOST_NAMES]
        self._origins = [f"http://{host}" for host in self._hosts]

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        """Return what Tornado expects: an empty dictionary to refuse the request, None to let it pass."""
        return None if self._passes(request) else {}

    def _passes(self, request: HTTPServerRequest) -> bool:
        """Whether the page needs a request."""
        path, _, query = (request.uri or "").partition("?")
        _, _, path_after_slash = path.partition("/")
        token, _, place = path_after_slash.partition("/")
        if not secrets.compare_digest(token.encode(), self._token):
            return False
        if request.method not in ("GET", "HEAD"):
            return False
        hosts = request.headers.get_list("Host")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return False
        origins = request.headers.get_list("Origin")
        if len(origins) > 1 or not set(origins) <= set(self._origins):
            return False
        if place == f"{PAGE_PATH}/ws":
            return request.method == "GET" and len(origins) == 1 and not query
        if place == PAGE_PATH:
            return not query
        return bool(SCRIPT_OR_STYLE.fullmatch(place) and FILE_VERSION.fullmatch(query))


class NotFound(RequestHandler):
    """Answers every request with "not found"."""

    def prepare(self) -> None:
        """Answer the request with 404 before Tornado looks at its method."""
        self.set_status(404)
        self.finish()


class PageServer:
    """A server of one page. Each tab of the browser has its own session, which ends when the tab is closed.

    The addresses of page, websocket, scripts and styles begin with a random token; see :class:`Refused`. Nothing is
    loaded from the network.

    Args:
        make_page: Makes the page of a session.
        title: Title of the page.
        port: Port; 0: any free port.

    Raises:
        OSError: The port is in use, or may not be used.
    """

    def __init__(self, make_page: Callable[[], Page], title: str, port: int = 0) -> None:
        """Bind the port, behind a gate for requests; nothing is served before :meth:`serve`."""
        self.token = secrets.token_urlsafe(24)
        self._make_page = make_page
        pn.extension()
        self._server: Server = pn.io.server.get_server(
            {f"/{PAGE_PATH}": self._session},
            prefix=self.token,
            address=LOCAL,
            port=port,
            title=title,
            use_index=False,
            redirect_root=False,
            check_unused_sessions_milliseconds=SESSION_LIFETIME // 3,
            unused_session_lifetime_milliseconds=SESSION_LIFETIME,
            websocket_max_message_size=LARGEST_MESSAGE,
        )
        gate = Rule(Refused(self.token, self.port), NotFound)
        icon = Rule(PathMatches(f"/{self.token}/({ICON})"), StaticFileHandler, {"path": DIST_DIR / "images"})
        self._server._tornado.add_handlers(r"(?s).*", [gate, icon])  # asked before all other handlers
        self._server._tornado.settings["log_function"] = lambda handler: None  # no request is logged to the terminal

    @property
    def url(self) -> str:
        """The page's address, with its token."""
        return f"http://{LOCAL}:{self.port}/{self.token}/{PAGE_PATH}"

    @property
    def port(self) -> int:
        """The server's port."""
        port = self._server.port
        assert port is not None
        return port

    @contextmanager
    def opened_in_browser(self) -> Iterator[None]:
        """Open the page in the user's browser, in a context whose end removes the file that leads to the page.

        The browser gets the name of this private file, and not the address with the token, because all users of the
        machine see the arguments of its programs.
        """
        with TemporaryDirectory(prefix="dssc-jax-explore-") as folder:
            redirect = Path(folder) / "explore.html"
            address = html.escape(self.url)
            files.write_text(redirect, REDIRECT.format(address=address), durable=False)
            webbrowser.open(redirect.as_uri())
            yield

    def serve(self) -> None:
        """Serve until the process is told to end, or :meth:`stop` is called."""
        self._server.start()
        self._server.io_loop.start()

    def stop(self) -> None:
        """Stop serving; may be called from any thread."""
        self._server.io_loop.add_callback(self._stop)

    def _stop(self) -> None:
        """Stop serving, in the thread of the server."""
        self._server.stop()
        self._server.io_loop.stop()

    def _session(self) -> Viewable:
        """Make the page of a new session; the page is closed when the session ends."""
        page = self._make_page()
        pn.state.on_session_destroyed(lambda _: page.close())
        return page.view
