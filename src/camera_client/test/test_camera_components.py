"""Which parts of a raw mask are kept."""

import cv2
import numpy as np
import pytest

from camera_client.components import keep_person, majority
from camera_client.settings import SilhouetteSettings


def blank():
    return np.zeros((240, 320), np.uint8)


def keep(mask, min_area_px=20, near_px=20, max_hole_px=30):
    return keep_person(mask, min_area_px, near_px, max_hole_px)


def test_limb_cut_from_the_trunk_survives():
    mask = blank()
    mask[40:120, 100:140] = 255  # trunk
    mask[135:200, 105:117] = 255  # legs, 15 px below: dark shorts on a dark floor
    mask[135:200, 123:135] = 255
    assert np.array_equal(keep(mask), mask)


def test_chain_of_pieces_survives_link_by_link():
    mask = blank()
    for x in (50, 80, 110, 140):  # each 18 px from the next, the last far from the largest
        mask[100:112, x : x + 12] = 255
    mask[90:130, 10:40] = 255
    assert np.array_equal(keep(mask), mask)


def test_piece_far_from_everything_is_dropped():
    mask = blank()
    mask[40:120, 100:140] = 255
    expected = mask.copy()
    mask[40:60, 161:190] = 255  # 21 px off
    assert np.array_equal(keep(mask), expected)


def test_noise_speck_is_dropped_even_beside_the_person():
    mask = blank()
    mask[40:120, 100:140] = 255
    expected = mask.copy()
    mask[60:64, 145:149] = 255  # 16 px of area
    assert np.array_equal(keep(mask), expected)


def test_smallest_kept_component_has_exactly_the_minimal_area():
    mask = blank()
    mask[10:14, 10:15] = 255
    assert keep(mask, min_area_px=20).any()
    assert not keep(mask, min_area_px=21).any()


def test_small_hole_is_filled_and_large_one_kept():
    mask = blank()
    mask[40:200, 100:180] = 255
    mask[60:65, 110:116] = 0  # 30 px
    mask[150:190, 130:150] = 0  # between the legs
    kept = keep(mask, max_hole_px=31)
    assert kept[62, 113] == 255
    assert np.array_equal(kept[150:190, 130:150], mask[150:190, 130:150])
    assert not keep(mask, max_hole_px=30)[60:65, 110:116].any()


def test_hole_of_a_dropped_component_stays_empty():
    mask = blank()
    mask[40:120, 10:60] = 255
    mask[40:70, 200:230] = 255
    mask[50:55, 210:215] = 0
    assert not keep(mask)[:, 190:].any()


def test_empty_mask_stays_empty():
    assert not keep(blank()).any()


def person():
    """Head, trunk, an arm held out with its hand, two legs with feet, as a camera 3 m away would see them."""
    mask = blank()
    cv2.circle(mask, (120, 30), 12, 255, -1)
    mask[42:120, 100:140] = 255
    mask[50:60, 140:200] = 255
    mask[120:215, 102:115] = mask[120:215, 125:138] = 255
    mask[215:222, 92:115] = mask[215:222, 125:148] = 255
    return mask


LIMBS = {
    "hand cut off by a thin strip in the background's colour": (slice(48, 62), slice(182, 187)),
    "head separated by a bright collar": (slice(40, 49), slice(95, 145)),
    "forearm hidden behind a pole": (slice(48, 62), slice(155, 170)),
    "foot beyond the shadow that was taken off the shin": (slice(188, 214), slice(95, 145)),
    "legs below shorts as dark as the floor": (slice(115, 142), slice(95, 145)),
}


@pytest.mark.parametrize("cut", LIMBS.values(), ids=LIMBS)
def test_limb_survives_that_is_cut_off_as(cut):
    mask = person()
    mask[cut] = 0
    settings = SilhouetteSettings()
    area = mask.shape[0] ** 2
    kept = keep_person(mask, settings.min_area * area, settings.near * mask.shape[0], settings.max_hole * area)
    assert cv2.connectedComponents(mask)[0] > 2  # it is cut off
    assert np.array_equal(kept, mask)


@pytest.mark.parametrize("side", [1, 3, 5, 7])
def test_majority_equals_the_median_of_a_mask(side):
    rng = np.random.default_rng(side)
    mask = np.where(rng.random((97, 131)) < 0.45, np.uint8(255), np.uint8(0))
    assert np.array_equal(majority(mask, side), mask if side == 1 else cv2.medianBlur(mask, side))
