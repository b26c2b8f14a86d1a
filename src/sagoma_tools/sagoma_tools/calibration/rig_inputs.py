"""What a person gives to calibrate a rig, gathered: cameras, targets, and what their footage shows of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from rig_calibration.boards.board import Board
from rig_calibration.boards.sighting import Sighting
from rig_calibration.bundle.wand import wand_points, wand_turns
from rig_calibration.extrinsics.calibrate import FLOOR, MOVING, WAND, FloorTarget, Target
from rig_calibration.extrinsics.from_motion import FloorAt, moments_on_floor
from rig_calibration.extrinsics.moments import choose_moments
from rig_calibration.extrinsics.still_board import StillBoard, average_still_board
from rig_calibration.extrinsics.world import WorldChoice

from .rig_sightings import Seen, explain_unseen


@dataclass(frozen=True, eq=False)
class RigInputs:
    """Sightings and the targets they name. ``strays``: by camera, frames in which the floor board lay elsewhere, of how
    many. ``floor_guess``: frames in which the carried board was taken to lie on the floor."""

    sightings: tuple[Sighting, ...]
    targets: Mapping[str, Target]
    strays: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    floor_guess: tuple[int, ...] = ()


def floor_inputs(
    floor: Mapping[str, Seen], board: Board, choice: WorldChoice, by_hand: Iterable[str] = ()
) -> RigInputs:
    """The board on the floor: each camera's frames averaged. Where all cameras' corners were given ``by_hand``, their
    order tells which way round the board lies."""
    stills = {
        name: average_still_board(seen.sightings, board, target=FLOOR) for name, seen in floor.items() if seen.sightings
    }
    target = FloorTarget.of_board(board, choice)
    if set(by_hand) >= set(stills):
        target = FloorTarget(target.points, 1, target.T_world_floor)
    return RigInputs(tuple(still.sighting for still in stills.values()), {FLOOR: target}, _strays(stills))


def moving_inputs(
    cameras: Mapping[str, CameraModel],
    moving: Sequence[Sighting],
    board: Board,
    choice: WorldChoice,
    floor_at: FloorAt | None,
) -> RigInputs:
    """The carried board at chosen moments; with ``floor_at``, what it shows while it lies on the floor becomes the
    floor target."""
    if floor_at is None:
        return RigInputs(_at_chosen_moments(moving), {MOVING: Target.of(board)})
    lying = set(moments_on_floor(cameras, moving, board, floor_at))
    resting = [sighting for sighting in moving if sighting.moment in lying]
    names = sorted({sighting.camera for sighting in resting})
    stills = {
        name: average_still_board([s for s in resting if s.camera == name], board, target=FLOOR) for name in names
    }
    carried = _at_chosen_moments([sighting for sighting in moving if sighting.moment not in lying])
    targets = {FLOOR: FloorTarget.of_board(board, choice)} | ({MOVING: Target.of(board)} if carried else {})
    guess = tuple(sorted(lying)) if floor_at == "lowest" else ()
    return RigInputs((*(still.sighting for still in stills.values()), *carried), targets, _strays(stills), guess)


def wand_inputs(wands: Sequence[Sighting], marks_m: Sequence[float]) -> RigInputs:
    """The carried wand at chosen moments."""
    target = Target(wand_points(marks_m), wand_turns(marks_m))
    return RigInputs(_at_chosen_moments(wands), {WAND: target})


def together(parts: Sequence[RigInputs]) -> RigInputs:
    """All parts as one."""
    return RigInputs(
        tuple(sighting for part in parts for sighting in part.sightings),
        {name: target for part in parts for name, target in part.targets.items()},
        {name: strays for part in parts for name, strays in part.strays.items()},
        tuple(frame for part in parts for frame in part.floor_guess),
    )


def require_seen(
    cameras: Iterable[str], inputs: RigInputs, footage: Mapping[str, Mapping[str, tuple[Seen, Board | None]]]
) -> None:
    """Raises InputError for cameras that no sighting places, saying what their ``footage`` (by kind, by camera) shows
    instead, and how to go on."""
    placed = {sighting.camera for sighting in inputs.sightings}
    unseen, others = sorted(set(cameras) - placed), len(placed) > 1
    if not unseen:
        return
    reasons = [
        f"{name} ({kind}): {explain_unseen(*seen[name])}"
        for name in unseen
        for kind, seen in footage.items()
        if name in seen
    ]
    raise InputError(
        f"no board was found for {', '.join(unseen)}. " + "; ".join(reasons),
        remedy="Show it the board nearer and more from above, or give the board's outer corners in its picture "
        "(--click, or --corners FILE)"
        + (f", or calibrate the others alone (--without {' '.join(unseen)})." if others else "."),
    )


def _at_chosen_moments(moving: Sequence[Sighting]) -> tuple[Sighting, ...]:
    chosen = set(choose_moments(moving))
    return tuple(sighting for sighting in moving if sighting.moment in chosen)


def _strays(stills: Mapping[str, StillBoard]) -> dict[str, tuple[int, int]]:
    return {name: (len(s.strays), len(s.strays) + len(s.frames)) for name, s in stills.items()}
