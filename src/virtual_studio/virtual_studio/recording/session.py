"""Writes a session folder: footage, empty room, exact silhouettes, rig, truth and body of the built-in persons.

Files: camNN.mp4, camNN_background.mp4, camNN_mask.mkv (lossless), rig.yaml, truth.csv, body.yaml, session.yaml; of the
second person truth_2.csv and body_2.yaml, and so on.
The same arguments, with the same seed, give the same pictures. The folder appears whole or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from capture_rig.errors import InputError
from capture_rig.files import replaced_folder
from capture_rig.rig import Rig, save_rig
from capture_rig.rigid import rotation_vector
from capture_rig.session import write_table
from capture_rig.video import VideoFile
from capture_rig.yaml_file import read_mapping, save_mapping
from stick_figure.body import Body, save_body
from stick_figure.kinematics import forward
from stick_figure.skeleton import ANGLE_NAMES

from ..motions.catalogue import MOTIONS, Motion, MotionFunction
from ..motions.together import TOGETHER
from ..people import Capsules, Outfit, VolumetricBody, together
from ..rendering.camera import Light, Sensor, VirtualCamera
from ..rendering.capsules import floor_shadow

MADE_BY = "virtual_studio"
FOOTAGE, LOSSLESS = ".mp4", ".mkv"
"""Suffixes of footage, and of exact silhouettes, under 1 KB each."""
SESSION_FPS = 60.0
BACKGROUND_S = 1.5
FIRST_BACKGROUND_FRAME = 1_000_000
"""Number of the first background frame for the sensor's noise, so that none repeats in the footage."""
POINT_COLUMNS = {
    "neck": 2, "head_top": 1, "l_shoulder": 3, "r_shoulder": 4, "l_elbow": 7, "r_elbow": 8, "l_hand_tip": 11,
    "r_hand_tip": 12, "l_hip": 5, "r_hip": 6, "l_knee": 9, "r_knee": 10, "l_ankle": 13, "r_ankle": 14,
}  # fmt: skip
"""Column name of each reference point; the pelvis (mid-hips) comes before them, p1 is the torso's position."""
TORSO_COLUMNS = ("torso_x", "torso_y", "torso_z", "torso_rx_rad", "torso_ry_rad", "torso_rz_rad")
"""p1 (m) and the rotation vector of R_world_torso (rad)."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class RenderSettings:
    """Appearance of a session.

    seed: of noise and flicker; noise: standard deviation of a pixel, grey levels; flicker: relative deviation of a
    frame's brightness; shadow: on the floor; build: thickness of the body over the average's.
    """

    seed: int = 1
    noise: float = 3.0
    flicker: float = 0.005
    shadow: bool = True
    build: float = 1.0


def write_session(
    folder: str | Path,
    rig: Rig,
    body: Body,
    motion: str | MotionFunction = "tour",
    fps: float = SESSION_FPS,
    seconds: float = 6.0,
    settings: RenderSettings | None = None,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Renders a session into `folder` and returns its path.

    motion: one of `motions.catalogue.MOTIONS`, or a function such as `motions.recorded.RecordedMotion`; progress
    is called with (frames done, frames in all). An older session of the virtual studio in `folder` is replaced.
    Raises InputError for an unknown motion, impossible numbers, or a folder that holds anything else.
    """
    folder, settings = Path(folder), settings or RenderSettings()
    if isinstance(motion, str) and motion not in MOTIONS:
        raise InputError(f"there is no motion '{motion}'", remedy=f"Known motions: {', '.join(MOTIONS)}.")
    moved = (MOTIONS[motion] if isinstance(motion, str) else motion)(body, seconds, fps, settings.build)
    actor = Actor(VolumetricBody(body, settings.build), moved)
    recipe = {"motion": str(motion), "seconds": seconds}
    return _write(folder, rig, (actor,), settings, recipe, progress)


