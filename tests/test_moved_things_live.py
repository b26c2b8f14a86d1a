"""A thing that was moved since the background was learned: the page, fed with footage, and the graph agree about it."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage

from camera_client.background.model import read_background
from capture_rig.mask_levels import SHADOW_CANDIDATE
from capture_rig.session import load_session
from capture_rig.video import Video
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from mocap_pipeline.session_footage import images_of
from sagoma_ros.images import decode_silhouette
from sagoma_tools.evaluation.live_inputs import FootageInput
from sagoma_tools.evaluation.live_run import LiveRun, run_live
from sagoma_tools.recording.reader import frame_tolerance_ns, read_frame_sets
from stick_figure.body import Body
from virtual_studio.recording.session import RenderSettings, write_session
from virtual_studio.rig import ring

FPS, SECONDS = 10.0, 8.0
CAMERA, PLACE = "cam02", (slice(80, 150), slice(500, 560))  # away from the person, where all others look


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> LiveRun:
    """A live run on a session in which somebody has put a thing into one camera's picture, as fast as it goes."""
    folder = tmp_path_factory.mktemp("moved")
    body, settings = Body.from_stature(1.75), RenderSettings(seed=7)
    session = write_session(folder / "session", ring(4, True), body, fps=FPS, seconds=SECONDS, settings=settings)
    _put_thing(session / f"{CAMERA}.mp4")
    return run_live(FootageInput(session), folder / "live")


def _put_thing(path: Path) -> None:
    """Write the video anew, lossless, with a thing of changing noise in it."""
    rng, writer = np.random.default_rng(0), None
    with Video(path) as video:
        while (image := video.read()) is not None:
            if writer is None:
                size, code = image.shape[1::-1], cv2.VideoWriter_fourcc(*"FFV1")
                writer = cv2.VideoWriter(str(path.with_suffix(".avi")), cv2.CAP_FFMPEG, code, FPS, size)
            shape = image[PLACE].shape[:2]
            image[PLACE] = np.rint(200 + rng.normal(size=(*shape, 1))).astype(np.uint8)
            writer.write(image)
    writer.release()
    path.unlink()


@pytest.mark.slow
def test_page_and_graph_absorb_the_same_thing_at_the_same_frame(live):
    session = load_session(live.session.folder)
    canvases = {camera.name: camera.undistorted_view().camera for camera in session.rig.cameras}
    configuration, pipeline, foreground = Configuration.of({}), None, []
    for frame_set, images in zip(
        read_frame_sets(live.bag, frame_tolerance_ns(live.bag)), images_of(session.videos), strict=True
    ):
        if pipeline is None:
            settings = configuration.camera.background_model
            backgrounds = {n: read_background(session.backgrounds[n], i.shape, settings) for n, i in images.items()}
            pipeline = MocapPipeline(session.rig, configuration, backgrounds)
        masks = pipeline.segment(frame_set.stamp_ns, images)
        pipeline.carve(frame_set.stamp_ns, masks)
        for camera, messages in frame_set.frames.items():
            sent = next(m for m in messages if m.topic.endswith("/silhouette/compressed"))
            message, canvas = deserialize_message(sent.data, CompressedImage), canvases[camera]
            mask = decode_silhouette(message, canvas.width, canvas.height, sent.topic, candidates=SHADOW_CANDIDATE)
            np.testing.assert_array_equal(mask, masks[camera], err_msg=f"{camera} at {frame_set.stamp_ns}")
        foreground.append(pipeline.cameras[CAMERA].moved.share)
    assert foreground[0] == 0.0 < foreground[-1] < 0.1
