"""What the doctor concludes from the facts of a made-up machine."""

from dataclasses import replace

import numpy as np
import pytest

from camera_client.settings import AravisSettings, CameraClientSettings
from capture_rig.camera import CameraModel
from sagoma_tools.doctor.camera import check_background, check_timing
from sagoma_tools.doctor.camera_network import (
    check_bandwidth,
    check_device,
    check_interface,
    check_receive_buffer,
    stream_bytes_per_s,
)
from sagoma_tools.doctor.collect import chrony_clock
from sagoma_tools.doctor.facts import BackgroundFacts, ClockFacts, DeviceFacts, HostFacts, InterfaceFacts, Stream
from sagoma_tools.doctor.findings import Severity, error, exit_status, note, ok, warning
from sagoma_tools.doctor.machine.checks import check_host

LINK = InterfaceFacts("enp3s0", "192.168.1.1", "255.255.255.0", mtu=9000, speed_mbit=1000)
DEVICE = DeviceFacts(
    "192.168.1.11",
    name="Maker Model",
    serial="123",
    own_address="192.168.1.11",
    subnet_mask="255.255.255.0",
    controlled=False,
    controller="",
    can_ptp=True,
    can_resend=True,
)
HOST = HostFacts(
    rmem_max=8 << 20,
    cores=8,
    load=1.0,
    available_bytes=8 << 30,
    governors=("performance",) * 8,
    clock=ClockFacts("chrony", True, 20e-6),
    environment={"ROS_DOMAIN_ID": "7"},
)
CAMERA = CameraModel("cam01", 640, 480, np.eye(3), "plumb_bob", np.zeros(5), np.eye(4))
SETTINGS = CameraClientSettings(
    aravis=AravisSettings(address="192.168.1.11", exposure_us=4000.0, gain=0.0, frame_rate=60.0)
)
GREY_VGA = Stream("cam01", 640 * 480, 100.0)


def worst(findings):
    found = list(findings)
    assert all(finding.remedy for finding in found if finding.severity >= Severity.WARNING)
    return max(found, key=lambda finding: finding.severity, default=ok("nothing", ""))


def aravis(**changes):
    return replace(SETTINGS.aravis, **changes)


@pytest.mark.parametrize(
    "findings",
    [
        check_interface(LINK, DEVICE.address, SETTINGS.aravis),
        check_device(DEVICE, SETTINGS.aravis, LINK),
        check_bandwidth([GREY_VGA], LINK, 0),
        check_receive_buffer(HOST, SETTINGS.aravis),
        check_host(HOST),
        check_timing(SETTINGS),
        check_background(BackgroundFacts("bg.npz", age_s=60.0, shape=(480, 640)), CAMERA, SETTINGS),
    ],
    ids=["interface", "device", "bandwidth", "buffer", "host", "timing", "background"],
)
def test_nothing_is_found_on_a_camera_pc_as_it_should_be(findings):
    assert worst(findings).severity is Severity.OK


@pytest.mark.parametrize(
    "link, settings, severity, code, remedy",
    [
        (None, {}, Severity.ERROR, "interface.none", "ip route get 192.168.1.11"),
        (replace(LINK, up=False), {}, Severity.ERROR, "interface.down", "ip link set enp3s0 up"),
        (replace(LINK, mtu=1500), {}, Severity.WARNING, "mtu.no_jumbo_frames", "ip link set enp3s0 mtu 9000"),
        (replace(LINK, mtu=1500), {"packet_size": 8000}, Severity.ERROR, "mtu.packet_too_large", "mtu 9000"),
        (replace(LINK, speed_mbit=100), {}, Severity.WARNING, "speed.slow", "1000 Mbit/s"),
        (replace(LINK, speed_mbit=0), {}, Severity.OK, "interface.ok", ""),
        (replace(LINK, mtu=1500, loopback=True), {}, Severity.OK, "interface.ok", ""),
    ],
)
def test_interface_that_does_not_serve_is_found_with_its_remedy(link, settings, severity, code, remedy):
    finding = worst(check_interface(link, DEVICE.address, aravis(**settings)))
    assert (finding.severity, finding.code) == (severity, code) and remedy in finding.remedy


