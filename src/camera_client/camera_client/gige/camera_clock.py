"""A camera's own clock mapped onto the host's, free of the jitter of the network and of our scheduling."""

from __future__ import annotations

from collections import deque

WINDOW = 256


class CameraClock:
    """Host time of camera stamps: camera time plus the smallest (arrival - camera time) of the last frames.

    The smallest difference is that of the frame least delayed on its way; a window of some seconds lets the offset
    follow the drift between the two clocks (100 ppm over 4 s is 0.4 ms). Stamps never go back.
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=WINDOW)
        self._last_ns: int | None = None

    def to_host_ns(self, camera_ns: int, arrival_ns: int) -> int:
        """Host stamp of a frame that the camera stamped ``camera_ns`` and that arrived at ``arrival_ns``."""
        self._offsets_ns.append(arrival_ns - camera_ns)
        stamp_ns = camera_ns + min(self._offsets_ns)
        if self._last_ns is not None:
            stamp_ns = max(stamp_ns, self._last_ns + 1)
        self._last_ns = stamp_ns
        return stamp_ns
