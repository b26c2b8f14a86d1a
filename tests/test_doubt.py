"""A limb that the cameras do not show is doubtful and its ellipsoid holds it; limbs in full view are not doubted."""

from typing import NamedTuple

import numpy as np

from capture_rig.session import footage_stamp_ns
from mocap_packets.fit import PART_NAMES, PART_POINTS
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline, TrackingStage
from mocap_pipeline.session_footage import EPOCH_NS
from sagoma_tools.evaluation.scores import INSIDE_95, PartCalls, nees_of
from sagoma_tools.evaluation.track import Track
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

LEFT_ARM = PART_NAMES.index("left arm")
ELBOW, HAND, NECK, ON_CHEST_M = 7, 11, 2, 0.35
FPS, STATURE_M = 20.0, 1.75
SECONDS = 4.2  # T-pose, the way to the chest, and most of the two seconds there
HIDDEN_FROM, WITHIN_M = 34, 0.12  # the frame; of the forearm's line
KNOWN_AFTER_S = 0.2  # what is gone in a set or two is no loss
CONFIGURATION = Configuration.of({"hull_server.backend": "cpu"})


class Scene(NamedTuple):
    """The studio's person before a ring of cameras and one on the ceiling: hulls, and the points (F, 15, 3), m."""

    rig: object
    products: list
    truth: np.ndarray


def played(motion, seconds, cameras):
    rig, body = ring(cameras - 1), Body.from_stature(STATURE_M)
    poses = MOTIONS[motion](body, seconds, FPS).poses
    person, eyes, pipeline = VolumetricBody(body), ExactSilhouettes(rig), MocapPipeline(rig, CONFIGURATION)
    products = [
        pipeline.carve(footage_stamp_ns(EPOCH_NS, frame, FPS), eyes.render(person.place(pose)))
        for frame, pose in enumerate(poses)
    ]
    return Scene(rig, products, np.array([forward(body, pose) for pose in poses]))


def calls_of(scene):
    """What is called of the parts in the tracked frames, and (F, 5) whether all points of a part are in their 95 %."""
    follower = TrackingStage.of(CONFIGURATION, scene.rig)
    states = [(frame, follower.step(products).state) for frame, products in enumerate(scene.products)]
    track = Track.of_states([(frame, state) for frame, state in states if state is not None])
    errors = track.points_world - scene.truth[track.frames]
    inside = nees_of(errors, track.covariance) <= INSIDE_95
    of_parts = np.stack([inside[:, list(points)].all(axis=1) for points in PART_POINTS], axis=1)
    return PartCalls.of(1e3 * np.linalg.norm(errors, axis=2), track.parts), of_parts


def without_left_forearm(products, elbow_world, hand_world):
    """A set without what the hull tells of a forearm, as when no camera sees it before what is behind it."""

    def elsewhere(points_world):
        along = hand_world - elbow_world
        share = np.clip((points_world - elbow_world) @ along / (along @ along), 0.0, 1.0)
        return np.linalg.norm(points_world - elbow_world - share[:, None] * along, axis=1) > WITHIN_M

    packets = (products.centerline, products.voxels, products.contour_rays)
    return products.of_rows(*(elsewhere(packet.points_world) for packet in packets))


def test_a_forearm_without_evidence_is_doubtful_and_limbs_in_full_view_are_not():
    walk = played("walk", 2.5, 5)
    truth = walk.truth
    shown = [
        products if frame < HIDDEN_FROM else without_left_forearm(products, truth[frame, ELBOW], truth[frame, HAND])
        for frame, products in enumerate(walk.products)
    ]
    calls, inside = calls_of(walk._replace(products=shown))
    frames = np.arange(len(truth))[-len(calls.clear) :]
    hidden, known = frames >= HIDDEN_FROM, frames >= HIDDEN_FROM + round(KNOWN_AFTER_S * FPS)
    assert known.sum() > 10
    assert calls.called[known, LEFT_ARM].mean() > 0.9
    assert inside[hidden & calls.called[:, LEFT_ARM], LEFT_ARM].mean() > 0.8  # three points, each in 95 %
    calls.called[hidden, LEFT_ARM] = False
    assert (~hidden).sum() > 25 and calls.clear[~hidden].all()
    assert not calls.called.any()


def test_an_arm_pressed_to_the_chest_before_three_cameras_is_right_or_doubtful():
    scene = played("arm_on_chest", SECONDS, 3)
    calls, inside = calls_of(scene)
    there = (np.linalg.norm(scene.truth[:, HAND] - scene.truth[:, NECK], axis=1) < ON_CHEST_M)[-len(calls.clear) :]
    assert there.sum() > 30
    assert (calls.clear | calls.called[:, LEFT_ARM])[there].all()
    assert inside[there, LEFT_ARM].mean() > 0.9
    others = [part for part in range(len(PART_NAMES)) if part != LEFT_ARM]
    assert not calls.called[:, others].any()
