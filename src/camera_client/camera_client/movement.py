"""Detects that a camera was moved since it was calibrated, from its own picture, twice a second by the frames' stamps.

Silhouettes do not show it: when the camera is bumped, every edge of the room becomes foreground. The whole picture
does, with a person in it, other lights, and a chair that was moved, unless the room has no edges. The thresholds
were chosen with ``bench/camera_faults.py --moved``.
"""

from __future__ import annotations

import zlib
from collections import deque
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.rigid import rotation_matrix, rotation_vector
from capture_rig.stamps import StampThrottle

from .alignment import Alignment, Array, PictureAlignment
from .background.model import BackgroundModel, Provenance
from .frame_source import LASTING_S, REPORT_PERIOD_S, Image
from .settings import CameraMovedSettings

# Thresholds: chosen with python bench/camera_faults.py --moved.
SAMPLES = 3  # whose median counts: something that springs back, or one bad picture, is no movement
MIN_AGREEMENT = 0.2  # share of the edges, beyond chance, that have to agree on a turn
MIN_AGREEMENT_GAIN = 0.08  # ... and more of them than agree that nothing moved
LOST = MIN_AGREEMENT / 2  # when fewer agree on anything for LASTING_S, the picture is another one; a search, which
# costs as much as ten comparisons, is not made more often


class MovementState(Enum):
    """Whether the camera was moved, as its picture shows."""

    UNKNOWN = "cannot tell"
    STILL = "has not moved"
    MOVED = "was moved"
    LOST = "shows something else"


@dataclass(frozen=True, eq=False)
class Movement:
    """How the camera has moved since its calibration.

    turn_rad (3,) : rotation vector of the camera in its own frame (x right, y down, z forward), radians; a push aside
    shows as the turn that has nearly the same effect. shift_px : how far the middle of the picture moved. agreeing :
    share of the background's edges that confirm it, beyond chance.
    """

    state: MovementState = MovementState.UNKNOWN
    turn_rad: Array = field(default_factory=lambda: np.zeros(3))
    shift_px: float = 0.0
    agreeing: float = 0.0

    @property
    def turned_deg(self) -> float:
        """Roll: how far the picture is turned about its middle, clockwise where positive."""
        return float(np.degrees(self.turn_rad[2]))

    @property
    def swing_deg(self) -> float:
        """Pan and tilt together: how far the optical axis is turned."""
        return float(np.degrees(np.hypot(*self.turn_rad[:2])))

    def describe(self, camera: str) -> str:
        """Return what is wrong, and what to do; "" when nothing is wrong, as far as is known."""
        if self.state is MovementState.LOST:
            return (
                f"{camera} shows something else than its background does: was it moved far, or is something before "
                "its lens? Put it back, or calibrate it and learn its background again"
            )
        if self.state is not MovementState.MOVED:
            return ""
        return (
            f"{camera} was moved: its picture is shifted by {self.shift_px:.1f} px ({self.swing_deg:.1f} degrees), "
            f"turned by {abs(self.turned_deg):.1f} degrees: put it back, or calibrate it and learn its background "
            "again"
        )

    def values(self) -> dict[str, object]:
        """Return the figures, by the keys of the diagnostics; only what was measured."""
        values: dict[str, object] = {"camera_moved": self.state.value}
        if self.state in (MovementState.STILL, MovementState.MOVED):
            values |= {
                "camera_shift_px": round(self.shift_px, 2),
                "camera_shift_deg": round(self.swing_deg, 3),
                "camera_turn_deg": round(self.turned_deg, 3),
                "camera_edges_agreeing": round(self.agreeing, 3),
            }
        return values


