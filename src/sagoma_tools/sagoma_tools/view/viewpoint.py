"""Where browsers' views stand: so that the rig's volume fills the screen, or, once somebody is tracked, the persons.

A view follows the persons until somebody moves it; "Reset View" of viser's panel gives it back.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping

import numpy as np
import viser

from capture_rig.rig import Rig

from .scene import Figure

Array = np.ndarray

FOV_RAD = np.deg2rad(50.0)
"""Vertical: a person is not distorted at the edges, and a room of four metres fits from five away."""
ASPECT = 4.0 / 3.0
"""Width by height of the scene beside its panel, or less than that."""
MARGIN = 1.05
"""The screen by what is shown on it: names stand beside the cameras."""
AZIMUTH_RAD, ELEVATION_RAD = np.deg2rad(-22.5), np.deg2rad(15.0)
LEVEL = np.cos(ELEVATION_RAD)
BACKWARD = np.array([LEVEL * np.cos(AZIMUTH_RAD), LEVEL * np.sin(AZIMUTH_RAD), np.sin(ELEVATION_RAD)])
"""Whence a view looks: from above, and from the front to the right, between the cameras of a ring of four or eight."""
ROOM = np.array([[-1.4, -1.4, 0.0], [1.4, 1.4, 2.2]])
"""Corners of the room that is shown while no rig is known, m."""
PERSON_M, STANDING_M = 2.2, 2.0
"""Width of the room that is shown about one person, arms stretched, and its height."""
REMEMBERED = 300
"""Views that a browser may still report after newer ones were sent: ten seconds of them."""
SAME_VIEW_M = 0.01
LEFT_ALONE_S = 3.0
"""After somebody moved it: longer than what we had sent before may be under way, and undo a mouse's first step."""


class Viewpoint:
    """Places the views of all browsers; safe from any thread."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server, self._lock = server, threading.Lock()
        self._given: deque[Array] = deque(maxlen=REMEMBERED)
        self._moved_s: dict[int, float] = {}  # when a browser's view was last seen where we had not placed it
        server.initial_camera.fov = FOV_RAD
        self.show_rig(None)

    def show_rig(self, rig: Rig | None) -> None:
        """Look at its volume and cameras, until somebody is tracked."""
        centres = np.array([camera.centre_world for camera in rig.cameras]) if rig is not None else np.zeros((0, 3))
        room = corners_of(rig.volume.low, rig.volume.high) if rig is not None else corners_of(*ROOM)
        with self._lock:
            self._about: Array | None = None
            self._show(np.concatenate([room, centres]))

    def follow(self, figures: Mapping[str, Figure]) -> None:
        """Look at who is tracked; who is lost, and where nobody is, the view stays as it is."""
        tracked = [figure.points_world[:, :2] for figure in figures.values() if figure.state != "lost"]
        if not tracked:
            return
        points = np.concatenate(tracked)
        with self._lock:
            about = moved_window(self._about, points.min(0), points.max(0))
            if self._about is None or not np.array_equal(about, self._about):
                self._about = about
                self._show(corners_of(*np.column_stack([about, [0.0, STANDING_M]])))

    def place(self, now_s: float) -> None:
        """Move those views that nobody has moved; called again and again: a browser tells late where its view is."""
        with self._lock:
            given = np.array(self._given)
        clients = self._server.get_clients()
        self._moved_s = {key: moved_s for key, moved_s in self._moved_s.items() if key in clients}
        for key, client in clients.items():
            camera = client.camera
            apart_m = np.abs(given - [camera.position, camera.look_at]).max((1, 2))
            if apart_m.min() > SAME_VIEW_M or not np.allclose(camera.up_direction, [0.0, 0.0, 1.0], atol=1e-3):
                if key in self._moved_s:  # else it has not yet heard where it begins
                    self._moved_s[key] = now_s
            elif now_s - self._moved_s.setdefault(key, -np.inf) > LEFT_ALONE_S and apart_m[-1] > SAME_VIEW_M:
                with client.atomic():
                    camera.position, camera.look_at = given[-1]

    def _show(self, points_world: Array) -> None:
        """Show these points (n, 3) in all views that nobody has moved, and in those to come."""
        look_at = 0.5 * (points_world.min(0) + points_world.max(0))
        position = look_at + distance_to(points_world - look_at) * BACKWARD
        self._given.append(np.stack([position, look_at]))
        self._server.initial_camera.position, self._server.initial_camera.look_at = position, look_at


def distance_to(points: Array) -> float:
    """Return from how far away points (n, 3) fill a view along ``-BACKWARD`` through the origin."""
    right = np.array([-BACKWARD[1], BACKWARD[0], 0.0]) / np.hypot(*BACKWARD[:2])
    up = np.cross(BACKWARD, right)
    wide, high = np.abs(points @ right) / ASPECT, np.abs(points @ up)
    return float((MARGIN * np.maximum(wide, high) / np.tan(0.5 * FOV_RAD) + points @ BACKWARD).max())


def corners_of(low: Array, high: Array) -> Array:
    """(8, 3) of a box."""
    return np.where(np.indices((2, 2, 2)).reshape(3, 8).T, high, low)


def moved_window(window: Array | None, low: Array, high: Array) -> Array:
    """Return the window (2, 2) m moved as little as may be so that it holds what lies between low and high (2,)."""
    size = np.maximum(high - low, PERSON_M)
    begin = 0.5 * (low + high - size) if window is None else np.clip(window[0], high - size, low)
    return np.stack([begin, begin + size])
