"""What happens to a frame in a camera client: begun as it comes, segmented, published."""

from __future__ import annotations

import time
from functools import partial

from rclpy.impl.rcutils_logger import RcutilsLogger

from capture_rig.errors import InputError
from sagoma_ros.health import LOG_EVERY_S, NodeHealth
from sagoma_ros.inputs import Worker

from .camera_ros import CameraTopics
from .frame_processor import BegunFrame, FrameProcessor, FrameResult
from .frame_source import Frame
from .settings import CameraClientSettings

PUBLISH_DEPTH = 4  # frames of a live camera that may wait to be published: more were stale when they are sent


class FrameStages:
    """Takes the frames of one activation to their publication.

    Those of a live camera are segmented and published on two other threads, so that its next frame does not wait for
    silhouette, encoder and middleware; footage is sent before more is read.
    last : the newest frame and its results.
    """

    def __init__(
        self,
        processor: FrameProcessor,
        topics: CameraTopics,
        health: NodeHealth,
        logger: RcutilsLogger,
        settings: CameraClientSettings,
    ) -> None:
        self._processor, self._topics, self._health, self._logger = processor, topics, health, logger
        self._stamps_are_now = stamps_are_now(settings)
        self.last: tuple[Frame, FrameResult] | None = None
        self._segmenter: Worker[tuple[Frame, BegunFrame, float]] | None = None
        self._publisher: Worker[tuple[Frame, FrameResult, float]] | None = None
        if settings.source != "footage":
            lost, failed = partial(health.count, "frames_unpublished"), self.add_error
            self._publisher = Worker("publish", self._publish, PUBLISH_DEPTH, on_drop=lost, on_error=failed)
            self._segmenter = Worker("segment", self._segment, 1, on_drop=lost, on_error=failed)

    def begin(self, frame: Frame) -> None:
        """Do what the next frame needs, and let the others do the rest."""
        began_s = time.perf_counter()
        begun = frame, self._processor.begin(frame), began_s
        if self._segmenter is None:
            self._segment(begun)
        else:
            self._segmenter.put_blocking(begun)

    def close(self) -> None:
        """Finish what was begun."""
        for worker in (self._segmenter, self._publisher):
            if worker is not None:
                worker.close(finish=True)

    def add_error(self, error: Exception) -> None:
        """Count and log what a frame raised."""
        bad_frame = isinstance(error, InputError)
        self._health.count("bad_frames" if bad_frame else "failed_frames")
        text = str(error) if bad_frame else f"a frame failed: {error!r}"
        self._health.set("last_error", text)
        self._logger.error(text, throttle_duration_sec=LOG_EVERY_S)

    def _segment(self, begun: tuple[Frame, BegunFrame, float]) -> None:
        frame, work, began_s = begun
        result = self._processor.finish(work)
        self.last = frame, result
        for flag in result.flags:
            self._health.count(f"{flag}_frames")
        done = frame, result, began_s
        if self._publisher is None:
            self._publish(done)
        else:
            self._publisher.put(done)

    def _publish(self, done: tuple[Frame, FrameResult, float]) -> None:
        frame, result, began_s = done
        self._topics.publish_image(frame)
        if result.canvas is None:
            self._topics.publish_uncalibrated(frame)
        elif result.silhouette is None:
            self._health.count("frames_without_background")
            return
        else:
            self._topics.publish_silhouette(frame, result, result.silhouette)
            for flag in result.silhouette.flags:
                self._health.count(f"{flag}_masks")
        self._health.tick(frame.stamp_ns if self._stamps_are_now else None)
        self._health.set("processing_ms", 1e3 * (time.perf_counter() - began_s))


def stamps_are_now(settings: CameraClientSettings) -> bool:
    """Return whether stamps follow the system clock, so that their age is a latency."""
    if settings.source == "footage":
        return settings.footage.rate == 1.0
    return settings.source != "aravis" or settings.aravis.clock_speed == 1.0
