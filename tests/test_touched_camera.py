"""A camera that somebody touches: its background is found again in the very frame, and by nothing else."""

import cv2
import numpy as np
import pytest
from camera_pictures import SENSOR, iou, learned, studio_walk

from camera_client.silhouettes.pipeline import SilhouettePipeline
from virtual_studio.recording.session import FIRST_BACKGROUND_FRAME
from virtual_studio.rig import ring

FRAME_NS = 66_666_667
CAMERA = 1


class Studio:
    """One camera of the studio on an empty room, and on the room with a person in it."""

    def __init__(self):
        self.camera = ring(4).cameras[CAMERA]
        [(self.light, self.person)], empty = studio_walk(self.camera, slice(20, 21))
        self.background = learned(SENSOR.expose(empty, CAMERA, FIRST_BACKGROUND_FRAME + k) for k in range(30))

    def pipeline(self):
        """A pipeline that has seen the person for some frames."""
        return self.run(SilhouettePipeline(self.camera, self.background), range(4))

    def run(self, pipeline, frames, change=lambda light: light, after=lambda picture: picture):
        """Show the person: the light changed before the sensor, the picture after it."""
        for k in frames:
            light = change(self.light).astype(np.float32)
            pipeline.silhouette = pipeline.run(after(SENSOR.expose(light, CAMERA, k)), k * FRAME_NS)
        return pipeline

    def most_px(self, pipeline):
        return pipeline.background.shift.total.most_px(self.light.shape)


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


@pytest.mark.parametrize(
    "displacement, light", [((-2.7, 1.3, 0.0), 1.0), ((1.0, 0.0, 0.005), 1.0), ((1.2, 0.9, 0.0), 1.2)]
)
def test_moved_picture_is_followed_in_its_first_frame(studio, displacement, light):
    pipeline = studio.run(studio.pipeline(), [4])
    before = iou(pipeline.silhouette.image_mask, studio.person)
    studio.run(pipeline, [5], lambda p: p * light, lambda p: moved(p, *displacement))
    found = pipeline.background.shift.total
    assert found[:2] == pytest.approx(displacement[:2], abs=0.1)
    assert found.roll_rad == pytest.approx(displacement[2], abs=3e-4)  # a tenth of a pixel in the corners
    assert iou(pipeline.silhouette.image_mask, moved(studio.person, *displacement) > 127) > before - 0.05
    assert pipeline.background.lights.switches == (light != 1.0)


@pytest.mark.parametrize(("shown", "ways_px"), [(4, (2.0, -1.5, 1.0, -0.7, 0.5)), (0, (0.6,))])
def test_camera_that_swings_or_lies_elsewhere_from_the_beginning_is_followed_in_every_frame(studio, shown, ways_px):
    pipeline = studio.run(SilhouettePipeline(studio.camera, studio.background), range(shown))
    for k, right_px in enumerate(ways_px, shown):
        studio.run(pipeline, [k], after=lambda p, px=right_px: moved(p, px, -0.2 * px))
        assert pipeline.background.shift.total[:2] == pytest.approx((right_px, -0.2 * right_px), abs=0.15)


def lamp(picture):
    v, u = np.indices(picture.shape)
    return picture * (1 + 0.6 * np.exp(-((u - 100) ** 2 + (v - 150) ** 2) / (2 * 150.0**2)))


@pytest.mark.parametrize("change", [lambda p: p * 0.5, lamp])
def test_other_light_moves_no_background(studio, change):
    pipeline = studio.run(studio.pipeline(), range(4, 8), change)
    assert pipeline.background.lights.switches == 1
    assert studio.most_px(pipeline) == 0


@pytest.mark.parametrize("begin", [0, 210])
@pytest.mark.parametrize("thing", [lambda p: p[::-1, ::-1], lambda p: moved(p, 1.6, 1.2)], ids=["somebody", "wall"])
def test_who_covers_or_what_moves_a_third_of_the_picture_moves_no_background(studio, begin, thing):
    def partly(picture):
        changed, part = picture.copy(), np.s_[:, begin : begin + 210]
        changed[part] = thing(picture)[part]
        return changed

    assert studio.most_px(studio.run(studio.pipeline(), range(4, 8), after=partly)) < 0.1


def test_camera_that_was_turned_away_is_left_to_the_watch(studio):
    pipeline = studio.run(studio.pipeline(), range(4, 12), after=lambda p: moved(p, 15.0, 13.0))
    assert studio.most_px(pipeline) < 1.0  # of twenty
