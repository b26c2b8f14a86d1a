"""The camera node among messages: lifecycle, stamps, learning, faults."""

import copy
import socket
import time

import cv2
import numpy as np
import pytest
from camera_pictures import iou
from camera_probe import EPOCH_NS, FRAMES, NAMESPACE, set_camera_info
from diagnostic_msgs.msg import DiagnosticArray
from node_probe import FAILURE, SUCCESS
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, TimeReference

from camera_client.background.model import load_background
from camera_client.sources.footage_source import FootageSource
from capture_rig.camera_info_file import load_camera_info, save_camera_info
from capture_rig.session import footage_stamp_ns
from mocap_packets.silhouette import NOBODY, ForegroundSupport
from mocap_packets.thinning import FrameDecimation
from sagoma_ros.images import camera_info_message, decode_silhouette, support_message
from sagoma_ros.messages import thinning_message, to_ns, to_stamp
from sagoma_ros.qos import LATCHED, RESULT, SILHOUETTE_RELIABLE_SUBSCRIBER

ABSENT = "127.0.0.78"  # no camera answers here


def test_every_frame_gives_a_mask_and_camera_info_with_its_capture_stamp(bench, session, scene, monkeypatch):
    drawn = []
    monkeypatch.setattr("camera_client.camera_ros.outline", lambda image, mask: drawn.append(1) or image)
    camera = bench(**session.parameters).start()
    camera.until(lambda: len(camera.masks) == FRAMES and len(camera.heard["camera_info"]) == FRAMES)
    expected = [footage_stamp_ns(EPOCH_NS, k, scene.fps) for k in range(FRAMES)]
    assert camera.stamps_ns() == camera.stamps_ns("camera_info") == expected
    canvas = scene.camera().undistorted_view().camera
    for message in camera.masks[:: FRAMES - 1]:
        mask = decode_silhouette(message, canvas.width, canvas.height, "test")
        assert iou(mask[: scene.height, : scene.width], session.truth) > 0.95
        assert message.header.frame_id == "cam01_optical"
    info = camera.heard["camera_info"][0]
    assert (info.width, info.height) == (canvas.width, canvas.height)
    assert not any(info.d) and np.allclose(np.array(info.k).reshape(3, 3), canvas.K)
    assert camera.peer.count_subscribers("/hull/thinning") == 0  # it goes as fast as it is answered, by no rule
    assert not drawn  # no preview, for nobody looks


def test_camera_without_a_name_takes_the_namespace(bench, session, scene):
    name = NAMESPACE.strip("/")
    rig = scene.write_rig(session.folder / "named.yaml", scene.camera(name))
    camera = bench(**{**session.parameters, "camera_name": "", "rig_file": rig}).start()
    camera.until(lambda: camera.masks)
    assert camera.masks[0].header.frame_id == f"{name}_optical"


@pytest.mark.parametrize("simulated", [False, True], ids=["", "simulated time stands still"])
def test_end_of_footage_is_said_and_the_next_activation_plays_again(bench, session, scene, simulated):
    camera = bench(**session.parameters, use_sim_time=simulated).start()
    camera.until(lambda: len(camera.masks) == FRAMES)
    camera.until_said(f"end of footage after {FRAMES} frames")
    assert camera.node.trigger_deactivate() == SUCCESS
    camera.masks.clear()
    assert camera.node.trigger_activate() == SUCCESS
    camera.until(lambda: len(camera.masks) == FRAMES)
    assert camera.stamps_ns()[0] == footage_stamp_ns(EPOCH_NS, FRAMES, scene.fps)


def test_footage_waits_for_the_other_cameras_of_its_rig(bench, session):
    camera = bench(**{**session.parameters, "footage.wait_for_cameras": True}).start()
    camera.until_said("waiting for a consumer")
    assert camera.masks == []
    camera.peer.create_publisher(TimeReference, "/footage/clock", LATCHED)  # of two cameras the other one
    camera.until(lambda: len(camera.masks) == FRAMES)


