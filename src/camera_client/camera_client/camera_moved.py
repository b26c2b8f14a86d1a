"""Was the camera moved since it was calibrated? Its own picture is asked, twice a second by the frames' stamps.

Silhouettes cannot tell: when the camera is bumped, every edge of the room becomes foreground. The whole picture can,
with somebody in it, other lights, and a chair that was moved; only a room without any edges cannot.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from capture_rig.camera import CameraModel

from .background_model import BackgroundModel
from .camera_moved_alignment import Alignment, PictureAlignment
from .camera_moved_points import Array
from .frame_source import Image
from .rotation import matrix_of, vector_of
from .settings import CameraMovedSettings

LOOKS = 3  # their median counts: something that springs back, or one bad picture, is no movement
TRUSTED = 0.2  # share of the edges, beyond chance, that have to agree on a turn
GAINED = 0.08  # ... and more of them than agree that nothing moved
LOST = 0.1  # when fewer agree on anything, the picture is another one ...
LOST_S = 3.0  # ... and that is said when it lasts
SEARCH_S = 3.0  # a search costs as much as ten looks
SIGMAS = 4.0
GRAVE = 2.5  # limits from which it is an error, and not only a warning


class State(Enum):
    """What the picture says about the camera."""

    UNKNOWN = "cannot tell"
    STILL = "has not moved"
    MOVED = "was moved"
    LOST = "shows something else"


@dataclass(frozen=True, eq=False)
class Movement:
    """Where the camera stands, compared with the time of its calibration.

    turn_rad (3,) : rotation vector of the camera in its own frame (x right, y down, z forward), radians; a push aside
    shows as the turn that does most of the same. shift_px (2,) : how far the middle of the picture moved, right and
    down. agreeing : share of the background's edges that confirm it, beyond chance. grave : the silhouettes are wrong
    by more than they can bear.
    """

    state: State = State.UNKNOWN
    turn_rad: Array = field(default_factory=lambda: np.zeros(3))
    shift_px: Array = field(default_factory=lambda: np.zeros(2))
    agreeing: float = 0.0
    grave: bool = False

    @property
    def turned_deg(self) -> float:
        """By how much the picture is turned about its middle, clockwise where positive."""
        return float(np.degrees(self.turn_rad[2]))

    @property
    def swing_deg(self) -> float:
        """By how much the camera looks to another side, or up or down."""
        return float(np.degrees(np.hypot(*self.turn_rad[:2])))

    def tell(self, camera: str) -> str:
        """What is wrong, and what to do; "" when nothing is known to be."""
        if self.state is State.LOST:
            return (
                f"{camera} shows something else than its background does: was it moved far, or is something before "
                "its lens? Put it back, or calibrate it and learn its background again"
            )
        if self.state is not State.MOVED:
            return ""
        shift_px = float(np.hypot(*self.shift_px))
        return (
            f"{camera} was moved: its picture is shifted by {shift_px:.1f} px ({self.swing_deg:.1f} degrees), "
            f"turned by {abs(self.turned_deg):.1f} degrees: put it back, or calibrate it and learn its background "
            "again"
        )

    def values(self) -> dict[str, object]:
        """The figures, by the keys of the diagnostics; only what was measured."""
        values: dict[str, object] = {"camera_moved": self.state.value}
        if self.state in (State.STILL, State.MOVED):
            values |= {
                "camera_shift_px": round(float(np.hypot(*self.shift_px)), 2),
                "camera_shift_deg": round(self.swing_deg, 3),
                "camera_turn_deg": round(self.turned_deg, 3),
                "camera_edges_agreeing": round(self.agreeing, 3),
            }
        return values


class CameraMovedWatch:
    """Compares frames of one camera with its background. The same frames give the same results at every speed.

    ``since_rad`` (3,) : the turn that the camera had made already when the background was learned.
    Frames come on one thread; ``movement`` may be read on another.
    """

    def __init__(
        self,
        camera: CameraModel,
        background: BackgroundModel,
        settings: CameraMovedSettings | None = None,
        since_rad: Array | None = None,
    ) -> None:
        self._camera, self._settings = camera, settings or CameraMovedSettings()
        self._alignment = PictureAlignment(camera, background.mean, float(np.median(background.sigma)))
        self._since = matrix_of(np.zeros(3) if since_rad is None else since_rad)
        self._looks: deque[Alignment] = deque(maxlen=LOOKS)
        self._last_ns: int | None = None
        self._searched_ns, self._unlike_s = -(10**18), 0.0
        self.movement = Movement()

    @property
    def enabled(self) -> bool:
        return self._settings.limit_deg > 0 and self._alignment.tells

    def look(self, image: Image, stamp_ns: int) -> Movement:
        """Take a frame (H, W) or (H, W, 3) of ``stamp_ns``; most are not looked at."""
        step_s = self._step_s(stamp_ns)
        if step_s == 0.0 or not self.enabled:
            return self.movement
        search = stamp_ns - self._searched_ns >= SEARCH_S * 1e9 or not self._looks
        start_rad = self._looks[-1].turn_rad if self._looks else np.zeros(3)
        found = self._alignment.align(image, start_rad, search)
        if found is not None and found.agreeing >= TRUSTED:
            self._looks.append(found)
            self._unlike_s = 0.0
            self.movement = self._measured()
            return self.movement
        if search:
            self._searched_ns = stamp_ns
        self._unlike_s = self._unlike_s + step_s if found is None or found.agreeing < LOST else 0.0
        if self._unlike_s >= LOST_S:
            self._looks.clear()
            self.movement = Movement(State.LOST, grave=True)
        return self.movement

    def _step_s(self, stamp_ns: int) -> float:
        """Time since the last look; 0 when it is too early for another."""
        if self._last_ns is None or stamp_ns < self._last_ns:
            self._last_ns = stamp_ns
            return self._settings.period_s
        step_s = (stamp_ns - self._last_ns) * 1e-9
        if step_s < self._settings.period_s:
            return 0.0
        self._last_ns = stamp_ns
        return min(step_s, 2 * self._settings.period_s)

    def _measured(self) -> Movement:
        """The median of the last looks; moved when that is certain, and more than the limit."""
        if len(self._looks) < LOOKS:
            return self.movement
        turn_rad = np.median([look.turn_rad for look in self._looks], axis=0)
        sd_rad = float(np.median([np.linalg.norm(look.sd_rad) for look in self._looks]))
        gained = float(np.median([look.agreeing - look.agreeing_unmoved for look in self._looks]))
        R = matrix_of(turn_rad) @ self._since
        total_rad = vector_of(R)
        limit_rad = np.radians(self._settings.limit_deg)
        beyond = np.linalg.norm(total_rad) - SIGMAS * sd_rad > limit_rad
        if np.linalg.norm(turn_rad) > limit_rad and gained < GAINED:
            return Movement()
        return Movement(
            state=State.MOVED if beyond else State.STILL,
            turn_rad=total_rad,
            shift_px=self._shift_px(R),
            agreeing=float(np.median([look.agreeing for look in self._looks])),
            grave=bool(np.linalg.norm(total_rad) > GRAVE * limit_rad),
        )

    def _shift_px(self, R: Array) -> Array:
        """(2,) from where to where a turn moves what is in the middle of the picture."""
        K = self._camera.K
        middle = np.array([self._camera.width - 1, self._camera.height - 1]) / 2
        u, v, w = K @ R @ np.linalg.inv(K) @ np.append(middle, 1.0)
        return np.array([u / w, v / w]) - middle if w > 0 else np.full(2, np.inf)
