"""What the built-in person does, by name: motions with exact truth, every one of which starts in the T-pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from stick_figure.body import Body

from .body import VolumetricBody
from .motions import crossing, everyday, fast, on_the_floor, touching, travelling
from .motions.placement import play_by_steps, play_on_circle
from .motions.timeline import T_POSE_S, Motion, Timeline

__all__ = ["HARD_CASES", "MOTIONS", "T_POSE_S", "HardCase", "Motion", "t_pose_only", "tour", "walk"]

Player = Callable[..., Motion]
"""(body, seconds, fps) and optionally the build (`VolumetricBody`) to a motion."""


def tour(body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
    """T-pose, then walking in a circle, raising the arms, a squat, turning the torso, and round again."""
    return play_on_circle(body, seconds, fps, everyday.TOUR)


def walk(body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
    """T-pose, then walking in a circle to the end."""
    return play_on_circle(body, seconds, fps, everyday.WALK)


def t_pose_only(body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
    """Standing still in the T-pose."""
    return play_on_circle(body, seconds, fps, everyday.T_POSE_ONLY)


@dataclass(frozen=True)
class HardCase:
    """A motion that trackers are known to fail at; the feet of whoever does it stay where they stand.

    script: the activities of a person; start_xy: where that person's torso begins, m.
    """

    script: Callable[[VolumetricBody], Timeline]
    start_xy: tuple[float, float] = (0.0, 0.0)

    def __call__(self, body: Body, seconds: float, fps: float, build: float = 1.0) -> Motion:
        person = VolumetricBody(body, build)
        return play_by_steps(person, seconds, fps, self.script(person), self.start_xy)

    @property
    def once_s(self) -> float:
        """Seconds from the T-pose through all activities once."""
        return T_POSE_S + sum(a.duration_s for a in self.script(VolumetricBody(Body.from_stature(1.75))).activities)


HARD_CASES: Mapping[str, HardCase] = {
    "arm_on_chest": HardCase(touching.arm_on_chest),
    "hands_clasped": HardCase(touching.hands_clasped),
    "hands_on_hips": HardCase(touching.hands_on_hips),
    "crossed_legs": HardCase(crossing.crossed_legs),
    "squat": HardCase(crossing.squat),
    "sitting": HardCase(crossing.sitting),
    "bow": HardCase(crossing.bow),
    "turn_on_spot": HardCase(travelling.turn_on_spot),
    "leave_and_return": HardCase(travelling.leave_and_return),
    "run": HardCase(travelling.run, start_xy=(0.0, -0.3)),
    "jump": HardCase(fast.jump),
    "kick": HardCase(fast.kick),
    "punch": HardCase(fast.punch),
    "lie_down": HardCase(on_the_floor.lie_down, start_xy=(0.4, 0.0)),
}

MOTIONS: Mapping[str, Player] = {"tour": tour, "walk": walk, "t_pose_only": t_pose_only, **HARD_CASES}
