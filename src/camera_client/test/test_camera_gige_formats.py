"""Pixel formats against the formulas of the standards."""

import numpy as np
import pytest

from camera_client.gige.pixel_formats import (
    can_be_halved,
    choose_format,
    find_format,
    image_shape,
    standard_name,
    to_image,
)
from gige_vision.gvsp import PixelFormat


@pytest.mark.parametrize("name, bits", [("Mono10", 10), ("Mono12", 12)])
def test_deep_mono_keeps_the_upper_eight_bits(name, bits):
    values = np.random.default_rng(5).integers(0, 1 << bits, (5, 7))
    image = to_image(values.astype("<u2").tobytes(), name, 7, 5)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, values >> (bits - 8))


@pytest.mark.parametrize("name, order", [("YUV422_8", "yuyv"), ("YUV422_8_UYVY", "uyvy"), ("YUV422Packed", "uyvy")])
def test_yuv_gives_the_colours_of_bt_601_at_full_range(name, order):
    rng = np.random.default_rng(3)
    y = rng.uniform(80, 170, (6, 8))
    u, v = (np.repeat(rng.uniform(100, 156, (6, 4)), 2, axis=1) for _ in range(2))
    y, u, v = (np.rint(plane).astype(np.uint8) for plane in (y, u, v))
    chroma = np.where(np.arange(8) % 2 == 0, u, v)
    pair = (y, chroma) if order == "yuyv" else (chroma, y)
    data = np.stack(pair, axis=2).tobytes()
    y, u, v = (plane.astype(float) for plane in (y, u, v))
    red, blue = y + 1.402 * (v - 128), y + 1.772 * (u - 128)
    green = (y - 0.299 * red - 0.114 * blue) / 0.587
    expected = np.stack([blue, green, red], axis=2).clip(0, 255)
    assert np.abs(to_image(data, name, 8, 6) - expected).max() <= 1.5


@pytest.mark.parametrize("name, pixel", [("BGR8", [10, 20, 30]), ("RGB8", [30, 20, 10]), ("RGB8Packed", [30, 20, 10])])
def test_three_bytes_a_pixel_come_out_in_bgr(name, pixel):
    image = to_image(bytes([10, 20, 30] * 12), name, 4, 3)
    assert image.shape == image_shape(name, 4, 3) and image[0, 0].tolist() == pixel


@pytest.mark.parametrize(
    "name, red_at", [("BayerRG8", (0, 0)), ("BayerGR8", (0, 1)), ("BayerGB8", (1, 0)), ("BayerBG8", (1, 1))]
)
def test_bayer_finds_red_where_the_name_says(name, red_at):
    raw = np.zeros((8, 8), np.uint8)
    raw[red_at[0] :: 2, red_at[1] :: 2] = 200
    blue, green, red = to_image(raw.tobytes(), name, 8, 8)[3:5, 3:5].reshape(-1, 3).mean(axis=0)
    assert red > 190 and blue < 10 and green < 10


@pytest.mark.parametrize("name", ["BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8"])
def test_tiles_of_a_mosaic_are_pixels_of_half_the_size(name):
    rng = np.random.default_rng(7)
    colours = rng.integers(0, 256, (3, 4, 3))  # of each tile, BGR
    greens = colours[..., 1] + rng.integers(-9, 10, (3, 4))
    raw = np.zeros((6, 8), np.uint8)
    tiles = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}[name[5:7]]
    green = iter((colours[..., 1], np.clip(greens, 0, 255)))
    planes = {"R": colours[..., 2], "B": colours[..., 0]}
    for place, colour in enumerate(tiles):
        raw[place // 2 :: 2, place % 2 :: 2] = next(green) if colour == "G" else planes[colour]
    image = to_image(raw.tobytes(), name, 8, 6, halved=True)
    assert image.shape == image_shape(name, 8, 6, halved=True) == (3, 4, 3)
    np.testing.assert_array_equal(image[..., ::2], colours[..., ::2])
    mean = (colours[..., 1] + np.clip(greens, 0, 255)) / 2
    assert np.abs(image[..., 1] - mean).max() <= 0.5
    assert can_be_halved(name, 8, 6) and not can_be_halved(name, 7, 6) and not can_be_halved("BGR8", 8, 6)


@pytest.mark.parametrize("name", PixelFormat.__members__)
def test_image_has_memory_of_its_own_and_more_bytes_do_no_harm_and_too_few_are_no_image(name):
    data = np.full(PixelFormat[standard_name(name)].image_bytes(8, 4) + 100, 100, np.uint8)
    image = to_image(data, name, 8, 4)
    before = image.copy()
    data[:] = 0
    np.testing.assert_array_equal(image, before)
    assert image.shape == image_shape(name, 8, 4) and image.flags.c_contiguous
    with pytest.raises(ValueError, match="too few"):
        to_image(bytes(PixelFormat[standard_name(name)].image_bytes(8, 4) - 1), name, 8, 4)


def test_choice_follows_the_channels_wanted_and_the_fewest_bytes():
    offered = ["Mono8", "Mono12", "BayerGB8", "RGB8Packed"]
    assert choose_format(offered, "auto") == "BayerGB8"
    assert choose_format(offered, "mono") == "Mono8"
    assert choose_format(["RGB8Packed", "Mono12"], "colour") == "RGB8Packed"
    assert choose_format(["RGB8Packed", "Mono12"], "mono") == "Mono12"
    assert choose_format(["Mono8"], "colour") is None
    assert choose_format(["Coord3D_C16"], "auto") is None
    assert find_format("RGB8", offered) == "RGB8Packed" and find_format("BGR8", offered) is None
