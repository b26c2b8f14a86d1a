"""From the images of one instant to the joint angles of everybody in view: the whole method on one page.

The nodes of the graph hold the same objects and call them in the same order, and their messages hold every number
exactly, so this page and the graph give the same results, bit for bit.

    images -> segment -> silhouettes -> resolve shadows -> carve -> slice -> fit -> filter -> predict -> next fit
                 ^---- support by other cameras <------|
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from camera_client.background.model import BackgroundModel
from camera_client.settings import CameraClientSettings
from camera_client.silhouettes.pipeline import SilhouettePipeline
from capture_rig.camera import CameraModel
from capture_rig.rig import Rig, Volume
from ekf_tracker.filter import PeopleFilter
from hull_server.hull_pipeline import HullPipeline
from icp_tracker.people.people_tracker import PeopleTracker, make_people_tracker
from mocap_packets.fit import Fit
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import HullProducts
from mocap_packets.keypoints import Detections, keypoints_of
from mocap_packets.people import FittedPeople, PeoplePoints
from mocap_packets.silhouette import ForegroundSupport
from mocap_packets.state import BodyState, NoState, Prediction

from .configuration import Configuration

Masks = Mapping[str, np.ndarray]
"""Canvas masks (h, w) uint8 by camera, levels of `capture_rig.mask_levels`."""


@dataclass(frozen=True, eq=False)
class PersonStep:
    """What one frame set gave of one person: the fit, and the filter's answer."""

    fit: Fit
    answer: BodyState | NoState

    @property
    def person(self) -> int:
        """The person's number: 1, 2, ..."""
        return self.fit.person

    @property
    def state(self) -> BodyState | None:
        """The filter's state, if it has one."""
        return self.answer if isinstance(self.answer, BodyState) else None


@dataclass(frozen=True, eq=False)
class Step:
    """What one frame set gave, person by person in the order of their numbers; the first one is always there."""

    people: tuple[PersonStep, ...]

    @property
    def fit(self) -> Fit:
        """The first person's fit."""
        return self.people[0].fit

    @property
    def answer(self) -> BodyState | NoState:
        """The filter's state of the first person."""
        return self.people[0].answer

    @property
    def state(self) -> BodyState | None:
        """The filter's state of the first person, if it has one."""
        return self.people[0].state


class MocapPipeline:
    """Images or silhouettes of a calibrated rig in, everybody's state out. Deterministic; stamps must rise."""

    def __init__(
        self, rig: Rig, configuration: Configuration, backgrounds: Mapping[str, BackgroundModel] | None = None
    ) -> None:
        """``backgrounds`` by camera are needed by :meth:`step` alone. InputError for settings that cannot be used."""
        self.cameras = {
            name: make_segmenter(rig.camera(name), background, configuration.camera, rig.volume)
            for name, background in (backgrounds or {}).items()
        }
        self.rig, self.hull = rig, HullPipeline(rig, configuration.hull)
        self.body = TrackingStage.of(configuration, rig)

    def step(self, stamp_ns: int, images: Mapping[str, np.ndarray], detections: Iterable[Detections] = ()) -> Step:
        """Return the persons at one instant, from the cameras' images (H, W[, 3]) uint8; ``detections`` : of a detector
        of 2D poses in them, if there is one."""
        return self.step_masks(stamp_ns, self.segment(stamp_ns, images), detections=detections)

    def segment(self, stamp_ns: int, images: Mapping[str, np.ndarray]) -> Masks:
        """Segment: what differs from the background, without noise, and how dark (6.3; camera_client/silhouettes/)."""
        masks = {name: self.cameras[name].run(image, stamp_ns).mask for name, image in images.items()}
        return masks

    def step_masks(
        self, stamp_ns: int, masks: Masks, missing: tuple[str, ...] = (), detections: Iterable[Detections] = ()
    ) -> Step:
        """Return the persons at one instant, from silhouettes; ``missing`` cameras delivered nothing."""
        products = self.carve(stamp_ns, masks, missing)
        return self.body.step(replace(products, keypoints=keypoints_of(self.rig, detections)))

    def carve(self, stamp_ns: int, masks: Masks, missing: tuple[str, ...] = ()) -> HullProducts:
        """Carve one instant: the visual hull and its products (hull_server/hull_pipeline.py)."""
        frame_set = FrameSet.of_instant(stamp_ns, dict(masks), missing)
        return self.carve_set(frame_set)

    def carve_set(self, frame_set: FrameSet[np.ndarray]) -> HullProducts:
        """Carve a frame set of cameras that are not in step, each with its own stamp."""
        # leave out cameras that contradict the others, resolve shadows, carve the voxels that all cameras see as
        # foreground (3.1; consistency/, floor_shadows.py, carving/ or opengl/)
        pending = self.hull.begin(frame_set)
        # slice the hull along x, y and z and keep the centroids of the slices that look like a limb (3.2; slicing/);
        # sample its voxels, and trace the rays that touch the body (slicing/voxel_runs.py, contour_rays/)
        result = self.hull.finish(pending)
        # report foreground without support by other cameras: moved things, which become background
        # (consistency/foreground_support.py; camera_client/background/moved_things.py)
        self.report_support(result.support)
        return result.products

    def report_support(self, reports: tuple[ForegroundSupport, ...]) -> None:
        """Pass each camera that is segmented here the support of its foreground by the others."""
        for report in reports:
            if report.camera in self.cameras:
                self.cameras[report.camera].add_support(report)


