"""Facts about a rig that the doctor checks: geometry, calibration reports, footage."""

from __future__ import annotations

import datetime
import itertools
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import Rig
from capture_rig.verdict import GOOD, REDO, USABLE
from capture_rig.video_findings import VideoFacts
from capture_rig.yaml_file import read_mapping

Array = npt.NDArray[np.float64]

STEP_M = 0.2
BODY_LEVELS_M = np.arange(0.1, 1.8, 0.2)  # soles to head
BREAST_M = 1.0
SUFFIX = ".report.yaml"  # of the report that sagoma calibrate writes beside its result


@dataclass(frozen=True)
class ReportFacts:
    """The report that a calibration left beside its result: its verdict and age, or why it cannot be read.

    ``findings`` are pairs of what was found and what to do; ``figures`` what is worth showing of it.
    """

    path: str
    error: str = ""
    grade: str = ""
    findings: tuple[tuple[str, str], ...] = ()
    age_s: float | None = None
    figures: str = ""


@dataclass(frozen=True)
class CameraGeometry:
    """One camera of the rig: its lens in pixels and degrees, where it is, and what it sees of the volume.

    ``sees`` : share of the standing places in the volume that it sees from soles to head. ``fov_deg`` : across the
    image, of the lens or of its pinhole, whichever is wider. ``reach_deg`` : off the axis, up to where the lens model
    holds; ``unused`` : share of the image's pixels beyond. ``mm_per_px`` and ``distance_m`` at the volume's centre.
    ``direction_world`` (3,) : unit vector from the volume's centre, at breast height, to the camera.
    """

    name: str
    size: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    fov_deg: float
    reach_deg: float
    unused: float
    centre_world: tuple[float, float, float]
    direction_world: tuple[float, float, float]
    distance_m: float
    mm_per_px: float
    sees: float
    upside_down: bool = False

    @property
    def height_m(self) -> float:
        return self.centre_world[2]


@dataclass(frozen=True)
class RigFacts:
    """The rig's cameras and what they see together.

    ``seen_by`` : for k = 1, 2, ... the share of standing places in the volume that at least k cameras see from soles to
    head. ``reports`` and ``infos``: the cameras' own calibration, its report and what its camera_info says of K.
    """

    path: str
    cameras: tuple[CameraGeometry, ...]
    seen_by: tuple[float, ...]
    report: ReportFacts | None = None
    reports: Mapping[str, ReportFacts] = field(default_factory=dict)
    differing: Mapping[str, str] = field(default_factory=dict)

    @property
    def pairs(self) -> list[tuple[CameraGeometry, CameraGeometry]]:
        return list(itertools.combinations(self.cameras, 2))


@dataclass(frozen=True)
class FootageFacts:
    """One camera's footage: image size (width, height), frames that can be decoded, its background's size, and what the
    video's reading showed; or why it cannot be read."""

    camera: str
    error: str = ""
    size: tuple[int, int] = (0, 0)
    frames: int = 0
    background_size: tuple[int, int] | None = None
    video: VideoFacts | None = None


def geometry(rig: Rig) -> tuple[tuple[CameraGeometry, ...], tuple[float, ...]]:
    """Return the cameras' geometry, and the shares of standing places seen by at least 1, 2, ... of them."""
    places = _standing_places(rig)
    seen = np.array([_sees(camera, places) for camera in rig.cameras])  # (cameras, places)
    middle = (rig.volume.low + rig.volume.high) / 2
    middle[2] = BREAST_M
    cameras = tuple(
        _camera(camera, middle, float(share)) for camera, share in zip(rig.cameras, seen.mean(axis=1), strict=True)
    )
    return cameras, tuple(float((seen.sum(axis=0) >= k).mean()) for k in range(1, len(cameras) + 1))


def angle_deg(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    """Return the angle between two unit vectors."""
    return float(np.degrees(np.arccos(np.clip(np.dot(one, other), -1.0, 1.0))))


def _standing_places(rig: Rig) -> Array:
    """Return (places, levels, 3) points of a person who stands somewhere in the volume."""
    low, high = rig.volume.low, rig.volume.high
    x, y = (np.arange(low[i] + STEP_M / 2, high[i], STEP_M) for i in range(2))
    grid = np.stack(np.meshgrid(x, y, BODY_LEVELS_M, indexing="ij"), axis=-1)
    return grid.reshape(-1, len(BODY_LEVELS_M), 3)


def _sees(camera: CameraModel, places: Array) -> npt.NDArray[np.bool_]:
    pixels = camera.project(places)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5)
    return np.asarray(inside.all(axis=(1, 2)))


def _camera(camera: CameraModel, middle: Array, sees: float) -> CameraGeometry:
    away = camera.centre_world - middle
    distance = float(np.linalg.norm(away))
    fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    return CameraGeometry(
        name=camera.name,
        size=(camera.width, camera.height),
        focal_px=(fx, fy),
        centre_px=(float(camera.K[0, 2]), float(camera.K[1, 2])),
        fov_deg=_across_deg(camera),
        reach_deg=float(np.degrees(camera.reach_rad)),
        unused=camera.unused_share,
        centre_world=tuple(camera.centre_world.tolist()),
        direction_world=tuple((away / max(distance, 1e-9)).tolist()),
        distance_m=distance,
        mm_per_px=1e3 * distance / fx,
        sees=sees,
        upside_down=bool(camera.R_camera_world[1, 2] > 0),
    )


def _across_deg(camera: CameraModel) -> float:
    """Return the angle across the image's middle row; to where the lens model holds, where it does not reach the
    sides."""
    row = camera.K[1, 2]
    ideal = camera.ideal_points(np.array([[0.0, row], [camera.width - 1.0, row]]))[:, 0]
    by_lens = float(np.degrees(np.nan_to_num(np.arctan(np.abs(ideal)), nan=camera.reach_rad).sum()))
    return max(by_lens, float(np.degrees(2 * np.arctan(camera.width / (2 * camera.K[0, 0])))))


def report_beside(result: Path) -> ReportFacts | None:
    """Return the report of ``result`` (rig.yaml: rig.report.yaml); None when there is none."""
    path = result.with_name(result.stem + SUFFIX)
    return read_report(path) if path.is_file() else None


def read_report(path: Path) -> ReportFacts:
    """Verdict, findings and age of the report at ``path``."""
    try:
        document = read_mapping(path, "Calibrate again.")
    except InputError as error:
        return ReportFacts(str(path), error.what)
    verdict = document.get("verdict")
    grade = verdict if verdict in (GOOD, USABLE, REDO) else ""
    findings = _findings(document.get("findings"))
    return ReportFacts(str(path), "", grade, findings, _age_s(document, path), _figures(document))


def _findings(entries: Any) -> tuple[tuple[str, str], ...]:
    """Return the report's findings as (what, remedy)."""
    found = []
    for entry in entries if isinstance(entries, list) else []:
        if isinstance(entry, Mapping):
            found.append((str(entry.get("what", "")), str(entry.get("remedy", ""))))
        else:
            found.append((str(entry), ""))
    return tuple(found)


def _age_s(document: Mapping[str, Any], path: Path) -> float:
    """Return the age by the date in the report, or by the file's where there is none."""
    try:
        return time.time() - datetime.datetime.fromisoformat(str(document.get("date"))).timestamp()
    except ValueError:
        return time.time() - path.stat().st_mtime


def _figures(document: Mapping[str, Any]) -> str:
    of_rig = document.get("rig")
    rms = (of_rig if isinstance(of_rig, Mapping) else document).get("rms_px")
    return f"rms {rms:.2f} px" if isinstance(rms, int | float) else ""
