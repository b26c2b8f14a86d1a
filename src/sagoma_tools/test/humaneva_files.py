"""Writes a small data set in HumanEva-I's formats about the built-in person: what the importer's tests read.

Nothing here uses the importer. A .c3d is put together byte by byte (C3D user guide, c3d.org). The body model's points
lie on the figure's own joints, and the subject's measures are such that the published formulas add nothing to them.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from footage_clips import write_clip

from capture_rig.camera import CameraModel
from capture_rig.session import WRIST_FRACTION
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import walk
from virtual_studio.rig import ring

Array = np.ndarray
NECK, HEAD, HAND = 2, 1, (11, 12)
JOINTS = {"Shoulder": (3, 4), "Hip": (5, 6), "Elbow": (7, 8), "Knee": (9, 10), "Ankle": (13, 14)}

HEAD_MM, PELVIS_MM = 316.103, 50.0
SHOULDER_WIDTH_MM = 14.0
"""Between the centres of two markers of 7 mm: a chest of no depth."""
MARKERS_NEAR = (
    "T10 RBAK STRN", "LFHD RFHD LBHD RBHD", "C7 CLAV", "LSHO", "RSHO", "LASI LPSI LTHI", "RASI RPSI RTHI", "LELB LUPA",
    "RELB RUPA", "LKNE LTIB", "RKNE RTIB", "LWRA LWRB LFIN LFRM", "RWRA RWRB RFIN RFRA", "LANK LHEE LTOE",
    "RANK RHEE RTOE",
)  # fmt: skip
"""The 39 markers: those near each of the fifteen points."""


def write_c3d(path: Path, tracks_mm: dict, rate_hz=120.0, unit="mm", prefix="") -> Path:
    """A C3D file of tracks (F, 3) by label, as 32-bit floats."""
    points = np.stack(list(tracks_mm.values()), axis=1)
    frames, count = points.shape[:2]
    scale = -0.05  # negative: floats
    labels = [prefix + label for label in tracks_mm]
    width = max(map(len, labels))

    def entry(name: str, group: int, content: bytes) -> bytes:
        tail = content + b"\0"
        return struct.pack("<bb", len(name), group) + name.encode() + struct.pack("<h", len(tail) + 2) + tail

    def parameter(name: str, kind: int, shape: list[int], data: bytes) -> bytes:
        return entry(name, 1, struct.pack("<bB", kind, len(shape)) + bytes(shape) + data)

    text = "".join(label.ljust(width) for label in labels).encode()
    body = entry("POINT", -1, b"")
    body += parameter("USED", 2, [], struct.pack("<H", count)) + parameter("SCALE", 4, [], struct.pack("<f", scale))
    body += parameter("RATE", 4, [], struct.pack("<f", rate_hz)) + parameter("FRAMES", 2, [], struct.pack("<H", frames))
    body += parameter("UNITS", -1, [len(unit)], unit.encode()) + parameter("LABELS", -1, [width, count], text)
    blocks = -(-(len(body) + 6) // 512)
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, count, 0, 1, frames, 0, scale, 2 + blocks, 0, rate_hz)
    words = np.zeros((frames, count, 4), "<f4")
    words[..., :3] = points
    words[..., 3] = np.where((points == 0).all(axis=2), -1, 0)
    parameters = struct.pack("<BBBB", 1, 0x50, blocks, 84) + body
    path.write_bytes(header.ljust(512, b"\0") + parameters.ljust(512 * blocks, b"\0") + words.tobytes())
    return path


def write_cal(path: Path, camera: CameraModel) -> Path:
    K, T = camera.K, camera.T_camera_world
    rows = [[K[0, 0], K[1, 1]], [K[0, 2], K[1, 2]], [0.0], camera.D, *T[:3, :3], 1000 * T[:3, 3]]
    path.write_text("".join(" ".join(f"{value:.7f}" for value in row) + "\n" for row in rows))
    return path


def write_mp(path: Path, left: float = 46.0, right: float = 52.0) -> Path:
    measures = {"MarkerDiameter": 14, "LKneeWidth": 110, "RKneeWidth": 108, "HeadOffset": 12.5}
    measures |= {"LShoulderOffset": left, "RShoulderOffset": right}
    path.write_text("".join(f"${name} = {value}\r\n" for name, value in measures.items()))
    return path


def write_avi(path: Path, images: list[Array]) -> Path:
    return write_clip(path, images, 60.0, "XVID")


def joints_of(points: Array, R_torso: Array) -> dict[str, Array]:
    """The truth: joints (F, 3) in metres of the stick figure's points (F, 15, 3) and torso rotation (F, 3, 3).

    All are the figure's own, but the head's top, which the data set puts at a fixed distance from the thorax's origin,
    and the neck, between that, straight above the pelvis's, and the top of the torso's axis, which begins farther back.
    """
    found = {"Pelvis": (points[:, 5] + points[:, 6]) / 2}
    for side, s in (("L", 0), ("R", 1)):
        found |= {side + name: points[:, index[s]] for name, index in JOINTS.items()}
        elbow, hand = points[:, 7 + s], points[:, HAND[s]]
        found[side + "Wrist"] = elbow + WRIST_FRACTION * (hand - elbow)
    thorax = 1e-3 * model_points(points, R_torso)["TRXO"]
    found["Neck"] = thorax - 1e-3 * PELVIS_MM / 2 * R_torso[:, :, 0]
    found["Head"] = thorax + 1e-3 * HEAD_MM * unit(points[:, HEAD] - thorax)
    return found


def model_points(points: Array, R_torso: Array) -> dict[str, Array]:
    """The body model's points (F, 3) in mm of the stick figure's points (F, 15, 3) m."""
    p, (x, y, z) = 1e3 * points, (R_torso[:, :, k] for k in range(3))
    middle = (p[:, 5] + p[:, 6]) / 2
    pelvis = middle + PELVIS_MM * x
    thorax = pelvis + np.sum((p[:, NECK] - middle) * z, axis=1, keepdims=True) * z
    tracks = {}
    for name, origin in (("PEL", pelvis), ("TRX", thorax)):
        tracks |= {name + "O": origin}
        tracks |= {name + letter: origin + 100 * axis for letter, axis in zip("ALP", (x, y, z), strict=True)}
    tracks |= _frame("HED", p[:, HEAD], unit(p[:, HEAD] - thorax), x, 100.0)
    for side, s in (("L", 0), ("R", 1)):
        shoulder, elbow = p[:, 3 + s], p[:, 7 + s]
        wrist = elbow + WRIST_FRACTION * (p[:, HAND[s]] - elbow)
        hip, knee, ankle = p[:, 5 + s], p[:, 9 + s], p[:, 13 + s]
        sticks = ("FE", hip, knee), ("TI", knee, ankle), ("HU", shoulder, elbow), ("RA", elbow, wrist)
        for name, begin, end in sticks:
            tracks |= _frame(side + name, end, unit(begin - end), x, np.linalg.norm(begin - end, axis=1))
        tracks |= _frame(f"{side}CL", shoulder, z, x, 100.0)
    return tracks


def marker_points(points: Array) -> dict[str, Array]:
    """The 39 markers (F, 3) in mm: a few centimetres from the stick figure's points."""
    rng = np.random.default_rng(7)
    near = [(label, index) for index, labels in enumerate(MARKERS_NEAR) for label in labels.split()]
    return {label: 1e3 * points[:, index] + rng.uniform(-30, 30, 3) for label, index in near}


def unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _frame(name: str, origin: Array, z: Array, towards_x: Array, length: Array | float) -> dict[str, Array]:
    """Origin, and points on x (100 mm), y (100 mm) and z (``length`` mm) of a frame with this z axis."""
    x = unit(towards_x - np.sum(towards_x * z, axis=1, keepdims=True) * z)
    reach = np.broadcast_to(length, len(origin))[:, None]
    return {
        f"{name}O": origin,
        f"{name}A": origin + 100 * x,
        f"{name}L": origin + 100 * np.cross(z, x),
        f"{name}P": origin + reach * z,
    }


MOCAP_HZ, GRID_HZ = 120, 600
BEGIN_S = 1.7
"""Mocap frame 1 is so long after the motion's begin: the walk is under way."""
MOCAP_FRAMES = 90
OFFSETS = {"C1": (10.0, 31.4, 2.0), "C2": (7.0, 21.4, 2.0), "C3": (3.5, 22.4, 2.0), "BW1": (6.0, 31.4, 2.0)}
"""Image 1 of C1, C2, C3, BW1 is taken at mocap frame 13.4, 9.4, 17.4, 21.4: BW1 starts latest."""
FIRST_IMAGE = {"C1": 5, "C2": 7, "C3": 3, "BW1": 1}
"""Hence the image of each camera at mocap frame 21.4, which is common frame 1."""
FIRST_MOCAP = 21.4
LAST_COMMON = 38
DROPOUTS = {"C7": (1, 34), "LKNE": (40, 43), "PELA": (60, 60)}
"""Labels that are zero from one mocap frame to another, both included."""