@pytest.mark.parametrize(
    "device, settings, severity, code, value",
    [
        (
            {"error": "no GigE Vision camera answers at 192.168.1.11"},
            {},
            Severity.ERROR,
            "camera.silent",
            "192.168.1.11",
        ),
        ({}, {"serial": "999"}, Severity.ERROR, "serial.differs", "'123'"),
        ({"user_id": "left"}, {"user_id": "right"}, Severity.ERROR, "user_id.differs", "'left'"),
        ({"own_address": "10.0.0.5"}, {}, Severity.WARNING, "subnet.differs", "10.0.0.0/24"),
        ({"controlled": True, "controller": "192.168.1.1"}, {}, Severity.NOTE, "control.local", "192.168.1.1"),
        ({"controlled": True, "controller": "192.168.1.9"}, {}, Severity.WARNING, "control.taken", "192.168.1.9"),
        ({"controlled": True, "controller": None}, {}, Severity.WARNING, "control.taken", ""),
        ({"controlled": None}, {}, Severity.NOTE, "control.unknown", ""),
        ({"can_ptp": False}, {"sync": "action"}, Severity.WARNING, "ptp.unsupported", "aravis.sync = action"),
        ({"can_ptp": None}, {"stamp_source": "ptp"}, Severity.NOTE, "ptp.unknown", "aravis.stamp_source = ptp"),
        ({}, {"sync": "ptp"}, Severity.OK, "camera.ok", ""),
        ({"can_resend": False}, {}, Severity.WARNING, "resend.unsupported", ""),
    ],
)
def test_camera_that_cannot_be_had_or_is_another_one_is_found(device, settings, severity, code, value):
    finding = worst(check_device(replace(DEVICE, **device), aravis(**settings), LINK))
    assert (finding.severity, finding.code) == (severity, code) and value in finding.what


def test_stream_on_the_wire_is_counted_with_the_headers_of_every_packet():
    # 300 packets of 1024 bytes of image each, and leader and trailer; 36 + 38 bytes of headers and gaps on each
    assert stream_bytes_per_s(Stream("a", 307_200, 10.0), 1024 + 36) == 10 * (307_200 + 302 * 74)


@pytest.mark.parametrize("cameras, code", [(1, "bandwidth.ok"), (3, "bandwidth.tight"), (4, "bandwidth.exceeded")])
def test_cameras_that_share_a_link_must_fit_it_together(cameras, code):
    finding = worst(check_bandwidth([GREY_VGA] * cameras, LINK, 0))  # 30.99 of 125 MB/s each
    assert finding.code == code and f"{24.8 * cameras:.0f} % of the 1000 Mbit/s" in finding.what


def test_bandwidth_without_a_frame_rate_is_unknown_and_names_the_camera():
    finding = worst(check_bandwidth([GREY_VGA, replace(GREY_VGA, camera="cam02", frame_rate=0.0)], LINK, 0))
    assert finding.code == "bandwidth.rate_unknown" and "cam02" in finding.what


def test_small_receive_buffers_are_found_with_the_sysctl_line():
    finding = worst(check_receive_buffer(replace(HOST, rmem_max=212992), SETTINGS.aravis))
    assert finding.code == "rmem_max.small" and "sysctl -w net.core.rmem_max=4194304" in finding.remedy


