"""From a frame to a silhouette, with the calibration and the background in use; both may be replaced at any time."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.camera import CameraModel
from capture_rig.rig import Volume

from .background_files import read_background
from .background_model import BackgroundModel, load_background
from .footage_reader import open_footage
from .frame_checks import FrameChecks
from .frame_source import Frame
from .settings import CameraClientSettings
from .silhouette import Silhouette, SilhouettePipeline


@dataclass(frozen=True, eq=False)
class Seen:
    """What one frame gave: ``flags`` of the frame itself (see frame_checks.REMEDIES); no silhouette without background.

    ``canvas`` is the undistorted camera that the silhouette's mask belongs to; ``gain`` how much brighter than learned
    the scene has slowly become.
    """

    canvas: CameraModel
    flags: tuple[str, ...]
    silhouette: Silhouette | None = None
    gain: float = 1.0


@dataclass(frozen=True, eq=False)
class _Tools:
    """Everything that is replaced as one, between two frames."""

    camera: CameraModel
    checks: FrameChecks
    pipeline: SilhouettePipeline | None = None
    background: BackgroundModel | None = None


class CameraChain:
    """Checks frames and finds silhouettes. Frames come on one thread; what is used may be replaced on another."""

    def __init__(self, camera: CameraModel, settings: CameraClientSettings, volume: Volume | None = None) -> None:
        self._settings, self._volume = settings, volume
        self._tools = _Tools(camera, FrameChecks(settings.frame_checks))

    @property
    def camera(self) -> CameraModel:
        """The calibrated camera in use."""
        return self._tools.camera

    @property
    def background(self) -> BackgroundModel | None:
        """The background in use."""
        return self._tools.background

    @property
    def pipeline(self) -> SilhouettePipeline | None:
        """The pipeline in use; None without a background."""
        return self._tools.pipeline

    def use_background(self, model: BackgroundModel | None) -> None:
        """From the next frame on. Raises InputError when it does not fit the camera's image size."""
        self._tools = self._made(self.camera, model)

    def use_camera(self, camera: CameraModel) -> None:
        """Another calibration of the same camera, from the next frame on."""
        self._tools = self._made(camera, self.background)

    def use_shape(self, shape: tuple[int, ...]) -> bool:
        """Images will have this shape: take the background that the settings name, unless one of it is in use.

        True when the background was replaced. Raises InputError when the file cannot be read or does not fit.
        """
        if self.background is not None and self.background.shape == shape:
            return False
        path = self._settings.background
        self.use_background(read_background(path, shape, self._settings.background_model) if path else None)
        return bool(path)

    def check_background_file(self) -> None:
        """Raises InputError when the background that the settings name is not there, whatever the images' shape."""
        path = self._settings.background
        if path.endswith(".npz"):
            load_background(path)
        elif path:
            open_footage(path).close()

    def run(self, frame: Frame) -> Seen:
        """Raises InputError for a frame of another size or type."""
        tools = self._tools
        canvas = tools.camera.undistorted_view().camera
        if tools.pipeline is None:
            return Seen(canvas, tools.checks.look(frame.image, frame.stamp_ns))
        silhouette = tools.pipeline.run(frame.image, frame.stamp_ns)
        gain = tools.pipeline.gain
        return Seen(canvas, tools.checks.look(frame.image, frame.stamp_ns, gain), silhouette, gain)

    def _made(self, camera: CameraModel, model: BackgroundModel | None) -> _Tools:
        s = self._settings
        if model is None:
            return _Tools(camera, FrameChecks(s.frame_checks))
        pipeline = SilhouettePipeline(camera, model, s.silhouette, s.background_model, self._volume)
        return _Tools(camera, FrameChecks(s.frame_checks, model.mean), pipeline, model)
