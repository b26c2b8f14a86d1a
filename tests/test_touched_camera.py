"""A camera that somebody touches: its background is found again in the very frame, and by nothing else."""

import cv2
import numpy as np
import pytest

from camera_client.background.model import BackgroundLearner
from camera_client.silhouettes.pipeline import SilhouettePipeline
from stick_figure.body import Body
from stick_figure.pose import Pose
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.people import OUTFITS, VolumetricBody
from virtual_studio.recording.session import FIRST_BACKGROUND_FRAME
from virtual_studio.rendering.camera import Sensor, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow
from virtual_studio.rig import ring

FRAME_NS = 66_666_667
SENSOR = Sensor(noise=2.0, flicker=0.005, seed=13)
CAMERA = 1


class Studio:
    """One camera of the studio on an empty room, and on the room with a person in it."""

    def __init__(self):
        self.camera = ring(4).cameras[CAMERA]
        eye = VirtualCamera(self.camera)
        self.empty = eye.empty_room()
        person = VolumetricBody(Body.from_stature(1.75)).place(self._pose())
        self.light, self.person = eye.render(OUTFITS["middle"].dress(person), floor_shadow(person, 0.5))
        learner = BackgroundLearner()
        for k in range(30):
            learner.add(SENSOR.expose(self.empty, CAMERA, FIRST_BACKGROUND_FRAME + k))
        self.background = learner.model("test")

    @staticmethod
    def _pose() -> Pose:
        return MOTIONS["walk"](Body.from_stature(1.75), 2.0, 15.0).poses[20]

    def pipeline(self, light=1.0):
        """A pipeline that has seen the person for some frames."""
        pipeline = SilhouettePipeline(self.camera, self.background)
        for k in range(4):
            pipeline.run(SENSOR.expose(self.light * np.float32(light), CAMERA, k), k * FRAME_NS)
        return pipeline


@pytest.fixture(scope="module")
def studio():
    return Studio()


def moved(picture, right_px, down_px, roll_rad=0.0):
    height, width = picture.shape
    A = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), -np.degrees(roll_rad), 1.0)
    A[:, 2] += right_px, down_px
    found = cv2.warpAffine(
        picture.astype(np.float32), A, (width, height), flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101
    )
    return np.rint(found).clip(0, 255).astype(np.uint8)


def iou(found, truth):
    found, truth = found > 127, truth > 127
    return (found & truth).sum() / (found | truth).sum()


@pytest.mark.parametrize(
    "displacement, light", [((-2.7, 1.3, 0.0), 1.0), ((1.0, 0.0, 0.005), 1.0), ((1.2, 0.9, 0.0), 1.2)]
)
def test_moved_picture_is_followed_in_its_first_frame(studio, displacement, light):
    pipeline = studio.pipeline()
    before = iou(pipeline.run(SENSOR.expose(studio.light, CAMERA, 4), 4 * FRAME_NS).image_mask, studio.person)
    frame = moved(SENSOR.expose(studio.light * np.float32(light), CAMERA, 5), *displacement)
    silhouette = pipeline.run(frame, 5 * FRAME_NS)
    found = pipeline.background.state.displacement
    assert found[:2] == pytest.approx(displacement[:2], abs=0.1)
    assert found.roll_rad == pytest.approx(displacement[2], abs=3e-4)  # a tenth of a pixel in the corners
    assert iou(silhouette.image_mask, moved(studio.person, *displacement)) > before - 0.05
    assert pipeline.background.state.switches == (light != 1.0)


def test_camera_that_swings_is_followed_in_every_frame(studio):
    pipeline = studio.pipeline()
    for k, right_px in enumerate((2.0, -1.5, 1.0, -0.7, 0.5), start=4):
        pipeline.run(moved(SENSOR.expose(studio.light, CAMERA, k), right_px, 0.0), k * FRAME_NS)
        assert pipeline.background.state.displacement.right_px == pytest.approx(right_px, abs=0.15)


def test_picture_that_lies_elsewhere_from_the_beginning(studio):
    pipeline = SilhouettePipeline(studio.camera, studio.background)
    pipeline.run(moved(SENSOR.expose(studio.light, CAMERA, 0), 0.6, -0.4), 0)
    assert pipeline.background.state.displacement[:2] == pytest.approx((0.6, -0.4), abs=0.1)


def lamp(picture):
    v, u = np.indices(picture.shape)
    return picture * (1 + 0.6 * np.exp(-((u - 100) ** 2 + (v - 150) ** 2) / (2 * 150.0**2))).astype(np.float32)


@pytest.mark.parametrize("change", [lambda p: p * 0.5, lambda p: p * 1.3, lamp])
def test_other_light_moves_no_background(studio, change):
    pipeline = studio.pipeline()
    for k in range(4, 8):
        pipeline.run(SENSOR.expose(change(studio.light).astype(np.float32), CAMERA, k), k * FRAME_NS)
    assert pipeline.background.state.switches == 1
    assert pipeline.background.state.displacement.most_px(studio.light.shape) == 0


@pytest.mark.parametrize("begin", [0, 210])
def test_what_covers_or_moves_a_third_of_the_picture_moves_no_background(studio, begin):
    """Somebody right before the camera, and a stage wall that is pushed by two pixels."""
    covered, pushed = studio.pipeline(), studio.pipeline()
    part = slice(None), slice(begin, begin + 210)
    for k in range(4, 8):
        image = SENSOR.expose(studio.light, CAMERA, k)
        near, wall = image.copy(), image.copy()
        near[part] = image[::-1, ::-1][part]
        wall[part] = moved(image, 1.6, 1.2)[part]
        covered.run(near, k * FRAME_NS)
        pushed.run(wall, k * FRAME_NS)
    for pipeline in (covered, pushed):
        assert pipeline.background.state.displacement.most_px(studio.light.shape) < 0.1


def test_camera_that_was_turned_away_is_left_to_the_watch(studio):
    pipeline = studio.pipeline()
    for k in range(4, 12):
        pipeline.run(moved(SENSOR.expose(studio.light, CAMERA, k), 15.0, 13.0), k * FRAME_NS)
    assert pipeline.background.state.displacement.most_px(studio.light.shape) < 1.0  # of twenty
