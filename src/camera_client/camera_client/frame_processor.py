"""Processes a frame: checks, silhouette, condition, movement; calibration and background may change any time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from capture_rig.camera import CameraModel
from capture_rig.rig import Volume
from capture_rig.verdict import Finding
from mocap_packets.silhouette import ForegroundSupport, Silhouette

from .background.causes import unfit
from .background.kernels import clear_absorbed
from .background.model import BackgroundModel, Provenance, load_background, read_background
from .condition import Condition, ConditionWatch
from .frame_source import Frame
from .gige.pixel_formats import to_image
from .movement import CameraMovedDetector, Movement, carry_turn_over, turn_when_learned
from .settings import CameraClientSettings
from .silhouettes.pipeline import Difference, SilhouettePipeline
from .sources.footage_reader import open_footage
from .sources.frame_checks import FrameChecks


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Results of a frame: ``flags`` of the frame itself (see frame_checks.REMEDIES); no silhouette without background.

    ``canvas`` is the undistorted camera that the silhouette's mask belongs to, None of a camera whose lens is unknown:
    it has no silhouettes; ``movement`` whether the camera has moved since its calibration, as far as that is known.
    """

    canvas: CameraModel | None
    flags: tuple[str, ...]
    silhouette: Silhouette | None = None
    movement: Movement | None = None


@dataclass(frozen=True, eq=False)
class _Stages:
    """The stages in use, which are replaced as one between two frames."""

    camera: CameraModel | None
    checks: FrameChecks
    pipeline: SilhouettePipeline | None = None
    background: BackgroundModel | None = None
    moved: CameraMovedDetector | None = None
    condition: ConditionWatch | None = None


@dataclass(frozen=True, eq=False)
class BegunFrame:
    """A frame whose silhouette is not made yet, with the stages that will make it."""

    stages: _Stages
    stamp_ns: int
    result: FrameResult
    difference: Difference | None
    condition: Condition | None


class FrameProcessor:
    """Checks frames and finds silhouettes. Frames come on one thread; what is used may be replaced on another."""

    def __init__(
        self,
        camera: CameraModel | None,
        settings: CameraClientSettings,
        volume: Volume | None = None,
        placed: bool = True,
    ) -> None:
        """``camera``: None while its lens is unknown. ``placed``: its pose is known; without, the floor is
        unknown, and shadows stay in the silhouettes. ``volume``: the capture volume, metres."""
        self._settings, self._volume, self._placed = settings, volume, placed
        self._stages = _Stages(camera, FrameChecks())
        self.refused: Finding | None = None
        """Why the background that there is cannot serve the camera."""

    @property
    def camera(self) -> CameraModel | None:
        """The calibrated camera in use; None while its lens is unknown."""
        return self._stages.camera

    @property
    def background(self) -> BackgroundModel | None:
        """The background in use."""
        return self._stages.background

    @property
    def pipeline(self) -> SilhouettePipeline | None:
        """The pipeline in use; None without a background or without a calibrated lens."""
        return self._stages.pipeline

    @property
    def condition(self) -> Condition:
        """How well the background in use fits the room now, as far as that was measured."""
        watch = self._stages.condition
        return Condition() if watch is None else watch.found

    def use_background(self, model: BackgroundModel | None) -> None:
        """Use a background from the next frame on; InputError when it does not fit the camera's image size."""
        self._stages = self._made(self.camera, model)
        self.refused = None

    def refuse_unfit_background(self, details: Mapping[str, str]) -> Finding | None:
        """Give up the background in use when it cannot serve the camera that told these details; returns why."""
        reason = None if self.background is None else unfit(self.background.provenance, details)
        if reason is not None:
            self.use_background(None)
            self.refused = reason
        return reason

    def use_learned_background(self, model: BackgroundModel) -> BackgroundModel:
        """Use a background that was learned just now, from the next frame on; return it as it should be saved: with
        how far the camera has turned since its calibration. Raises InputError as :meth:`use_background` does."""
        related = model if self.camera is None else carry_turn_over(model, self.background, self.camera)
        self.use_background(related)
        return related

    def use_camera(self, camera: CameraModel) -> None:
        """Use another calibration of the same camera from the next frame on."""
        self._stages = self._made(camera, self.background)

    def use_shape(self, shape: tuple[int, ...]) -> bool:
        """Take the background that the settings name, else the one that the last training saved, for images of this
        shape, unless one of that shape is in use.

        True when there is another one now. Raises InputError when the file cannot be read or does not fit.
        """
        if self.background is not None and self.background.shape == shape:
            return False
        self.use_background(None)
        path, saved = self._settings.background, self._settings.background_file
        if not path and saved and Path(saved).exists():
            path = saved
        if path:
            self.use_background(read_background(path, shape))
        return bool(path)

    def check_background_file(self) -> None:
        """Raises InputError when the background that the settings name is not there, whatever the images' shape."""
        path = self._settings.background
        if path.endswith(".npz"):
            load_background(path)
        elif path:
            open_footage(path).close()

    def add_support(self, report: ForegroundSupport) -> None:
        """Take what the other cameras see, from any thread; it counts for frames some time after its stamp."""
        if self.pipeline is not None:
            self.pipeline.add_support(report)

    def run(self, frame: Frame) -> FrameResult:
        """Process one frame. Raises InputError for one of another size or type."""
        return self.finish(self.begin(frame))

    def begin(self, frame: Frame) -> BegunFrame:
        """Do what the next frames need, as :meth:`run` says: all but the silhouette."""
        tools = self._stages
        canvas = None if tools.camera is None else tools.camera.undistorted_view().camera
        difference, condition, moved = None, None, tools.moved
        if tools.pipeline is not None:
            difference = tools.pipeline.subtract(frame.image, frame.stamp_ns)
        flags = tools.checks.check(frame.image, frame.stamp_ns)
        if tools.condition is not None and not flags:
            condition = tools.condition.of_background(frame.stamp_ns)
        if moved is not None and not flags:
            moved.update(frame.image, frame.stamp_ns)
        result = FrameResult(canvas, flags, None, None if moved is None else moved.movement)
        return BegunFrame(tools, frame.stamp_ns, result, difference, condition)

    def finish(self, begun: BegunFrame) -> FrameResult:
        """Make the silhouette of a frame that was begun. On one thread, in the frames' order; the next frames may be
        begun on another one meanwhile, which changes nothing."""
        tools = begun.stages
        if tools.pipeline is None or begun.difference is None:
            return begun.result
        silhouette = tools.pipeline.segment(begun.difference)
        if tools.condition is not None and begun.condition is not None:
            tools.condition.add(begun.condition, begun.stamp_ns)
        return replace(begun.result, silhouette=silhouette)

    def _made(self, camera: CameraModel | None, model: BackgroundModel | None) -> _Stages:
        s = self._settings
        checks = FrameChecks(None if model is None else model.mean, may_repeat=s.source == "footage")
        if model is None:
            return _Stages(camera, checks)
        pipeline, moved, condition = None, None, None
        if camera is not None:
            silhouette = s.silhouette if self._placed else replace(s.silhouette, shadow="keep")
            moved = CameraMovedDetector(camera, model, s.camera_moved, turn_when_learned(model.provenance, camera))
            pipeline = SilhouettePipeline(
                camera, model, silhouette, s.background_model, self._volume, alignment=moved.alignment
            )
            condition = ConditionWatch(pipeline)
        return _Stages(camera, checks, pipeline, model, moved, condition)


