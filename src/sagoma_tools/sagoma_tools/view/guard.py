"""Who may open the page: programs of this machine, or who has the token; never a page of another origin.

A browser lets any website open a WebSocket to localhost, so each request is checked before viser sees it: its Host must
be one that we serve (else a website could point a name of its own at us), a WebSocket's Origin must be this page, and
where the page is open to other machines a token is needed, which a first visit exchanges for a cookie.
"""

from __future__ import annotations

import hmac
import http
import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import rich
import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from .client_script import with_script

LOOPBACK = ("127.0.0.1", "localhost", "::1")
ANY_HOST = ("0.0.0.0", "::")
COOKIE = "sagoma_view"
TOKEN_BYTES = 16
_patching = threading.Lock()


@dataclass(frozen=True)
class Guard:
    """Decides on requests by their headers.

    host : the address that the page is bound to. token : None where the page is this machine's alone.
    """

    host: str
    token: str | None

    @classmethod
    def of(cls, host: str, token: str | None = None) -> Guard:
        """A token is made up where none is given and the page is open to other machines."""
        if token is None and host not in LOOPBACK:
            token = secrets.token_urlsafe(TOKEN_BYTES)
        return cls(host, token)

    def refusal(self, path: str, headers: Headers) -> Response | None:
        """Return why a request is not served, as the response to it (or a redirect that sets the cookie), else None."""
        authority = headers.get("Host", "")
        if not self._is_ours(urlsplit(f"//{authority}").hostname):
            return _refuse(f"this page is not served as '{authority}'")
        origin = headers.get("Origin")
        is_websocket = headers.get("Upgrade", "").lower() == "websocket"
        if is_websocket and origin is not None and urlsplit(origin).netloc != authority:
            return _refuse("only this page itself may connect, not one of another origin")
        if self.token is None:
            return None
        if _equal(_cookie_of(headers), self.token):
            return None
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        if not is_websocket and _equal(given, self.token):
            cookie = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            return Response(http.HTTPStatus.SEE_OTHER, "See Other", Headers({"Location": "/", "Set-Cookie": cookie}))
        return _refuse("this page needs its token: open the address that `sagoma view` printed")

    def _is_ours(self, hostname: str | None) -> bool:
        """Names are believed on loopback only; from other machines the token protects, whatever they call us."""
        return hostname in LOOPBACK if self.host in LOOPBACK else bool(hostname)


def guarded_server(guard: Guard, port: int) -> viser.ViserServer:
    """Start a page's server that asks the guard first; the port is another one if this is taken.

    viser has no hook for it, so the websockets server that it starts is given one. Raises RuntimeError when this viser
    starts another: then nothing is served.
    """
    rich.get_console().quiet = True  # viser prints an address without the token
    with _patching, _serving(guard.refusal) as served:
        server = viser.ViserServer(host=guard.host, port=port, verbose=False)
    if not served:
        server.stop()
        raise RuntimeError("this version of viser starts its server in another way: the page cannot be protected")
    return server


@contextmanager
def _serving(refusal: Callable[[str, Headers], Response | None]) -> Iterator[list[bool]]:
    """While this lasts, servers of websockets refuse first, and then serve as told, the page with our script."""
    original, served = websockets.asyncio.server.serve, []

    def serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def process(connection: Any, request: Request) -> Any:
            refused = refusal(request.path, request.headers)
            if refused is not None:
                return refused
            is_page = urlsplit(request.path).path == "/" and request.headers.get("Upgrade", "").lower() != "websocket"
            if is_page:
                del request.headers["Accept-Encoding"]  # our script goes into it
            response = process_request(connection, request)
            return with_script(response) if is_page else response

        served.append(True)
        return original(*arguments, process_request=process, **options)

    websockets.asyncio.server.serve = serve  # type: ignore[misc, assignment]
    try:
        yield served
    finally:
        websockets.asyncio.server.serve = original  # type: ignore[misc]


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


def _refuse(why: str) -> Response:
    body = f"sagoma view: {why}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)
