"""Buttons of the page, and what they do."""

from __future__ import annotations

from collections.abc import Callable

import viser

from .take_work import Deliver

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
