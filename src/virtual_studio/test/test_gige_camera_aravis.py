"""Simulated cameras seen through Aravis, the library that real cameras are opened with."""

import gc
from itertools import pairwise

import numpy as np
import pytest
from gige_client import AravisClient, eventually
from still_scene import Still, noise

from gige_vision.pixel_formats import PixelFormat
from virtual_studio.gige import CameraSettings, PatternScene, SimulatedCamera

MS = 1_000_000
TAI_MINUS_UTC_NS = 37_000_000_000


def test_every_feature_can_be_read_through_aravis(aravis, address):
    Aravis = aravis[0]
    with SimulatedCamera(address, PatternScene(colour=True)) as camera, AravisClient(aravis, address) as client:
        names = [f.name for f in camera.features if f.name and f.category and not f.chunk]
        assert len(names) > 60
        for name in names:
            node = client.device.get_feature(name)
            assert node is not None, name
            if isinstance(node, Aravis.GcCommand):
                continue
            if isinstance(node, Aravis.GcFloat):
                value = client.camera.get_float(name)
            elif isinstance(node, Aravis.GcEnumeration):
                value = client.camera.get_string(name)
                assert value in client.camera.dup_available_enumerations_as_strings(name)
            elif isinstance(node, Aravis.GcString):
                value = client.camera.get_string(name)
            elif isinstance(node, Aravis.GcBoolean):
                value = client.camera.get_boolean(name)
            else:
                value = client.camera.get_integer(name)
            feature = next(f for f in camera.features if f.name == name)
            if not feature.volatile and not isinstance(node, Aravis.GcEnumeration) and feature.bits is None:
                held = camera.registers[feature.key]
                assert value == held, name
        assert client.camera.get_vendor_name() == "Sagoma"
        assert client.camera.get_device_serial_number() == "SIM00001"


def test_frames_are_the_scene_s_pixels_with_ids_from_one_in_order(aravis, address):
    scene = PatternScene()
    with SimulatedCamera(address, scene, CameraSettings(frame_rate=100.0)), AravisClient(aravis, address) as client:
        frames = client.start().buffers(20)
    assert [block for block, _, _ in frames] == list(range(1, 21))
    for block, _, data in frames:
        picture = np.frombuffer(data, np.uint8).reshape(480, 640)
        number, instant_ns = PatternScene.read(picture)
        assert number == block - 1
        np.testing.assert_array_equal(picture, scene.picture(number, instant_ns))


