"""Compiles and loads what a silhouette needs before the first frame comes, which would wait for it otherwise."""

from __future__ import annotations

from functools import cache

import numpy as np

from capture_rig.camera import CameraModel

from ..background.kernels import clear_absorbed
from ..background.model import BackgroundModel, Provenance
from ..gige.pixel_formats import to_image
from .pipeline import SilhouettePipeline

WIDTH, HEIGHT = 160, 120
FRAMES, STEP_NS = 12, 100_000_000  # a second: the field of the light is followed from half a second on
NOISE_LEVELS, SHADOW = 2.0, 0.7


@cache
def warm_up_silhouettes(colour: bool) -> None:
    """Segment a small synthetic person with a shadow on the floor; once a process for mono and for colour images."""
    rng, shape = np.random.default_rng(0), (HEIGHT, WIDTH, 3) if colour else (HEIGHT, WIDTH)
    K = np.array([[WIDTH, 0.0, WIDTH / 2], [0.0, WIDTH, HEIGHT / 2], [0.0, 0.0, 1.0]])
    T_camera_world = np.eye(4)  # level, 1.5 m above the floor
    T_camera_world[:3, :3], T_camera_world[:3, 3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [0.0, 1.5, 3.0]
    mean = rng.uniform(120, 160, shape).astype(np.float32)
    background = BackgroundModel(mean, np.full_like(mean, NOISE_LEVELS), Provenance("warm-up", 20, NOISE_LEVELS))
    camera = CameraModel("warm_up", WIDTH, HEIGHT, K, "plumb_bob", np.zeros(5), T_camera_world)
    pipeline = SilhouettePipeline(camera, background)
    for frame in range(FRAMES):
        picture = mean + rng.normal(0.0, NOISE_LEVELS, shape)
        picture[80:110, 40:140] *= SHADOW
        picture[20:100, 60:100] = 20.0
        image = np.rint(picture).clip(0, 255).astype(np.uint8)
        pipeline.run(image, frame * STEP_NS)
    if colour:
        to_image(np.zeros(WIDTH * HEIGHT, np.uint8), "BayerRG8", WIDTH, HEIGHT, halved=True)
    pixels, mask = image.reshape(HEIGHT, WIDTH, -1), np.zeros((HEIGHT, WIDTH), np.uint8)
    clear_absorbed(pixels, mean.reshape(pixels.shape), mask, mask, 1.0, 1, (0, 0, HEIGHT, WIDTH), mask)
