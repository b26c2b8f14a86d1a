"""What tests of camera_client share: a learned background, somebody in the studio, the frames of a source, how well a
mask fits."""

import numpy as np

from camera_client.background.model import BackgroundLearner
from capture_rig.mask_levels import SHADOW_CANDIDATE
from stick_figure.body import Body
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.people import OUTFITS, VolumetricBody
from virtual_studio.rendering.camera import Sensor, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow

PATIENCE = 20  # silent seconds, only ever used up by a failing test
SENSOR = Sensor(noise=2.0, flicker=0.005, seed=13)


def learned(images, source="test", **about):
    """The background that these images show."""
    learner = BackgroundLearner()
    for image in images:
        learner.add(image)
    return learner.model(source, **about)


def studio_walk(camera, poses, outfit="middle", colour=False):
    """Light (h, w[, 3]) and exact mask of somebody who walks, of these of 15 poses a second, and of the empty room."""
    eye, body, clothes, seen = VirtualCamera(camera), Body.from_stature(1.75), OUTFITS[outfit], []
    for pose in MOTIONS["walk"](body, 2.0, 15.0).poses[poses]:
        person = VolumetricBody(body).place(pose)
        if colour:
            seen.append(eye.render_colour(person, clothes.albedo_bgr(person), floor_shadow(person, 0.5)))
        else:
            seen.append(eye.render(clothes.dress(person), floor_shadow(person, 0.5)))
    return seen, eye.empty_room_colour() if colour else eye.empty_room()


def iou(mask, truth):
    """Intersection over union of the person (candidates for shadow are none) and the truth (not zero)."""
    person = mask > SHADOW_CANDIDATE
    return (person & (truth > 0)).sum() / (person | (truth > 0)).sum()


def frames_of(source, count):
    """The next so many frames of a started source; incomplete ones, and those left out, are passed over."""
    frames, silences = [], 0
    while len(frames) < count:
        before = source.statistics.arrived, source.counters.get("left_out")
        frame = source.read(1.0)
        if frame is not None:
            frames.append(frame)
        elif before == (source.statistics.arrived, source.counters.get("left_out")):
            silences += 1
            assert silences < PATIENCE, f"no frames: {source.counters} {source.statistics}"
    return frames


def taken(source, count=15):
    """The first so many frames of a source, which is closed again."""
    with source:
        source.start()
        return frames_of(source, count)


def change_of(image, mean):
    """By how many whole grey levels (h, w) uint8 two pictures differ in the channel that differs most."""
    difference = np.abs(np.rint(image.astype(float) - mean))
    return (difference if difference.ndim == 2 else difference.max(axis=2)).astype(np.uint8)
