"""Who may open the page: programs of this machine, or who has the token; never a page of another origin.

A browser lets any website open a WebSocket to localhost, so each request is checked before viser sees it: its Host must
be one that we serve (else a website could point a name of its own at us), a WebSocket's Origin must be this page, and
where the page is open to other machines a token is needed, which a first visit exchanges for a cookie.
"""

from __future__ import annotations

import hmac
import http
import re
import secrets
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Response

from capture_rig.errors import InputError

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
            raise InputError(
                "an empty token" if not token.strip() else "this is no token", where="--token", remedy=remedy
            )
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
