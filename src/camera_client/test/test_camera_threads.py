"""Frames that are under way together, on two threads, give what one thread gives, byte for byte."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from camera_pictures import SENSOR, iou, learned, studio_walk

from camera_client.frame_processor import FrameProcessor
from camera_client.frame_source import Frame
from camera_client.settings import CameraClientSettings
from virtual_studio.recording.session import FIRST_BACKGROUND_FRAME
from virtual_studio.rig import ring

CAMERA, POSES, FRAMES, STEP_NS = 1, 6, 30, 10**8


class Take:
    """Frames of a person who walks in a room whose lamps are turned down on the way, and its learned background."""

    def __init__(self, colour):
        self.rig = ring(4, size=(320, 240))
        self.camera = self.rig.cameras[CAMERA]
        seen, empty = studio_walk(self.camera, slice(10, 10 + POSES), colour=colour)
        shots = (SENSOR.expose(empty, CAMERA, FIRST_BACKGROUND_FRAME + k) for k in range(30))
        self.background, self.truth = learned(shots), [mask for _, mask in seen]
        self.order = ([*range(POSES), *reversed(range(POSES))] * FRAMES)[:FRAMES]
        self.frames = []
        for k, pose in enumerate(self.order):
            light = np.float32(1.0 if k < FRAMES // 2 else 0.8) * seen[pose][0]
            self.frames.append(Frame(SENSOR.expose(light, CAMERA, k), k * STEP_NS, k, "test"))

    def processor(self):
        processor = FrameProcessor(self.camera, CameraClientSettings(), self.rig.volume)
        processor.use_background(self.background)
        return processor


def one_thread(processor, frames):
    return [processor.run(frame) for frame in frames]


def two_threads(processor, frames):
    with ThreadPoolExecutor(1) as segmenting:
        return [each.result() for each in [segmenting.submit(processor.finish, processor.begin(f)) for f in frames]]


@pytest.mark.parametrize("colour, pixel_m", [(False, 0.0), (True, 0.0), (True, 1.0)], ids=["mono", "colour", "halved"])
def test_threads_change_no_byte_of_silhouettes_condition_and_background(colour, pixel_m, monkeypatch):
    monkeypatch.setattr("capture_rig.visibility.MOST_PIXEL_M", pixel_m)
    take, told = Take(colour), []
    for run in (one_thread, two_threads):
        processor = take.processor()
        results = run(processor, take.frames)
        pipeline, background = processor.pipeline, processor.pipeline.background
        assert pipeline.scale == (2 if pixel_m else 1) and 0.7 < background.light.brightness < 0.9  # it is followed
        assert iou(results[-1].silhouette.image_mask, take.truth[take.order[-1]]) > 0.7
        told.append(
            [each.silhouette.mask.tobytes() + each.silhouette.image_mask.tobytes() for each in results]
            + [(each.flags, each.silhouette.foreground_fraction, each.movement.values()) for each in results]
            + [processor.condition, background.noise.read.tobytes(), background.shift.total]
            + [background.light.gain.tobytes(), background.light.field.tobytes()]
        )
    assert told[0] == told[1]
    assert len(set(told[0][:FRAMES])) == FRAMES
