"""One thread that serves many cameras, their sockets, exposures and timers; and how other programs reach it."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from capture_rig.errors import InputError
from capture_rig.stamps import UTC, CaptureClock

T = TypeVar("T")
_LONGEST_WAIT_NS = 1_000_000_000  # the cameras' clock may be set meanwhile
_FINE_NS = 2_000_000  # asyncio's timers are up to a millisecond late: the last part of a wait is slept


Timer = asyncio.Task[None]
"""A callback that waits for its time; cancel() makes it never run."""


class EventLoop:
    """Callbacks for readable sockets and for instants of the cameras' clock (ns), one at a time, in one thread.

    clock : the cameras' time, UTC unless in slow motion; the network has its own pace (:meth:`call_later`).

    Everything that a camera does happens in here, so that its parts need no locks; other threads come in by
    :meth:`call`. An error in one callback is logged (by asyncio, whose loop this is); the others go on.
    """

    def __init__(self, name: str = "gige", clock: CaptureClock = UTC) -> None:
        self.clock, self._loop = clock, asyncio.new_event_loop()
        self.add_reader, self.remove_reader = self._loop.add_reader, self._loop.remove_reader
        self._thread = threading.Thread(target=self._loop.run_forever, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread, and waits for it; timers that are not due yet never run."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.run_until_complete(asyncio.sleep(0))  # calls that came while it ended
        self._loop.close()

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Runs a coroutine in the loop and returns its result; from any other thread."""
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()

    def call_at(self, when_ns: int, callback: Callable[[], object]) -> Timer:
        """Calls back at an instant of the cameras' clock. Only from within the loop."""
        return self._loop.create_task(self._run_at(when_ns, callback))

    def call_later(self, delay_ns: int, callback: Callable[[], object]) -> Timer:
        """Calls back after a UTC delay, whatever the speed of the cameras' clock. Only from within the loop."""
        return self.call_at(self.clock.at_utc(time.time_ns() + delay_ns), callback)

    def call(self, callback: Callable[[], T]) -> T:
        """Runs a function in the loop's thread and returns its result (or raises); from any thread."""
        if threading.current_thread() is self._thread:
            return callback()
        if not self._thread.is_alive():
            raise RuntimeError("the loop is not running")

        async def answer() -> T:
            return callback()

        return self.run(answer())

    async def _run_at(self, when_ns: int, callback: Callable[[], object]) -> None:
        while (left_ns := self.clock.wait_ns(when_ns)) > 2 * _FINE_NS:
            await asyncio.sleep(min(left_ns - _FINE_NS, _LONGEST_WAIT_NS) * 1e-9)
        if left_ns > 0:
            time.sleep(left_ns * 1e-9)
        callback()


# --- The studio's control channel: one JSON line in, one out, over a Unix socket that only its owner may open.


Request = dict[str, Any]
LONGEST_LINE = 1 << 16
ANSWER_TIMEOUT_S = 10.0


def default_path() -> Path:
    """Returns the socket on which a studio listens by default."""
    folder = os.environ.get("XDG_RUNTIME_DIR") or "/tmp"
    return Path(folder) / f"sagoma-studio-{os.getuid()}.sock"


def serve_requests(path: Path, loop: EventLoop, handle: Callable[[Request], Request]) -> None:
    """Answers each request with the result of ``handle``, called within the loop; InputErrors become {"error": ...}.

    Connections end with the loop; the caller removes the socket's name. Raises InputError where it is in use.
    """

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, ValueError):  # the client has gone, or sends no lines
            while (line := await reader.readline()).endswith(b"\n"):
                writer.write(json.dumps(_answer(line, handle)).encode() + b"\n")
                await writer.drain()
        writer.close()

    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_socket() and sock.connect_ex(str(path)) == errno.ECONNREFUSED:
            path.unlink()  # a studio that was killed left it behind
        sock.bind(str(path))
        path.chmod(0o600)
    except OSError as error:
        sock.close()
        remedy = "Another studio may be there: end it, or choose another --control."
        raise InputError(f"cannot listen ({error.strerror or error})", where=str(path), remedy=remedy) from None
    loop.run(asyncio.start_unix_server(serve, sock=sock, limit=LONGEST_LINE))


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
