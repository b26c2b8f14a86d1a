"""What the server costs over cameras, voxels and people: a study of bench/live.py.

The built-in studio's person walks before a ring of cameras and one on the ceiling, 640 x 480 at 60 Hz. Silhouettes are
the body's, half of its pixels as dark as floor in shadow, and a shadow under the feet, so that the hull server has to
resolve them; they are encoded as camera clients send them. Every configuration answers the same sets in turns, one set
each: what else the machine does falls on all. Times are processor time of one thread, mean of a set, from the encoded
masks to the filtered pose, without middleware. Stages that are due a few times a second count with their share.

Several people are bodies side by side in the silhouettes: the hull server's cost. One of them is tracked here, so that
tracker and filter do not depend on their number (bench/people.py together_ measures what each person costs them).

Figures: cameras_ms, voxels_ms, people_ms : {"6 cameras": mean ms of a set}, about 6 cameras, 20 mm and one person;
set_bytes_per_camera : masks on the wire.
"""

from __future__ import annotations

import time
import types
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from report import Table

import cv2
import numpy as np

from capture_rig import Rig
from capture_rig.mask_levels import ATTENUATED_LEVELS, FOREGROUND, SHADOW_CANDIDATE
from ekf_tracker.filter import PeopleFilter
from hull_server import hull_pipeline
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from icp_tracker.initialization.initial_pose import KnownPose
from icp_tracker.people.people_tracker import PeopleTracker
from icp_tracker.settings import TrackerSettings
from icp_tracker.tracker import IcpTracker
from mocap_packets.frame_set import FrameSet
from mocap_pipeline.pipeline import TrackingStage
from sagoma_ros import mask_png
from stick_figure.body import Body
from stick_figure.pose import Pose
from virtual_studio.motions.catalogue import walk
from virtual_studio.people import Capsules, VolumetricBody
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

FPS, STATURE_M = 60.0, 1.75
PLACES_M = ((0.6, 0.5, 0.0), (-0.6, 0.5, 0.0), (0.0, -0.6, 0.0))  # how far several bodies are shifted
FIRST_S = 2.0  # of the motion: it begins with a T-pose
WARM_UP = 12  # sets that do not count
CAMERAS, VOXELS_MM, PEOPLE = (3, 4, 6, 8, 10, 12, 30), (20, 15, 10, 7, 5), (1, 2, 3)
USUAL = (6, 20, 1)
BLOCK_PX = 8  # of dark and bright clothes
SHADOW_M, SHADOW_LEVEL = 0.35, ATTENUATED_LEVELS[4]
STAGES = {
    "decode": ("decode",),
    "consistency": ("consistency",),
    "shadows": ("shadows", "support"),
    "carve": ("carve", "floor"),
    "slice, sample": ("slice", "filter", "sample"),
    "contour rays": ("contour_rays",),
}
TRACKING = ("as sent", "fit", "filter pose")


@dataclass
class Server:
    """Hull server, tracker and filter of one configuration, and the ms of each stage, a row a set."""

    rig: Rig
    sets: list[dict[str, bytes]]
    voxel_mm: int
    body: Body
    first: Pose
    ms: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._hull = HullPipeline(self.rig, HullSettings(voxel_size_m=self.voxel_mm / 1e3, backend="cpu"))
        source, settings = KnownPose(self.first, self.body), TrackerSettings(acquire_inliers=0.0)
        self._body = TrackingStage(PeopleTracker(lambda: IcpTracker(source, settings), most=1), PeopleFilter())

    def answer(self, number: int) -> None:
        """Answer one set, and note what it cost."""
        stamp_ns, laps = round(number * 1e9 / FPS), [time.thread_time()]

        def lap() -> None:
            laps.append(time.thread_time())

        masks = {name: _decoded(data) for name, data in self.sets[number].items()}
        lap()
        result = self._hull.run(FrameSet.of_instant(stamp_ns, masks, ()))
        lap()
        products = result.products
        lap()
        fit = self._body.fit(products)
        lap()
        self._body.filter(fit)
        lap()
        decode, _, sent, fitted, filtered = (1e3 * float(ms) for ms in np.diff(laps))
        of_hull = {stage: sum(result.stage_ms.get(one, 0.0) for one in parts) for stage, parts in STAGES.items()}
        self.ms.append(of_hull | {"decode": decode, "as sent": sent, "fit": fitted, "filter pose": filtered})

    def mean_ms(self, stage: str) -> float:
        """Mean of a stage; of "hull" and "sum", too."""
        stages = {"hull": (*STAGES,), "sum": (*STAGES, *TRACKING), "tracking": TRACKING}.get(stage, (stage,))
        return float(np.mean([sum(row[one] for one in stages) for row in self.ms[WARM_UP:]]))

    @property
    def set_bytes(self) -> float:
        """Mean size of all masks of a set."""
        return float(np.mean([sum(len(data) for data in one.values()) for one in self.sets]))


def _decoded(data: bytes) -> np.ndarray:
    mask = mask_png.decode(data, candidates=SHADOW_CANDIDATE)
    assert mask is not None
    return mask