class CameraMovedDetector:
    """Compares frames of one camera with its background; the same frames give the same results at every speed.

    ``since_rad`` (3,) : the turn that the camera had made already when the background was learned.
    ``alignment`` : of pictures with the background, for others on the frames' thread.
    Frames come on one thread; ``movement`` may be read on another.
    """

    def __init__(
        self,
        camera: CameraModel,
        background: BackgroundModel,
        settings: CameraMovedSettings | None = None,
        since_rad: Array | None = None,
    ) -> None:
        self._focal_px, self._settings = camera.K[0, 0], settings or CameraMovedSettings()
        self.alignment = PictureAlignment(camera, background.mean, float(np.median(background.sigma)))
        self._since = rotation_matrix(np.zeros(3) if since_rad is None else since_rad)
        self._samples: deque[Alignment] = deque(maxlen=SAMPLES)
        self._throttle = StampThrottle(REPORT_PERIOD_S)
        self._searched_ns, self._unlike_s = -(10**18), 0.0
        self.movement = Movement()

    @property
    def enabled(self) -> bool:
        return self._settings.limit_deg > 0 and self.alignment.has_enough_edges

    def update(self, image: Image, stamp_ns: int) -> Movement:
        """Compare a frame (H, W) or (H, W, 3) of ``stamp_ns`` if it is time to; returns ``movement``."""
        step_s = self._throttle.step_s(stamp_ns)
        if step_s == 0.0 or not self.enabled:
            return self.movement
        search = stamp_ns - self._searched_ns >= LASTING_S * 1e9 or not self._samples
        start_rad = self._samples[-1].turn_rad if self._samples else np.zeros(3)
        found = self.alignment.align(image, start_rad, search)
        if found is not None and found.agreeing >= MIN_AGREEMENT:
            self._samples.append(found)
            self._unlike_s = 0.0
            self.movement = self._measured()
            return self.movement
        if search:
            self._searched_ns = stamp_ns
        self._unlike_s = self._unlike_s + step_s if found is None or found.agreeing < LOST else 0.0
        if self._unlike_s >= LASTING_S:
            self._samples.clear()
            self.movement = Movement(MovementState.LOST)
        return self.movement

    def _measured(self) -> Movement:
        """Return the median of the last samples; moved when that is more than the limit."""
        if len(self._samples) < SAMPLES:
            return self.movement
        turn_rad = np.median([sample.turn_rad for sample in self._samples], axis=0)
        gained = float(np.median([sample.agreeing - sample.agreeing_unmoved for sample in self._samples]))
        total_rad = rotation_vector(rotation_matrix(turn_rad) @ self._since)
        limit_rad = np.radians(self._settings.limit_deg)
        if np.linalg.norm(turn_rad) > limit_rad and gained < MIN_AGREEMENT_GAIN:
            return Movement()
        return Movement(
            state=MovementState.MOVED if np.linalg.norm(total_rad) > limit_rad else MovementState.STILL,
            turn_rad=total_rad,
            shift_px=float(self._focal_px * np.hypot(*total_rad[:2])),
            agreeing=float(np.median([sample.agreeing for sample in self._samples])),
        )


# --- how far the camera had turned when a background was learned
#
# Learning the background of a bumped camera again repairs its silhouettes, but not its calibration. So each background
# is compared with the one before, and its provenance says how far the camera had turned since the first one that was
# learned with the same calibration. Another calibration of the camera's pose begins anew.


def pose_checksum(camera: CameraModel) -> str:
    """Return a short text that changes with the camera's calibrated pose."""
    return f"{zlib.crc32((np.round(camera.T_camera_world, 6) + 0.0).tobytes()):08x}"


def turn_when_learned(about: Provenance, camera: CameraModel) -> Array:
    """(3,) rotation vector, radians, of the camera when this background was learned, from when it was calibrated; zero
    where that is unknown, or ``camera`` has been calibrated again since."""
    return about.turn_rad if about.calibration == pose_checksum(camera) else np.zeros(3)


def carry_turn_over(model: BackgroundModel, before: BackgroundModel | None, camera: CameraModel) -> BackgroundModel:
    """Return ``model`` with how far the camera had turned when it was learned, by the background ``before`` it."""
    place, turn_rad = pose_checksum(camera), np.zeros(3)
    if before is not None and before.shape == model.shape and before.provenance.calibration in ("", place):
        turn_rad = turn_when_learned(before.provenance, camera)
        found = PictureAlignment(camera, before.mean, float(np.median(before.sigma))).align(model.mean)
        if found is not None and found.agreeing >= MIN_AGREEMENT:
            turn_rad = rotation_vector(rotation_matrix(found.turn_rad) @ rotation_matrix(turn_rad))
    text = " ".join(f"{angle:.6f}" for angle in turn_rad)
    return model.with_provenance(calibration=place, camera_turn_rad=text)
