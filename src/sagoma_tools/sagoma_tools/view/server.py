"""The page's web server, viser's, on a socket that we opened, and the guard that is asked about every request first.

viser has no hook for requests, so the websockets server that it starts is given ours. The page is for
programs of this machine, or for who has the token; never for a page of another origin: a browser lets any website open
a WebSocket to localhost. A request's Host must be one that we serve (else a website could point a name of its own at
us), a WebSocket's Origin must be this page, and where the page is open to other machines a token is needed, which a
first visit exchanges for a cookie.
"""

from __future__ import annotations

import errno
import hmac
import http
import logging
import secrets
import socket
from collections.abc import Callable
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import rich
import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from capture_rig.errors import InputError

LOOPBACK = ("127.0.0.1", "localhost", "::1")
ANY_HOST = ("0.0.0.0", "::")
COOKIE = "sagoma_view"
TOKEN_BYTES = 16


@dataclass(frozen=True)
class Guard:
    """Decides on requests by their headers.

    host : the address that the page is bound to. token : None where the page is this machine's alone.
    """

    host: str
    token: str | None

    @classmethod
    def of(cls, host: str) -> Guard:
        """Return a guard with a new token where the page is open to other machines."""
        return cls(host, None if host in LOOPBACK else secrets.token_urlsafe(TOKEN_BYTES))

    def refusal(self, path: str, headers: Headers) -> Response | None:
        """Return why a request is not served, as the response to it (or a redirect that sets the cookie), else None."""
        authority = headers.get("Host", "")
        if not self._is_ours(urlsplit(f"//{authority}").hostname):
            return refuse(f"this page is not served as '{authority}'")
        origin = headers.get("Origin")
        is_websocket = headers.get("Upgrade", "").lower() == "websocket"
        if is_websocket and origin is not None and urlsplit(origin).netloc != authority:
            return refuse("only this page itself may connect, not one of another origin")
        if self.token is None:
            return None
        if _equal(_cookie_of(headers), self.token):
            return None
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        if not is_websocket and _equal(given, self.token):
            cookie = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            return Response(http.HTTPStatus.SEE_OTHER, "See Other", Headers({"Location": "/", "Set-Cookie": cookie}))
        return refuse("this page needs its token: open the address that `sagoma view` printed")

    def _is_ours(self, hostname: str | None) -> bool:
        """Names are believed on loopback only; from other machines the token protects, whatever they call us."""
        return hostname in LOOPBACK if self.host in LOOPBACK else bool(hostname)


def _cookie_of(headers: Headers) -> str:
    cookies: SimpleCookie = SimpleCookie()
    try:
        for line in headers.get_all("Cookie"):
            cookies.load(line)
    except CookieError:
        return ""
    return cookies[COOKIE].value if COOKIE in cookies else ""


