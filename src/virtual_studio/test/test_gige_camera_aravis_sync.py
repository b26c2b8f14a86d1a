"""Simulated cameras in step, seen through Aravis: triggers, scheduled actions, PTP, clocks."""

import time

import numpy as np
import pytest
from gige_client import AravisClient, eventually
from still_scene import Still, noise

from gige_vision.gvcp import Action
from virtual_studio.gige import CameraSettings, EventLoop, PatternScene, SimulatedCamera, TriggerWire, free_addresses

MS = 1_000_000
TAI_MINUS_UTC_NS = 37_000_000_000


def test_software_triggers_take_one_frame_each(aravis, address):
    with SimulatedCamera(address, PatternScene()) as camera, AravisClient(aravis, address) as client:
        client.camera.set_trigger("Software")
        client.start()
        for expected in (1, 2, 3):
            client.camera.software_trigger()
            assert client.buffer().get_frame_id() == expected
        assert camera.counters["triggers"] == 3
        eventually(lambda: camera.counters["frames_sent"] == 3)  # counted when the last packet has left


def open_all(aravis, cameras, **more):
    return [AravisClient(aravis, camera.address, **more) for camera in cameras]


@pytest.fixture
def three_cameras():
    """Three cameras of one loop and one trigger wire."""
    loop = EventLoop()
    loop.start()
    wire = TriggerWire(loop)
    scene = Still(noise(48, 64))
    cameras = [
        SimulatedCamera(
            address, scene, CameraSettings(seed=i, ptp_settle_s=0.1, drift_ppm=20.0 * i), loop=loop, wire=wire
        )
        for i, address in enumerate(free_addresses(3))
    ]
    for camera in cameras:
        camera.start()
    yield cameras
    for camera in cameras:
        camera.close()
    loop.stop()


def enable_ptp(client):
    client.camera.set_boolean("PtpEnable", True)
    eventually(lambda: client.camera.get_string("PtpStatus") == "Slave", "PTP status Slave")


def utc_stamps(clients):
    """The stamps of each client's next frame, in PTP time brought back to UTC."""
    return [client.buffer().get_timestamp() - TAI_MINUS_UTC_NS for client in clients]


def test_wire_pulse_triggers_all_cameras_at_one_instant(aravis, three_cameras):
    clients = open_all(aravis, three_cameras)
    for client in clients:
        enable_ptp(client)
        client.camera.set_trigger("Line1")
        client.start()
    for _ in range(3):
        instant_ns = three_cameras[0].wire.pulse()
        stamps = utc_stamps(clients)
        assert max(abs(stamp - instant_ns) for stamp in stamps) <= 200
    for client in clients:
        client.__exit__()


def test_scheduled_actions_expose_three_cameras_at_the_instant_they_name(aravis, three_cameras):
    from gige_client import GvcpClient

    clients = open_all(aravis, three_cameras)
    for client in clients:
        enable_ptp(client)
        for key, value in (("ActionDeviceKey", 1), ("ActionGroupKey", 2), ("ActionGroupMask", 4)):
            client.camera.set_integer(key, value)
        client.camera.set_trigger("Action1")
        client.start()
    senders = [GvcpClient(camera.address) for camera in three_cameras]
    for _ in range(5):
        instant_ns = time.time_ns() + 300 * MS  # so far ahead that a busy machine is not late with the command
        for sender in senders:
            sender.send_packet(Action(1, 2, 4, instant_ns + TAI_MINUS_UTC_NS).command())
            assert sender.receive().status == 0
        stamps = utc_stamps(clients)
        assert max(abs(stamp - instant_ns) for stamp in stamps) <= 200
        assert max(stamps) - min(stamps) <= 200
    for client, sender in zip(clients, senders, strict=True):
        client.__exit__()
        sender.__exit__()


def test_free_running_cameras_expose_in_step_whenever_they_start(aravis, three_cameras):
    clients = open_all(aravis, three_cameras)
    seen = []
    for client in clients:
        enable_ptp(client)
        client.camera.set_frame_rate(50.0)
        client.start()
        seen.append({round(stamp - TAI_MINUS_UTC_NS, -3) // 1000 for _, stamp, _ in client.buffers(3)})
    for stamps in seen:
        assert all(abs((stamp + 10_000) % 20_000 - 10_000) <= 1 for stamp in stamps)  # us, multiples of 20 ms of UTC
    for client in clients:
        client.__exit__()


def test_sync_free_run_timer_counts_from_its_start_time(aravis, three_cameras):
    with AravisClient(aravis, three_cameras[0].address) as client:
        enable_ptp(client)
        start_ns = time.time_ns() + TAI_MINUS_UTC_NS + 100 * MS + 1_234_567
        client.camera.set_integer("SyncFreeRunTimerStartTimeLow", start_ns & 0xFFFFFFFF)
        client.camera.set_integer("SyncFreeRunTimerStartTimeHigh", start_ns >> 32)
        client.camera.set_float("SyncFreeRunTimerTriggerRate", 40.0)
        client.camera.execute_command("SyncFreeRunTimerUpdate")
        client.camera.set_boolean("SyncFreeRunTimerEnable", True)
        stamps = [stamp for _, stamp, _ in client.start().buffers(5)]
    assert stamps[0] >= start_ns - 200
    for stamp in stamps:
        assert abs((stamp - start_ns + 12_500_000) % 25_000_000 - 12_500_000) <= 200


def test_ptp_settles_and_stamps_are_tai_at_the_start_of_the_exposure(aravis, address):
    scene = PatternScene()
    settings = CameraSettings(ptp_settle_s=0.2, ptp_offset_ns=100)
    with SimulatedCamera(address, scene, settings), AravisClient(aravis, address) as client:
        assert client.camera.get_string("PtpStatus") == "Disabled"
        client.camera.set_boolean("PtpEnable", True)
        states = []
        eventually(lambda: states.append(client.camera.get_string("PtpStatus")) or states[-1] == "Slave")
        assert "Listening" in states
        client.camera.execute_command("PtpDataSetLatch")
        assert abs(client.camera.get_integer("PtpOffsetFromMaster")) <= 100
        for _, stamp, data in client.start().buffers(3):
            _, middle_ns = PatternScene.read(np.frombuffer(data, np.uint8).reshape(480, 640))
            assert stamp - TAI_MINUS_UTC_NS == pytest.approx(middle_ns - 2 * MS, abs=200)  # 4 ms of exposure


def test_clock_latch_reads_the_counter_that_stamps_the_frames(aravis, address):
    with SimulatedCamera(address, PatternScene()), AravisClient(aravis, address) as client:
        client.camera.execute_command("TimestampLatch")
        before = client.camera.get_integer("TimestampLatchValue")
        stamp = client.start().buffer().get_timestamp()
        client.camera.execute_command("TimestampLatch")
        after = client.camera.get_integer("TimestampLatchValue")
    assert before < stamp < after < before + 60_000 * MS