@pytest.mark.parametrize(
    "changes, severity, code, value",
    [
        ({"load": 7.5}, Severity.WARNING, "cores.busy", "0.5 of"),
        ({"available_bytes": 100 << 20}, Severity.WARNING, "memory.low", "100 MiB"),
        ({"governors": ("powersave", "performance")}, Severity.NOTE, "governor.powersave", "powersave"),
        ({"governors": ()}, Severity.NOTE, "governor.unknown", ""),
        ({"clock": ClockFacts("chrony", False)}, Severity.WARNING, "clock.unsynchronised", "chrony"),
        ({"clock": ClockFacts("chrony", True, -5e-3)}, Severity.WARNING, "clock.off", "5.0 ms"),
        ({"clock": ClockFacts(unknown_because="no chronyc")}, Severity.NOTE, "clock.unknown", "no chronyc"),
        ({"environment": {"ROS_DOMAIN_ID": "300"}}, Severity.ERROR, "ros.domain_invalid", "'300'"),
        (
            {"environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}},
            Severity.WARNING,
            "ros.discovery_local",
            "LOCALHOST",
        ),
        ({"environment": {"ROS_AUTOMATIC_DISCOVERY_RANGE": "NEAR"}}, Severity.ERROR, "ros.discovery_invalid", "'NEAR'"),
        ({"environment": {"ROS_LOCALHOST_ONLY": "1"}}, Severity.WARNING, "ros.discovery_local", "ROS_LOCALHOST_ONLY"),
        (
            {"environment": {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}},
            Severity.NOTE,
            "ros.untested_rmw",
            "rmw_cyclonedds_cpp",
        ),
        ({"aravis_error": "Aravis is not available"}, Severity.ERROR, "aravis.missing", "Aravis is not available"),
    ],
)
def test_machine_that_is_not_ready_is_found(changes, severity, code, value):
    finding = worst(check_host(replace(HOST, **changes)))
    assert (finding.severity, finding.code) == (severity, code) and value in finding.what


def test_chrony_tells_whether_and_how_well_the_clock_is_kept():
    # chronyc -c tracking: reference, its address, stratum, time, offset, ...
    synchronised = ["A29FC87B", "10.0.0.1", "3", "1763712345.6", "0.000012345", "0.00001", "0.00002"]
    assert chrony_clock(synchronised) == ClockFacts("chrony", True, 0.000012345)
    assert chrony_clock(["00000000", "", "0", "0.0", "0.0"]).in_step is False


@pytest.mark.parametrize(
    "facts, severity, code, value",
    [
        (None, Severity.NOTE, "background.none_named", ""),
        (BackgroundFacts("bg.npz", error="bg.npz: cannot be read"), Severity.ERROR, "background.unusable", "bg.npz"),
        (BackgroundFacts("bg.npz", shape=(240, 320)), Severity.ERROR, "background.size_differs", "320 x 240"),
        (BackgroundFacts("bg.npz", age_s=86400.0, shape=(480, 640)), Severity.WARNING, "background.old", "24 h"),
        (
            BackgroundFacts("bg.npz", shape=(480, 640), exposure_us="8000"),
            Severity.WARNING,
            "background.exposure_differs",
            "8000 us",
        ),
        (BackgroundFacts("bg.npz", shape=(480, 640), exposure_us="4001"), Severity.OK, "background.ok", ""),
    ],
)
def test_background_that_does_not_serve_is_found(facts, severity, code, value):
    finding = worst(check_background(facts, CAMERA, SETTINGS))
    assert (finding.severity, finding.code) == (severity, code) and value in finding.what
    assert severity is Severity.OK or "sagoma background --cameras cam01" in finding.remedy


def test_exposure_longer_than_a_frame_is_an_error():
    finding = worst(check_timing(replace(SETTINGS, aravis=aravis(exposure_us=20_000.0))))
    assert finding.code == "exposure.longer_than_frame" and "16667 us" in finding.what


def test_features_left_to_the_camera_are_noted():
    findings = list(check_timing(replace(SETTINGS, aravis=aravis(gain=-1.0))))
    (left,) = [finding for finding in findings if finding.severity is Severity.NOTE]
    assert left.code == "settings.left_to_camera" and "aravis.gain" in left.what


def test_exit_status_follows_the_gravest_finding():
    findings = [ok("a", ""), note("b", ""), warning("c", "", "do"), error("d", "", "do")]
    assert [exit_status(findings[:count]) for count in range(5)] == [0, 0, 0, 1, 2]
