"""What the server of a page answers: the page's own requests, and nothing else."""

import re
import socket
import stat
import subprocess
import sys
import webbrowser
from pathlib import Path
from urllib.parse import urljoin, urlsplit
from urllib.request import url2pathname

import panel as pn
import pytest

from dssc_jax.exploration.serving import PageServer
from tests.exploration.serving import serving

WITNESS = "sndhdr"
"""A module of Python that nobody imports."""


class Page:
    """A page with a slider."""

    def __init__(self):
        self.view = pn.Column(pn.widgets.FloatSlider(start=0.0, end=1.0))

    def close(self):
        pass


@pytest.fixture(scope="module")
def served():
    with serving(Page) as server:
        yield server


def port_of(server):
    return urlsplit(server.url).port


def answer(server, path, method="GET", headers=None, version="HTTP/1.1"):
    """Status and body of an answer to a request that is sent as it is, byte by byte; status 0: it was closed."""
    lines = [("Host", f"127.0.0.1:{port_of(server)}")] if headers is None else headers
    text = "".join(f"{name}: {value}\r\n" for name, value in [*lines, ("Connection", "close")])
    with socket.create_connection(("127.0.0.1", port_of(server)), timeout=30) as channel:
        channel.sendall(f"{method} {path} {version}\r\n{text}\r\n".encode("latin-1"))
        stream = channel.makefile("rb")
        try:
            head = stream.readline().split()
            length = 0
            while (line := stream.readline()) not in (b"\r\n", b""):
                name, _, value = line.partition(b":")
                length = int(value) if name.lower() == b"content-length" else length
            return (int(head[1]) if head else 0), (b"" if method == "HEAD" else stream.read(length))
        except ConnectionError:
            return 0, b""


def upgrade(server, origin=None, **changes):
    """Headers that ask for a websocket."""
    names = {
        "Host": f"127.0.0.1:{port_of(server)}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": "bokeh, token",
        "Origin": origin,
    }
    return [(name, value) for name, value in (names | changes).items() if value is not None]


def hosts(server):
    """Names of other hosts, and none."""
    port = port_of(server)
    names = ("evil.example", "127.0.0.1", f"127.0.0.1:{port + 1}", f"127.0.0.2:{port}", f"0.0.0.0:{port}", "")
    return [*names, f"evil.example:{port}", f"127.0.0.1:{port}.evil.example", f"127.0.0.1:{port}@evil.example", "[::1]"]


def other_paths(server):
    """Paths that are not the page's: without, beside, around and behind its token."""
    token = server.token
    yield from (f"/components/{WITNESS}/a/b", f"/components/{WITNESS}/{token}/b")
    wrong = ("", "wrong", token[:-1], f"{token}a", token.swapcase(), f"{token}%00", f"%2f{token}", token[::-1])
    encoded = "".join(f"%{ord(letter):02x}" for letter in token)
    places = ("explore", "explore/ws", "static/js/bokeh.min.js", f"components/{WITNESS}/a/b", "")
    for first in (*wrong, encoded, f".{token}", f"{token};a", f"{token},{token}", f"x/../{token}", f"./{token}"):
        yield from (f"/{first}/{place}" for place in places)
    paths = ("", "/", "/explore/", "/explore/metadata", "/explore/autoload.js", "/explore?a=b", "/explore/ws?token=a")
    paths += ("/explore/ws/", "/explore%2fws", "/EXPLORE", "/explore;a", "/explore#a", "/metadata", "/autoload.js")
    paths += (f"/components/{WITNESS}/a/b", f"/components/{WITNESS}/a", f"/components/{WITNESS}/__file__/b")
    paths += (f"/explore/components/{WITNESS}/a/b", f"/static/components/{WITNESS}/a/b", f"/Components/{WITNESS}/a/b")
    paths += ("/rest/session_info", "/liveness", "/admin", "/login", "/logout", "/index.html", "/assets/a.js")
    paths += (f"/{token}/explore", "//explore", "/./explore", "/x/../explore", "/explore/..", "/explore/../explore")
    up = ("..", "%2e%2e", "..%2f..", "%2e%2e%2f", "..\\..", "%252e%252e", "....//", "..%c0%af", ".%00.", "..;")
    paths += tuple(f"/static/{part}/{part}/server.py" for part in up)
    paths += tuple(f"/static/js/{part}/{part}/{part}/etc/passwd" for part in up)
    paths += tuple(f"/static/extensions/panel/{part}/io/server.py" for part in up)
    paths += ("/static/", "/static//etc/passwd", "/static/.hidden", "/static/js/", "/static/js/bokeh.min.js?v=1&a=b")
    paths += ("/static/js/bokeh.min.js?v=../..", "/static/js/bokeh.min.js%00.png", "/static/js/~root", "/static")
    yield from (f"/{token}{place}" for place in paths)
    yield from ("*", "http://evil.example/", "//")
    yield from (f"http://evil.example/{token}/explore", f"http://127.0.0.1:{port_of(server)}/{token}/explore")
    yield from ("/favicon.ico", "/static/js/bokeh.min.js", "/explore", "/explore/ws", f"/?{token}", f"/#{token}")


