"""The page's web server, viser's, on a socket that we opened, and the guard that checks every request first.

viser has no hook for requests and messages, so we pass ours to the websockets server that it starts. The page is for
programs of this machine, or for holders of the token; never for a page of another origin: a browser lets any website
open a WebSocket to localhost. A request's Host must be one that we serve (else a website could point a name of its own
at us), a WebSocket's Origin must be this page, and where the page is open to other machines a token is needed, which a
first visit exchanges for a cookie.
"""

from __future__ import annotations

import errno
import hmac
import http
import logging
import math
import secrets
import socket
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from http.cookies import CookieError, SimpleCookie
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import msgspec
import rich
import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from capture_rig.errors import InputError, shortened

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
        """Hosts are checked on loopback only; from other machines the token protects, under any name."""
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


def refuse(why: str, status: http.HTTPStatus = http.HTTPStatus.FORBIDDEN) -> Response:
    """The response to a refused request."""
    body = f"sagoma view: {why}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)


# messages of a browser ------------------------------------------------------------------------------------------------


Vector = tuple[float, float, float]
ControlOf = Callable[[str], Any]
"""Finds a control by its id, None where there is none."""


class Sent(msgspec.Struct, tag_field="type", tag=lambda name: f"{name}Message", forbid_unknown_fields=True):
    """A message of viser's client, named as viser names it."""


class ViewerCamera(Sent):
    """Where the view is: quaternion wxyz, metres, radians, pixels."""

    wxyz: tuple[float, float, float, float]
    position: Vector
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: Vector
    up_direction: Vector


class GuiUpdate(Sent):
    """A control's new value; viser would set any attribute of it that is named."""

    uuid: str
    updates: dict[Literal["value"], bool | int | float | str]


async def next_message(receive: Callable[[], Awaitable[Any]], control_of: ControlOf, log: logging.Logger) -> bytes:
    """Return the next message that viser may read, and log the dropped ones before it."""
    while True:
        data = await receive()
        fault = fault_of(data, control_of)
        if not fault:
            return data
        log.warning("the page has left out what a browser sent: %s", fault)


def fault_of(data: str | bytes, control_of: ControlOf) -> str:
    """Return why a message is not this page's; empty when it is."""
    if isinstance(data, str):
        return "text"
    try:
        message = msgspec.msgpack.decode(data, type=ViewerCamera | GuiUpdate)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        return shortened(str(error)) or repr(error)
    if isinstance(message, ViewerCamera):
        numbers = (*message.wxyz, *message.position, message.fov, message.near, message.far, *message.look_at)
        finite = all(map(math.isfinite, (*numbers, *message.up_direction)))
        return "" if finite else "a view that is not finite"
    control = control_of(message.uuid)  # viser leaves one alone that is gone
    fits = control is None or all(_fits(value, control) for value in message.updates.values())
    return "" if fits else "a value that its control cannot have"


def _fits(value: object, control: Any) -> bool:
    """Is this of the type of the control's value, and one of its options where it has some?"""
    now = control.value
    if isinstance(now, bool) or isinstance(value, bool):
        return isinstance(now, bool) and isinstance(value, bool)
    if isinstance(now, str):
        return isinstance(value, str) and value in getattr(control, "options", (value,))
    return isinstance(now, int | float) and isinstance(value, int | float) and math.isfinite(value)


# the server ----------------------------------------------------------------------------------------------------------


PORT = 8080
TRIED_PORTS = 100
"""The default port of a page, and the number of ports after it that are tried while they are in use."""
MOST_BYTES = 1 << 20
"""Of a message from a browser: the page has nothing to upload."""
NO_HOST = "Give one of this machine's addresses (`ip address` lists them), or 0.0.0.0 for all."
FRAMING = "Content-Security-Policy", "frame-ancestors 'none'"
"""No other page may show ours in a frame, where a click meant for theirs would press our buttons."""
HANDSHAKE_FAILED = "opening handshake failed"
"""websockets' message for a connection without a request: browsers open such in advance."""
_log = logging.getLogger("sagoma.view")


def guarded_server(guard: Guard, port: int | None = None) -> viser.ViserServer:
    """Start a page's server behind the guard. ``port`` : 0 for any, None for PORT or the next free one.

    Raises InputError when it cannot listen there; RuntimeError, serving nothing, when this viser starts its server in
    another way.
    """
    rich.get_console().quiet = True  # viser prints an address without the token
    server: viser.ViserServer | None = None

    def control_of(uuid: str) -> Any:
        return None if server is None else server.gui._gui_input_handle_from_uuid.get(uuid)

    listening = listening_socket(guard.host, port)
    with _serving(guard, listening, control_of) as served:
        server = viser.ViserServer(host=guard.host, port=listening.getsockname()[1], verbose=False)
    if not served:
        server.stop()
        listening.close()
        raise RuntimeError("this version of viser starts its server in another way: the page cannot be protected")
    return server


def listening_socket(host: str, port: int | None) -> socket.socket:
    """Open the socket to listen on; port as of :func:`guarded_server`. Raises InputError when there is none."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    if not host:  # Python takes that for all addresses
        raise InputError("cannot listen on ''", where="--host", remedy=NO_HOST)
    ports = (port,) if port is not None else range(PORT, PORT + TRIED_PORTS)
    for tried in ports:
        try:
            return socket.create_server((host, tried), family=family)
        except (OSError, UnicodeError) as error:
            if getattr(error, "errno", None) != errno.EADDRINUSE:
                what = f"cannot listen on '{host}', port {tried}: {error}"
                raise InputError(what, where="--host", remedy=NO_HOST) from error
    taken = f"port {ports[0]} is taken" if port is not None else f"ports {ports[0]} to {ports[-1]} are taken"
    raise InputError(taken, where="--port", remedy="Give another one, or 0 for any free one.")


@contextmanager
def _serving(guard: Guard, listening: socket.socket, control_of: Callable[[str], Any]) -> Iterator[list[bool]]:
    """While this lasts, servers of websockets listen there, and refuse first."""
    original, served = websockets.asyncio.server.serve, []

    def serve(handler: Any, *address: Any, process_request: Any = None, **options: Any) -> Any:
        async def handle(connection: Any) -> None:
            connection.recv = partial(next_message, connection.recv, control_of, _log)
            await handler(connection)

        def answer(connection: Any, request: Request) -> Response | None:
            try:
                response = guard.refusal(request.path, request.headers) or process_request(connection, request)
            except Exception as error:  # headers that cannot be read, a path too long for a file: not served
                _log.warning("a request could not be answered: %s", shortened(repr(error)))
                response = refuse("this request cannot be answered", http.HTTPStatus.BAD_REQUEST)
            if response is not None:
                response.headers[FRAMING[0]] = FRAMING[1]
            return response

        served.append(True)
        _log.addFilter(_in_one_line)
        options |= {"max_size": MOST_BYTES, "logger": _log}
        return original(handle, sock=listening, process_request=answer, **options)

    websockets.asyncio.server.serve = serve  # type: ignore[misc, assignment]
    try:
        yield served
    finally:
        websockets.asyncio.server.serve = original  # type: ignore[misc]


def _in_one_line(record: logging.LogRecord) -> bool:
    """Log failures without their traceback, and connections without a request not at all."""
    if record.exc_info:
        record.msg, record.args = f"{record.getMessage()}: {shortened(repr(record.exc_info[1]))}", ()
        record.exc_info = None
    return not record.getMessage().startswith(HANDSHAKE_FAILED)
