"""Simulated cameras seen through Aravis, the library that real cameras are opened with."""

import gc

import numpy as np
import pytest
from gige_client import AravisClient, eventually

from capture_rig.errors import InputError
from virtual_studio.gige import CameraSettings, Faults, PatternScene, SimulatedCamera


class Still:
    """A scene that never changes."""

    def __init__(self, picture):
        self.picture = picture
        self.shape = picture.shape

    def image(self, instant_ns):
        return self.picture


def noise(*shape):
    return np.random.default_rng(3).integers(0, 256, shape).astype(np.uint8)


def test_every_feature_can_be_read_through_aravis(aravis, address):
    Aravis = aravis[0]
    with SimulatedCamera(address, PatternScene(colour=True)) as camera, AravisClient(aravis, address) as client:
        features = [f for f in camera.features if f.name and f.category and not f.chunk]
        assert len(features) > 60
        readers = {
            Aravis.GcFloat: client.camera.get_float,
            Aravis.GcEnumeration: client.camera.get_string,
            Aravis.GcString: client.camera.get_string,
            Aravis.GcBoolean: client.camera.get_boolean,
        }
        for feature in features:
            node = client.device.get_feature(feature.name)
            assert node is not None, feature.name
            if isinstance(node, Aravis.GcCommand):
                continue
            read = next((read for kind, read in readers.items() if isinstance(node, kind)), client.camera.get_integer)
            value = read(feature.name)
            if isinstance(node, Aravis.GcEnumeration):
                assert value in client.camera.dup_available_enumerations_as_strings(feature.name)
            elif not feature.volatile and feature.bits is None:
                assert value == camera.registers[feature.key], feature.name
        assert client.camera.get_vendor_name() == "Sagoma"
        assert client.camera.get_device_serial_number() == "SIM00001"


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


# faults: the client's tests and drills show each of the others


def picture(client):
    return client.bytes().reshape(480, 640)


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
    scene = Still(np.full((240, 320), 100, np.uint8))
    with SimulatedCamera(address, scene, CameraSettings(noise=3.0)), AravisClient(aravis, address) as client:
        client.start()
        frames = np.array([client.bytes() for _ in range(8)], float)
    deviation = np.sqrt(frames.var(axis=0, ddof=1).mean())  # in time, so that every frame has noise of its own
    assert deviation == pytest.approx(3.0, rel=0.03)
    assert frames.mean() == pytest.approx(100.0, abs=0.1)


def test_unknown_fault_and_impossible_value_are_refused_and_change_nothing():
    faults = Faults()
    with pytest.raises(InputError, match=r"no fault 'packetloss'.*packet_loss"):
        faults.update({"stall": True, "packetloss": 0.1})
    impossible = [("packet_loss", 1.5), ("packet_loss", "much"), ("stall", 3), ("light", -1), ("stamp_jump_ns", True)]
    impossible += [("stamp_jump_ns", float("inf")), ("light", 1e300)]
    for name, value in impossible:
        with pytest.raises(InputError, match=rf"{name} = "):
            faults.update({name: value})
    assert faults.active() == {}
    faults.update({"stall": 1, "packet_loss": 0.5})
    assert faults.active() == {"stall": True, "packet_loss": 0.5}
    faults.clear()
    assert faults.active() == {}
