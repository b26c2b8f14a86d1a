"""Is a calibrated rig good enough to track a person with, and if not, what to do about it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from capture_rig.verdict import REDO, USABLE, Finding, Verdict, judge

from .camera_findings import findings_of_camera
from .evidence import Evidence
from .tape import TapeCheck

FACING_DEG = 170.0
"""Cameras that look at each other see the same outline, mirrored."""
CLOSE_DEG, WIDE_DEG = 12.0, 170.0
FEWEST_CAMERAS = 3
RESTING_FRAMES = 3
"""A board that lies on the floor is seen there in so many frames."""
SCALE_USABLE, SCALE_REDO, SCALE_SDS = 0.01, 0.03, 4.0
TAPE_ERROR_M = 0.02
"""A tape held against a lens errs by so much."""


def judge_rig(evidence: Evidence) -> Verdict:
    """GOOD, USABLE or REDO, with every finding and its remedy: the rig's first, then each camera's."""
    cameras = (findings_of_camera(camera, evidence) for camera in evidence.figures.cameras)
    rig = (_of_floor(evidence), _of_guess(evidence), _of_sides(evidence), _of_scale(evidence), _of_layout(evidence))
    return judge(chain.from_iterable([*rig, *cameras]))


def _of_floor(evidence: Evidence) -> Iterator[Finding]:
    if not evidence.floor_known:
        yield Finding(
            USABLE,
            "no picture shows the board on the floor: heights and the vertical are guesses",
            "Add pictures of the board lying on the floor (--floor), or carry it there (--floor-at).",
        )


def _of_guess(evidence: Evidence) -> Iterator[Finding]:
    if 0 < len(evidence.floor_guess) < RESTING_FRAMES:
        frames = ", ".join(map(str, evidence.floor_guess))
        yield Finding(
            USABLE,
            f"the floor was taken from frame {frames}, where the carried board was lowest, but it did not rest there",
            "Look at the floor's grid in the pictures; lay the board down for some seconds, or say when it lies on the "
            "floor (--floor-at).",
        )


def _of_sides(evidence: Evidence) -> Iterator[Finding]:
    if evidence.undecided:
        yield Finding(
            REDO,
            f"nothing tells on which side of the board {', '.join(evidence.undecided)} stand(s)",
            "Use a board with an odd and an even number of inner corners, or a ChArUco board.",
        )


def _of_scale(evidence: Evidence) -> Iterator[Finding]:
    for target, (ratio, sd) in sorted(evidence.scales.items()):
        if abs(ratio - 1.0) > max(SCALE_USABLE, SCALE_SDS * sd):
            yield Finding(
                REDO if abs(ratio - 1.0) > SCALE_REDO else USABLE,
                f"board '{target}' is {ratio:.3f} times as large as stated, if the other board's size is right",
                "Measure the fields of both prints over the whole length of a row, and state those (--board, "
                "--floor-board).",
            )
    for check in evidence.tape:
        yield from _of_tape(check)


def _of_tape(check: TapeCheck) -> Iterator[Finding]:
    error = abs(check.ratio - 1.0)
    if error > max(SCALE_USABLE, TAPE_ERROR_M / check.tape_m):
        size = "smaller" if check.ratio > 1.0 else "larger"
        yield Finding(
            REDO if error > SCALE_REDO else USABLE,
            str(check),
            f"If the tape is right, the board's fields are {size} than stated, {1.0 / check.ratio:.4f} times as "
            "large: measure the print, state that size and calibrate again.",
        )


def _of_layout(evidence: Evidence) -> Iterator[Finding]:
    figures = evidence.figures
    if len(figures.cameras) == 1:
        yield Finding(
            REDO, "one camera alone makes no hull", "Give the pictures of all cameras (--cameras names them)."
        )
    elif len(figures.cameras) < FEWEST_CAMERAS:
        yield Finding(
            USABLE,
            f"{len(figures.cameras)} cameras: the hull will be much fatter than the body",
            "Use three or more, around the person.",
        )
    if not evidence.usable_volume:
        yield Finding(
            USABLE,
            "nowhere do enough cameras see a standing person from feet to head",
            "Move the cameras back, or turn them towards one place.",
        )
    for (one, other), angle in figures.facing_deg.items():
        if angle > FACING_DEG:
            what = f"{one} and {other} look at each other ({angle:.0f} degrees): they see the same outline"
            yield Finding(USABLE, what, "Move one of them sideways, by 20 degrees or more around the volume.")
        if angle < CLOSE_DEG:
            yield Finding(
                USABLE,
                f"{one} and {other} see almost the same ({angle:.0f} degrees apart)",
                "Move one of them around the volume; if they stand far apart in the room, check that each "
                "has its own footage.",
            )
    if len(figures.cameras) >= FEWEST_CAMERAS:
        for (one, other), gap in figures.gaps_deg.items():
            if gap > WIDE_DEG:
                yield Finding(
                    USABLE,
                    f"no camera stands between {one} and {other}, {gap:.0f} degrees apart",
                    "Spread the cameras around the volume.",
                )
