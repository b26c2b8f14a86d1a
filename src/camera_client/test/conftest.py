"""A small camera, an empty scene it looks at, and ways to write both as footage."""

import types
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from camera_probe import DEADLINE_S, EPOCH_NS, FRAMES, CameraProbe

from camera_client.sources.aravis_source import import_aravis
from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.rig import Rig, Volume, save_rig
from virtual_studio.gige import CameraSettings, PatternScene, SimulatedCamera, free_address

WIDTH, HEIGHT = 160, 120
FPS = 50.0


def camera(name="cam01", distortion=(0.0, 0.0, 0.0, 0.0, 0.0)):
    """Looks level along world +y from 1.2 m above the floor: pixel rows below the middle meet the floor."""
    K = np.array([[150.0, 0, WIDTH / 2], [0, 150.0, HEIGHT / 2], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    T[:3, 3] = T[:3, :3] @ -np.array([0.0, -4.0, 1.2])
    return CameraModel(name, WIDTH, HEIGHT, K, "plumb_bob", np.array(distortion), T)


def calibrated():
    """The same camera after another calibration: longer lens, some distortion."""
    K = np.array([[170.0, 0, 79.0], [0, 171.0, 61.0], [0, 0, 1]])
    return replace(camera(), K=K, D=np.array([-0.1, 0.02, 0.0, 0.0, 0.0]))


def write_video(path, images, fps=FPS):
    """Lossless video (FFV1), so that tests can compare pixels exactly."""
    shape = images[0].shape
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"FFV1"), fps, (shape[1], shape[0]))
    assert writer.isOpened()
    for image in images:
        writer.write(image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    return str(path)


def empty_scene(frames, seed=0, colour=False, noise=1.5):
    """Images of a textured wall and floor with sensor noise."""
    return list(_empty_images(frames, seed, colour, noise).copy())


@lru_cache(maxsize=8)
def _empty_images(frames, seed, colour, noise):
    rng = np.random.default_rng(seed)
    shape = (HEIGHT, WIDTH, 3) if colour else (HEIGHT, WIDTH)
    base = cv2.GaussianBlur(np.random.default_rng(99).uniform(90, 170, shape), (0, 0), 1.0)
    images = [np.clip(np.rint(base + noise * rng.normal(size=shape)), 0, 255) for _ in range(frames)]
    return np.array(images, np.uint8)


def person_mask():
    """A head, a trunk and two legs with a gap between them."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.circle(mask, (80, 20), 8, 255, -1)
    mask[28:70, 68:93] = 255
    mask[70:110, 68:77] = 255
    mask[70:110, 84:93] = 255
    return mask


def with_person(image, mask=None):
    """The image with the person in it, bright on the left half and dark on the right."""
    mask = person_mask() if mask is None else mask
    person = image.copy()
    person[mask > 0] = 30
    person[(mask > 0) & (np.arange(WIDTH) < 80)] = 240
    return person


def write_rig(path, *cameras):
    save_rig(Rig(tuple(cameras) or (camera(),), Volume(np.array([-2.0, -2, 0]), np.array([2.0, 2, 2.2]))), path)
    return str(path)


@pytest.fixture
def scene():
    """The helpers above as one object."""
    return types.SimpleNamespace(
        camera=camera,
        calibrated=calibrated,
        write_video=write_video,
        empty=empty_scene,
        person_mask=person_mask,
        with_person=with_person,
        write_rig=write_rig,
        width=WIDTH,
        height=HEIGHT,
        fps=FPS,
    )


@pytest.fixture
def gige_camera():
    """``gige_camera(scene, loop=..., **settings)``: a simulated GigE Vision camera on a loopback address of its own.

    Its pictures are numbered and carry the instant of mid-exposure, unless another scene is given. Skips where Aravis
    is not installed. All cameras are switched off at the end: ask for it before the node that uses it, which closes
    first then and does not wait for dead cameras.
    """
    try:
        import_aravis()
    except InputError as error:
        pytest.skip(str(error))
    cameras = []

    def make(scene=None, *, address=None, loop=None, wire=None, **settings):
        address = address or free_address()
        scene = scene or PatternScene(256, 192)
        simulated = SimulatedCamera(address, scene, CameraSettings(**settings), loop=loop, wire=wire)
        cameras.append(simulated)
        return simulated.start()

    yield make
    for simulated in cameras:
        simulated.close()


@pytest.fixture
def bench(open_probe, monkeypatch):
    """``bench(window, **parameters)``: a probe of a camera node with these parameters, which judges its state often.

    ``window`` : frames under way before an acknowledgement is awaited.
    """
    monkeypatch.setattr("camera_client.camera_node.REPORT_PERIOD_S", 0.05)
    monkeypatch.setattr("camera_client.camera_node.CONSUMER_WAIT_S", DEADLINE_S)
    monkeypatch.setattr("camera_client.camera_node.SETTLE_S", 0.0)  # of nodes in one process
    monkeypatch.setattr("camera_client.sources.footage_source.LEAD_NS", 10**8)
    monkeypatch.setattr("camera_client.sources.footage_source.PATIENCE_S", 600.0)

    def open_bench(window=10, **parameters):
        monkeypatch.setattr("camera_client.sources.footage_source.WINDOW", window)
        return open_probe(CameraProbe, parameters)

    return open_bench


@pytest.fixture(scope="session")
def footage(tmp_path_factory):
    """Rig, background and video of a person, written once: parameters that play it as fast as it is acknowledged."""
    folder = tmp_path_factory.mktemp("footage")
    return {
        "camera_name": "cam01",
        "rig_file": write_rig(folder / "rig.yaml", camera(), camera("cam02")),
        "background": write_video(folder / "bg.avi", empty_scene(40)),
        "footage.path": write_video(
            folder / "cam01.avi", [with_person(image) for image in empty_scene(FRAMES, seed=5)]
        ),
        "footage.epoch_ns": EPOCH_NS,
        "footage.rate": 0.0,
    }


@pytest.fixture
def session(tmp_path, footage):
    """Parameters that play the common footage, its pictures, where the person is, and a folder of the test's own."""
    images = [with_person(image) for image in empty_scene(FRAMES, seed=5)]
    return types.SimpleNamespace(folder=tmp_path, images=images, parameters=footage, truth=person_mask())