class DataSet(NamedTuple):
    """A data set on disk and the truth of its only trial, S2 Walking_1: common frame -> joint -> (3,) metres."""

    root: Path
    joints: dict[int, dict[str, Array]]


def write_data_set(root: Path) -> DataSet:
    """The trial as files: four cameras that do not start together, motion capture with dropouts."""
    body = Body.from_stature(1.78)
    played = walk(body, BEGIN_S + 1.05, GRID_HZ)
    folders = {name: root / "S2" / name for name in ("Image_Data", "Calibration_Data", "Sync_Data", "Mocap_Data")}
    for folder in (*folders.values(), root / "Background"):
        folder.mkdir(parents=True)

    def state(*mocap_frames: float) -> tuple[Array, Array]:
        numbers = [round((BEGIN_S + (mocap_frame - 1) / MOCAP_HZ) * GRID_HZ) for mocap_frame in mocap_frames]
        poses = [played.poses[number] for number in numbers]
        return np.array([forward(body, pose) for pose in poses]), np.array([pose.R_world_torso for pose in poses])

    _write_mocap(folders["Mocap_Data"], *state(*range(1, MOCAP_FRAMES + 1)))
    rng = np.random.default_rng(3)
    for name, camera in zip(OFFSETS, ring(4, ceiling=False, size=(320, 240)).cameras, strict=True):
        write_cal(folders["Calibration_Data"] / f"{name}.cal", camera)
        offset = "".join(f"{number:.6f}\n" for number in OFFSETS[name])
        (folders["Sync_Data"] / f"Walking_1_({name}).ofs").write_text(offset)
        room = cv2.GaussianBlur(rng.uniform(40, 110, (240, 320)), (0, 0), 3.0)
        images = []
        for n in range(1, FIRST_IMAGE[name] + LAST_COMMON):
            image = room.copy()
            image[60:200, 4 * n : 4 * n + 40] = 30.0  # somebody walks by
            images.append(_tint(image, name))
        write_avi(folders["Image_Data"] / f"Walking_1_({name}).avi", images)
        for movie, gain in ((1, 0.8), (2, 1.0), (3, 1.25)):
            shown = [_tint(0 * room, name)] * 5 + [_tint(gain * room, name)] * 8
            write_avi(root / "Background" / f"Background_{movie}_({name}).avi", shown)
    truth = {}
    for frame in range(1, LAST_COMMON + 1):
        found = joints_of(*state(FIRST_MOCAP + 2 * (frame - 1)))
        truth[frame] = {name: point[0] for name, point in found.items()}
    return DataSet(root, truth)


def _tint(image: Array, name: str) -> Array:
    """What a colour camera makes of a grey image: less blue, more red; a grey camera leaves it."""
    coloured = image if name.startswith("BW") else image[..., None] * [0.8, 1.0, 1.1]
    return np.clip(coloured, 0, 255).astype(np.uint8)


def _write_mocap(folder: Path, points: Array, R_torso: Array) -> None:
    tracks = {**marker_points(points), **model_points(points, R_torso)}
    for label, (first, last) in DROPOUTS.items():
        tracks[label] = tracks[label].copy()
        tracks[label][first - 1 : last] = 0.0
    write_c3d(folder / "Walking_1.c3d", tracks, MOCAP_HZ, prefix="S2:")
    still = {label: np.tile([10.0, 20.0, 1000.0], (6, 1)) for label in tracks}
    still["LSHO"] = still["RSHO"] + [0.0, SHOULDER_WIDTH_MM, 0.0]
    still["RSHO"][2] = 0.0  # one frame in which it was not seen
    write_c3d(folder / "Static.c3d", still, MOCAP_HZ)
    write_mp(folder / "S2.mp", 0.0, 0.0)