def _equal(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def refuse(why: str) -> Response:
    """The response to who is not served."""
    status = http.HTTPStatus.FORBIDDEN
    body = f"sagoma view: {why}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)


# the server ----------------------------------------------------------------------------------------------------------


PORT = 8080
TRIED_PORTS = 100
"""The port of a page for which none was asked, and how many after it are tried while they are taken."""
MOST_BYTES = 1 << 20
"""Of a message from a browser: the page has nothing to upload."""
FRAMING = "Content-Security-Policy", "frame-ancestors 'none'"
"""No other page may show ours in a frame, where a click meant for theirs would press our buttons."""
_log = logging.getLogger("sagoma.view.requests")
_log.setLevel(logging.CRITICAL)  # websockets calls an error what browsers do: they open connections in advance


def guarded_server(guard: Guard, port: int | None = None) -> viser.ViserServer:
    """Start a page's server that asks the guard first. ``port`` : 0 for any, None for PORT or the next free one.

    Raises InputError when it cannot listen there; RuntimeError when this viser starts its server in another way: then
    nothing is served.
    """
    rich.get_console().quiet = True  # viser prints an address without the token
    original, served = websockets.asyncio.server.serve, []

    def serve(handler: Any, *address: Any, process_request: Any = None, **options: Any) -> Any:
        def answer(connection: Any, request: Request) -> Response | None:
            response = guard.refusal(request.path, request.headers) or _page(connection, request, process_request)
            if response is not None:
                response.headers[FRAMING[0]] = FRAMING[1]
            return response

        served.append(True)
        options |= {"max_size": MOST_BYTES, "logger": _log}
        return original(handler, sock=listening, process_request=answer, **options)

    listening = listening_socket(guard.host, port)
    websockets.asyncio.server.serve = serve  # type: ignore[misc, assignment]
    try:
        server = viser.ViserServer(host=guard.host, port=listening.getsockname()[1], verbose=False)
    finally:
        websockets.asyncio.server.serve = original  # type: ignore[misc]
    if not served:
        server.stop()
        listening.close()
        raise RuntimeError("this version of viser starts its server in another way: the page cannot be protected")
    return server


def listening_socket(host: str, port: int | None) -> socket.socket:
    """Open the socket to listen on; port as of :func:`guarded_server`. Raises InputError when there is none."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    ports = (port,) if port is not None else range(PORT, PORT + TRIED_PORTS)
    for tried in ports:
        try:
            return socket.create_server((host, tried), family=family)
        except (OSError, UnicodeError) as error:
            if getattr(error, "errno", None) != errno.EADDRINUSE:
                remedy = "Give one of this machine's addresses (`ip address` lists them), or 0.0.0.0 for all."
                what = f"cannot listen on '{host}', port {tried}: {error}"
                raise InputError(what, where="--host", remedy=remedy) from error
    taken = f"port {ports[0]} is taken" if port is not None else f"ports {ports[0]} to {ports[-1]} are taken"
    raise InputError(taken, where="--port", remedy="Give another one, or 0 for any free one.")


def _page(connection: Any, request: Request, serve: Callable[[Any, Request], Response | None]) -> Response | None:
    """What viser serves; the page itself uncompressed, with our script."""
    is_page = urlsplit(request.path).path == "/" and request.headers.get("Upgrade", "").lower() != "websocket"
    if is_page and "Accept-Encoding" in request.headers:
        del request.headers["Accept-Encoding"]
    response = serve(connection, request)
    return with_script(response) if is_page and response is not None else response


# script beside viser's client -----------------------------------------------------------------------------------------


FULL_FRAME_MS = 25
"""Between two frames without a GPU: shorter than two refreshes of a 60 Hz screen and longer than one."""
SCRIPT = """<script>
document.title = "sagoma";
(() => {
    const gl = document.createElement("canvas").getContext("webgl2");
    const info = gl && gl.getExtension("WEBGL_debug_renderer_info");
    const renderer = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
    if (!/swiftshader|llvmpipe|software|basic render/i.test(renderer)) return;

    const getContext = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, attributes) {
        const plain = kind.startsWith("webgl") ? {...attributes, antialias: false} : attributes;
        return getContext.call(this, kind, plain);
    };

    const request = window.requestAnimationFrame.bind(window), cancel = window.cancelAnimationFrame.bind(window);
    const waiting = new Map();
    let drawn = -Infinity, number = 0;
    window.requestAnimationFrame = callback => {
        const id = ++number;
        const refreshed = now => {
            if (now !== drawn && now - drawn < FULL_FRAME_MS) {
                waiting.set(id, request(refreshed));
                return;
            }
            drawn = now;
            waiting.delete(id);
            callback(now);
        };
        waiting.set(id, request(refreshed));
        return id;
    };
    window.cancelAnimationFrame = id => {
        cancel(waiting.get(id));
        waiting.delete(id);
    };
})();
</script>""".replace("FULL_FRAME_MS", str(FULL_FRAME_MS))
HEAD = b"<head>"


def with_script(page: Response) -> Response:
    """Return viser's page, uncompressed, with our script before its own; RuntimeError when it is another page."""
    before, head, after = page.body.partition(HEAD)
    if not head:
        raise RuntimeError("this version of viser serves another page: our script has no place in it")
    body = before + head + SCRIPT.encode() + after
    headers = Headers(page.headers)
    del headers["Content-Length"]
    headers["Content-Length"] = str(len(body))
    return Response(page.status_code, page.reason_phrase, headers, body)
