"""The studio's control channel: one JSON line in, one out, over a Unix socket that only its owner may open."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from capture_rig.errors import InputError

from .server.loop import EventLoop

Request = dict[str, Any]
LONGEST_LINE = 1 << 16
ANSWER_TIMEOUT_S = 10.0


def default_path() -> Path:
    """Returns the socket on which a studio listens by default."""
    folder = os.environ.get("XDG_RUNTIME_DIR") or "/tmp"
    return Path(folder) / f"sagoma-studio-{os.getuid()}.sock"


class ControlServer:
    """Answers each request with what ``handle`` returns; its InputErrors become {"error": ...}."""

    def __init__(self, path: Path, loop: EventLoop, handle: Callable[[Request], Request]) -> None:
        self._path, self._loop, self._handle = path, loop, handle
        self._connections: dict[socket.socket, bytearray] = {}
        self._socket = _listening(path)
        loop.call(lambda: loop.add_reader(self._socket, self._accept))

    def close(self) -> None:
        """Only while the loop runs."""
        self._loop.call(self._close)
        self._path.unlink(missing_ok=True)

    def _close(self) -> None:
        for connection in [self._socket, *self._connections]:
            self._loop.remove_reader(connection)
            connection.close()
        self._connections.clear()

    def _accept(self) -> None:
        try:
            connection, _ = self._socket.accept()
        except BlockingIOError:
            return
        connection.setblocking(False)
        self._connections[connection] = bytearray()
        self._loop.add_reader(connection, lambda: self._receive(connection))

    def _receive(self, connection: socket.socket) -> None:
        received = self._connections[connection]
        try:
            data = connection.recv(LONGEST_LINE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        received += data
        if not data or len(received) > LONGEST_LINE:
            self._drop(connection)
            return
        while (end := received.find(b"\n")) >= 0:
            line = bytes(received[:end])
            del received[: end + 1]
            if not self._reply(connection, self._answer(line)):
                self._drop(connection)
                return

    def _answer(self, line: bytes) -> Request:
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise InputError("a request is a JSON object", where="studio", remedy='Such as {"do": "status"}.')
            return self._handle(request)
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            return {"error": f"not a line of JSON: {error}"}
        except InputError as error:
            return {"error": str(error)}

    def _reply(self, connection: socket.socket, answer: Request) -> bool:
        try:
            connection.sendall(json.dumps(answer).encode() + b"\n")
        except OSError:
            return False
        return True

    def _drop(self, connection: socket.socket) -> None:
        self._loop.remove_reader(connection)
        del self._connections[connection]
        connection.close()


def ask(request: Request, path: str | Path | None = None) -> Request:
    """Sends one request to a running studio and returns its answer. Raises InputError with the studio's error."""
    path = Path(path) if path else default_path()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(ANSWER_TIMEOUT_S)
        try:
            link.connect(str(path))
            link.sendall(json.dumps(request).encode() + b"\n")
            line = link.makefile("rb").readline()
        except OSError as error:
            remedy = "Start one: sagoma studio; or name its socket with --control."
            raise InputError(f"no studio answers ({error.strerror or error})", where=str(path), remedy=remedy) from None
    if not line:
        raise InputError("the studio ended without an answer", where=str(path), remedy="Look at its output.")
    answer = json.loads(line)
    if "error" in answer:
        raise InputError(str(answer["error"]).rstrip("."), where="studio")
    return answer


def _listening(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.setblocking(False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_socket() and not _is_served(path):
            path.unlink()  # a studio that was killed left it behind
        listener.bind(str(path))
        path.chmod(0o600)
        listener.listen()
    except OSError as error:
        listener.close()
        remedy = "Another studio may be there: end it, or choose another --control."
        raise InputError(f"cannot listen ({error.strerror or error})", where=str(path), remedy=remedy) from None
    return listener


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
        return True
