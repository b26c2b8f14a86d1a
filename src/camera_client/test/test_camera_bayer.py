"""Bayer cameras that are finer than the hull: each tile of 2 x 2 pixels is one pixel of what is looked at."""

import itertools
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from camera_pictures import SENSOR, iou, learned, studio_walk

from camera_client.background.model import load_background
from camera_client.camera_ros import outline
from camera_client.configuration import check_size
from camera_client.frame_processor import FrameProcessor
from camera_client.frame_source import Frame
from camera_client.gige.pixel_formats import to_image
from camera_client.settings import CameraClientSettings
from capture_rig.errors import InputError
from sagoma_ros.images import decode_silhouette
from virtual_studio.recording.session import FIRST_BACKGROUND_FRAME
from virtual_studio.rendering.camera import VirtualCamera
from virtual_studio.rig import ring

ANY_PIXEL_M = 1.0


class StillRoom:
    """What a simulated camera sees of an empty room."""

    def __init__(self, frames):
        self.shape, self._frames = frames[0].shape, itertools.cycle(frames)

    def image(self, instant_ns):
        return next(self._frames)


def mosaic(image):
    """What a sensor behind a BayerRG8 filter would send of a colour image (H, W, 3)."""
    raw = image[..., 1].copy()
    raw[::2, ::2], raw[1::2, 1::2] = image[::2, ::2, 2], image[1::2, 1::2, 0]
    return raw


@pytest.mark.parametrize("outfit", ["middle", "dark"])
def test_tiles_give_better_silhouettes_than_the_interpolated_mosaic_at_half_the_size(outfit, monkeypatch):
    monkeypatch.setattr("capture_rig.visibility.MOST_PIXEL_M", ANY_PIXEL_M)
    rig, found = ring(4, size=(640, 480)), {}
    camera = rig.cameras[1]
    seen, room = studio_walk(camera, slice(12, 18), outfit, colour=True)
    for halved in (False, True):

        def picture(light, number, halved=halved):
            raw = mosaic(SENSOR.expose(light, 1, number))
            return to_image(raw.tobytes(), "BayerRG8", camera.width, camera.height, halved)

        processor = FrameProcessor(camera, CameraClientSettings(), rig.volume)
        processor.use_background(learned([picture(room, FIRST_BACKGROUND_FRAME + k) for k in range(30)]))
        assert processor.pipeline.scale == 2
        silhouettes = [
            processor.run(Frame(picture(light, k), k * 10**8, k, "test")).silhouette
            for k, (light, _) in enumerate(seen)
        ]
        pairs = zip(silhouettes, seen, strict=True)
        found[halved] = np.mean([iou(silhouette.image_mask, truth) for silhouette, (_, truth) in pairs])
        last, view = silhouettes[-1], camera.undistorted_view()
        assert last.image_mask.shape == view.image_shape and last.mask.shape == view.seen.shape
        assert outline(picture(seen[-1][0], 5), last.image_mask).shape == (240, 320, 3)
    assert found[True] > max(found[False], 0.88)


def test_camera_that_turns_is_found_in_pictures_of_half_the_size():
    rig = ring(4, size=(640, 480))
    camera, room = rig.cameras[1], VirtualCamera(rig.cameras[1]).empty_room_colour()

    def picture(number, right_px):
        A = np.array([[1.0, 0.0, right_px], [0.0, 1.0, 0.0]])
        moved = cv2.warpAffine(room, A, (640, 480), borderMode=cv2.BORDER_REFLECT)
        return to_image(mosaic(SENSOR.expose(moved, 1, number)).tobytes(), "BayerRG8", 640, 480, halved=True)

    processor = FrameProcessor(camera, CameraClientSettings(), rig.volume)
    processor.use_background(learned([picture(FIRST_BACKGROUND_FRAME + k, 0.0) for k in range(30)]))
    for k in range(5):
        movement = processor.run(Frame(picture(k, 12.0), k * 10**9, k, "test")).movement
    assert movement.state.value == "was moved"
    assert movement.shift_px == pytest.approx(12.0, abs=1.0)  # the camera's own pixels


@pytest.mark.parametrize("raw", [False, True], ids=["silhouettes alone", "images too"])
def test_client_makes_whole_images_only_where_somebody_takes_them(
    raw, gige_camera, bench, scene, tmp_path, monkeypatch
):
    monkeypatch.setattr("capture_rig.visibility.MOST_PIXEL_M", ANY_PIXEL_M)
    simulated = gige_camera(StillRoom(scene.empty(50, colour=True)))
    saved = tmp_path / "background.npz"
    settings = {"source": "aravis", "aravis.address": simulated.address, "publish_raw": raw}
    files = {"rig_file": scene.write_rig(tmp_path / "rig.yaml", scene.camera()), "background_file": str(saved)}
    camera = bench(camera_name="cam01", background_frames=20, **settings, **files).start()
    assert camera.ask_to_learn().success
    camera.until(lambda: camera.masks)
    factor = 1 if raw else 2
    shape = scene.height // factor, scene.width // factor, 3
    assert camera.node.source.shape == load_background(saved).shape == shape
    canvas = scene.camera().undistorted_view().camera
    mask = decode_silhouette(camera.masks[0], canvas.width, canvas.height, "test")
    assert mask.shape == (canvas.height, canvas.width)


def test_background_of_another_size_says_what_to_do(scene):
    processor = FrameProcessor(scene.camera(), CameraClientSettings())
    processor.use_background(learned([image[::2, ::2] for image in scene.empty(3, colour=True)]))
    with pytest.raises(InputError, match="an image of 160 x 120 colour"):
        processor.run(Frame(scene.empty(1, colour=True)[0], 0, 0, "test"))
    with pytest.raises(InputError, match="the background is 53 x 40 colour"):
        processor.use_background(learned([image[::3, ::3][:40, :53] for image in scene.empty(3, colour=True)]))


def test_pictures_of_half_the_size_are_the_cameras_only_where_the_source_halved_them(scene):
    source = SimpleNamespace(shape=(scene.height // 2, scene.width // 2, 3), description="cam01", halved=True)
    check_size(source, scene.camera())
    with pytest.raises(InputError, match="gives images of 80 x 60 pixels"):  # a part of the sensor, perhaps
        check_size(SimpleNamespace(**vars(source) | {"halved": False}), scene.camera())
