"""Masks as PNG: round trips, other programs, former versions' files, damage."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import CompressedImage

from capture_rig.mask_levels import BACKGROUND, CANDIDATE_LEVELS, FOREGROUND, LEVELS, SHADOW_CANDIDATE
from sagoma_ros import mask_png
from sagoma_ros.images import decode_silhouette
from sagoma_ros.run_deflate import deflate, inflate, match_lengths, most_bytes, run_code

mask_png.warm_up()

KINDS = {1: [BACKGROUND, FOREGROUND], 2: [BACKGROUND, SHADOW_CANDIDATE, FOREGROUND], 4: list(LEVELS)}


def person(depth: int, height: int = 480, width: int = 640) -> np.ndarray:
    """Return a body with a shadow (2 bits), and attenuated patches in it (4 bits)."""
    mask, unit = np.zeros((height, width), np.uint8), height / 120
    if depth > 1:
        cv2.ellipse(mask, (int(0.6 * width), int(0.8 * height)), (int(35 * unit), int(9 * unit)), 20, 0, 360, 127, -1)
    cv2.ellipse(mask, (width // 2, height // 2), (int(20 * unit), int(45 * unit)), 10, 0, 360, 255, -1)
    if depth == 4:
        patches = np.random.default_rng(0).choice(np.array(LEVELS[5:], np.uint8), (height // 8 + 1, width // 8))
        mask[mask == 255] = np.kron(patches, np.ones((8, 8), np.uint8))[:height][mask == 255]
        mask[0, :2] = LEVELS[1], LEVELS[-2]
    return mask


def chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def with_body(data: bytes, body: bytes) -> bytes:
    """Return a PNG with another stream, its checksum right, so that the stream itself is read."""
    return data[:33] + chunk(b"IDAT", body) + data[-12:]


def with_size(data: bytes, width: int, height: int) -> bytes:
    return data[:8] + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)) + data[33:]


def written_by_zlib(mask: np.ndarray, depth: int) -> bytes:
    """Return the PNG that former versions wrote: the same rows, deflated by zlib's run-length strategy."""
    ours = mask_png.encode(mask)
    assert ours[24] == depth
    packer = zlib.compressobj(2, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    return with_body(ours, packer.compress(zlib.decompress(ours[41:-16])) + packer.flush())


@given(st.integers(2, 90), st.integers(1, 30), st.integers(0, 2**32), st.sampled_from(list(KINDS)), st.booleans())
def test_masks_of_any_width_come_back_and_other_programs_see_them(width, height, seed, depth, sparse) -> None:
    """All over, and of a small patch alone, as masks mostly are."""
    rng = np.random.default_rng(seed)
    mask = rng.choice(np.array(KINDS[depth], np.uint8), (height, width))
    if sparse:
        top, left = rng.integers(height), rng.integers(width)
        patch = mask[top : top + rng.integers(1, 9), left : left + rng.integers(1, 20)].copy()
        mask[:] = BACKGROUND
        mask[top : top + len(patch), left : left + patch.shape[1]] = patch
    mask[0, :2] = KINDS[depth][1], KINDS[depth][-2]
    data = mask_png.encode(mask)
    assert data[24] == depth  # bits a pixel
    assert np.array_equal(mask_png.decode(data, SHADOW_CANDIDATE), mask)
    for candidates in (BACKGROUND, FOREGROUND):
        expected = np.where(np.isin(mask, CANDIDATE_LEVELS), candidates, np.where(mask > SHADOW_CANDIDATE, 255, 0))
        assert np.array_equal(mask_png.decode(data, candidates), expected)
    shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    sixteen_greys = 17 * np.searchsorted(LEVELS, mask)  # in the order of their darkness
    assert np.array_equal(shown, sixteen_greys if depth == 4 else np.where(mask == SHADOW_CANDIDATE, 85, mask))


@pytest.mark.parametrize("depth", KINDS)
@pytest.mark.parametrize("width", [1, 7, 13, 640])
def test_files_of_former_versions_and_blank_and_full_masks_are_read(depth: int, width: int) -> None:
    mask = np.random.default_rng(width).choice(np.array(KINDS[depth], np.uint8), (5, width))
    mask[0, 0] = {1: FOREGROUND, 2: SHADOW_CANDIDATE, 4: LEVELS[1]}[depth]
    former = CompressedImage(data=written_by_zlib(mask, depth))
    for candidates in (BACKGROUND, FOREGROUND, SHADOW_CANDIDATE):
        read = decode_silhouette(former, width, 5, "test", candidates)
        assert np.array_equal(read, mask_png.decode(mask_png.encode(mask), candidates))
    for level in (BACKGROUND, KINDS[depth][1], FOREGROUND):
        even = np.full((5, width), level, np.uint8)
        assert np.array_equal(mask_png.decode(mask_png.encode(even), SHADOW_CANDIDATE), even)


def test_mask_that_lies_anywhere_in_memory_is_sent_as_it_looks() -> None:
    buffer = np.random.default_rng(0).choice(np.array(LEVELS, np.uint8), (50, 90))
    for view in (buffer[3:40, 5:77], buffer[::2, ::3], buffer.T, buffer.reshape(-1)[3:1603].reshape(20, 80)):
        view.flags.writeable = False
        assert np.array_equal(mask_png.decode(mask_png.encode(view), SHADOW_CANDIDATE), view)


@pytest.mark.parametrize("depth", KINDS)
def test_runs_of_all_lengths_come_back_and_the_bound_of_the_length_holds(depth: int) -> None:
    rng, code = np.random.default_rng(depth), run_code(depth)
    runs = 700
    value = np.cumsum(rng.integers(1, 256, runs)).astype(np.uint8)  # no two neighbours alike
    for count in (np.arange(1, runs + 1), np.ones(runs, int), np.full(runs, 258 + 2), np.full(runs, 259 + 257)):
        out = np.empty(most_bytes(code, int(count.sum()), runs), np.uint8)
        stream = out[: deflate(value, count, code, out)]
        assert zlib.decompress(stream.tobytes()) == np.repeat(value, count).tobytes()
        read, times = np.empty(len(stream), np.uint8), np.empty(len(stream), np.int64)
        assert inflate(stream, code, *match_lengths(), read, times) == runs
        assert np.array_equal(read[:runs], value) and np.array_equal(times[:runs], count)


# --- damage


@pytest.mark.parametrize("depth", KINDS)
def test_damaged_streams_are_refused_or_of_the_right_size_and_nothing_is_written_beyond_them(depth: int) -> None:
    rng, data = np.random.default_rng(depth), mask_png.encode(person(depth, 60, 80))
    body = np.frombuffer(data[41:-16], np.uint8)
    code, guard = run_code(depth), 64
    refused = 0
    for _ in range(3000):
        damaged = body.copy()
        for _ in range(rng.integers(1, 4)):
            damaged[rng.integers(len(damaged))] = rng.integers(256)
        stream = damaged[: rng.integers(len(damaged)) if rng.random() < 0.3 else len(damaged)]
        value, count = np.full(len(stream) + guard, 77, np.uint8), np.full(len(stream) + guard, -7)
        runs = inflate(stream, code, *match_lengths(), value[: len(stream)], count[: len(stream)])
        assert runs <= len(stream) and (value[len(stream) :] == 77).all() and (count[len(stream) :] == -7).all()
        mask = mask_png.decode(with_body(data, stream.tobytes()))
        assert mask is None or mask.shape == (60, 80)
        refused += mask is None
    assert refused > 2500  # the rest: what hit nothing, or was put back


@pytest.mark.parametrize("depth", KINDS)
def test_rows_too_many_too_few_or_with_a_filter_are_refused_by_the_painter(depth: int) -> None:
    cells_of_byte = mask_png._cells(depth, SHADOW_CANDIDATE)
    buffer = np.full((6, 5), 9, cells_of_byte.dtype)
    cells = buffer[1:5]  # a row before and one behind it, which stay
    for value, count in (
        ([0], [24 + 1]),
        ([0], [24 - 1]),
        ([0, 1], [6, 1]),
        ([255], [24]),
        ([0, 255], [1, 10**9]),
        ([0], [1 << 60]),
    ):
        assert not mask_png.paint_runs(np.array(value, np.uint8), np.array(count), cells_of_byte, cells)
    assert (buffer[[0, 5]] == 9).all()
    assert mask_png.paint_runs(np.array([0, 255, 0], np.uint8), np.array([19, 1, 4]), cells_of_byte, cells)
    assert np.argwhere(cells).tolist() == [[3, 0]] and cells[3, 0] == cells_of_byte[255]


def test_bomb_and_absurd_size_are_refused_without_taking_memory() -> None:
    data = mask_png.encode(person(1, 60, 80))
    assert mask_png.decode(with_size(data, 80, 60)) is not None
    assert mask_png.decode(with_body(data, zlib.compress(bytes(50_000_000), 9))) is None
    for size in ((1 << 31, 1 << 31), (0, 5), (5, 0)):
        assert mask_png.decode(with_size(data, *size)) is None
