"""What the page was asked for: one thing at a time, on a thread of its own, told as it goes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

import viser

from capture_rig.errors import InputError

BUSY = "still busy with: {}"
Tell = Callable[[str], None]
Work = Callable[[Tell], str]
Deliver = Callable[[str, bytes], None]
"""Gives a file of this name to who asked for it."""
Owner = TypeVar("Owner")
Asked = ParamSpec("Asked")


def as_work(method: Callable[Concatenate[Owner, Tell, Asked], str]) -> Callable[Concatenate[Owner, Asked], Work]:
    """Turn a method that does some work into one that returns the work, to be done when its turn comes."""

    def asked(owner: Owner, /, *args: Asked.args, **options: Asked.kwargs) -> Work:
        return lambda tell: method(owner, tell, *args, **options)

    return asked


class Jobs:
    """Runs requests one after the other's end, and says what came of each; a request while one runs is refused."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running = ""
        self._said = ""
        self.cancelled = threading.Event()

    @property
    def said(self) -> str:
        """What the last request said last."""
        with self._lock:
            return self._said

    def request(self, what: str, work: Work) -> bool:
        """Begin some work unless other work is under way; its last word is shown. Returns whether it began."""
        with self._lock:
            if self._running:
                self._said = BUSY.format(self._running)
                return False
            self._running, self._said = what, f"{what} ..."
        self.cancelled.clear()
        threading.Thread(target=self._run, args=(what, work), name=f"page: {what}", daemon=True).start()
        return True

    def cancel(self) -> None:
        """End a countdown."""
        self.cancelled.set()

    def report(self, text: str) -> None:
        """Show this until something else is said."""
        with self._lock:
            self._said = text

    def _run(self, what: str, work: Work) -> None:
        try:
            said = work(self.report)
        except InputError as error:
            said = str(error)
        except Exception as error:  # the page goes on, whatever a request met
            said = f"{what} failed: {error!r}"
        with self._lock:
            self._said, self._running = said, ""


Button = viser.GuiButtonHandle | viser.GuiButtonGroupHandle


def on_click(button: Button, act: Callable[[], object]) -> None:
    """Do this when somebody presses the button."""

    def clicked(event: viser.GuiEvent) -> None:
        act()

    button.on_click(clicked)


def on_click_deliver(button: Button, act: Callable[[Deliver], object]) -> None:
    """Do this when somebody presses the button; it is given a function that sends a file to that browser."""

    def clicked(event: viser.GuiEvent) -> None:
        if event.client is not None:
            act(event.client.send_file_download)

    button.on_click(clicked)
