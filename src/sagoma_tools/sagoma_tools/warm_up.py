"""Compiles every numerical kernel into the cache, by doing the whole job once on a tiny made-up session.

Run by the set-up: without it the first start of each node would take a minute.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from capture_rig.session import load_session
from stick_figure.body import Body
from virtual_studio.rig import ring
from virtual_studio.session import write_session

from .evaluation.in_process import Configuration, track_session

FRAMES, FPS = 8, 10.0


def main() -> None:
    """Render, segment, carve, fit, filter."""
    with tempfile.TemporaryDirectory(prefix="sagoma_warm_up_") as folder:
        path = write_session(
            Path(folder) / "session", ring(4, True), Body.from_stature(1.75), "t_pose_only", FPS, FRAMES / FPS
        )
        session = load_session(path)
        for method in ("hierarchical", "articulated"):
            # from the T-pose, so that a person is measured and the sizes refined as well
            track_session(session, Configuration.of({"hull_server.backend": "cpu", "icp_tracker.method": method}))


if __name__ == "__main__":
    main()
