"""A session that is just enough to describe a graph."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

RING4 = Path(__file__).resolve().parents[3] / "config" / "rig" / "ring4.yaml"


def write_video(path, frames=3):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (640, 480))
    for _ in range(frames):
        writer.write(np.zeros((480, 640, 3), np.uint8))
    writer.release()


@pytest.fixture()
def session(tmp_path):
    """Two cameras of the example rig, with videos and stills of the empty room."""
    rig = yaml.safe_load(RING4.read_text())
    rig["cameras"] = {name: rig["cameras"][name] for name in ("cam01", "cam02")}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    for name in ("cam01", "cam02"):
        write_video(tmp_path / f"{name}.mp4")
        cv2.imwrite(str(tmp_path / f"{name}_background.png"), np.zeros((480, 640), np.uint8))
    return tmp_path
