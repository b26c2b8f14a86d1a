"""Track with your own silhouettes: any function from an image to a mask takes the place of the camera clients'.

    python examples/02_own_silhouettes.py my_session > hands.csv

Prints where both hands are in each frame, in metres: z up, the origin on the floor.
"""

import sys

import cv2
import numpy as np

from capture_rig.session import load_session
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from mocap_pipeline.session_footage import frame_sets, images_of
from stick_figure.skeleton import POINT_NAMES


def person_mask(image: np.ndarray, empty: np.ndarray) -> np.ndarray:
    """Your segmentation: an image (H, W[, 3]) in, 255 where somebody is and 0 elsewhere out.

    Here: what differs from the empty room, which is right where nobody throws a shadow.
    """
    difference = np.atleast_3d(cv2.absdiff(image, empty)).max(axis=2)
    changed = cv2.GaussianBlur(difference, (5, 5), 0) > 12
    return cv2.morphologyEx(np.uint8(255) * changed, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))


session = load_session(sys.argv[1])
empty = next(images_of(session.backgrounds))  # of every camera
lenses = {camera.name: camera.undistorted_view() for camera in session.rig.cameras}
pipeline = MocapPipeline(session.rig, Configuration.of({}))
hands = [POINT_NAMES.index("left_hand"), POINT_NAMES.index("right_hand")]
print("frame,left_x,left_y,left_z,right_x,right_y,right_z")
for frame, (stamp_ns, images) in enumerate(frame_sets(session)):
    masks = {name: person_mask(image, empty[name]) for name, image in images.items()}
    step = pipeline.step_masks(stamp_ns, {name: lenses[name].undistort_mask(mask) for name, mask in masks.items()})
    if step.state is not None:
        print(frame, *step.state.points_world[hands].ravel().round(3), sep=",")
