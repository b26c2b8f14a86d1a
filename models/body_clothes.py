"""The table of builds widened by what people wear: how far clothed bodies of other makers lie off its Gaussian.

    python models/body_clothes.py --motions pybullet_data/data/motions --avatars GLB --leave-out FAMILY IN.csv OUT.csv

IN.csv is what `models/body_builds.py` makes of naked rendered people and the studio's: the table in the tree, which is
not widened so, for what other makers wear does not carry over to one that is left out (docs/results/accuracy.md).

Each avatar (`models/avatar_people.py` says where they come from) stands in poses of the clips; rays along its outline
give the likeliest of its capsules, fixed to its own joints, under the table's Gaussian. How far they lie off what its
lengths let expect is what clothes, hair and a maker's idea of a joint do; the second moment of that, with the same
weight for each family, is added to the covariance, about the unchanged mean, and the modes are found anew in the
measure of these people's rays.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from avatar_body import load_avatar
from body_builds import (
    FREE,
    LEAST_INFORMATION,
    NAMES,
    NUMBERS,
    STICKS,
    STUDIO_LOOKS,
    STUDIO_SD,
    Array,
    N,
    modes,
    normal_equations,
    stepped,
    write,
)
from body_subjects import FRAMES_EACH, Subject, people_in_clothes

from icp_tracker.initialization.body_sizes import sizes_of_body
from stick_figure import body_surface as table
from stick_figure.body import BUILD_NUMBERS

FAMILIES = {
    "valid": (
        *("valid_White_F_1_Medi", "valid_White_M_1_Busi", "valid_Black_M_2_Milit"),
        *("valid_Hispanic_F_1_Casual", "valid_MENA_M_1_Util"),
    ),
    "quaternius": (
        *("quat_men_Worker", "quat_women_Formal", "quat_men_Suit", "quat_women_Soldier"),
        "quat_women_Casual",
    ),
    "rocketbox": ("rocketbox_m17",),
}
"""Avatars by maker; those of `avatar_people` are among them, so a family's own figures are proof only of the table
that leaves it out."""


def shift_of(person: Subject, of_length: Array, expected: Array, inverse: Array) -> Array:
    """How far (N,) a person's capsules lie off the ``expected`` ones, over the stature."""
    own = expected
    for _ in range(STUDIO_LOOKS):
        own, _ = stepped(person, of_length, own, expected, inverse)
    return own - expected


def widened(families: list[list[Subject]], before: table.Builds) -> list[Array]:
    """The columns of the table after it has been widened by the families' people."""
    of_length, mean = before.of_length, before.of_stature.ravel()
    slopes, ways = before.slopes.reshape(N, -1), before.modes.reshape(N, -1)
    covariance, inverse = ways @ ways.T, np.linalg.inv((ways @ ways.T + STUDIO_SD**2 * np.eye(N))[np.ix_(FREE, FREE)])
    moments, information = np.zeros((N, N)), np.zeros((N, N))
    for people in families:
        for person in people:
            lengths = sizes_of_body(person.body)[: len(before.mean)]
            expected = mean + slopes @ (lengths / person.stature - before.mean)
            off = shift_of(person, of_length, expected, inverse)
            moments += np.outer(off, off) / len(people) / len(families)
            information += normal_equations(person, of_length, expected)[0]
    information += LEAST_INFORMATION * np.trace(information) / N * np.eye(N)
    kept = np.ones(N)
    hand = NUMBERS * NAMES.index("hand")
    kept[hand : hand + 3] = 0.0  # a hand's start is the wrist, about which it turns
    count = sum(map(len, families))
    found = modes((covariance + moments) * np.outer(kept, kept), information / count, BUILD_NUMBERS)
    return [of_length.reshape(N, 1), mean[:, None], slopes, found * kept[:, None]]


def main() -> int:
    """Make the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", type=Path, required=True, help="pybullet_data/data/motions, unpacked")
    parser.add_argument("--avatars", type=Path, required=True, help="folder of the avatars")
    parser.add_argument("--leave-out", default="", choices=("", *FAMILIES), help="a family that is not looked at")
    parser.add_argument("--poses", type=int, default=FRAMES_EACH, help="of each clip, three of which each person plays")
    parser.add_argument("before", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    table.TABLE = options.before
    families = [
        list(
            people_in_clothes(
                (load_avatar(options.avatars / f"{name}.glb") for name in names), options.motions, options.poses, STICKS
            )
        )
        for family, names in FAMILIES.items()
        if family != options.leave_out
    ]
    before = table.builds()
    write(options.out, before.mean, widened(families, before))
    return 0


if __name__ == "__main__":
    sys.exit(main())
