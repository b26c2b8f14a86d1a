"""A session that is just enough to describe a graph."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from footage_clips import write_clip

RING4 = Path(__file__).resolve().parents[3] / "config" / "rig" / "ring4.yaml"


@pytest.fixture()
def session(tmp_path):
    """Two cameras of the example rig, with videos and stills of the empty room."""
    rig = yaml.safe_load(RING4.read_text())
    rig["cameras"] = {name: rig["cameras"][name] for name in ("cam01", "cam02")}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    for name in ("cam01", "cam02"):
        write_clip(tmp_path / f"{name}.mp4", [np.zeros((480, 640), np.uint8)] * 3, 25.0)
        cv2.imwrite(str(tmp_path / f"{name}_background.png"), np.zeros((480, 640), np.uint8))
    return tmp_path
