"""Who may open the live page: by headers, and against the server as it runs."""

import http.client

import pytest
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from sagoma_tools.view.client_script import SCRIPT
from sagoma_tools.view.guard import COOKIE, Guard, guarded_server

OURS = Guard.of("127.0.0.1")
OPEN = Guard.of("0.0.0.0", "secret")


def asked(guard: Guard, path: str = "/", **headers: str) -> int:
    """The status of the refusal; 200 for none."""
    given = Headers({name.replace("_", "-"): value for name, value in headers.items()})
    refusal = guard.refusal(path, given)
    return 200 if refusal is None else refusal.status_code


def test_this_machine_needs_no_token_and_others_always_have_one():
    assert OURS.token is None
    made_up = Guard.of("192.168.1.5").token
    assert made_up is not None and len(made_up) > 16 and made_up != Guard.of("192.168.1.5").token


@pytest.mark.parametrize(
    ("host", "status"),
    [("127.0.0.1:8080", 200), ("localhost:8080", 200), ("[::1]:8080", 200), ("evil.example:8080", 403), ("", 403)],
)
def test_a_page_of_this_machine_answers_to_its_own_names_only(host, status):
    assert asked(OURS, Host=host) == status


@pytest.mark.parametrize(
    ("origin", "status"),
    [("http://127.0.0.1:8080", 200), ("http://127.0.0.1:9999", 403), ("https://evil.example", 403), ("null", 403)],
)
def test_a_connection_comes_from_this_page_itself(origin, status):
    assert asked(OURS, Host="127.0.0.1:8080", Upgrade="websocket", Origin=origin) == status


def test_a_token_becomes_a_cookie_and_the_cookie_opens_the_page():
    assert asked(OPEN, Host="box:8080") == 403
    assert asked(OPEN, "/?token=wrong", Host="box:8080") == 403
    assert asked(OPEN, "/?token=secret", Host="box:8080") == 303
    assert asked(OPEN, Host="box:8080", Cookie=f"{COOKIE}=secret") == 200
    assert asked(OPEN, Host="box:8080", Cookie=f"{COOKIE}=other") == 403
    assert asked(OPEN, Host="box:8080", Upgrade="websocket", Origin="http://box:8080") == 403
    socket = {"Upgrade": "websocket", "Cookie": f"{COOKIE}=secret"}
    assert asked(OPEN, Host="box:8080", Origin="http://box:8080", **socket) == 200
    assert asked(OPEN, Host="box:8080", Origin="http://evil.example", **socket) == 403


@pytest.fixture(scope="module")
def port():
    server = guarded_server(Guard("127.0.0.1", "secret"), 0)
    yield server.get_port()
    server.stop()


def get(port: int, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("GET", path, headers=headers)
    return connection.getresponse()


def test_the_server_asks_the_guard_before_it_serves_the_page(port):
    assert get(port, "/").status == 403
    assert get(port, "/../guard.py", Cookie=f"{COOKIE}=secret").status == 404
    redirect = get(port, "/?token=secret")
    assert redirect.status == 303 and "HttpOnly" in redirect.getheader("Set-Cookie")
    page = get(port, "/", Cookie=f"{COOKIE}=secret")
    assert page.status == 200
    body = page.read()
    assert len(body) == int(page.getheader("Content-Length")) and page.getheader("Content-Encoding") == "identity"
    assert body.index(b"<head>" + SCRIPT.encode()) < body.index(b"<title>")


def test_the_server_refuses_connections_of_other_origins(port):
    with pytest.raises(InvalidStatus, match="403"):
        connect(
            f"ws://127.0.0.1:{port}/", origin="http://evil.example", additional_headers={"Cookie": f"{COOKIE}=secret"}
        )
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://127.0.0.1:{port}/", origin=f"http://127.0.0.1:{port}")
