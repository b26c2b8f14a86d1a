"""What bench/avatar_body.py is made of: joints of any maker by name, and segments that a skeleton lacks."""

import avatar_body
import numpy as np
import pytest
from mesh_body import NAMES


@pytest.mark.parametrize(
    ("name", "plain", "side"),
    [
        ("mixamorig:LeftForeArm", "forearm", "L"),
        ("RightUpLeg", "upleg", "R"),
        ("Bip01 L UpperArm", "upperarm", "L"),
        ("Bip01 Pelvis", "pelvis", ""),
        ("J_Bip_R_LowerLeg", "lowerleg", "R"),
        ("J_Bip_C_Head", "head", ""),
        ("UpperLeg.R", "upperleg", "R"),
        ("Hips", "hips", ""),
    ],
)
def test_joint_is_known_by_its_name_whoever_made_it(name: str, plain: str, side: str) -> None:
    assert avatar_body._plain_name(name) == (plain, side)


def test_segments_that_a_spine_lacks_lie_evenly_between_those_that_it_has() -> None:
    limbs = {name: np.zeros(3) for name in NAMES if name[-2:] in (".L", ".R")}
    up = np.array([0.0, 0.0, 1.0])
    heads = avatar_body._heads(limbs | {"spine05": 0.9 * up, "spine01": 1.3 * up, "neck01": 1.5 * up, "head": 1.6 * up})
    heights = [heads[NAMES.index(name)][2] for name in ("spine05", "spine04", "spine03", "spine02", "spine01")]
    assert heights == pytest.approx([0.9, 1.0, 1.1, 1.2, 1.3])
    assert heads[NAMES.index("neck02")][2] == pytest.approx(1.55)
