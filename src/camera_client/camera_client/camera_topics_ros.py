"""Publishes what one camera gives: silhouettes with their camera_info, pictures on request, and the images themselves
while it is not calibrated yet."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import with_intrinsics
from mocap_packets.silhouette import Silhouette
from sagoma_ros import mask_png
from sagoma_ros.images import SILHOUETTE_FORMAT, camera_info_message, image_message, preview_message
from sagoma_ros.messages import to_stamp
from sagoma_ros.qos import LATCHED, RESULT, SILHOUETTE_PUBLISHER
from sagoma_ros.raw import CompressedImageWriter, StampedMessage

from .background.model import BackgroundModel
from .camera_chain import FrameResult
from .frame_source import Frame
from .settings import CameraClientSettings
from .silhouettes.pipeline import outline

PREVIEW_PERIOD_S = 0.2
SILHOUETTE_TOPIC = "silhouette/compressed"


def camera_from_message(info: CameraInfo, camera: CameraModel, where: str = "set_camera_info") -> CameraModel:
    """Return ``camera`` with the intrinsics of ``info``. Raises InputError naming ``where``, the field and value."""
    K, R = np.reshape(info.k, (3, 3)), np.reshape(info.r, (3, 3))
    if not R.any():  # zero where the sender did not fill it in
        R = np.eye(3)
    return with_intrinsics(
        camera, info.width, info.height, K.tolist(), info.distortion_model, list(info.d), R.tolist(), where
    )


class CameraTopics:
    """The publishers of one camera client, made by ``create(message type, topic, QoS)``."""

    def __init__(
        self,
        create: Callable[[type, str, Any], Any],
        frame_id: str,
        settings: CameraClientSettings,
        to_calibrate: bool = False,
    ) -> None:
        """``to_calibrate``: images are offered for the calibration, and sent while there is a subscriber."""
        self._frame_id, self._raw_always = frame_id, settings.publish_raw
        self._silhouettes = create(CompressedImage, SILHOUETTE_TOPIC, SILHOUETTE_PUBLISHER)
        self._infos = create(CameraInfo, "camera_info", SILHOUETTE_PUBLISHER)
        self._means = create(Image, "background/mean", LATCHED)
        offered = settings.publish_raw or to_calibrate
        self._raws = create(Image, "image_raw", SILHOUETTE_PUBLISHER) if offered else None
        self._previews = create(CompressedImage, "preview/compressed", RESULT) if settings.publish_preview else None
        self._info: tuple[CameraModel, StampedMessage] | None = None
        self._writer = CompressedImageWriter(frame_id, SILHOUETTE_FORMAT)
        self._last_preview_s = -np.inf

    @property
    def has_listener(self) -> bool:
        """Whether there is a subscriber to the silhouettes, or to images that are sent only then."""
        return self._silhouettes.get_subscription_count() > 0 or (not self._raw_always and self._raw_has_listener)

    @property
    def _raw_has_listener(self) -> bool:
        return self._raws is not None and self._raws.get_subscription_count() > 0

    @property
    def _preview_has_listener(self) -> bool:
        return self._previews is not None and self._previews.get_subscription_count() > 0

    def publish_image(self, frame: Frame) -> None:
        """Publish the frame as it came, with ``publish_raw`` or while somebody subscribes to calibrate the camera."""
        if self._raws is not None and (self._raw_always or self._raw_has_listener):
            self._raws.publish(image_message(frame.image, frame.stamp_ns, self._frame_id))

    def publish_uncalibrated(self, frame: Frame) -> None:
        """Publish the camera_info of a frame whose lens is unknown: K[0] = 0 says so (REP-104)."""
        info = CameraInfo(height=frame.image.shape[0], width=frame.image.shape[1])
        info.header.stamp, info.header.frame_id = to_stamp(frame.stamp_ns), self._frame_id
        self._infos.publish(info)

    def publish_silhouette(self, frame: Frame, seen: FrameResult, silhouette: Silhouette) -> None:
        """Publish the silhouette and its camera_info under one stamp; now and then a preview, while somebody looks."""
        assert seen.canvas is not None
        self._infos.publish(self._info_of(seen.canvas).at(frame.stamp_ns))
        self._silhouettes.publish(self._writer.write(frame.stamp_ns, mask_png.encode(silhouette.mask)))
        now_s = time.monotonic()
        if now_s - self._last_preview_s >= PREVIEW_PERIOD_S and self._preview_has_listener:
            assert self._previews is not None
            self._last_preview_s = now_s
            outlined = outline(frame.image, silhouette.image_mask)
            self._previews.publish(preview_message(outlined, frame.stamp_ns, self._frame_id))

    def _info_of(self, canvas: CameraModel) -> StampedMessage:
        """Return its camera_info, made once a canvas: setting and serialising its arrays costs more than all else."""
        if self._info is None or self._info[0] is not canvas:
            self._info = (canvas, StampedMessage(camera_info_message(canvas, 0, self._frame_id)))
        return self._info[1]

    def publish_background(self, model: BackgroundModel) -> None:
        """Publish the mean of the background in use."""
        self._means.publish(image_message(np.rint(model.mean).astype(np.uint8), 0, self._frame_id))