# --- before the first frame, which would wait for it otherwise: compile and load what a silhouette needs

WIDTH, HEIGHT = 160, 120
FRAMES, STEP_NS = 12, 100_000_000  # a second: the field of the light is followed from half a second on
NOISE_LEVELS, SHADOW = 2.0, 0.7


@cache
def warm_up_silhouettes(colour: bool) -> None:
    """Segment a small synthetic person with a shadow on the floor; once a process for mono and for colour images."""
    rng, shape = np.random.default_rng(0), (HEIGHT, WIDTH, 3) if colour else (HEIGHT, WIDTH)
    K = np.array([[WIDTH, 0.0, WIDTH / 2], [0.0, WIDTH, HEIGHT / 2], [0.0, 0.0, 1.0]])
    T_camera_world = np.eye(4)  # level, 1.5 m above the floor
    T_camera_world[:3, :3], T_camera_world[:3, 3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [0.0, 1.5, 3.0]
    mean = rng.uniform(120, 160, shape).astype(np.float32)
    background = BackgroundModel(mean, np.full_like(mean, NOISE_LEVELS), Provenance("warm-up", 20, NOISE_LEVELS))
    camera = CameraModel("warm_up", WIDTH, HEIGHT, K, "plumb_bob", np.zeros(5), T_camera_world)
    pipeline = SilhouettePipeline(camera, background)
    for frame in range(FRAMES):
        picture = mean + rng.normal(0.0, NOISE_LEVELS, shape)
        picture[80:110, 40:140] *= SHADOW
        picture[20:100, 60:100] = 20.0
        image = np.rint(picture).clip(0, 255).astype(np.uint8)
        pipeline.run(image, frame * STEP_NS)
    if colour:
        to_image(np.zeros(WIDTH * HEIGHT, np.uint8), "BayerRG8", WIDTH, HEIGHT, halved=True)
    pixels, mask = image.reshape(HEIGHT, WIDTH, -1), np.zeros((HEIGHT, WIDTH), np.uint8)
    clear_absorbed(pixels, mean.reshape(pixels.shape), mask, mask, (1.0, 1, 0, 0), (0, 0, HEIGHT, WIDTH), mask)