def test_camera_that_starts_late_plays_by_the_clock_of_the_others_and_tells_it(bench, session, scene):
    late_s, epoch_ns = 4.0, EPOCH_NS + 7
    playing = {"footage.rate": 1.0, "footage.loop": True, "footage.epoch_ns": 0}
    camera = bench(**{**session.parameters, **playing})
    told = camera.listen(TimeReference, "/footage/clock", LATCHED)
    others = camera.peer.create_publisher(TimeReference, "/footage/clock", LATCHED)
    clock = TimeReference(time_ref=to_stamp(epoch_ns), source="cam02")
    clock.header.stamp = to_stamp(time.time_ns() - round(late_s * 1e9))
    others.publish(clock)
    stranger = camera.peer.create_publisher(TimeReference, "/footage/clock", LATCHED)
    stranger.publish(TimeReference())  # of no clock at all
    camera.start()
    camera.until(lambda: any(to_ns(mask.header.stamp) < epoch_ns + 10**12 for mask in camera.masks))
    stamps = [stamp for stamp in camera.stamps_ns() if stamp < epoch_ns + 10**12]  # before it heard, by its own clock
    frames = [round((stamp - epoch_ns) * 1e-9 * scene.fps) for stamp in stamps]
    assert stamps == [footage_stamp_ns(epoch_ns, frame, scene.fps) for frame in frames]
    assert frames[0] >= (late_s - 0.25) * scene.fps
    camera.until(lambda: any(message.source == "cam01" and message.time_ref == clock.time_ref for message in told))
    assert [message.header.stamp for message in told if message.time_ref == clock.time_ref][-1] == clock.header.stamp


def test_acknowledgements_let_frames_leave_and_suspension_holds_them(bench, session, scene):
    camera = bench(window=2, **session.parameters)
    camera.acknowledging = False
    camera.start()
    camera.until(lambda: len(camera.masks) == 2 and camera.answers.get_subscription_count() == 1)
    for k in range(5):
        camera.acknowledge(footage_stamp_ns(EPOCH_NS, k, scene.fps))
        camera.until(lambda wanted=k + 3: len(camera.masks) == wanted)
    assert camera.node.trigger_deactivate() == SUCCESS
    assert camera.node.trigger_activate() == SUCCESS
    camera.until(lambda: len(camera.masks) == 9)  # a new window of two
    assert camera.stamps_ns() == [footage_stamp_ns(EPOCH_NS, k, scene.fps) for k in range(9)]
    assert camera.values()["pace_timeouts"] == "0"


def test_camera_keeps_the_exposures_that_the_hull_server_tells_it(bench, session, scene, monkeypatch):
    monkeypatch.setattr("camera_client.sources.footage_source.KEPT_UP_NS", 10**18)  # a busy machine loses none
    camera = bench(**{**session.parameters, "footage.rate": 1.0})
    told = camera.peer.create_publisher(DiagnosticArray, "/hull/thinning", LATCHED)
    assert camera.node.trigger_configure() == SUCCESS
    stamps = [footage_stamp_ns(EPOCH_NS, k, scene.fps) for k in range(FRAMES)]
    told.publish(thinning_message(FrameDecimation(stamps[10], stamps[10], stamps[0], 1e9 / scene.fps, 2, 3)))
    camera.until(lambda: camera.node.selector.newest.of == 3)
    assert camera.node.trigger_activate() == SUCCESS
    camera.until_said(f"end of footage after {FRAMES} frames")
    assert camera.stamps_ns() == stamps[:10] + [stamps[k] for k in range(10, FRAMES) if 2 * k % 3 < 2]
    assert camera.values()["frames_thinned"] == str(FRAMES - len(camera.masks))


def test_background_is_learned_live_saved_used_and_taken_again_at_the_next_start(bench, session, scene):
    parameters = {**session.parameters, "background_frames": 20, "footage.rate": 1.0, "footage.loop": True}
    parameters["footage.path"] = scene.write_video(session.folder / "empty.avi", scene.empty(25, seed=3))
    parameters["background_file"] = str(session.folder / "learned.npz")
    parameters["background"] = ""
    camera = bench(**parameters)
    camera.listen(Image, "background/mean", LATCHED)
    camera.start()
    camera.until_said("call ~/learn_background")
    assert camera.masks == []
    answer = camera.ask_to_learn()
    assert answer.success, answer.message
    assert "20 frames" in answer.message and "noise 1.5" in answer.message and "0.00 %" in answer.message
    camera.until(lambda: camera.masks and camera.heard["background/mean"])
    saved = load_background(parameters["background_file"])
    assert saved.provenance.frames == 20 and "empty.avi" in saved.provenance.source
    mean = np.frombuffer(camera.heard["background/mean"][-1].data, np.uint8)
    assert np.array_equal(mean.reshape(scene.height, scene.width), np.rint(saved.mean).astype(np.uint8))
    camera.until_said("the mask is empty")
    assert int(camera.values()["empty_masks"]) > 0
    assert camera.node.trigger_deactivate() == SUCCESS and camera.node.trigger_cleanup() == SUCCESS
    camera.masks.clear()
    camera.start()
    camera.until(lambda: camera.masks)
    assert camera.node.processor.background.provenance.frames == 20