@pytest.mark.parametrize("packet_size", [0, 1500, 9000, 16000])
def test_largest_packet_is_negotiated_and_any_size_carries_whole_frames(aravis, address, packet_size):
    with SimulatedCamera(address, Still(noise(480, 640))), AravisClient(aravis, address, packet_size) as client:
        if not packet_size:
            client.camera.gv_set_stream_options(client.Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
            assert 15_990 <= client.camera.gv_auto_packet_size() <= 16_000
        np.testing.assert_array_equal(client.start().bytes(), noise(480, 640).reshape(-1))


def mono_bytes(grey, name):
    """The format's bytes, pixel by pixel as the GigE Vision standard words them."""
    flat = [int(value) for value in grey.reshape(-1)]
    if name == "Mono8":
        return bytes(flat)
    depth = 10 if "10" in name else 12
    deep = [(v << (depth - 8)) | (v >> (16 - depth)) for v in flat]
    if "Packed" not in name:
        return b"".join(v.to_bytes(2, "little") for v in deep)
    low = depth - 8
    mask = (1 << low) - 1
    out = bytearray()
    for a, b in zip(deep[0::2], deep[1::2], strict=True):
        out += bytes([a >> low, (b & mask) << 4 | (a & mask), b >> low])
    return bytes(out)


@pytest.mark.parametrize("name", ["Mono8", "Mono10", "Mono10Packed", "Mono12", "Mono12Packed"])
def test_mono_formats_arrive_bit_by_bit(aravis, address, name):
    picture = noise(32, 48)
    with SimulatedCamera(address, Still(picture)), AravisClient(aravis, address) as client:
        client.camera.set_pixel_format_from_string(name)
        buffer = client.start().buffer()
        assert buffer.get_image_pixel_format() == PixelFormat[name]
        assert bytes(buffer.get_data()) == mono_bytes(picture, name)


def test_colour_formats_arrive_channel_by_channel(aravis, address):
    picture = noise(32, 48, 3)
    blue, green, red = (picture[..., i].astype(int) for i in range(3))
    with SimulatedCamera(address, Still(picture)) as _, AravisClient(aravis, address) as client:
        seen = {}
        for name in ("BGR8", "RGB8", "BayerRG8", "YUV422_8"):
            client.camera.set_pixel_format_from_string(name)
            client.start()
            seen[name] = client.bytes()
            client.camera.stop_acquisition()
            client.stream = None
            gc.collect()
    np.testing.assert_array_equal(seen["BGR8"].reshape(32, 48, 3), picture)
    np.testing.assert_array_equal(seen["RGB8"].reshape(32, 48, 3), picture[..., ::-1])
    bayer = seen["BayerRG8"].reshape(32, 48)
    np.testing.assert_array_equal(bayer[0::2, 0::2], red[0::2, 0::2])
    np.testing.assert_array_equal(bayer[0::2, 1::2], green[0::2, 1::2])
    np.testing.assert_array_equal(bayer[1::2, 0::2], green[1::2, 0::2])
    np.testing.assert_array_equal(bayer[1::2, 1::2], blue[1::2, 1::2])
    yuyv = seen["YUV422_8"].reshape(32, 24, 4).astype(int)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    assert np.abs(yuyv[..., [0, 2]].reshape(32, 48) - luma).max() <= 1
    u = np.clip(128 + 0.564 * (blue - luma), 0, 255).reshape(32, 24, 2).mean(axis=2)
    v = np.clip(128 + 0.713 * (red - luma), 0, 255).reshape(32, 24, 2).mean(axis=2)
    assert np.abs(yuyv[..., 1] - u).max() <= 1.6
    assert np.abs(yuyv[..., 3] - v).max() <= 1.6


def test_region_and_binning_cut_and_average_the_sensor(aravis, address):
    picture = noise(64, 96)
    with SimulatedCamera(address, Still(picture)), AravisClient(aravis, address) as client:
        client.camera.set_region(8, 10, 32, 20)
        np.testing.assert_array_equal(client.start().bytes().reshape(20, 32), picture[10:30, 8:40])
        client.camera.stop_acquisition()
        client.stream = None
        gc.collect()
        client.camera.set_region(0, 0, 96, 64)
        client.camera.set_binning(2, 2)
        assert client.camera.get_region()[2:] != (96, 64)
        binned = client.start().bytes().reshape(32, 48)
    means = picture.reshape(32, 2, 48, 2).mean(axis=(1, 3))
    assert np.abs(binned - means).max() <= 0.5


def test_geometry_is_locked_while_frames_are_taken(aravis, address):
    with SimulatedCamera(address, PatternScene()), AravisClient(aravis, address) as client:
        client.start().buffer()
        with pytest.raises(client.GLib.Error, match="access-denied"):
            client.camera.set_integer("Width", 320)
        client.camera.stop_acquisition()
        client.camera.set_integer("Width", 320)
        assert client.camera.get_integer("Width") == 320


def test_exposure_and_gain_change_the_brightness_by_their_factors(aravis, address):
    with SimulatedCamera(address, Still(np.full((64, 64), 50, np.uint8))), AravisClient(aravis, address) as client:
        client.start()
        assert client.bytes()[0] == 50
        client.camera.set_exposure_time(8000.0)
        eventually(lambda: client.bytes()[0] == 100)
        client.camera.set_gain(20 * np.log10(2.0))
        eventually(lambda: client.bytes()[0] == 200)
        client.camera.set_exposure_time(2000.0)
        eventually(lambda: client.bytes()[0] == 50)


def test_auto_functions_own_what_they_control(aravis, address):
    settings = CameraSettings(auto_functions="Continuous", frame_rate=200)
    with SimulatedCamera(address, PatternScene(), settings), AravisClient(aravis, address) as client:
        with pytest.raises(client.GLib.Error, match="access-denied"):
            client.camera.set_exposure_time(2000.0)
        client.camera.set_string("ExposureAuto", "Off")
        client.camera.set_exposure_time(2000.0)
        assert client.camera.get_exposure_time() == 2000.0


def test_frame_rate_spaces_the_stamps(aravis, address):
    with SimulatedCamera(address, PatternScene(), CameraSettings(drift_ppm=0)), AravisClient(aravis, address) as client:
        client.camera.set_frame_rate(125.0)
        frames = client.start().buffers(10)
    for (a, earlier, _), (b, later, _) in pairwise(frames):  # on a busy machine the camera leaves out whole periods
        periods = round((later - earlier) / (8 * MS))
        assert later - earlier == pytest.approx(8 * MS * periods, abs=2) and periods >= b - a >= 1


def test_single_frame_mode_sends_one_frame(aravis, address):
    with SimulatedCamera(address, PatternScene()) as camera, AravisClient(aravis, address) as client:
        client.camera.set_string("AcquisitionMode", "SingleFrame")
        client.start().buffer()
        eventually(lambda: camera.status()["streaming"] is False)
    assert camera.counters["frames_sent"] == 1


def test_lost_packets_are_sent_again_and_frames_are_whole(aravis, address):
    scene, settings = PatternScene(), CameraSettings(frame_rate=50)
    with SimulatedCamera(address, scene, settings) as camera, AravisClient(aravis, address) as client:
        camera.faults.packet_loss = 0.01
        for _, _, data in client.start().buffers(60):
            picture = np.frombuffer(data, np.uint8).reshape(480, 640)
            np.testing.assert_array_equal(picture, scene.picture(*PatternScene.read(picture)))
    assert camera.counters["packets_dropped"] > 5
    assert camera.counters["packets_resent"] > 5


def test_without_resend_lost_packets_leave_frames_incomplete(aravis, address):
    with SimulatedCamera(address, PatternScene()) as camera, AravisClient(aravis, address) as client:
        camera.faults.no_resend, camera.faults.packet_loss = True, 0.2
        client.start(resend=False)
        client.stream.set_property("frame-retention", 20_000)
        eventually(lambda: client.buffer(whole=False).get_status() != client.Aravis.BufferStatus.SUCCESS)
    assert camera.counters["packets_resent"] == 0


def test_packet_delay_spreads_a_frame_and_loses_nothing(aravis, address):
    with SimulatedCamera(address, Still(noise(480, 640))), AravisClient(aravis, address) as client:
        client.camera.set_integer("GevSCPD", 100_000)
        for _ in range(3):
            np.testing.assert_array_equal(
                client.start().bytes() if client.stream is None else client.bytes(), noise(480, 640).reshape(-1)
            )


def test_chunks_follow_the_image_and_agree_with_the_leader(aravis, address):
    picture = noise(480, 640)
    with SimulatedCamera(address, Still(picture)), AravisClient(aravis, address) as client:
        client.camera.set_exposure_time(5000.0)
        client.camera.set_chunks("Timestamp,ExposureTime")
        parser = client.camera.create_chunk_parser()
        assert client.camera.get_payload() > picture.size
        buffer = client.start().buffer()
        assert buffer.has_chunks()
        assert parser.get_integer_value(buffer, "ChunkTimestamp") == buffer.get_timestamp()
        assert parser.get_float_value(buffer, "ChunkExposureTime") == 5000.0
        lit = np.clip(np.rint(picture.reshape(-1) * 1.25), 0, 255)
        np.testing.assert_array_equal(np.frombuffer(buffer.get_data(), np.uint8)[: picture.size], lit)


def test_older_generation_is_opened_by_its_older_names(aravis, address):
    settings = CameraSettings(generation="old", ptp_settle_s=0.1)
    scene = Still(np.full((64, 64), 50, np.uint8))
    with SimulatedCamera(address, scene, settings), AravisClient(aravis, address) as client:
        for name in ("ExposureTime", "AcquisitionFrameRate", "Gain", "PtpEnable", "TimestampLatch"):
            assert not client.camera.is_feature_available(name)
        client.camera.set_exposure_time(8000.0)
        assert client.camera.get_float("ExposureTimeAbs") == 8000.0
        client.camera.set_integer("GainRaw", 60)  # 6.0 dB
        client.camera.set_frame_rate(50.0)
        assert client.camera.get_float("AcquisitionFrameRateAbs") == 50.0
        client.camera.set_boolean("GevIEEE1588", True)
        eventually(lambda: client.camera.get_string("GevIEEE1588Status") == "Slave")
        client.camera.execute_command("GevTimestampControlLatch")
        assert client.camera.get_integer("GevTimestampValue") > TAI_MINUS_UTC_NS
        assert client.start().bytes()[0] == round(100 * 10 ** (6 / 20))


def test_second_controller_is_refused_and_may_look(aravis, address):
    with SimulatedCamera(address, PatternScene()) as camera, AravisClient(aravis, address) as first:
        second = AravisClient(aravis, address)
        assert first.device.is_controller() and not second.device.is_controller()
        assert second.camera.get_device_serial_number() == "SIM00001"
        with pytest.raises(second.GLib.Error, match="access-denied"):
            second.camera.set_exposure_time(1000.0)
        second.close()
        assert camera.counters["control_denied"] >= 1
        first.start().buffer()  # the first one is not disturbed


def test_power_cycle_forgets_settings_but_not_the_user_s_name(aravis, address):
    with SimulatedCamera(address, PatternScene(), CameraSettings(user_id="left")) as camera:
        with AravisClient(aravis, address) as client:
            client.camera.set_exposure_time(9000.0)
            client.camera.set_string("DeviceUserID", "right")
        camera.power_off()
        assert not camera.powered
        camera.power_on()
        with AravisClient(aravis, address) as client:
            assert client.device.is_controller()
            assert client.camera.get_exposure_time() == 4000.0
            assert client.camera.get_string("DeviceUserID") == "right"
            assert client.start().buffer().get_frame_id() == 1
