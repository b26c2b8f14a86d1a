"""People with volume, carved from their exact silhouettes, for the tests of the first pose."""

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.visibility import RigVisibility
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from mocap_packets.frame_set import FrameSet
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from virtual_studio.people import Capsules, VolumetricBody
from virtual_studio.rendering.camera import VirtualCamera
from virtual_studio.rig import ring

DOWN = -np.pi / 2  # of an arm's elevation
SET_NS = 16_666_667


def standing(body, angles, heading=0.0, place=(0.0, 0.0), lean=0.0):
    """The pose on the floor, hips above ``place``, leaning forward by ``lean`` rad."""
    R = (Rotation.from_rotvec([0, 0, heading]) * Rotation.from_rotvec([0, lean, 0])).as_matrix()
    points = forward(body, Pose.from_angles(np.zeros(3), R, angles))
    hips = points[5:7].mean(axis=0)
    height = VolumetricBody(body).ankle_height - points[13:, 2].min()
    return Pose.from_angles(np.r_[np.array(place) - hips[:2], height], R, angles)


def person(body, pose, build=1.0):
    """The parts of a person; ``build`` widens them."""
    parts = VolumetricBody(body).place(pose)
    return parts._replace(radii=parts.radii * build)


def box(low, high, radius=0.15):
    """A cart: upright capsules side by side."""
    x, y = np.meshgrid(np.arange(low[0], high[0], radius), np.arange(low[1], high[1], radius))
    feet = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, low[2] + radius)])
    tops = feet * [1, 1, 0] + [0, 0, high[2] - radius]
    return Capsules(feet, tops, np.full((len(feet), 2), radius), np.full(len(feet), 0.3))


class Studio:
    """A rig of cameras around the volume and what it shows of people."""

    def __init__(self, rig):
        self.rig, self.visibility = rig, RigVisibility(rig)
        self._eyes = [(c.name, VirtualCamera(c), c.undistorted_view()) for c in self.rig.cameras]
        self._pipeline = HullPipeline(self.rig, HullSettings(backend="cpu"))
        self._stamp_ns = 0

    def render(self, *people, apart_ns=1_000_000_000):
        """The products of a set with people (Capsules), ``apart_ns`` after the last one."""
        self._stamp_ns += apart_ns
        masks = {}
        for name, eye, view in self._eyes:
            seen = [eye.render(parts, None)[1] for parts in people]
            masks[name] = view.undistort_mask(np.maximum.reduce(seen))
        return self._pipeline.run(FrameSet.of_instant(self._stamp_ns, masks)).products


@lru_cache
def studio(cameras=5, ceiling=True):
    """A rig; made once."""
    return Studio(ring(cameras, ceiling=ceiling))
