"""The outlined picture."""

import numpy as np
import pytest

from camera_client.preview import CANDIDATE_BGR, PERSON_BGR, outline


@pytest.mark.parametrize("shape", [(120, 160), (120, 160, 3)])
def test_person_and_shadow_candidates_are_outlined_in_two_colours(shape):
    mask = np.zeros((120, 160), np.uint8)
    mask[20:100, 60:100] = 255
    mask[80:100, 100:140] = 127
    shown = outline(np.full(shape, 128, np.uint8), mask)
    assert shown.shape == (60, 80, 3) and shown.dtype == np.uint8
    assert tuple(shown[25, 30]) == PERSON_BGR  # left side of the person
    assert tuple(shown[45, 69]) == CANDIDATE_BGR  # right side of the shadow
    assert (shown[30, 40] == 128).all() and (shown[45, 60] == 128).all() and (shown[5, 5] == 128).all()


def test_image_given_is_not_drawn_into():
    image, mask = np.full((40, 40, 3), 128, np.uint8), np.full((40, 40), 255, np.uint8)
    outline(image, mask)
    assert (image == 128).all()
