"""The faults of simulated cameras, as a client sees them."""

from itertools import pairwise

import numpy as np
import pytest
from gige_client import AravisClient, eventually

from capture_rig.errors import InputError
from gige_vision.pixel_formats import PixelFormat
from virtual_studio.gige import CameraSettings, Faults, PatternScene, SimulatedCamera
from virtual_studio.gige.stream import kept_packets

SECOND_NS = 1_000_000_000


@pytest.fixture
def camera(address):
    with SimulatedCamera(address, PatternScene(), CameraSettings(frame_rate=100.0)) as camera:
        yield camera


@pytest.fixture
def client(aravis, camera):
    with AravisClient(aravis, camera.address) as client:
        yield client.start()


def picture(client):
    return client.bytes().reshape(480, 640)


def test_stalled_camera_sends_nothing_and_still_answers(camera, client):
    client.buffer()
    camera.faults.stall = True
    eventually(lambda: client.stream.timeout_pop_buffer(300_000) is None)
    assert client.camera.get_exposure_time() == 4000.0
    camera.faults.stall = False
    assert client.buffer().get_frame_id() > 1


def test_frozen_camera_repeats_its_picture_while_ids_and_stamps_go_on(camera, client):
    client.buffer()
    camera.faults.frozen = True
    eventually(lambda: np.array_equal(picture(client), picture(client)))
    first, second = client.buffers(2)
    assert first[2] == second[2]
    assert first[0] < second[0] and first[1] < second[1]
    camera.faults.frozen = False
    eventually(lambda: not np.array_equal(picture(client), picture(client)))


def test_lens_cap_leaves_the_sensor_s_noise(aravis, address):
    settings = CameraSettings(noise=4.0)
    with SimulatedCamera(address, PatternScene(), settings) as camera, AravisClient(aravis, address) as client:
        camera.faults.lens_cap = True
        client.start()
        eventually(lambda: picture(client).mean() < 5)
        dark = picture(client)
    assert dark.max() > 0
    assert (dark == 0).mean() == pytest.approx(0.55, abs=0.08)  # the negative half of the noise is cut off


def test_sensor_noise_has_the_deviation_that_was_set(aravis, address):
    class Grey:
        shape = (240, 320)

        def image(self, instant_ns):
            return np.full(self.shape, 100, np.uint8)

    with SimulatedCamera(address, Grey(), CameraSettings(noise=3.0)), AravisClient(aravis, address) as client:
        client.start()
        frames = np.array([client.bytes() for _ in range(8)], float)
    deviation = np.sqrt(frames.var(axis=0, ddof=1).mean())  # in time, so that every frame has noise of its own
    assert deviation == pytest.approx(3.0, rel=0.03)
    assert frames.mean() == pytest.approx(100.0, abs=0.1)


def test_faults_of_the_light_dim_the_picture_and_the_lens_cap_makes_it_black(camera, client):
    bright = picture(client)[20:].mean()
    camera.faults.light = 0.5
    eventually(lambda: picture(client)[20:].mean() == pytest.approx(0.5 * bright, rel=0.05))
    camera.faults.light, camera.faults.lights_off = 1.0, True
    eventually(lambda: 0 < picture(client)[20:].mean() < 0.1 * bright)
    camera.faults.lens_cap = True
    eventually(lambda: picture(client).max() == 0)


def test_stamp_jump_moves_the_clock_by_so_much(camera, client):
    client.buffers(2)
    camera.faults.stamp_jump_ns = 5 * SECOND_NS
    frames = client.buffers(40)
    steps = [(b[1] - a[1]) - 10_000_000 * (b[0] - a[0]) for a, b in pairwise(frames)]
    jumps = [step for step in steps if step > SECOND_NS]
    if not jumps:  # it came before the first of them
        client.buffers(1)
    assert all(step == pytest.approx(5 * SECOND_NS, abs=10_000_000) for step in jumps)
    assert len(jumps) <= 1


def test_wrong_format_in_the_leader_is_another_one_than_was_set(camera, client):
    assert client.buffer().get_image_pixel_format() == PixelFormat.Mono8
    camera.faults.wrong_format = True
    eventually(lambda: client.buffer(whole=False).get_image_pixel_format() == PixelFormat.Mono12)
    assert client.camera.get_pixel_format() == PixelFormat.Mono8


def test_half_of_the_packets_lost_still_gives_some_whole_frames(camera, client):
    camera.faults.packet_loss = 0.5
    client.buffers(3)
    assert camera.counters["packets_dropped"] > 30


def test_packet_loss_follows_the_seed():
    def dropped(seed):
        return kept_packets(1000, 0.3, np.random.default_rng(seed))

    assert (dropped(1) == dropped(1)).all()
    assert (dropped(1) != dropped(2)).any()
    assert 1 - dropped(1).mean() == pytest.approx(0.3, abs=0.05)


def test_unknown_fault_and_impossible_value_are_refused_and_change_nothing():
    faults = Faults()
    with pytest.raises(InputError, match=r"no fault 'packetloss'.*packet_loss"):
        faults.update({"stall": True, "packetloss": 0.1})
    impossible = [("packet_loss", 1.5), ("packet_loss", "much"), ("stall", 3), ("light", -1), ("stamp_jump_ns", True)]
    impossible += [("stamp_jump_ns", float("inf")), ("slow_control_ms", 1e300)]
    for name, value in impossible:
        with pytest.raises(InputError, match=rf"{name} = "):
            faults.update({name: value})
    assert faults.active() == {}
    faults.update({"stall": 1, "packet_loss": 0.5})
    assert faults.active() == {"stall": True, "packet_loss": 0.5}
    faults.clear()
    assert faults.active() == {}
