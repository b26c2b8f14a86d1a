"""ASF and AMC files of known geometry; the oracle chains rotation vectors by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from virtual_studio.motion_files.acclaim import read_amc, read_asf

ASF = """# a comment
:version 1.10
:name VICON
:units
  mass 1.0
  length 0.45
  angle deg
:documentation
   two bones and a stump
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name upper
     direction 0.6 -0.8 0
     length 2.0
     axis 10 -20 30  XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
     id 2
     name lower
     direction 0 -1 0
     length 3.0
     axis 0 0 40  ZYX
    dof rz
    limits (-10.0 170.0)
  end
  begin
     id 3
     name stump
     direction 1 0 0
     length 0.5
     axis 0 0 0  XYZ
  end
:hierarchy
  begin
    root upper
    upper lower stump
  end
"""
AMC = """#!OML:ASF somewhere
:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 0 0
upper 0 0 0
lower 0
2
root 1.5 2 3 5 -10 15
upper 20 -30 40
lower 50
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "07.asf").write_text(ASF)
    (tmp_path / "07_01.amc").write_text(AMC)
    return tmp_path


def about(*vector_deg: float) -> np.ndarray:
    """A rotation matrix from a rotation vector."""
    return Rotation.from_rotvec(np.radians(vector_deg)).as_matrix()


def fixed_xyz(x: float, y: float, z: float) -> np.ndarray:
    """About the fixed x axis first, then y, then z."""
    return about(0, 0, z) @ about(0, y, 0) @ about(x, 0, 0)


def test_bones_of_the_rest_pose_follow_their_directions(folder: Path) -> None:
    motion = read_amc(folder / "07_01.amc", 120.0)
    assert motion.fps == 120.0
    assert motion.names == ("root", "upper", "lower", "stump")
    np.testing.assert_allclose(
        motion.positions[0], [[1, 2, 3], [2.2, 0.4, 3], [2.2, -2.6, 3], [2.7, 0.4, 3]], atol=1e-12
    )


def test_moved_bones_lie_where_matrices_put_them(folder: Path) -> None:
    moved = read_amc(folder / "07_01.amc", 120.0).positions[1]
    root = fixed_xyz(5, -10, 15)
    C = fixed_xyz(10, -20, 30)
    upper = root @ C @ fixed_xyz(20, -30, 40) @ C.T
    C = about(40, 0, 0)  # "0 0 40 ZYX": 40 degrees belong to x, the last letter
    lower = upper @ C @ about(0, 0, 50) @ C.T
    elbow = np.array([1.5, 2, 3]) + upper @ [1.2, -1.6, 0]
    np.testing.assert_allclose(moved[1], elbow, atol=1e-12)
    np.testing.assert_allclose(moved[2], elbow + lower @ [0, -3.0, 0], atol=1e-12)
    np.testing.assert_allclose(moved[3], elbow + upper @ [0.5, 0, 0], atol=1e-12)


def test_a_motion_in_radians_equals_the_same_in_degrees(folder: Path) -> None:
    frame = "1\nroot 0 0 0 {} 0 0\nupper 0 {} 0\nlower {}\n"
    (folder / "07_02.amc").write_text(":DEGREES\n" + frame.format(30, 45, 90))
    (folder / "07_03.amc").write_text(":RADIANS\n" + frame.format(np.pi / 6, np.pi / 4, np.pi / 2))
    degrees, radians = (read_amc(folder / f"07_0{k}.amc", 120.0).positions for k in (2, 3))
    np.testing.assert_allclose(radians, degrees, atol=1e-12)


def test_the_skeleton_beside_the_motion_is_found_or_asked_for(folder: Path) -> None:
    (folder / "08.asf").write_text(ASF)
    assert read_amc(folder / "07_01.amc", 60.0).names[1] == "upper"
    (folder / "walk.amc").write_text(AMC)
    with pytest.raises(InputError, match="2 ASF files"):
        read_amc(folder / "walk.amc", 60.0)
    assert read_amc(folder / "walk.amc", 60.0, folder / "08.asf").fps == 60.0


def test_an_amc_without_a_rate_is_refused_and_says_what_to_give(folder: Path) -> None:
    with pytest.raises(InputError, match="120 frames a second"):
        read_amc(folder / "07_01.amc", None)


def test_the_length_unit_of_a_skeleton_is_kept(folder: Path) -> None:
    assert read_asf(folder / "07.asf").unit_length == 0.45


@pytest.mark.parametrize(
    ("old", "new", "line", "word"),
    [
        ("direction 0.6", "direction much", 19, "much"),
        ("direction 0 -1 0", "direction 0 0 0", 30, "zero"),
        ("ZYX", "ZYZ", 32, "ZYZ"),
        ("dof rz", "dof rw", 33, "rw"),
        ("dof rz", "dof rz rz", 33, "rz"),
        ("length 2.0", "length", 20, "no value"),
        ("upper lower stump", "upper lower", 36, "stump"),
        ("upper lower stump", "upper lower stumps", 46, "stumps"),
        ("root upper", "root upper lower", 46, "two parents"),
        ("name lower", "name upper", 35, "upper"),
        ("# a comment", "stray", 1, "stray"),
    ],
)
def test_a_damaged_asf_is_refused_with_file_line_and_word(
    folder: Path, old: str, new: str, line: int, word: str
) -> None:
    path = folder / "07.asf"
    assert old in ASF
    path.write_text(ASF.replace(old, new, 1))
    with pytest.raises(InputError, match=word) as caught:
        read_asf(path)
    assert caught.value.where == f"{path}, line {line}"


@pytest.mark.parametrize(
    ("old", "new", "line", "word"),
    [
        ("lower 50", "lower", 11, "0 numbers and 1"),
        ("lower 50", "lower 50 60", 11, "2 numbers and 1"),
        ("lower 50", "lower fifty", 11, "fifty"),
        ("lower 50", "tail 50", 11, "tail"),
        ("lower 50", "upper 1 2 3", 11, "twice"),
        ("lower 50\n", "", 10, "no numbers for 'lower'"),
        ("lower 0\n", "", 7, "no numbers for 'lower'"),
        ("1\nroot 1 2 3", "root 1 2 3", 4, "before the first frame"),
    ],
)
def test_a_damaged_amc_is_refused_with_file_line_and_word(
    folder: Path, old: str, new: str, line: int, word: str
) -> None:
    path = folder / "07_01.amc"
    assert old in AMC
    path.write_text(AMC.replace(old, new, 1))
    with pytest.raises(InputError, match=word) as caught:
        read_amc(path, 120.0)
    assert caught.value.where == f"{path}, line {line}"


def test_a_skeleton_without_bones_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.asf").write_text(":version 1.1\n:root\n order TX\n")
    with pytest.raises(InputError, match=":bonedata"):
        read_asf(tmp_path / "a.asf")