def test_learning_is_answered_without_frames_and_when_the_camera_is_suspended_and_cleaned_up(bench, session):
    camera = bench(**{**session.parameters, "background_frames": 1000, "footage.rate": 1.0, "footage.loop": True})
    assert camera.node.trigger_configure() == SUCCESS
    answer = camera.ask_to_learn()
    assert not answer.success and "activate the camera first" in answer.message
    assert camera.node.trigger_activate() == SUCCESS
    camera.until(lambda: camera.masks)

    def stop():
        assert camera.node.trigger_deactivate() == SUCCESS
        assert camera.node.trigger_cleanup() == SUCCESS

    answer = camera.ask_to_learn(meanwhile=stop)
    assert not answer.success and "the camera was suspended after" in answer.message


def test_frame_of_another_size_is_dropped_and_counted(bench, session, scene):
    folder = session.folder / "stills"
    folder.mkdir()
    for k, image in enumerate(session.images[:6]):
        cv2.imwrite(str(folder / f"f{k}.png"), image[:100] if k == 2 else image)
    (folder / "f4.png").write_bytes(b"broken")
    camera = bench(**{**session.parameters, "footage.path": str(folder), "footage.fps": 50.0}).start()
    camera.until(lambda: len(camera.masks) == 4)
    assert camera.stamps_ns() == [footage_stamp_ns(EPOCH_NS, k, 50.0) for k in (0, 1, 3, 5)]
    values = camera.values()
    assert [int(values[key]) for key in ("expected", "delivered", "incomplete", "lost")] == [6, 5, 1, 0]
    assert (values["bad_frames"], values["undecodable"], values["incomplete"]) == ("1", "1", "1")


