"""Simulated cameras: their features seen through Aravis, and what their settings and faults make of the picture."""

from collections import Counter

import numpy as np
import pytest

from capture_rig.errors import InputError
from virtual_studio.gige import CameraSettings, Faults, PatternScene, SimulatedCamera, free_address
from virtual_studio.gige.device import Device
from virtual_studio.gige.feature_table import feature_table
from virtual_studio.gige.imaging import ImagingPipeline
from virtual_studio.gige.registers import Registers


def read_features(address, names):
    """What Aravis reads of each feature that is no command: value, and choices where it has some.

    It lets go of the camera at the end; when the camera was switched off before, that would take it seconds.
    """
    gi = pytest.importorskip("gi", reason="PyGObject is not installed: apt install python3-gi gir1.2-aravis-0.8")
    gi.require_version("Aravis", "0.8")
    from gi.repository import Aravis, Gio

    inet = Gio.InetAddress.new_from_string
    device = Aravis.GvDevice.new(inet("127.0.0.1"), inet(address))
    camera, found = Aravis.Camera.new_with_device(device), {}
    texts, floats, flags = (Aravis.GcEnumeration, Aravis.GcString), Aravis.GcFloat, Aravis.GcBoolean
    readers = {texts: camera.get_string, floats: camera.get_float, flags: camera.get_boolean}
    for name in names:
        node = device.get_feature(name)
        if not isinstance(node, Aravis.GcCommand):
            read = next((read for kind, read in readers.items() if isinstance(node, kind)), camera.get_integer)
            is_choice = isinstance(node, Aravis.GcEnumeration)
            found[name] = read(name), camera.dup_available_enumerations_as_strings(name) if is_choice else None
    return found


def test_every_feature_can_be_read_through_aravis():
    with SimulatedCamera(free_address(), PatternScene(colour=True)) as simulated:
        features = {f.name: f for f in simulated.features if f.category}
        found = read_features(simulated.address, features)
        assert len(features) > 50 and found["DeviceVendorName"][0] == "Sagoma"
        for name, (value, choices) in found.items():
            if choices is not None:
                assert value in choices
            elif not features[name].volatile and features[name].bits is None:
                assert value == simulated.registers[name], name


class Imaging:
    """The imaging of a camera that is seen through its registers and faults alone."""

    def __init__(self, width, height, **settings):
        settings = CameraSettings(**settings)
        self.registers = Registers(feature_table(settings, "127.0.0.9", width, height, colour=False))
        self.faults = Faults()
        self.pipeline = ImagingPipeline(Device("127.0.0.9", settings, self.registers, self.faults, Counter(), None))

    def of(self, picture, **values):
        for key, value in values.items():
            self.registers[key] = value
        self.pipeline.refresh()
        return self.pipeline.capture(picture)


def test_exposure_gain_and_light_change_the_brightness_by_their_factors():
    camera, scene = Imaging(64, 64), np.full((64, 64), 50, np.uint8)
    for values, level in (({}, 50), ({"ExposureTime": 8000.0}, 100), ({"Gain": 20 * np.log10(2.0)}, 200)):
        assert (camera.of(scene, **values) == level).all()
    camera.faults.light = 0.5
    assert (camera.of(scene, ExposureTime=2000.0) == 25).all()


def test_sensor_noise_has_the_deviation_that_was_set_and_stays_without_light():
    camera, scene = Imaging(320, 240, noise=4.0), np.full((240, 320), 100, np.uint8)
    frames = np.array([camera.of(scene) for _ in range(8)], float)
    deviation = np.sqrt(frames.var(axis=0, ddof=1).mean())  # in time, so that every frame has noise of its own
    assert deviation == pytest.approx(4.0, rel=0.03) and frames.mean() == pytest.approx(100.0, abs=0.1)
    camera.faults.light = 0.0
    dark = camera.of(scene)
    assert dark.max() > 0 and dark.mean() < 5
    assert (dark == 0).mean() == pytest.approx(0.55, abs=0.08)  # the negative half of the noise is cut off


def test_power_cycle_forgets_settings_but_not_the_user_s_name():
    with SimulatedCamera(free_address(), PatternScene(), CameraSettings(user_id="left")) as camera:
        camera.loop.call(lambda: camera.registers.__setitem__("ExposureTime", 9000.0))
        camera.loop.call(lambda: camera.registers.__setitem__("DeviceUserID", "right"))
        camera.power_off()
        assert not camera.powered
        camera.power_on()
        assert camera.registers["ExposureTime"] == 4000.0 and camera.registers["DeviceUserID"] == "right"


def test_unknown_fault_and_impossible_value_are_refused_and_change_nothing():
    faults = Faults()
    with pytest.raises(InputError, match=r"no fault 'packetloss'.*packet_loss"):
        faults.update({"stall": True, "packetloss": 0.1})
    for name, value in [("packet_loss", "much"), ("stall", 3), ("light", -1), ("stamp_jump_ns", float("inf"))]:
        with pytest.raises(InputError, match=rf"{name} = "):
            faults.update({name: value})
    assert faults.active() == {}
    faults.update({"stall": 1, "packet_loss": 0.5})
    assert faults.active() == {"stall": True, "packet_loss": 0.5}
    faults.clear()
    assert faults.active() == {}
