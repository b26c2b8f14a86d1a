"""The common main as a process of its own: signals, exit status, and errors in callbacks."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PATIENCE_S = 60.0  # for the process to end; a hang, not slowness, is what this catches

NODE = textwrap.dedent("""
    import sys
    import time
    from dataclasses import dataclass

    from capture_rig.errors import InputError
    from capture_rig.settings import setting
    from sagoma_ros.node import SagomaNode
    from sagoma_ros.process import run_node


    @dataclass(frozen=True)
    class Settings:
        rig_file: str = setting("rig.yaml", "the rig")
        failing_callback: bool = setting(False, "raise in a callback")
        turned_interrupt: bool = setting(False, "wait for a signal in a callback and make another error of it")


    def say(text):
        print(text, flush=True)


    class Example(SagomaNode):
        Settings = Settings

        def __init__(self):
            if "impossible" in sys.argv:
                raise InputError("there is no such device", where="camera", remedy="Plug it in.")
            super().__init__("example")
            self.create_timer(0.01, self.first_turn)
            self.turns = 0

        def configure(self):
            if not self.settings.rig_file:
                raise InputError("rig_file = '' is not a file", where="parameters", remedy="Name a rig file.")

        def first_turn(self):
            self.turns += 1
            if self.turns == 2:
                say(self._state_machine.current_state[1])
            if self.turns == 1 and self.get_parameter("failing_callback").value:
                raise ZeroDivisionError("a defect in a callback")
            if self.turns == 3 and self.get_parameter("turned_interrupt").value:
                say("waiting")
                try:
                    while True:
                        time.sleep(0.01)  # the signal may interrupt another thread: Python sees it between two of these
                except KeyboardInterrupt:
                    raise RuntimeError("as a conversion in C++ would") from None

        def cleanup(self):
            say("released")


    sys.exit(run_node(Example))
""")

Start = Callable[..., subprocess.Popen]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts the example node as a process with the given arguments; ends what a failed test leaves."""
    script = tmp_path / "example_node.py"
    script.write_text(NODE)
    processes: list[subprocess.Popen] = []

    def start(*arguments: str) -> subprocess.Popen:
        process = subprocess.Popen(
            [sys.executable, str(script), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def parameters(**values: object) -> list[str]:
    return ["--ros-args", *(word for key, value in values.items() for word in ("-p", f"{key}:={value}"))]


def next_line(process: subprocess.Popen) -> str:
    """The next line of output; "" when the process ended instead."""
    return process.stdout.readline().strip()


@pytest.mark.parametrize(
    ("arguments", "status", "said", "output"),
    [
        (
            parameters(autostart=True, rig_file='""'),
            1,
            "parameters: rig_file = '' is not a file. Name a rig file.",
            {"released"},
        ),
        (["impossible"], 2, "camera: there is no such device. Plug it in.", set()),
        (["--ros-args", "--params-file", "/nowhere.yaml"], 2, "nowhere.yaml", set()),
    ],
    ids=["autostart that fails", "node that cannot be made", "parameter file that is missing"],
)
def test_failing_start_ends_with_its_status_and_clear_text(start: Start, arguments, status, said, output) -> None:
    process = start(*arguments)
    printed, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, set(printed.split())) == (status, output), errors
    assert said in errors and "Traceback" not in errors


def test_error_in_a_callback_is_logged_and_a_signal_ends_the_node_although_another_error_was_made_of_it(start) -> None:
    process = start(*parameters(autostart=True, failing_callback=True, turned_interrupt=True))
    assert (next_line(process), next_line(process)) == ("active", "waiting")  # in turns after the failing one
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0 and output.split() == ["released"], errors
    assert "ZeroDivisionError: a defect in a callback" in errors and errors.count("Traceback") == 1
