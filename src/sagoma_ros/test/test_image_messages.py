"""Silhouettes, previews, images and camera_info as messages."""

from __future__ import annotations

import array
import struct
import zlib

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CompressedImage

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.mask_levels import BACKGROUND, FOREGROUND, SHADOW_CANDIDATE
from mocap_packets.silhouette import LEVELS as SUPPORT_LEVELS
from mocap_packets.silhouette import ForegroundSupport
from sagoma_ros.images import (
    camera_info_message,
    decode_silhouette,
    image_message,
    preview_message,
    read_support,
    silhouette_message,
    support_message,
)
from sagoma_ros.messages import to_ns

STAMP = 1_700_000_000_123_456_789
TOPIC = "cam01/silhouette/compressed"
WIDTH, HEIGHT = 160, 120


def body_mask() -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.ellipse(mask, (80, 60), (20, 45), 10, 0, 360, 255, -1)
    return mask


def encoded(image: np.ndarray, suffix: str = ".png") -> CompressedImage:
    ok, data = cv2.imencode(suffix, image)
    assert ok
    return CompressedImage(format="png", data=array.array("B", data.tobytes()))


def refusal(message: CompressedImage) -> str:
    with pytest.raises(InputError) as caught:
        decode_silhouette(message, WIDTH, HEIGHT, TOPIC)
    assert str(caught.value).startswith(f"{TOPIC}: ")
    assert caught.value.remedy
    return str(caught.value)


def test_silhouette_comes_back_pixel_for_pixel() -> None:
    message = silhouette_message(body_mask(), STAMP, "cam01_optical")
    assert (to_ns(message.header.stamp), message.header.frame_id) == (STAMP, "cam01_optical")
    assert np.array_equal(decode_silhouette(message, WIDTH, HEIGHT, TOPIC), body_mask())


def test_empty_and_full_silhouettes_come_back() -> None:
    for value in (0, 255):
        mask = np.full((HEIGHT, WIDTH), value, np.uint8)
        assert np.array_equal(decode_silhouette(silhouette_message(mask, 0, ""), WIDTH, HEIGHT, TOPIC), mask)


def test_silhouette_is_a_png_of_one_bit_a_pixel_and_a_few_kilobytes() -> None:
    large = cv2.resize(body_mask(), (640, 480), interpolation=cv2.INTER_NEAREST)
    data = bytes(silhouette_message(large, 0, "").data)
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert (data[24], data[25]) == (1, 0)  # PNG header: bit depth 1, colour type grey
    assert len(data) < 4096


def test_mask_of_another_program_is_foreground_wherever_it_is_neither_zero_nor_a_candidate() -> None:
    grey = np.arange(HEIGHT * WIDTH, dtype=np.uint64).reshape(HEIGHT, WIDTH).astype(np.uint8)
    expected = np.where((grey == 0) | (grey == SHADOW_CANDIDATE), 0, 255)
    assert np.array_equal(decode_silhouette(encoded(grey), WIDTH, HEIGHT, TOPIC), expected)


@pytest.mark.parametrize("level", [BACKGROUND, SHADOW_CANDIDATE, FOREGROUND])
def test_shadow_candidates_come_back_as_the_reader_wants_them(level: int) -> None:
    mask = body_mask()
    mask[90:, 60:140] = SHADOW_CANDIDATE
    message = silhouette_message(mask, STAMP, "cam01_optical")
    shown = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)  # two bits: 0, 85, 170, 255
    assert np.array_equal(shown, np.where(mask == SHADOW_CANDIDATE, 85, mask))
    read = decode_silhouette(message, WIDTH, HEIGHT, TOPIC, candidates=level)
    assert np.array_equal(read, np.where(mask == SHADOW_CANDIDATE, level, mask))
    without = np.where(mask == SHADOW_CANDIDATE, 0, mask)
    assert np.array_equal(decode_silhouette(message, WIDTH, HEIGHT, TOPIC), without)


def test_silhouette_with_candidates_takes_a_few_kilobytes() -> None:
    large = cv2.resize(body_mask(), (640, 480), interpolation=cv2.INTER_NEAREST)
    cv2.ellipse(large, (420, 400), (150, 40), 20, 0, 360, SHADOW_CANDIDATE, -1)
    assert len(bytes(silhouette_message(large, 0, "").data)) < 5000