def test_raw_images_are_published_on_request_and_previews_to_who_subscribes(bench, session, scene):
    camera = bench(**{**session.parameters, "publish_raw": True})
    camera.listen(Image, "image_raw", SILHOUETTE_RELIABLE_SUBSCRIBER)
    camera.listen(CompressedImage, "preview/compressed", RESULT)
    camera.start()
    camera.until(lambda: len(camera.heard["image_raw"]) == FRAMES and camera.heard["preview/compressed"])
    raw = camera.heard["image_raw"][0]
    assert np.array_equal(np.frombuffer(raw.data, np.uint8).reshape(scene.height, scene.width), session.images[0])
    preview = cv2.imdecode(np.frombuffer(camera.heard["preview/compressed"][0].data, np.uint8), cv2.IMREAD_COLOR)
    assert preview.shape == (scene.height // 2, scene.width // 2, 3)
    green = (preview[..., 1] > 150) & (preview[..., 0] < 100)
    assert 30 < green.sum() < 400


@pytest.mark.parametrize(
    "changed, text",
    [
        ({"camera_name": "cam9"}, "rig.yaml: there is no camera 'cam9' in the rig. Known cameras: cam01, cam02."),
        ({"background": "/nowhere/bg.npz"}, "/nowhere/bg.npz: cannot be read"),
        (
            {"background": "/nowhere/bg.npz", "source": "aravis", "aravis.address": ABSENT},
            "/nowhere/bg.npz: cannot be read",
        ),
        ({"footage.path": ""}, "parameter footage.path: is empty"),
        ({"footage.path": "{folder}/small.avi"}, "of 160 x 100 pixels, camera cam01 was calibrated at 160 x 120"),
        ({"footage.raet": 1.0}, "unknown key 'footage.raet'. Did you mean 'footage.rate'?"),
        ({"camera_info_file": "{folder}/other.yaml"}, "camera_name = 'cam02' is not this camera, 'cam01'"),
        ({"camera_info_file": "{folder}/other.yaml", "rig_file": ""}, "camera_name = 'cam02' is not this camera"),
    ],
)
def test_configure_fails_with_a_clear_error(bench, session, scene, changed, text):
    if changed.get("source") == "aravis":
        pytest.importorskip("gi", reason="PyGObject is not installed: apt install python3-gi gir1.2-aravis-0.8")
    save_camera_info(session.folder / "other.yaml", scene.camera("cam02"))
    scene.write_video(session.folder / "small.avi", [image[:100] for image in session.images[:2]])
    filled = {key: v.format(folder=session.folder) if isinstance(v, str) else v for key, v in changed.items()}
    camera = bench(**{**session.parameters, **filled})
    assert camera.node.trigger_configure() == FAILURE
    camera.until_said(text)
    assert camera.node.source is None


def test_set_camera_info_is_used_from_the_next_frame_on_and_saved(bench, session, scene):
    path = session.folder / "info.yaml"
    camera = bench(2, **{**session.parameters, "camera_info_file": str(path)})
    camera.acknowledging = False
    camera.start()
    camera.until(lambda: len(camera.heard["camera_info"]) == 2)
    wanted = scene.calibrated()
    answer = set_camera_info(camera, camera_info_message(wanted, 0, "cam01_optical"))
    assert answer.success and f"saved to {path}" in answer.status_message
    camera.acknowledging = True
    camera.acknowledge(camera.stamps_ns()[-1])
    camera.until(lambda: len(camera.heard["camera_info"]) > 2 and len(camera.masks) == len(camera.heard["camera_info"]))
    before, after = camera.heard["camera_info"][1], camera.heard["camera_info"][2]
    canvas = wanted.undistorted_view().camera
    assert before.k[0] == pytest.approx(150.0) and after.k[0] == pytest.approx(170.0) and not any(after.d)
    assert decode_silhouette(camera.masks[2], canvas.width, canvas.height, "test").any()
    saved = load_camera_info(path, scene.camera())
    assert np.array_equal(saved.K, wanted.K) and np.array_equal(saved.D, wanted.D)
    assert camera.node.trigger_deactivate() == SUCCESS and camera.node.trigger_cleanup() == SUCCESS
    assert camera.node.trigger_configure() == SUCCESS  # what was saved replaces the rig's
    assert np.array_equal(camera.node.processor.camera.K, wanted.K)


def test_set_camera_info_that_does_not_fit_changes_nothing(bench, session, scene):
    camera = bench(**{**session.parameters, "camera_info_file": str(session.folder / "info.yaml")})
    fits = camera_info_message(scene.calibrated(), 0, "cam01_optical")
    answer = set_camera_info(camera, fits)
    assert not answer.success and "not configured" in answer.status_message
    camera.start()
    wide, endless = copy.deepcopy(fits), copy.deepcopy(fits)
    wide.width, endless.k[0] = 640, 1e300
    for info, text in (
        (wide, "is for images of 640 x 120 pixels"),
        (endless, "has focal lengths of 1e+300 and"),
        (CameraInfo(width=fits.width, height=fits.height), "camera_matrix"),
    ):
        answer = set_camera_info(camera, info)
        assert not answer.success and text in answer.status_message
    assert not (session.folder / "info.yaml").exists()
    camera.until(lambda: len(camera.heard["camera_info"]) == FRAMES)
    assert {message.k[0] for message in camera.heard["camera_info"]} == {150.0}


def test_what_the_others_do_not_see_becomes_background(bench, session, scene):
    """Frames of a thing, a fifth of a second apart; the peer answers each with a report of the same stamp."""
    thing = np.zeros((scene.height, scene.width), np.uint8)
    thing[24:64, 24:56] = 255
    images = [scene.with_person(image, thing) for image in scene.empty(30, seed=5)]
    path = scene.write_video(session.folder / "thing.avi", images)
    camera = bench(1, **session.parameters | {"footage.path": path, "footage.fps": 5.0})
    reports = camera.peer.create_publisher(Image, "silhouette/support", RESULT)
    canvas = scene.camera().undistorted_view().camera
    camera.acknowledging = False
    camera.start()
    camera.until(lambda: reports.get_subscription_count() == 1 == camera.answers.get_subscription_count())
    for count in range(1, 31):
        camera.until(lambda count=count: len(camera.masks) == count)
        stamp_ns = camera.stamps_ns()[-1]
        cells = np.full((canvas.height // 8, canvas.width // 8), NOBODY, np.uint8)
        reports.publish(support_message(ForegroundSupport(stamp_ns, "cam01", 8, cells)))
        camera.acknowledge(stamp_ns)
    first, last = (decode_silhouette(camera.masks[k], canvas.width, canvas.height, "test") for k in (0, -1))
    assert (first[thing > 0] > 0).mean() > 0.9 and not last.any()


@pytest.mark.parametrize(("details", "hardware"), [({"camera_serial": "S7"}, "S7"), ({}, socket.gethostname())])
def test_diagnostics_name_the_camera_by_its_serial_number(bench, session, monkeypatch, details, hardware):
    monkeypatch.setattr(FootageSource, "details", property(lambda source: details))
    camera = bench(**session.parameters)
    assert camera.node.trigger_configure() == SUCCESS
    camera.until(lambda: camera.diagnostics and camera.diagnostics[-1].status[0].hardware_id == hardware)
    assert camera.values()["host"] == socket.gethostname()
