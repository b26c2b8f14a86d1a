"""Images and joints of other people's programs in a live graph, beside the same session through simulated GigE cameras.

    python bench/drivers.py ../shared/data/sessions/walk_ring5top
    python bench/drivers.py FOLDER --keypoints FOLDER/keypoints --hz 60

The whole graph runs, a process each, its clients with ``source: topic``; `driver_stand_in.py`, which uses rclpy alone,
publishes the session's videos (and detections, as tests/support/simulated_detections.py makes them): all cameras at
once, and every second one a frame of the film later (16.7 ms at 60 Hz); the truth is then that between two frames.
``--speed`` : of the cameras' time, for all rows.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from report import Table, execute, finish, machine_line, parser

import numpy as np

from capture_rig.stamps import CaptureClock
from capture_rig.yaml_file import save_mapping
from sagoma_bringup.graph import LOSSLESS_SETTINGS, NodeSpec, build_graph, camera_node
from sagoma_tools.evaluation.live_inputs import LiveInput
from sagoma_tools.evaluation.live_run import LiveRun, evaluate_run, run_live, run_studio
from sagoma_tools.evaluation.track import SessionClock, frame_count
from sagoma_tools.graph.topics import PREDICTION_TOPIC
from sagoma_tools.recording.recorder import GraphRecorder

DOMAIN, SETTLE_S = 88, 5.0  # of the graph; what it may still have to answer after the last image
DRIVER = Path(__file__).parent / "driver_stand_in.py"


class DriverInput(LiveInput):
    """A foreign process that publishes the session's images."""

    def __init__(self, session: Path, hz: float, apart: int, speed: float, keypoints: Path | None) -> None:
        super().__init__(session)
        self._hz, self._apart, self.clock = hz, apart, CaptureClock(speed)
        self.in_real_time = self.clock.speed == 1
        given = ["--hz", str(hz), "--apart", str(apart), "--speed", str(speed)]
        given += ["--keypoints", str(keypoints)] if keypoints else []
        self._command = [sys.executable, str(DRIVER), str(session), *given]

    def open(self, cancel: threading.Event) -> None:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._driver = subprocess.Popen(self._command, text=True, bufsize=1, **pipes)

    def close(self) -> None:
        self._driver.kill()
        self._driver.wait()

    def graph(self, settings: Mapping[str, Any]) -> list[NodeSpec]:
        rig = self.session.folder / "rig.yaml"
        apart = {"hull_server.tolerance_s": (0.9 if self._apart else 0.5) / self._hz, "hull_server.deadline_s": 0.1}
        slow = {} if self.in_real_time else LOSSLESS_SETTINGS
        with tempfile.TemporaryDirectory() as folder:
            for name, background in self.session.backgrounds.items():
                image = {"source": "topic", "topic.name": f"/driver/{name}/image_raw", "background": str(background)}
                save_mapping(Path(folder) / f"{name}.yaml", camera_node(name, image).parameter_document())
            return build_graph(rig=rig, cameras=folder, settings={**apart, **slow, **settings})

    def play(self, recorder: GraphRecorder, cancel: threading.Event) -> SessionClock:
        assert self._driver.stdin is not None and self._driver.stdout is not None
        recorder.wait_for_count(PREDICTION_TOPIC, round(self._hz), 60.0)  # of the first picture
        self._driver.stdin.write("play\n")
        begin_ns, frames = int(self._driver.stdout.readline()), frame_count(self.session)
        self._driver.wait()
        recorder.wait_for_stamp(PREDICTION_TOPIC, begin_ns + round(1e9 * frames / self._hz), SETTLE_S)
        return SessionClock(begin_ns + round(0.5e9 * self._apart / self.session.fps), frames, self.session.fps)


def between_frames(run: LiveRun) -> LiveRun:
    """Return the run with the truth half a frame later."""
    truth = run.session.truth
    assert truth is not None
    points = truth.points_world
    between = replace(truth, points_world=0.5 * (points + np.concatenate([points[1:], points[-1:]])))
    return replace(run, session=replace(run.session, truth=between), seen=np.arange(run.clock.frames))


def main() -> None:
    """Run every row."""
    arguments = parser(__doc__)
    arguments.add_argument("session", type=Path)
    arguments.add_argument("--hz", type=float, default=30.0, help="of the cameras (default: 30)")
    arguments.add_argument("--speed", type=float, default=1.0, help="of the cameras' time, a power of two")
    arguments.add_argument("--keypoints", type=Path, help="detections: two rows, without and with them")
    given = arguments.parse_args()
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(DOMAIN)}
    print(machine_line())
    rows: dict[str, tuple[int, Path | None] | None] = {"GigE": None, "driver": (0, None), "driver, apart": (1, None)}
    if given.keypoints:
        rows = {"driver": (0, None), "driver, keypoints": (0, given.keypoints)}
    table = Table("row:<18 | frames:>6d | sets:>5d | torn:>5d | tracked:>7d | mean mm:>7.1f | over 200 mm:>11.4f")
    figures: dict[str, Any] = {"hz": given.hz, "speed": given.speed}
    for name, row in rows.items():
        with tempfile.TemporaryDirectory() as output:
            if row is None:
                run = run_studio(given.session, Path(output), given.hz, given.speed)
            else:
                run = run_live(DriverInput(given.session, given.hz, row[0], given.speed, row[1]), Path(output))
            scores = evaluate_run(between_frames(run) if row and row[0] else run).figures()
        kept = {key: scores[key] for key in ("tracked", "mean_mm", "over_200mm")}
        table.row(name, len(run.seen), run.answered, run.incomplete, *kept.values())
        figures[name] = {"sets": run.answered, "torn": run.incomplete, **kept}
    finish(figures)


if __name__ == "__main__":
    execute(main)
