"""The page's server as it runs: where it listens, whom it serves, and what of a browser's messages it reads."""

import http.client
import logging
import socket
import threading

import msgspec
import pytest
import viser
from websockets.datastructures import Headers
from websockets.sync.client import connect

from capture_rig.errors import InputError
from sagoma_tools.cli import main
from sagoma_tools.view.server import COOKIE, FRAMING, PORT, Guard, guarded_server, listening_socket

CAMERA = {"type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [3.0, 0, 1], "look_at": [0, 0, 1]}
CAMERA |= {"fov": 1.0, "near": 0.01, "far": 1000, "image_height": 600, "image_width": 800, "up_direction": [0, 0, 1]}
OPENED = {"Cookie": f"{COOKIE}=secret"}
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def server():
    server = guarded_server(Guard("127.0.0.1", "secret"), 0)
    yield server
    server.stop()


@pytest.fixture()
def port(server):
    return server.get_port()


def get(port, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("GET", path, headers=headers)
    return connection.getresponse()


def get_with_exactly(port, *headers, path="/"):
    """The answer to a request that has these header lines and no others."""
    with socket.create_connection(("127.0.0.1", port)) as link:
        link.sendall("\r\n".join([f"GET {path} HTTP/1.1", *headers, "", ""]).encode("latin-1"))
        return b"".join(iter(lambda: link.recv(1 << 16), b""))


def test_the_server_asks_the_guard_before_it_serves_the_page_which_is_never_in_a_frame(port):
    assert get(port, "/").status == 403
    assert get(port, "/../guard.py", **OPENED).status == 404
    assert get(port, "/" + "a" * 5000, **OPENED).status == 400  # too long for a file
    redirect = get(port, "/?token=secret")
    assert redirect.status == 303 and "HttpOnly" in redirect.getheader("Set-Cookie")
    assert b"<title>" in get(port, "/", **OPENED).read()
    bare = get_with_exactly(port, f"Host: 127.0.0.1:{port}", f"Cookie: {COOKIE}=secret")  # without Accept-Encoding
    assert bare.startswith(b"HTTP/1.1 200 ")
    for path in ("/", "/index.html"):
        assert get(port, path, **OPENED).getheader(FRAMING[0]) == FRAMING[1] == "frame-ancestors 'none'"


@pytest.mark.parametrize(
    "lines",
    [
        ["Host: [::1"],
        ["Host: 127.0.0.1", "Host: evil.example"],
        ["Host: 127.0.0.1", "Upgrade: websocket", "Origin: http://[", f"Cookie: {COOKIE}=secret"],
        ["Host: 127.0.0.1", f"Cookie: {COOKIE}=secret", "Upgrade: a", "Upgrade: websocket"],
    ],
)
def test_odd_headers_are_refused_with_one_line_in_the_log(port, lines, caplog):
    answer = get_with_exactly(port, *lines)
    assert answer.startswith(b"HTTP/1.1 400 ") and b"<html" not in answer
    (record,) = (record for record in caplog.records if record.levelno >= logging.WARNING)
    assert "could not be answered" in record.message and "\n" not in record.message and record.exc_info is None


def send(link, message):
    link.send(msgspec.msgpack.encode(message))


def update_of(control, **updates):
    return {"type": "GuiUpdateMessage", "uuid": control._impl.uuid, "updates": updates}


def test_messages_of_wrong_types_are_left_out_and_every_control_goes_on(server, caplog):
    gui = server.gui
    controls = [
        gui.add_slider("second", 0.0, 9.0, 0.01, 1.0),
        gui.add_text("name", "walk"),
        gui.add_checkbox("pictures", False),
        gui.add_dropdown("take", ("walk", "run")),
        gui.add_button_group("recording", ("record", "finish")),
    ]
    before = [control.value for control in controls]
    moved = threading.Event()
    controls[0].on_update(lambda event: moved.set())
    bad: list[object] = [
        update_of(control, **updates)
        for control in controls
        for updates in ({"__dict__": {}}, {"value": {}}, {"value": [1]}, {"value": None}, {"update_cb": []}, {"no": 1})
    ]
    bad += [update_of(controls[0], value=value) for value in ("1", True, float("nan"), float("inf"))]
    bad += [update_of(controls[2], value=1), update_of(controls[1], value=7)]
    bad += [update_of(control, value="none of these") for control in controls[3:]]
    bad += [{**CAMERA, "position": "here"}, {**CAMERA, "look_at": [0, 0]}, {**CAMERA, "fov": float("nan")}]
    bad += [{"type": "GuiUpdateMessage"}, {"type": "ShareUrlRequest"}, {"type": []}, {}, [], 7, None]
    address = f"ws://127.0.0.1:{server.get_port()}/"
    protocol = f"viser-v{viser.__version__}"
    with connect(address, additional_headers=OPENED, subprotocols=[protocol]) as link:
        for message in bad:
            send(link, message)
        link.send("text")
        link.send(b"\xc1")
        left_out = len(bad) + 2
        send(link, CAMERA)
        assert not moved.is_set()
        send(link, update_of(controls[0], value=2))
        assert moved.wait(PATIENCE_S)  # of the same connection, so all before has been read
    assert [control.value for control in controls] == [2.0, *before[1:]]
    records = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(records) == left_out and all("left out" in record.message for record in records)
    assert all("\n" not in record.message and record.exc_info is None for record in records)


def test_a_taken_port_is_refused_when_it_was_asked_for_and_else_passed_over(capsys):
    with listening_socket("127.0.0.1", None) as first, listening_socket("127.0.0.1", None) as second:
        taken = first.getsockname()[1]
        assert PORT <= taken < second.getsockname()[1]
        with pytest.raises(InputError, match=f"port {taken} is taken"):
            listening_socket("127.0.0.1", taken)
        assert main(["view", "--port", str(taken)]) == 2
        assert "Give another one" in capsys.readouterr().err


# --- the guard, by the headers of a request

OURS = Guard.of("127.0.0.1")
OPEN = Guard("0.0.0.0", "secret")
SOCKET = {"Host": "127.0.0.1:8080", "Upgrade": "websocket"}


def asked(guard: Guard, path: str = "/", **headers: str) -> int:
    """The status of the refusal; 200 for none."""
    refusal = guard.refusal(path, Headers(headers))
    return 200 if refusal is None else refusal.status_code


def test_this_machine_needs_no_token_and_others_always_have_one():
    assert OURS.token is None
    made_up = Guard.of("192.168.1.5").token
    assert made_up is not None and len(made_up) > 16 and made_up != Guard.of("192.168.1.5").token


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "127.0.0.1:8080"}, 200),
        ({"Host": "localhost:8080"}, 200),
        ({"Host": "[::1]:8080"}, 200),
        ({"Host": "evil.example:8080"}, 403),
        ({"Host": ""}, 403),
        ({**SOCKET, "Origin": "http://127.0.0.1:8080"}, 200),
        *(({**SOCKET, "Origin": origin}, 403) for origin in ("http://127.0.0.1:9999", "https://evil.example", "null")),
    ],
)
def test_a_page_of_this_machine_answers_to_its_own_names_and_its_connection_comes_from_itself(headers, status):
    assert asked(OURS, **headers) == status


FROM_BOX = {"Upgrade": "websocket", "Origin": "http://box:8080"}


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/", {}, 403),
        ("/?token=wrong", {}, 403),
        ("/?token=secret", {}, 303),
        ("/", OPENED, 200),
        ("/", {"Cookie": f"{COOKIE}=other"}, 403),
        ("/", FROM_BOX, 403),
        ("/", {**FROM_BOX, **OPENED}, 200),
        ("/", {**FROM_BOX, **OPENED, "Origin": "http://evil.example"}, 403),
    ],
)
def test_a_token_becomes_a_cookie_and_the_cookie_opens_the_page(path, headers, status):
    assert asked(OPEN, path, Host="box:8080", **headers) == status
