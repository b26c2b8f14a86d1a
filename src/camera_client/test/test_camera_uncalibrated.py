"""A camera before it is calibrated: images and backgrounds, no silhouettes; and what happens when its lens is known."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from camera_probe import set_camera_info
from node_probe import SUCCESS
from sensor_msgs.msg import Image

from camera_client.background.model import load_background
from camera_client.background.training import KEY, TrainingReport
from camera_client.camera_ros import CameraTopics
from camera_client.diagnostics import UNCALIBRATED, UNPLACED
from camera_client.frame_source import Frame
from camera_client.settings import CameraClientSettings
from sagoma_ros.images import camera_info_message, decode_silhouette
from sagoma_ros.qos import SILHOUETTE_RELIABLE_SUBSCRIBER


@pytest.fixture
def unknown(bench, session, scene, monkeypatch):
    """Parameters of a camera of which nothing is known; its footage shows the empty room for ever."""
    monkeypatch.setattr("camera_client.camera_node.CONSUMER_WAIT_S", 0.1)
    empty = scene.write_video(session.folder / "empty.avi", scene.empty(25, seed=3))
    changed = {"rig_file": "", "background": "", "footage.path": empty, "footage.rate": 1.0, "footage.loop": True}
    return {**session.parameters, **changed, "background_frames": 20}


def test_images_and_camera_info_with_zero_K_come_instead_of_silhouettes(bench, unknown, scene):
    camera = bench(**unknown)
    camera.listen(Image, "image_raw", SILHOUETTE_RELIABLE_SUBSCRIBER)
    camera.start()
    camera.until(lambda: camera.heard["image_raw"] and len(camera.heard["camera_info"]) > 5)
    camera.until_said(UNCALIBRATED)
    assert camera.diagnostics[-1].status[0].level == b"\1"
    image, info = camera.heard["image_raw"][0], camera.heard["camera_info"][0]
    assert (image.width, image.height) == (info.width, info.height) == (scene.width, scene.height)
    assert image.header.frame_id == info.header.frame_id == "cam01_optical"
    assert not info.k.any() and not info.p.any() and len(info.d) == 0
    assert set(camera.stamps_ns("image_raw")) <= set(camera.stamps_ns("camera_info"))
    assert camera.masks == [] and float(camera.values()["rate_hz"]) > 10


@pytest.mark.parametrize(
    "to_calibrate, publish_raw, listeners, sent",
    [(True, False, 0, 0), (True, False, 1, 1), (False, False, 1, 0), (True, True, 0, 1), (False, True, 0, 1)],
)
def test_images_for_calibration_are_sent_only_while_somebody_listens(to_calibrate, publish_raw, listeners, sent):
    out = []

    def create(kind, topic, qos):
        return SimpleNamespace(get_subscription_count=lambda: listeners, publish=out.append)

    topics = CameraTopics(create, "cam01_optical", CameraClientSettings(publish_raw=publish_raw), to_calibrate)
    topics.publish_image(Frame(np.zeros((4, 6), np.uint8), 5, 1, "test"))
    assert len(out) == sent


def test_background_learned_before_the_calibration_serves_after_it(bench, unknown, session, scene):
    path = session.folder / "cam01.yaml"
    camera = bench(**unknown, camera_info_file=str(path)).start()
    camera.until_said(UNCALIBRATED)
    answer = camera.ask_to_learn()
    assert answer.success and "20 frames" in answer.message
    assert camera.masks == []
    values = camera.values()
    training = TrainingReport.from_json(values[KEY])
    assert (training.number, training.frames, training.text, training.saved) == (1, 20, answer.message, "")
    assert (values["background_age_h"], values["things_share"]) == ("0", "")  # there is no foreground
    wanted = scene.calibrated()
    too_wide = camera_info_message(replace(wanted, width=640), 0, "cam01_optical")
    answer = set_camera_info(camera, too_wide)
    assert not answer.success and "for images of 640 x 120" in answer.status_message
    assert set_camera_info(camera, camera_info_message(wanted, 0, "cam01_optical")).success
    canvas = wanted.undistorted_view().camera
    camera.until(lambda: camera.masks and camera.heard["camera_info"][-1].k[0] != 0)
    info = camera.heard["camera_info"][-1]
    assert (info.width, info.height) == (canvas.width, canvas.height)
    assert np.allclose(np.reshape(info.k, (3, 3)), canvas.K)
    assert not decode_silhouette(camera.masks[-1], canvas.width, canvas.height, "test").any()
    camera.until_said(UNPLACED)
    assert camera.node.trigger_deactivate() == SUCCESS and camera.node.trigger_cleanup() == SUCCESS
    assert camera.node.trigger_configure() == SUCCESS  # with what was saved
    assert np.array_equal(camera.node.processor.camera.K, wanted.K)


class Room:
    """What a simulated camera sees: a textured wall, and when told so a bright bar before it."""

    shape, bar = (192, 256), False
    wall = cv2.GaussianBlur(np.random.default_rng(1).uniform(60, 200, shape), (0, 0), 3).astype(np.uint8)

    def image(self, instant_ns):
        image = self.wall.copy()
        if self.bar:
            image[60:150, 100:140] = 250
        return image


def test_live_camera_learns_before_its_calibration_and_tells_who_was_in_the_room(gige_camera, bench, tmp_path):
    room, saved = Room(), tmp_path / "bg.npz"
    simulated = gige_camera(room, noise=2.0, serial="SN42")
    parameters = {
        "source": "aravis",
        "aravis.address": simulated.address,
        "aravis.frame_rate": 50.0,
        "aravis.exposure_us": 3000.0,
        "background_frames": 30,
        "background_file": str(saved),
    }
    camera = bench(camera_name="cam01", **parameters).start()
    camera.until_said(UNCALIBRATED)
    answer = camera.ask_to_learn()
    assert answer.success and answer.message.startswith("good")
    about = load_background(saved).provenance
    assert (about.camera_serial, about.gain, about.pixel_format) == ("SN42", "0", "Mono8")
    assert float(about.exposure_us) == pytest.approx(3000, rel=0.01)
    room.bar, seen = True, camera.node.loop.frames
    camera.until(lambda: camera.node.loop.frames > seen + 20)  # frames under way show the wall alone
    answer = camera.ask_to_learn()
    assert answer.success and "something else than in the background of" in answer.message
    assert "in the middle at 100..139, 60..149: 7.3 %" in answer.message  # 40 x 90 of 256 x 192 pixels


def test_damaged_background_of_the_last_lesson_keeps_no_camera_from_starting(bench, session):
    saved = session.folder / "learned.npz"
    saved.write_bytes(b"broken")
    changed = {"background": "", "background_file": str(saved), "footage.rate": 1.0, "footage.loop": True}
    camera = bench(**{**session.parameters, **changed}).start()
    camera.until_said("no background")
    assert camera.masks == []