def foreign(server):
    """Requests that do not come from the page: path, method and headers."""
    page, port = urlsplit(server.url).path, port_of(server)
    host = ("Host", f"127.0.0.1:{port}")
    origins = ("http://evil.example", f"https://127.0.0.1:{port}", f"http://127.0.0.1:{port + 1}", "null", "file://")
    origins += (
        f"http://127.0.0.1:{port}.evil.example",
        f"http://evil.example:{port}",
        f"http://127.0.0.1:{port}/",
        "*",
    )
    for path in other_paths(server):
        yield path, "GET", None
        yield path, "GET", upgrade(server, f"http://127.0.0.1:{port}")
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "PATCH", "CONNECT", "TRACE", "get", "PROPFIND"):
        for place in ("", "/ws", f"/../components/{WITNESS}/a/b"):
            yield page + place, method, None
    for name in hosts(server):
        yield page, "GET", [("Host", name)]
        yield f"{page}/ws", "GET", upgrade(server, f"http://{name}", Host=name)
    for origin in origins:
        yield page, "GET", [host, ("Origin", origin)]
        yield f"{page}/ws", "GET", upgrade(server, origin)
        yield f"/components/{WITNESS}/a/b", "GET", [host, ("Origin", origin)]
    yield page, "GET", []
    yield page, "GET", [host, host]
    yield page, "GET", [host, ("Host", "evil.example")]
    yield page, "GET", [("Host", "evil.example"), host]
    yield page, "GET", [host, ("Origin", f"http://127.0.0.1:{port}"), ("Origin", "http://evil.example")]
    for path in (f"{page}/ws", "/explore/ws", f"/wrong{page}/ws", "/ws", f"/{server.token}/ws", f"{page}/ws/"):
        yield path, "GET", upgrade(server)
        yield path, "POST", upgrade(server, f"http://127.0.0.1:{port}")
    yield f"{page}/ws", "HEAD", upgrade(server, f"http://127.0.0.1:{port}")


def test_only_the_page_answers(served, capfd):
    requests = list(foreign(served))
    assert len(requests) >= 300
    for path, method, headers in requests:
        status, body = answer(served, path, method, headers)
        assert status in (0, 400, 404, 405), (path, method, headers, status)  # others than 404: no request of HTTP
        assert served.token.encode() not in body
        assert len(body) < 200
    assert WITNESS not in sys.modules
    assert answer(served, urlsplit(served.url).path)[0] == 200  # it still serves
    assert capfd.readouterr().err == ""


def test_the_page_has_what_it_needs(served):
    """Page, scripts, styles and websocket, under the token only."""
    status, body = answer(served, urlsplit(served.url).path)
    assert status == 200
    links = re.findall(rb"""(?:src|href)=["']([^"']+)["']|["']([^"' ]*static/[^"' ]+)["']""", body)
    addresses = {urlsplit(urljoin(served.url, (linked or named).decode())) for linked, named in links}
    scripts = {address.path for address in addresses if address.path.endswith(".js")}
    assert any(path.endswith("bokeh.min.js") for path in scripts)
    assert any(path.endswith("panel.min.js") for path in scripts)
    for address in addresses:
        assert address.path.startswith(f"/{served.token}/")
        path = f"{address.path}?{address.query}" if address.query else address.path
        assert answer(served, path)[0] == 200, path
        assert answer(served, path.replace("^", "%5E"), "HEAD")[0] == 200, path
    for name in ("127.0.0.1", "localhost"):
        host = f"{name}:{port_of(served)}"
        path = urlsplit(served.url).path
        assert answer(served, path, headers=[("Host", host)])[0] == 200
        # without a session's token, Bokeh's own check comes next
        assert answer(served, f"{path}/ws", headers=upgrade(served, f"http://{host}", Host=host))[0] in (101, 403)


def test_the_address_is_of_this_machine_and_cannot_be_guessed(served):
    assert served.url.startswith(f"http://127.0.0.1:{port_of(served)}/{served.token}/")
    assert len(served.token) >= 32


def test_no_program_is_started_with_the_token(served, monkeypatch):
    """All users see the arguments of a browser; it is given a private file that leads to the page."""
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(subprocess, "Popen", None)
    with served.opened_in_browser():
        (address,) = opened
        assert served.token not in address
        file = Path(url2pathname(urlsplit(address).path))
        assert f'content="0; url={served.url}"' in file.read_text()
        assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
    assert not file.parent.exists()
    assert isinstance(served, PageServer)