def test_silhouette_of_another_size_names_both_sizes() -> None:
    text = refusal(silhouette_message(np.zeros((HEIGHT, WIDTH - 1), np.uint8), 0, ""))
    assert "159 x 120 pixels" in text and "canvas 160 x 120" in text
    huge = silhouette_message(body_mask(), 0, "")  # that says it has 2^31 columns
    huge.data[16:20] = array.array("B", b"\x80\0\0\0")
    huge.data[29:33] = array.array("B", struct.pack(">I", zlib.crc32(bytes(huge.data[12:29]))))
    assert "2147483648 x 120" in refusal(huge)
    assert "same rig file" in text


def test_jpeg_instead_of_png_is_refused_by_its_format() -> None:
    message = preview_message(body_mask(), 0, "")
    text = refusal(message)
    assert "format 'jpeg' is not a PNG silhouette" in text


@pytest.mark.parametrize("image", [np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.zeros((HEIGHT, WIDTH), np.uint16)])
def test_png_of_another_encoding_is_refused(image: np.ndarray) -> None:
    assert "is not mono8" in refusal(encoded(image))


@pytest.mark.parametrize("data", [b"", b"not a picture", b"\x89PNG\r\n\x1a\n"])
def test_bytes_that_are_no_picture_are_refused(data: bytes) -> None:
    assert "PNG" in refusal(CompressedImage(format="png", data=array.array("B", data)))


def test_truncated_png_is_refused_and_not_shown_in_part() -> None:
    message = silhouette_message(body_mask(), 0, "")
    message.data = message.data[: len(message.data) // 2]
    assert "cannot be decoded" in refusal(message)


def test_damaged_png_is_refused() -> None:
    message = silhouette_message(body_mask(), 0, "")
    message.data[len(message.data) // 2] ^= 0xFF
    assert "cannot be decoded" in refusal(message)


def test_preview_is_a_jpeg_of_the_image() -> None:
    image = np.full((HEIGHT, WIDTH, 3), (30, 90, 200), np.uint8)
    message = preview_message(image, STAMP, "cam01_optical")
    assert message.format == "jpeg"
    decoded = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(decoded.astype(int) - image).max() < 6


@pytest.mark.parametrize(("shape", "encoding", "step"), [((4, 6), "mono8", 6), ((4, 6, 3), "bgr8", 18)])
def test_image_message_holds_the_pixels_row_by_row(shape: tuple[int, ...], encoding: str, step: int) -> None:
    image = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    message = image_message(image, STAMP, "cam01_optical")
    assert (message.height, message.width, message.encoding, message.step) == (4, 6, encoding, step)
    assert np.array_equal(np.frombuffer(message.data, np.uint8).reshape(shape), image)


def test_image_view_is_sent_as_it_looks_and_not_as_it_lies_in_memory() -> None:
    image = np.random.default_rng(2).integers(0, 256, (8, 12), dtype=np.uint8)[::2, ::3]
    assert np.array_equal(np.frombuffer(image_message(image, 0, "").data, np.uint8).reshape(4, 4), image)


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


def support_report() -> ForegroundSupport:
    cells = np.random.default_rng(0).choice(np.array(SUPPORT_LEVELS, np.uint8), (15, 20))
    return ForegroundSupport(STAMP, "cam01", 8, cells)


def test_report_of_support_comes_back_with_the_size_of_its_cells() -> None:
    message = support_message(support_report())
    assert (to_ns(message.header.stamp), message.header.frame_id) == (STAMP, "cam01_optical")
    back = read_support(message, "cam01", WIDTH, TOPIC)
    assert (back.stamp_ns, back.camera, back.cell_px) == (STAMP, "cam01", 8)
    assert np.array_equal(back.cells, support_report().cells)


@pytest.mark.parametrize(
    "cells, width", [(np.full((15, 20), 85, np.uint8), 170), (np.full((15, 20), 7, np.uint8), 160)]
)
def test_report_for_another_canvas_or_with_unknown_levels_is_refused(cells: np.ndarray, width: int) -> None:
    with pytest.raises(InputError, match=TOPIC):
        read_support(image_message(cells, STAMP, "cam01_optical"), "cam01", width, TOPIC)
