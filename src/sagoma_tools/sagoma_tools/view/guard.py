"""Who may open the page: programs of this machine, or who has the token; never a page of another origin.

A browser lets any website open a WebSocket to localhost, so each request is checked before viser sees it: its Host must
be one that we serve (else a website could point a name of its own at us), a WebSocket's Origin must be this page, and
where the page is open to other machines a token is needed, which a first visit exchanges for a cookie.
"""

from __future__ import annotations

import hmac
import http
import logging
import math
import re
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import msgspec
from websockets.datastructures import Headers
from websockets.http11 import Response

from capture_rig.errors import InputError, shortened

LOOPBACK = ("127.0.0.1", "localhost", "::1")
ANY_HOST = ("0.0.0.0", "::")
COOKIE = "sagoma_view"
TOKEN_BYTES = 16
TOKEN = re.compile(r"[\w.~-]+", re.ASCII)
"""What an address and a cookie hold as it is; an unset variable of a shell is none."""


@dataclass(frozen=True)
class Guard:
    """Decides on requests by their headers.

    host : the address that the page is bound to. token : None where the page is this machine's alone.
    """

    host: str
    token: str | None

    @classmethod
    def of(cls, host: str, token: str | None = None) -> Guard:
        """A token is made up where none is given and the page is open to other machines. Raises InputError."""
        if token is not None and not TOKEN.fullmatch(token):
            remedy = "Leave --token out to have one made, or give one of letters, digits, '-', '_', '.' and '~'."
            what = "an empty token" if not token.strip() else "this is no token"
            raise InputError(what, where="--token", remedy=remedy)
        if token is None and host not in LOOPBACK:
            token = secrets.token_urlsafe(TOKEN_BYTES)
        return cls(host, token)

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


def refuse(why: str, status: http.HTTPStatus = http.HTTPStatus.FORBIDDEN) -> Response:
    """The response to who is not served."""
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

    def fault(self, control_of: ControlOf) -> str:
        """Say what cannot be used; empty when all can."""
        numbers = (*self.wxyz, *self.position, self.fov, self.near, self.far, *self.look_at, *self.up_direction)
        return "" if all(map(math.isfinite, numbers)) else "a view that is not finite"


class GuiUpdate(Sent):
    """A control's new value; viser would set any attribute of it that is named."""

    uuid: str
    updates: dict[Literal["value"], bool | int | float | str]

    def fault(self, control_of: ControlOf) -> str:
        """Say what cannot be used; empty when all can, and of a control that is gone, which viser leaves alone."""
        control = control_of(self.uuid)
        fits = control is None or all(_fits(value, control) for value in self.updates.values())
        return "" if fits else "a value that its control cannot have"


async def next_message(receive: Callable[[], Awaitable[Any]], control_of: ControlOf, log: logging.Logger) -> bytes:
    """Return the next message that viser may read, and log what is left out before it."""
    while True:
        data = await receive()
        fault = fault_of(data, control_of)
        if not fault:
            return data
        log.warning("the page has left out what a browser sent: %s", fault)


def fault_of(data: str | bytes, control_of: ControlOf) -> str:
    """Say why a message is none of this page's; empty when it is one."""
    if isinstance(data, str):
        return "text"
    try:
        message = msgspec.msgpack.decode(data, type=ViewerCamera | GuiUpdate)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        return shortened(str(error)) or repr(error)
    return message.fault(control_of)


def _fits(value: object, control: Any) -> bool:
    """Is this of the type of the control's value, and one of its options where it has some?"""
    now = control.value
    if isinstance(now, bool) or isinstance(value, bool):
        return isinstance(now, bool) and isinstance(value, bool)
    if isinstance(now, str):
        return isinstance(value, str) and value in getattr(control, "options", (value,))
    return isinstance(now, int | float) and isinstance(value, int | float) and math.isfinite(value)