class Studio:
    """Renders and encodes the silhouettes of so many sets; what was rendered is kept."""

    def __init__(self, sets: int) -> None:
        self.body = Body.from_stature(STATURE_M)
        motion = walk(self.body, FIRST_S + (sets + 1) / FPS, FPS)
        first = round(FIRST_S * FPS)
        self.poses = motion.poses[first : first + sets]
        self._person, self._made = VolumetricBody(self.body), dict[tuple[int, int], tuple[Rig, list]]()

    def server(self, cameras: int, voxel_mm: int, people: int) -> Server:
        """A server for one configuration."""
        rig, sets = self.sets(cameras, people)
        return Server(rig, sets, voxel_mm, self.body, _shifted(self.poses[0], _places(people)[0]))

    def sets(self, cameras: int, people: int) -> tuple[Rig, list[dict[str, bytes]]]:
        """A rig and the encoded silhouettes of all sets, by camera."""
        if (cameras, people) not in self._made:
            rig = ring(cameras - 1)
            self._made[cameras, people] = rig, list(self._sets(rig, people))
        return self._made[cameras, people]

    def _sets(self, rig: Rig, people: int) -> Iterator[dict[str, bytes]]:
        places, eyes = _places(people), ExactSilhouettes(rig)
        views = {camera.name: camera.undistorted_view() for camera in rig.cameras}
        angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        disc = SHADOW_M * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(24)])
        for pose in self.poses:
            one = self._person.place(pose)
            starts, ends = (np.concatenate([points + place for place in places]) for points in (one.starts, one.ends))
            several = Capsules(starts, ends, np.tile(one.radii, (people, 1)), np.tile(one.albedo, people))
            under = [place + pose.position_world * [1.0, 1.0, 0.0] for place in places]
            levels = {}
            for name, mask in eyes.render(several).items():
                shadow, view = np.zeros_like(mask), views[name]
                for foot in under:
                    cv2.fillPoly(shadow, [np.rint(view.camera.project(disc + foot)).astype(np.int32)], SHADOW_LEVEL)
                levels[name] = mask_png.encode(np.where(mask > 0, _clothes(mask), np.where(view.seen, shadow, 0)))
            yield levels


def _places(people: int) -> np.ndarray:
    """How far (people, 3) each body is shifted."""
    return np.array(PLACES_M[:people]) if people > 1 else np.zeros((1, 3))


def _shifted(pose: Pose, by_m: np.ndarray) -> Pose:
    return Pose(pose.position_world + by_m, pose.R_world_torso, pose.R_joints, pose.hinges)


def _clothes(mask: np.ndarray) -> np.ndarray:
    """Levels of a body half of whose pixels, in squares, are as dark as floor in shadow."""
    v, u = np.indices(mask.shape) // BLOCK_PX
    level = np.array(ATTENUATED_LEVELS, np.uint8)[(7 * v + 3 * u) % len(ATTENUATED_LEVELS)]
    return np.where((u + v) % 2 == 0, level, np.uint8(FOREGROUND))


def measure(studio: Studio, configurations: list[tuple[int, int, int]]) -> dict[tuple[int, int, int], Server]:
    """Answer all sets with every configuration, in turns."""
    # the pipeline's own stage watch reads processor time
    hull_pipeline.time = types.SimpleNamespace(perf_counter=time.thread_time)  # type: ignore[attr-defined]
    servers = {configuration: studio.server(*configuration) for configuration in configurations}
    for number in range(len(studio.poses)):
        for server in servers.values():
            server.answer(number)
    return servers


def show(title: str, column: str, rows: dict[int, Server]) -> None:
    """Print the stages over one quantity."""
    stages = [*STAGES, "hull", "tracking", "sum"]
    table = Table({column: ">9d", **{stage: f">{max(len(stage), 6)}.2f" for stage in stages}, "KB": ">6.1f"}, title)
    for value, server in rows.items():
        table.row(value, *(server.mean_ms(stage) for stage in stages), server.set_bytes / 1e3)


def scaling(quick: bool) -> dict[str, Any]:
    """Print the tables; ``quick`` : 18 sets a configuration instead of 72, twelve cameras at most."""
    studio = Studio(WARM_UP + (18 if quick else 72))
    cameras, voxels, people = USUAL
    wanted = {
        "cameras": {n: (n, voxels, people) for n in (CAMERAS[:-1] if quick else CAMERAS)},
        "voxels": {mm: (cameras, mm, people) for mm in VOXELS_MM},
        "people": {n: (cameras, voxels, n) for n in PEOPLE},
    }
    servers = measure(studio, list(dict.fromkeys(c for kind in wanted.values() for c in kind.values())))
    found = {kind: {value: servers[c] for value, c in rows.items()} for kind, rows in wanted.items()}
    show("over cameras: ms of processor time a set, 20 mm, 1 person", "cameras", found["cameras"])
    show("over voxels: 6 cameras, 1 person", "voxel mm", found["voxels"])
    show("over people: 6 cameras, 20 mm; one of them is tracked", "people", found["people"])
    figures = {
        f"{kind}_ms": {f"{n} {kind}": round(one.mean_ms("sum"), 2) for n, one in rows.items()}
        for kind, rows in found.items()
    }
    return {**figures, "set_bytes_per_camera": round(servers[USUAL].set_bytes / cameras)}
