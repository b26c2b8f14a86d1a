"""The files with which camera clients and hull server run against a studio."""

from __future__ import annotations

from pathlib import Path

import yaml

from capture_rig.rig import save_rig

from ..calibration.truth_files import save_truth
from .studio import Studio

RIG_FILE = "rig.yaml"
CAMERA_FOLDER = "cameras"


def write_rig_files(studio: Studio, folder: str | Path) -> Path:
    """rig.yaml, and cameras/CAMERA.yaml for each camera PC, as `sagoma up --rig --cameras` reads them.

    Of cameras that are still to be calibrated: the boards' files, and the rig as truth_rig.yaml, for scoring only.
    """
    folder = Path(folder)
    cameras = folder / CAMERA_FOLDER
    cameras.mkdir(parents=True, exist_ok=True)
    rig_file = folder / RIG_FILE
    if studio.is_calibrated:
        save_rig(studio.rig, rig_file)
    else:
        save_truth(studio.rig, *studio.boards, folder)
    for name, camera in studio.cameras.items():
        parameters = {
            "autostart": True,
            **({"rig_file": str(rig_file.resolve())} if studio.is_calibrated else {}),
            "camera_name": name,
            "source": "aravis",
            "aravis": {"address": camera.address, "frame_rate": studio.frame_rate},
            "background_file": str((folder / f"{name}_background.npz").resolve()),
        }
        document = {f"/{name}/camera_client": {"ros__parameters": parameters}}
        (cameras / f"{name}.yaml").write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return folder