def write_scene(
    folder: str | Path,
    rig: Rig,
    scene: str,
    persons: Sequence[VolumetricBody],
    outfits: Sequence[Outfit] = (),
    fps: float = SESSION_FPS,
    settings: RenderSettings | None = None,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Renders a scene of several persons (`motions.together.TOGETHER`) as :func:`write_session` does one person.

    persons: one for each role; outfits: in the same order; persons without one wear the usual clothes.
    Raises InputError for a folder that holds anything else.
    """
    motions = TOGETHER[scene].motions(persons, fps)
    worn = [*outfits, *[None] * len(persons)]
    actors = [Actor(*one) for one in zip(persons, motions, worn, strict=False)]
    recipe = {"scene": scene, "seconds": len(motions[0].poses) / fps}
    return _write(Path(folder), rig, actors, settings or RenderSettings(), recipe, progress)


@dataclass(frozen=True)
class Actor:
    """Somebody before the cameras: a body, its motion, and the clothes, if not the usual ones."""

    person: VolumetricBody
    motion: Motion
    outfit: Outfit | None = None

    def at(self, frame: int) -> Capsules:
        placed = self.person.place(self.motion.poses[frame])
        return placed if self.outfit is None else self.outfit.dress(placed)


def _write(
    folder: Path,
    rig: Rig,
    actors: Sequence[Actor],
    settings: RenderSettings,
    recipe: dict[str, object],
    progress: Progress,
) -> Path:
    of_all = {"build": [actor.person.build for actor in actors]}
    of_all["stature_m"] = [round(actor.person.body.stature, 4) for actor in actors]
    recipe |= {"seed": settings.seed, "noise_grey_levels": settings.noise, "flicker": settings.flicker}
    recipe |= {"shadow": settings.shadow}
    recipe |= {name: values[0] if len(values) == 1 else values for name, values in of_all.items()}
    with replaced_folder(folder, is_own) as partial:
        save_rig(rig, partial / "rig.yaml")
        for number, actor in enumerate(actors, 1):
            tail, body = "" if number == 1 else f"_{number}", actor.person.body
            save_body(body, partial / f"body{tail}.yaml", source="the built-in body of the virtual studio: exact")
            write_truth(partial / f"truth{tail}.csv", body, actor.motion)
        description = {
            "fps": actors[0].motion.fps,
            "units": "metres, radians, pixels",
            "source": "rendered by python -m virtual_studio",
            "made_by": MADE_BY,
            "recipe": recipe,
            "body": "body.yaml",
        }
        save_mapping(partial / "session.yaml", description)
        _film(partial, rig, actors, settings, progress)
    return folder


def write_truth(path: Path, body: Body, motion: Motion) -> None:
    """Writes truth.csv, one row a frame: reference points (m; left is the person's left), torso pose, 18 angles."""
    names = [f"{name}_{axis}" for name in ("pelvis", *POINT_COLUMNS) for axis in "xyz"]
    rows = []
    for pose, angles in zip(motion.poses, motion.angles, strict=True):
        points = forward(body, pose)
        pelvis = 0.5 * (points[5] + points[6])
        places = np.vstack([pelvis, points[list(POINT_COLUMNS.values())], pose.position_world])
        rows.append(np.concatenate([places.ravel(), rotation_vector(pose.R_world_torso), angles]))
    names += [*TORSO_COLUMNS, *(f"{name}_rad" for name in ANGLE_NAMES)]
    write_table(path, names, range(len(rows)), np.array(rows), 7)


def _film(folder: Path, rig: Rig, actors: Sequence[Actor], settings: RenderSettings, progress: Progress) -> None:
    motion = actors[0].motion
    sensor, things, fps = Sensor(settings.noise, settings.flicker, settings.seed), motion.things, motion.fps
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(min(len(rig.cameras), os.cpu_count() or 1)))
        furnished = (things.untouched, things.standing) if things else (None,)
        rooms = [list(pool.map(partial(VirtualCamera, standing=room), rig.cameras)) for room in furnished]
        empty = rooms[0]
        for number, (name, camera) in enumerate(zip(rig.names, empty, strict=True)):
            with VideoFile(folder / f"{name}_background{FOOTAGE}", fps) as video:
                for frame in range(max(round(BACKGROUND_S * fps), 1)):
                    video.write(sensor.expose(camera.empty_room(), number, FIRST_BACKGROUND_FRAME + frame))
        footage = [stack.enter_context(VideoFile(folder / f"{name}{FOOTAGE}", fps)) for name in rig.names]
        masks = [stack.enter_context(VideoFile(folder / f"{name}_mask{LOSSLESS}", fps)) for name in rig.names]

        def shoot(number: int, frame: int, capsules: Capsules, shadow: Light | None) -> None:
            cameras = empty if things and frame < things.taken else rooms[-1]
            light, mask = cameras[number].render(capsules, shadow)
            footage[number].write(sensor.expose(light, number, frame))
            masks[number].write(mask)

        for frame in range(len(motion.poses)):
            capsules = together(*(actor.at(frame) for actor in actors))
            if things:
                capsules = things.foreground(capsules, frame)
            shadow = floor_shadow(capsules) if settings.shadow else None
            for done in [pool.submit(shoot, number, frame, capsules, shadow) for number in range(len(empty))]:
                done.result()
            progress(frame + 1, len(motion.poses))


def is_own(folder: Path, description: str = "session.yaml") -> bool:
    """Returns whether the virtual studio wrote a folder, by its ``description``."""
    try:
        return read_mapping(folder / description, "").get("made_by") == MADE_BY
    except InputError:
        return False
