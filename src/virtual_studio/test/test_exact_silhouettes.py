"""Silhouettes without pictures equal those of the rendered sessions."""

import numpy as np

from stick_figure.body import Body
from virtual_studio.body import VolumetricBody
from virtual_studio.motion import tour
from virtual_studio.render import VirtualCamera
from virtual_studio.rig import ring
from virtual_studio.silhouettes import ExactSilhouettes


def test_bare_silhouettes_equal_the_rendered_ones():
    rig, body = ring(1), Body.from_stature(1.7)
    eyes = ExactSilhouettes(rig)
    for pose in tour(body, 6.0, 1.0).poses[::4]:
        capsules = VolumetricBody(body).place(pose)
        masks = eyes.see(capsules)
        assert list(masks) == list(rig.names)
        for camera in rig.cameras:
            rendered = VirtualCamera(camera).see(capsules, None)[1]
            expected = camera.undistorted_view().undistort_mask(rendered)
            assert expected.any()
            np.testing.assert_array_equal(masks[camera.name], expected)