class TrackingStage:
    """Tracker and filters of everybody: each fit starts from the filter's state after the frame set before."""

    def __init__(self, tracker: PeopleTracker, filters: PeopleFilter, feedback: bool = True) -> None:
        """Without ``feedback`` each fit starts from the fit before (thesis 4.3)."""
        self.tracker, self.filters = tracker, filters
        self._feeds_back = feedback
        self._predictions: dict[int, Prediction] = {}

    @classmethod
    def of(cls, configuration: Configuration, rig: Rig | None = None) -> TrackingStage:
        """Build tracker and filters by the settings; ``rig`` : of the hulls."""
        tracker = make_people_tracker(configuration.icp, rig, configuration.hull.min_seeing)
        return cls(tracker, PeopleFilter(configuration.ekf), configuration.feedback)

    def step(self, products: HullProducts) -> Step:
        """Fit and filter one frame set."""
        fits = self.fit(products)
        answers = self.filter(fits)
        return Step(tuple(PersonStep(fit, answers[fit.person]) for fit in fits))

    def fit(self, products: HullProducts) -> tuple[Fit, ...]:
        """Find first poses, later fit the stick figures to the hull from where they are expected (4.3;
        icp_tracker/people/ for data association; icp_tracker/tracker.py with initialization/, articulated_fit.py,
        monitor/, refinement/, thesis/)."""
        return self.tracker.step(products, self._predictions)

    def filter(self, fits: tuple[Fit, ...]) -> dict[int, BodyState | NoState]:
        """Correct the predictions with the fitted reference points (5.2; ekf_tracker/filter.py, track.py)."""
        # a body is measured with the first pose; its sizes are refined as it moves (initialization/, refinement/)
        bodies = {fit.person: body for fit in fits if (body := self.tracker.body_of(fit.person)) is not None}
        # extended Kalman filter over pose and velocity, predicted to this stamp (tables 5.5 and 5.7)
        answers = self.filters.step(FittedPeople(fits[0].stamp_ns, PeoplePoints.of_fits(fits), bodies))
        # predict: where the next fit starts (table 5.5; ekf_tracker/motion_model.py)
        if self._feeds_back:
            self._predictions = {person: answer.prediction for person, answer in answers.items()}
        return answers


def make_segmenter(
    camera: CameraModel, background: BackgroundModel, settings: CameraClientSettings, volume: Volume | None
) -> SilhouettePipeline:
    """Return the silhouettes of one camera, as its client computes them."""
    return SilhouettePipeline(camera, background, settings.silhouette, settings.background_model, volume)
