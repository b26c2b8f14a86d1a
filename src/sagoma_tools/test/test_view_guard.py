"""Who may open the live page, by the headers of a request."""

import pytest
from websockets.datastructures import Headers

from capture_rig.errors import InputError
from sagoma_tools.view.guard import COOKIE, Guard

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


@pytest.mark.parametrize("token", ["", "  ", "two words", "a;b"])
def test_an_empty_or_blank_token_is_refused_with_the_remedy(token):
    for host in ("0.0.0.0", "127.0.0.1"):
        with pytest.raises(InputError, match="Leave --token out"):
            Guard.of(host, token)
