"""The built-in person in the virtual room, rendered while the cameras look."""

from __future__ import annotations

from capture_rig.rig import Rig
from stick_figure.body import Body

from ..body import VolumetricBody
from ..motion import MOTIONS
from ..render import VirtualCamera
from ..shadow import floor_shadow
from .live_scene import LiveScene, grey
from .pixels import Image
from .stage import Stage

POSES_PER_S = 60.0


class RoomScene(LiveScene):
    """A person who moves, seen by all cameras of a rig."""

    def __init__(
        self,
        rig: Rig,
        motion: str = "tour",
        seconds: float = 20.0,
        stature_m: float = 1.75,
        shadow: bool = True,
        most_hz: float = 20.0,
    ) -> None:
        body = Body.from_stature(stature_m)
        self._body, self._shadow = VolumetricBody(body), shadow
        self._poses = MOTIONS[motion](body, seconds, POSES_PER_S).poses
        self._cameras = {camera.name: VirtualCamera(camera) for camera in rig.cameras}
        empty = {name: grey(camera.empty_room()) for name, camera in self._cameras.items()}
        super().__init__(Stage(len(self._poses), POSES_PER_S), empty, most_hz)

    def render(self, instant_ns: int) -> dict[str, Image]:
        capsules = self._body.place(self._poses[self.stage.frame_at(instant_ns)])
        shade = floor_shadow(capsules) if self._shadow else None
        return {name: grey(camera.see(capsules, shade)[0]) for name, camera in self._cameras.items()}
