"""The lenses of a rig's cameras: camera_info YAML files, one a camera, or a rig file whose poses are to be renewed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import read_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.yaml_file import read_mapping
from rig_calibration.boards.sighting import Sighting

PINHOLE = ("fx", "fy", "cx", "cy")
CALIBRATE = "Run sagoma calibrate intrinsics for it first"


def read_intrinsics(path: str | Path, names: Iterable[str]) -> dict[str, CameraModel]:
    """The models of the cameras called ``names``, in name order; their poses mean nothing.

    ``path``: a folder with one NAME.yaml (camera_info) a camera, or a rig YAML. Raises InputError naming the camera
    without a file, and the file that is another camera's.
    """
    path, wanted = Path(path), sorted(names)
    if path.is_file():
        rig = load_rig(path)
        return {name: rig.camera(name) for name in wanted}
    if not path.is_dir():
        raise InputError(
            "does not exist", where=str(path), remedy=f"Give the folder of camera_info files. {CALIBRATE}."
        )
    return {name: _read(path, name) for name in wanted}


def read_lens_deviations(path: str | Path, names: Iterable[str]) -> dict[str, list[float]]:
    """Standard deviations of fx, fy, cx, cy, px, of those cameras whose NAME.report.yaml lies in the folder."""
    found = {}
    for name in sorted(names):
        report = Path(path) / f"{name}.report.yaml"
        if report.is_file():
            parameters = read_mapping(report, f"{CALIBRATE}, or delete this file.").get("parameters")
            if isinstance(parameters, Mapping) and set(PINHOLE) <= set(parameters):
                found[name] = [float(parameters[key]["sd"]) for key in PINHOLE]
    return found


def require_image_sizes(cameras: Mapping[str, CameraModel], sightings: Iterable[Sighting]) -> None:
    """Raises InputError for images of another size than the camera's lens was calibrated for."""
    for sighting in sightings:
        camera = cameras[sighting.camera]
        if sighting.image_size != (camera.width, camera.height):
            raise InputError(
                f"its images are {sighting.image_size[0]} x {sighting.image_size[1]} pixels, its intrinsics are for "
                f"{camera.width} x {camera.height}",
                where=sighting.camera,
                remedy="Calibrate the lens at the size that the camera delivers, or give footage of that size.",
            )


def _read(folder: Path, name: str) -> CameraModel:
    path = folder / f"{name}.yaml"
    if not path.is_file():
        files = sorted(file.stem for file in folder.glob("*.yaml") if not file.stem.endswith(".report"))
        there = f"it holds {', '.join(files)}" if files else "it holds no .yaml file"
        raise InputError(
            f"there is no {path.name} with the intrinsics of camera '{name}'; {there}",
            where=str(folder),
            remedy=f"{CALIBRATE}, rename the footage or the file, or leave the camera out (--without {name}).",
        )
    camera = read_camera_info(path)
    if camera.name != name:
        raise InputError(
            f"camera_name = '{camera.name}', but the footage is called '{name}'",
            where=str(path),
            remedy="If the file belongs to this camera, correct camera_name in it; else give the right folder.",
        )
    return camera
