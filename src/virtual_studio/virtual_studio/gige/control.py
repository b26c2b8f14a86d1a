"""The studio's control channel: one JSON line in, one out, over a Unix socket that only its owner may open."""

from __future__ import annotations

import functools
import json
import os
import socket
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingUnixStreamServer
from typing import Any

from capture_rig.errors import InputError

from .loop import EventLoop

Request = dict[str, Any]
LONGEST_LINE = 1 << 16
ANSWER_TIMEOUT_S = 10.0
POLL_S = 0.05
"""How long the server takes to notice that it is to end."""


def default_path() -> Path:
    """Returns the socket on which a studio listens by default."""
    folder = os.environ.get("XDG_RUNTIME_DIR") or "/tmp"
    return Path(folder) / f"sagoma-studio-{os.getuid()}.sock"


class ControlServer:
    """Answers each request with what ``handle`` returns, called within the loop; InputErrors become {"error": ...}.

    Raises InputError where the socket cannot be had.
    """

    def __init__(self, path: Path, loop: EventLoop, handle: Callable[[Request], Request]) -> None:
        self._path = path

        class Connection(StreamRequestHandler):
            def handle(self) -> None:
                while (line := self.rfile.readline(LONGEST_LINE)).endswith(b"\n"):
                    try:
                        answer = loop.call(functools.partial(_answer, line, handle))
                        self.wfile.write(json.dumps(answer).encode() + b"\n")
                    except (OSError, RuntimeError, CancelledError):  # the client has gone, or the studio ends
                        return

        self._server = _listening(path, Connection)
        threading.Thread(target=self._server.serve_forever, args=(POLL_S,), name="control", daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._path.unlink(missing_ok=True)


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


def _answer(line: bytes, handle: Callable[[Request], Request]) -> Request:
    try:
        request = json.loads(line)
        if not isinstance(request, dict):
            raise InputError("a request is a JSON object", where="studio", remedy='Such as {"do": "status"}.')
        return handle(request)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        return {"error": f"not a line of JSON: {error}"}
    except InputError as error:
        return {"error": str(error)}


def _listening(path: Path, connection: type[StreamRequestHandler]) -> ThreadingUnixStreamServer:
    server = ThreadingUnixStreamServer(str(path), connection, bind_and_activate=False)
    server.daemon_threads = True
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_socket() and not _is_served(path):
            path.unlink()  # a studio that was killed left it behind
        server.server_bind()
        path.chmod(0o600)
        server.server_activate()
    except OSError as error:
        server.server_close()
        remedy = "Another studio may be there: end it, or choose another --control."
        raise InputError(f"cannot listen ({error.strerror or error})", where=str(path), remedy=remedy) from None
    return server


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
        return True
