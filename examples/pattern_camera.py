"""A camera source of one's own: any program that has pictures and their times can be a camera of the graph.

Run a camera client with it:  PYTHONPATH=examples, parameters

    source: plugin
    plugin.source: pattern_camera:PatternCamera
"""

import time

import numpy as np

from camera_client.frame_source import Frame, FrameSource


class PatternCamera(FrameSource):
    """Grey pictures with a bar that moves, as an SDK of a camera would deliver them; options come as texts."""

    def __init__(self, width: str = "640", height: str = "480", frame_rate: str = "30") -> None:
        super().__init__()
        self.description, self.shape = "pattern camera", (int(height), int(width))
        self._period_s, self._number = 1 / float(frame_rate), 0

    def connect(self) -> None:
        """Open the device; raise SourceUnavailable where it is absent: it is tried again."""

    def start(self) -> None:
        self._next_s = time.monotonic()

    def read(self, timeout_s: float) -> Frame | None:
        self._next_s += self._period_s
        time.sleep(max(min(self._next_s - time.monotonic(), timeout_s), 0.0))  # an SDK waits for its camera here
        self._number += 1
        image = np.full(self.shape, 100, np.uint8)
        image[:, (4 * self._number) % self.shape[1] :][:, :40] = 200
        self._statistics.add(self._number)  # so that the diagnostics count losses
        return Frame(image, time.time_ns(), self._number, clock="this machine", uncertainty_ns=1_000_000)

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass
