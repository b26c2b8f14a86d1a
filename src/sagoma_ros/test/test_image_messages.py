"""Silhouettes, images, camera_info, stamps and the rule of thinning as messages."""

from __future__ import annotations

import array
import struct
import zlib

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CompressedImage

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.mask_levels import BACKGROUND, FOREGROUND, SHADOW_CANDIDATE
from mocap_packets.thinning import EVERY_FRAME, FrameDecimation
from sagoma_ros.images import (
    camera_info_message,
    decode_silhouette,
    image_message,
    preview_message,
    read_support,
    silhouette_message,
)
from sagoma_ros.messages import read_thinning, thinning_message, to_ns

STAMP = 1_700_000_000_123_456_789
TOPIC = "cam01/silhouette/compressed"
WIDTH, HEIGHT = 160, 120


def body_mask() -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.ellipse(mask, (80, 60), (20, 45), 10, 0, 360, 255, -1)
    return mask


def encoded(image: np.ndarray) -> CompressedImage:
    return png(cv2.imencode(".png", image)[1].tobytes())


def png(data: bytes) -> CompressedImage:
    return CompressedImage(format="png", data=array.array("B", data))


@pytest.mark.parametrize("level", [BACKGROUND, SHADOW_CANDIDATE, FOREGROUND])
def test_silhouette_comes_back_with_shadow_candidates_as_the_reader_wants_them(level: int) -> None:
    mask = body_mask()
    mask[90:, 60:140] = SHADOW_CANDIDATE
    read = decode_silhouette(silhouette_message(mask, STAMP, ""), WIDTH, HEIGHT, TOPIC, candidates=level)
    assert np.array_equal(read, np.where(mask == SHADOW_CANDIDATE, level, mask))


def test_mask_of_another_program_is_foreground_wherever_it_is_neither_zero_nor_a_candidate() -> None:
    grey = np.arange(HEIGHT * WIDTH, dtype=np.uint64).reshape(HEIGHT, WIDTH).astype(np.uint8)
    expected = np.where((grey == 0) | (grey == SHADOW_CANDIDATE), 0, 255)
    assert np.array_equal(decode_silhouette(encoded(grey), WIDTH, HEIGHT, TOPIC), expected)


BODY = bytes(silhouette_message(body_mask(), 0, "").data)
WIDE = BODY[:16] + b"\x80\0\0\0" + BODY[20:29]  # a header that says 2^31 columns
WIDE += struct.pack(">I", zlib.crc32(WIDE[12:])) + BODY[33:]


@pytest.mark.parametrize(
    ("message", "said"),
    [
        pytest.param(
            silhouette_message(np.zeros((HEIGHT, WIDTH - 1), np.uint8), 0, ""),
            r"159 x 120 pixels, .* canvas 160 x 120\. .*same rig file",
            id="another size",
        ),
        pytest.param(png(WIDE), "2147483648 x 120", id="huge size"),
        pytest.param(preview_message(body_mask(), 0, ""), "format 'jpeg' is not a PNG silhouette", id="jpeg"),
        pytest.param(encoded(np.zeros((HEIGHT, WIDTH, 3), np.uint8)), "is not mono8", id="colour"),
        pytest.param(png(b""), "is not a PNG", id="empty"),
        pytest.param(png(BODY[: len(BODY) // 2]), "the PNG cannot be decoded", id="truncated"),
    ],
)
def test_message_that_is_no_silhouette_is_refused_with_topic_cause_and_remedy(message, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        decode_silhouette(message, WIDTH, HEIGHT, TOPIC)
    assert str(caught.value).startswith(f"{TOPIC}: ") and caught.value.remedy


@pytest.mark.parametrize(("shape", "encoding", "step"), [((4, 6), "mono8", 6), ((4, 6, 3), "bgr8", 18)])
def test_image_message_holds_the_pixels_as_they_look_and_not_as_they_lie_in_memory(
    shape: tuple[int, ...], encoding: str, step: int
) -> None:
    image = np.random.default_rng(1).integers(0, 256, (8, 18, *shape[2:]), dtype=np.uint8)[::2, ::3]
    message = image_message(image, STAMP, "cam01_optical")
    assert (message.height, message.width, message.encoding, message.step) == (4, 6, encoding, step)
    assert np.array_equal(np.frombuffer(message.data, np.uint8).reshape(shape), image)


def test_camera_info_of_an_undistorted_canvas_has_no_distortion_and_P_equal_to_K() -> None:
    K = np.array([[470.0, 0, 316], [0, 468, 244], [0, 0, 1]])
    camera = CameraModel("cam01", 640, 480, K, "plumb_bob", np.array([-0.19, 0.08, 0, 0, 0]), np.eye(4))
    canvas = camera.undistorted_view().camera
    info = camera_info_message(canvas, STAMP, "cam01_optical")
    assert (info.width, info.height, info.distortion_model) == (canvas.width, canvas.height, "plumb_bob")
    assert info.width > 640 and info.width % 32 == 0
    assert list(info.d) == [0] * 5
    assert np.array_equal(np.reshape(info.k, (3, 3)), canvas.K)
    assert np.array_equal(np.reshape(info.r, (3, 3)), np.eye(3))
    assert np.array_equal(np.reshape(info.p, (3, 4)), np.column_stack([canvas.K, np.zeros(3)]))
    assert (to_ns(info.header.stamp), info.header.frame_id) == (STAMP, "cam01_optical")


@pytest.mark.parametrize(("level", "width"), [(85, 170), (7, 160)], ids=["another canvas", "unknown level"])
def test_report_that_does_not_fit_is_refused(level: int, width: int) -> None:
    cells = np.full((15, 20), level, np.uint8)
    with pytest.raises(InputError, match=TOPIC):
        read_support(image_message(cells, STAMP, "cam01_optical"), "cam01", width, TOPIC)


# --- thinning ---------------------------------------------------------------------------------------------------------

RULE = FrameDecimation(
    1_790_000_000_123_456_789, 1_790_000_000_200_000_000, 1_789_999_999_000_000_001, 16_666_666.667, 9, 20
)


@pytest.mark.parametrize(
    ("rule", "level", "said"),
    [(RULE, DiagnosticStatus.WARN, "thinned to 9 of 20"), (EVERY_FRAME, DiagnosticStatus.OK, "every frame")],
)
def test_rule_of_thinning_survives_the_message_which_warns_while_it_thins_and_says_why(
    rule: FrameDecimation, level: bytes, said: str
) -> None:
    message = thinning_message(rule, said if rule is RULE else "")
    assert read_thinning(message, "test") == rule
    assert (message.status[0].level, message.status[0].message) == (level, said)


@pytest.mark.parametrize(
    ("key", "value"), [("keep", "0"), ("keep", "21"), ("of", "x"), ("period_ns", "0"), ("phase_ns", None), (None, None)]
)
def test_message_without_a_usable_rule_of_thinning_is_refused(key: str | None, value: str | None) -> None:
    message = DiagnosticArray() if key is None else thinning_message(RULE)
    for status in message.status:
        status.values = [pair for pair in status.values if pair.key != key or value is not None]
        for pair in status.values:
            pair.value = value if pair.key == key else pair.value
    with pytest.raises(InputError, match="test"):
        read_thinning(message, "test")
