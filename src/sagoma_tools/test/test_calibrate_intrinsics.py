"""``sagoma calibrate intrinsics`` on stills and live, and what it says when it cannot."""

import json
from itertools import count

import cv2
import numpy as np
import pytest
import yaml
from calibration_room import at_the_origin, before, picture, write_pictures
from footage_clips import write_clip
from sensor_msgs.msg import CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo

from capture_rig.camera_info_file import read_camera_info
from capture_rig.errors import InputError
from rig_calibration.boards.board import Checkerboard
from rig_calibration.intrinsics.selection import ViewCollector
from sagoma_ros.images import decode_image, image_message
from sagoma_ros.qos import RESULT
from sagoma_tools.calibration.live_lens import plain_line
from sagoma_tools.cli import main
from sagoma_tools.graph.ros_link import RosLink

CAMERA = at_the_origin("cam01")
BOARD, BOARD_TEXT = Checkerboard(9, 6, (0.1, 0.1)), "checkerboard 9x6 100mm"
STATIONS = [  # place of the board's middle in the picture (of its width and height), lean about its x and y, distance m
    (0.5, 0.5, 35, 0, 1.28),
    (0.5, 0.5, -35, 0, 1.28),
    (0.5, 0.5, 0, 35, 1.28),
    (0.5, 0.5, 0, -35, 1.28),
    (0.25, 0.27, 25, 25, 1.7),
    (0.75, 0.27, 25, -25, 1.7),
    (0.25, 0.73, -25, 25, 1.7),
    (0.75, 0.73, -25, -25, 1.7),
    (0.5, 0.5, 0, 0, 1.2),
    (0.2, 0.5, 20, 30, 2.0),
    (0.8, 0.5, -20, -30, 2.0),
    (0.5, 0.25, 40, 10, 2.2),
    (0.5, 0.75, -40, -10, 2.2),
    (0.35, 0.4, 30, -30, 2.4),
]


@pytest.fixture(scope="module")
def shown():
    return [picture(CAMERA, BOARD, before(CAMERA, BOARD, *station), seed) for seed, station in enumerate(STATIONS)]


@pytest.fixture(scope="module")
def stills(shown, tmp_path_factory):
    return write_pictures(tmp_path_factory.mktemp("footage"), {"cam01": shown})


def calibrated(capsys, *arguments):
    """Exit status, figures, what was printed."""
    status = main(["calibrate", "intrinsics", *map(str, arguments), "--json"])
    printed = capsys.readouterr()
    return status, json.loads(printed.out.splitlines()[-1]), printed.err


@pytest.mark.parametrize("kind", ["stills", "film"])
def test_footage_gives_the_lens_and_files_that_read_back(kind, stills, shown, tmp_path, capsys):
    footage, output = stills, tmp_path / "lens"
    if kind == "film":
        footage = write_clip(tmp_path / "cam01.AVI", [image for image in shown for _ in range(2)], 25.0, "XVID")
    status, figures, _ = calibrated(capsys, footage, "--board", BOARD_TEXT, "--output", output)
    (camera,) = figures["cameras"]
    assert status == 0 and camera["camera"] == "cam01" and camera["views"] >= 12
    read = read_camera_info(output / "cam01.yaml")
    assert read.name == "cam01" and read.K[0, 0] == pytest.approx(camera["values"]["fx"], abs=1e-5)
    assert np.abs(read.K.diagonal()[:2] / CAMERA.K.diagonal()[:2] - 1).max() < 2e-3
    assert np.abs(read.K[:2, 2] - CAMERA.K[:2, 2]).max() < 1.0
    report = yaml.safe_load((output / "cam01.report.yaml").read_text())
    assert report["verdict"] == camera["verdict"] and report["board"] == BOARD_TEXT
    assert cv2.imread(str(output / "cam01.png")).shape[0] > 500


@pytest.mark.slow
def test_camera_that_cannot_be_calibrated_is_named_and_changes_no_byte_of_another_s_lens(shown, tmp_path, capsys):
    write_pictures(tmp_path / "in", {"cam01": shown[:5]})
    calibrated(capsys, tmp_path / "in", "--board", BOARD_TEXT, "--output", tmp_path / "alone")
    write_pictures(tmp_path / "in", {"cam02": [cv2.GaussianBlur(image, (0, 0), 9.0) for image in shown[:2]]})
    status, figures, err = calibrated(capsys, tmp_path / "in", "--board", BOARD_TEXT, "--output", tmp_path / "out")
    assert status == 1 and [camera["camera"] for camera in figures["cameras"]] == ["cam01"]
    assert "cam02: 0 of 2 images show the board usably" in err
    assert not (tmp_path / "out/cam02.yaml").exists()
    assert (tmp_path / "out/cam01.yaml").read_bytes() == (tmp_path / "alone/cam01.yaml").read_bytes()


def test_another_board_than_the_one_that_was_filmed_is_named(shown, tmp_path, capsys):
    write_pictures(tmp_path, {"cam01": shown[:1]})
    assert main(["calibrate", "intrinsics", f"cam01={tmp_path / 'cam01.png'}", "--board", "checkerboard 7x4 25mm"]) == 2
    said = capsys.readouterr().err
    assert "cam01: 0 of 1 images show the board usably" in said and "9 x 6" in said


# --- live


class Camera:
    """A camera's image topic, its set_camera_info service, and somebody who looks at the preview."""

    def __init__(self, link, images):
        self._images, self.given, self.previews = images, [], []
        self._publisher = link.node.create_publisher(Image, "/cam01/image_raw", RESULT)
        link.node.create_service(SetCameraInfo, "/cam01/set_camera_info", self._set)
        link.node.create_subscription(CompressedImage, "/cam01/calibration/preview/compressed", self.previews.append, 5)
        self._number = count()
        link.node.create_timer(0.05, self._publish)

    def _publish(self):
        """Every picture stays for a while, as a board that is held still."""
        number = next(self._number)
        image = self._images[number // 4 % len(self._images)]
        self._publisher.publish(image_message(image, 1_000_000 * number, "cam01_optical"))

    def _set(self, request, response):
        self.given.append(request.camera_info)
        response.success, response.status_message = True, "in use"
        return response


def test_live_camera_is_calibrated_and_given_the_result(shown, tmp_path, capsys):
    with RosLink("fake_camera") as link:
        camera = Camera(link, shown)
        status, figures, said = calibrated(
            capsys, "--topic", "/cam01/image_raw", "--board", BOARD_TEXT, "--output", tmp_path, "--views", "8", "--set"
        )
    (found,) = figures["cameras"]
    assert status == 0, said
    assert found["camera"] == "cam01" and found["views"] == 8
    assert found["values"]["fx"] == pytest.approx(CAMERA.K[0, 0], rel=0.01)
    assert camera.given[0].k[0] == pytest.approx(found["values"]["fx"], abs=1e-5)
    assert "the camera client took it: in use" in said
    preview = cv2.imdecode(np.frombuffer(camera.previews[-1].data, np.uint8), cv2.IMREAD_COLOR)
    assert preview.shape == (480, 640, 3) and np.ptp(preview.astype(int), axis=2).max() > 60  # drawn in colour
    assert read_camera_info(tmp_path / "cam01.yaml").K[0, 0] == pytest.approx(found["values"]["fx"], abs=1e-5)


def test_topic_without_images_is_named_with_those_there_are(shown, tmp_path, capsys):
    with RosLink("fake_camera") as link:
        Camera(link, shown)
        arguments = ["--topic", "/cam02/image_raw", "--board", BOARD_TEXT, "--output", str(tmp_path), "--wait", "2"]
        assert main(["calibrate", "intrinsics", *arguments]) == 2
    said = capsys.readouterr().err
    assert "/cam02/image_raw: no image came for 2 s" in said and "/cam01/image_raw" in said


def test_line_shows_progress_advice_and_the_last_reason(shown):
    collector = ViewCollector(BOARD, "cam01")
    collector.process(shown[0], 0)
    detection, reason = collector.process(shown[0], 1)
    assert detection is not None and reason
    advice = collector.advice()
    line = plain_line(collector, reason)
    assert line.startswith("cam01: 1 views; image ") and "tilt" in line
    assert advice in line and line.endswith(f"(last image: {reason})")


COLOURS = np.random.default_rng(0).integers(0, 255, (8, 12, 3), np.uint8)  # BGR
GREY = COLOURS[:, :, 0]


def image(encoding, pixels):
    """A message of 12 x 8 pixels, whose rows may be longer."""
    data = np.ascontiguousarray(pixels).tobytes()
    return Image(height=8, width=12, encoding=encoding, step=len(data) // 8, data=data)


@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("bgr8", COLOURS, COLOURS),
        ("rgb8", COLOURS[:, :, ::-1], COLOURS),
        ("bgra8", np.dstack([COLOURS, np.full((8, 12), 255, np.uint8)]), COLOURS),
        ("mono8", np.pad(GREY, ((0, 0), (0, 4))), GREY),  # padded rows
        ("mono16", GREY.astype("<u2") * 16, GREY * (255.0 / GREY.max())),
    ],
)
def test_encodings_are_read_as_bgr_or_grey(encoding, pixels, expected):
    tolerance = 1.0 if encoding == "mono16" else 0.0
    assert np.abs(decode_image(image(encoding, pixels), "/t").astype(float) - expected).max() <= tolerance


def test_red_pixels_of_a_bayer_sensor_stay_red():
    mosaic = np.zeros((8, 12), np.uint8)
    mosaic[::2, ::2] = 200  # RGGB: red at even rows and columns
    colours = decode_image(image("bayer_rggb8", mosaic), "/t")
    assert colours[3:5, 3:5, 2].min() > 90 and colours[:, :, 0].max() == 0


@pytest.mark.parametrize(
    "message, said",
    [
        (Image(height=2, width=2, encoding="theora", step=2, data=bytes(4)), "/t: encoding 'theora' is not known"),
        (Image(height=9, width=2, encoding="mono8", step=2, data=bytes(4)), "2 x 9 with step 2 does not have 4 bytes"),
        (CompressedImage(format="jpeg", data=b"nothing"), "cannot be decoded"),
    ],
)
def test_images_that_are_none_are_refused(message, said):
    with pytest.raises(InputError, match=said):
        decode_image(message, "/t")
