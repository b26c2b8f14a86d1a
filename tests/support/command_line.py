"""Commands as users give them: run to their end, or `sagoma up` until Ctrl-C."""

import signal
import subprocess
import sys
import threading
from pathlib import Path

COMMAND_TIMEOUT_S = 2000.0  # four films of boards take 270 s on a calm machine


def command(*words: object) -> list[str]:
    """A sagoma command for this environment."""
    return [sys.executable, "-m", "sagoma_tools.cli", *map(str, words)]


def run(*words: object) -> str:
    """What a command printed, which may have found something to warn of."""
    done = subprocess.run(command(*words), capture_output=True, text=True, timeout=COMMAND_TIMEOUT_S, check=False)
    assert done.returncode in (0, 1), f"{' '.join(map(str, words))}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


class Graph:
    """``sagoma up`` as a process; its end is asked for as by Ctrl-C. ``active`` : set when it says that nodes are."""

    def __init__(self, log: Path, *words: object) -> None:
        self.active, self.log = threading.Event(), log
        self.process = subprocess.Popen(
            command("up", *words, "--run-folder", log.with_suffix("")),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with self.log.open("w") as log:
            for line in self.process.stdout:
                log.write(line)
                log.flush()
                if "nodes are active" in line:
                    self.active.set()

    def __enter__(self) -> "Graph":
        return self

    def __exit__(self, *raised: object) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60.0)
        self._reader.join()
