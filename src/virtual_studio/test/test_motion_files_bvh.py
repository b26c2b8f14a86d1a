"""BVH files of known geometry; the oracle multiplies homogeneous matrices by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture_rig.errors import InputError
from virtual_studio.motions.bvh import read_bvh

ARM = """HIERARCHY
ROOT Hips
{{
\tOFFSET 1.0 2.0 3.0
\tCHANNELS 6 Xposition Yposition Zposition {root}
\tJOINT Arm
\t{{
\t\tOFFSET 0 10 0
\t\tCHANNELS 3 {arm}
\t\tEnd Site
\t\t{{
\t\t\tOFFSET 5 0 2
\t\t}}
\t}}
}}
MOTION
Frames: {frames}
Frame Time: {period}
{rows}
"""
ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")


def channels(order: str) -> str:
    return " ".join(f"{axis}rotation" for axis in order)


def arm(
    path: Path,
    root: str = "ZXY",
    arm: str = "ZXY",
    rows: str = "0 0 0 0 0 0 0 0 0",
    frames: int = 1,
    period: str = "0.025",
) -> Path:
    path.write_text(ARM.format(root=channels(root), arm=channels(arm), frames=frames, period=period, rows=rows))
    return path


def turn(axis: str, degrees: float) -> np.ndarray:
    """A homogeneous matrix, from the definition of a rotation about one axis."""
    i = "XYZ".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    T = np.eye(4)
    T[j, j], T[j, k], T[k, j], T[k, k] = c, -s, s, c
    return T


def shift(*offset: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = offset
    return T


@pytest.mark.parametrize("order", ORDERS)
def test_joints_of_a_bvh_lie_where_matrices_put_them_for_every_order_of_rotation(tmp_path: Path, order: str) -> None:
    values = np.array([0.5, -1.0, 2.0, 20.0, -35.0, 50.0, 15.0, 70.0, -40.0])
    joints, _ = read_bvh(arm(tmp_path / "a.bvh", order, order[::-1], " ".join(f"{v:g}" for v in values)))
    T = shift(*values[:3])
    for axis, degrees in zip(order, values[3:6], strict=True):
        T = T @ turn(axis, degrees)
    np.testing.assert_allclose(joints["Hips"][0], T[:3, 3], atol=1e-12)
    T = T @ shift(0, 10, 0)
    np.testing.assert_allclose(joints["Arm"][0], T[:3, 3], atol=1e-12)
    for axis, degrees in zip(order[::-1], values[6:], strict=True):
        T = T @ turn(axis, degrees)
    np.testing.assert_allclose(joints["Arm_end"][0], (T @ shift(5, 0, 2))[:3, 3], atol=1e-12)


def test_rate_and_frames_follow_the_header_and_positions_without_a_channel_the_offset(tmp_path: Path) -> None:
    rows = "1 0 0 0 0 0 0 0 0\n2 0 0 0 0 0 0 0 0\n"
    joints, fps = read_bvh(arm(tmp_path / "a.bvh", rows=rows, frames=2, period="0.0083333"))
    assert fps == pytest.approx(120.0, rel=1e-4)
    np.testing.assert_allclose(joints["Hips"][:, 0], [1.0, 2.0])
    text = "HIERARCHY\nROOT a b {\nOFFSET 1 2 3\nCHANNELS 1 yposition\nEnd Site { OFFSET 0 1 0 }\n}\n"
    (tmp_path / "b.bvh").write_text(text + "MOTION\nFrames: 1\nFrame Time: 0.1\n7\n")
    joints, _ = read_bvh(tmp_path / "b.bvh")
    np.testing.assert_allclose(joints["a b"][0], [1, 7, 3])
    np.testing.assert_allclose(joints["a b_end"][0], [1, 8, 3])


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("HIERARCHY", "HIERARCH", "HIERARCHY"),
        ("OFFSET 0 10 0", "OFFSET 0 ten 0", "ten"),
        ("OFFSET 0 10 0", "OFFSET 0 nan 0", "nan is no number"),
        ("OFFSET 0 10 0", "", "no OFFSET"),
        ("CHANNELS 3 Z", "CHANNELS 3 W", "CHANNELS 3"),
        ("CHANNELS 3", "CHANNELS three", "three"),
        ("JOINT Arm", "JOINT Hips", "two joints"),
        ("JOINT Arm", "JOIN Arm", "JOIN"),
        ("Frames: 1", "Frames: 2", "9 numbers where 2 frames of 9 channels"),
        ("Frames: 1", "Frames: some", "some"),
        ("Time: 0.025", "Time: 0", "frame time"),
        ("0 0 0 0 0 0 0 0 0", "0 0 0 0 0 0 0 0 x", "'x'"),
        ("0 0 0 0 0 0 0 0 0", "", "0 numbers"),
    ],
)
def test_a_damaged_bvh_is_refused_with_file_and_word(tmp_path: Path, old: str, new: str, word: str) -> None:
    path = arm(tmp_path / "broken.bvh")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=word) as caught:
        read_bvh(path)
    assert caught.value.where == str(path)
