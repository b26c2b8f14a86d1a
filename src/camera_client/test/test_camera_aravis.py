"""GigE Vision through Aravis against Aravis's own simulated camera on loopback; nothing leaves the machine."""

import pathlib
import socket
import subprocess
import sys
import threading
from itertools import pairwise

import numpy as np
import pytest

from camera_client import gige_network
from camera_client.aravis_source import AravisSource, import_aravis
from camera_client.camera_clock import CameraClock
from camera_client.gige_network import enlarge_receive_buffer, host_address_for
from camera_client.pixel_formats import choose_format, image_shape, to_image
from camera_client.settings import AravisSettings
from capture_rig.errors import InputError

ADDRESS = "127.0.0.1"
PATIENCE_S = 20.0  # only ever used up by a failing test
MS = 1_000_000


@pytest.fixture(scope="module")
def fake_camera():
    """A simulated camera at ADDRESS; skips where Aravis or the address is not to be had."""
    try:
        import_aravis()
    except InputError as error:
        pytest.skip(str(error))
    script = pathlib.Path(__file__).with_name("fake_gige_camera.py")
    process = subprocess.Popen([sys.executable, str(script), ADDRESS], stdout=subprocess.PIPE, text=True)
    try:
        if process.stdout.readline().strip() != "running":
            pytest.skip(f"the simulated camera cannot bind {ADDRESS}:{gige_network.GVCP_PORT}")
        yield ADDRESS
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def frames_of(source, count):
    """That many frames; incomplete ones are passed over."""
    frames, silences = [], 0
    while len(frames) < count:
        frame = source.read(1.0)
        if frame is None:
            silences += 1
            assert silences < PATIENCE_S, f"no frames: {source.counters}"
        else:
            frames.append(frame)
    return frames


def test_frames_arrive_in_order_with_rising_stamps(fake_camera):
    with AravisSource(AravisSettings(address=fake_camera, pixel_format="Mono8", frame_rate=50.0)) as source:
        source.start()
        frames = frames_of(source, 25)
    assert source.shape == (512, 512)
    assert all(frame.image.shape == (512, 512) and frame.image.dtype == np.uint8 for frame in frames)
    assert frames[0].image.std() > 1  # the simulated camera's moving pattern
    assert all(b.stamp_ns > a.stamp_ns for a, b in pairwise(frames))
    assert all((b.frame_id - a.frame_id) % 65535 > 0 for a, b in pairwise(frames))
    assert not np.shares_memory(frames[0].image, frames[17].image)  # copies: the pool goes round after 16


def test_camera_stamps_keep_the_camera_clock_s_spacing(fake_camera):
    with AravisSource(AravisSettings(address=fake_camera, frame_rate=50.0, stamp_source="camera")) as source:
        source.start()
        frames = frames_of(source, 20)
    steps_ms = np.diff([frame.stamp_ns for frame in frames]) / MS / np.diff([frame.frame_id for frame in frames])
    assert np.median(steps_ms) == pytest.approx(20.0, abs=1.0)
    assert "camera" in frames[0].clock


def test_settings_are_set_and_read_back(fake_camera):
    settings = AravisSettings(address=fake_camera, pixel_format="Mono8", exposure_us=5000.0, frame_rate=40.0)
    with AravisSource(settings) as source:
        assert source.details == {"camera_serial": "SAGOMA-TEST", "exposure_us": "5000"}
        assert source.description == f"camera {fake_camera}"


def test_colour_format_is_preferred_and_converted(fake_camera):
    with AravisSource(AravisSettings(address=fake_camera)) as source:
        source.start()
        assert source.shape == frames_of(source, 1)[0].image.shape == (512, 512, 3)


def test_mono_is_taken_when_asked_for(fake_camera):
    with AravisSource(AravisSettings(address=fake_camera), channels="mono") as source:
        assert source.shape == (512, 512)


def test_pixel_format_that_the_camera_lacks_is_refused(fake_camera):
    source = AravisSource(AravisSettings(address=fake_camera, pixel_format="BGR8"))
    with pytest.raises(InputError, match=r"does not offer pixel format 'BGR8' but .*Mono8.*aravis\.pixel_format"):
        source.connect()


def test_second_controller_is_refused(fake_camera):
    with AravisSource(AravisSettings(address=fake_camera)):
        other = AravisSource(AravisSettings(address=fake_camera))
        with pytest.raises(InputError, match="controlled by another program"):
            other.connect()


def test_closed_camera_can_be_opened_again_at_once(fake_camera):
    for _ in range(3):
        with AravisSource(AravisSettings(address=fake_camera)) as source:
            source.start()
            assert len(frames_of(source, 1)) == 1


def test_stop_pauses_and_start_goes_on(fake_camera):
    with AravisSource(AravisSettings(address=fake_camera, frame_rate=50.0)) as source:
        source.start()
        last = frames_of(source, 2)[-1]
        source.stop()
        with pytest.raises(InputError, match="not started"):
            source.read(0.0)
        source.start()
        assert frames_of(source, 1)[0].stamp_ns > last.stamp_ns


def test_absent_camera_is_refused_without_asking_anybody_else():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:  # bound, but mute
        taken.bind(("127.0.0.77", gige_network.GVCP_PORT))
        with pytest.raises(InputError, match=r"no GigE Vision camera answers at 127\.0\.0\.77 \(nothing answered\)"):
            host_address_for("127.0.0.77")
        taken.setblocking(False)
        assert taken.recv(100) == gige_network.DISCOVERY_COMMAND
    with pytest.raises(InputError, match=r"127\.0\.0\.78 \(Connection refused\).*ping"):
        host_address_for("127.0.0.78")


@pytest.mark.parametrize("address", ["", "cam01", "300.1.1.1", "224.0.0.1", "0.0.0.0", "192.168.1.255"])
def test_address_that_is_not_one_device_is_refused(address):
    with pytest.raises(InputError, match=r"aravis\.address"):
        host_address_for(address)


def test_device_that_answers_gives_our_own_address_on_that_link():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.79", gige_network.GVCP_PORT))

        def answer():
            _, peer = device.recvfrom(100)
            device.sendto(bytes([0, 0, 0, 3, 0, 0, 0, 1]), peer)  # DISCOVERY_ACK

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        assert host_address_for("127.0.0.79").startswith("127.")
        thread.join(PATIENCE_S)


def test_receive_buffer_of_the_right_socket_is_enlarged():
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        stream.bind((ADDRESS, 0))
        other.bind((ADDRESS, 0))
        before = other.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        assert enlarge_receive_buffer(stream.getsockname()[1], 100_000) == ""
        assert stream.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == 200_000  # Linux reports twice
        assert other.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == before


def test_receive_buffer_that_the_system_caps_is_warned_of_with_the_remedy():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream:
        stream.bind((ADDRESS, 0))
        warning = enlarge_receive_buffer(stream.getsockname()[1], 1 << 30)
    assert "sysctl -w net.core.rmem_max=1073741824" in warning


def test_socket_that_is_not_there_is_warned_of():
    assert "not found" in enlarge_receive_buffer(1, 100_000)


def test_camera_clock_takes_out_the_jitter_of_arrival():
    rng = np.random.default_rng(0)
    camera_ns = np.arange(300) * 10 * MS
    offset_ns = 7_000 * MS
    arrival_ns = camera_ns + offset_ns + 400_000 + (rng.exponential(2.0, 300) * MS).astype(int)
    clock = CameraClock()
    stamps = np.array([clock.to_host_ns(int(c), int(a)) for c, a in zip(camera_ns, arrival_ns, strict=True)])
    error_ms = (stamps - camera_ns - offset_ns)[50:] / MS
    assert error_ms.min() >= 0.4 - 1e-6 and error_ms.max() < 0.6
    assert (np.diff(stamps) > 0).all()


def test_camera_clock_follows_drift():
    camera_ns = np.arange(3000) * 10 * MS
    arrival_ns = (camera_ns * (1 + 100e-6)).astype(int) + 5 * MS  # the camera's clock is slow by 100 ppm
    clock = CameraClock()
    stamps = np.array([clock.to_host_ns(int(c), int(a)) for c, a in zip(camera_ns, arrival_ns, strict=True)])
    assert np.abs(stamps - arrival_ns).max() < 0.3 * MS


def test_bayer_images_come_out_in_bgr():
    raw = np.zeros((8, 8), np.uint8)
    raw[0::2, 0::2] = 200  # RGGB: red at the first pixel
    image = to_image(raw.tobytes(), "BayerRG8", 8, 8)
    assert image.shape == (8, 8, 3)
    blue, green, red = image[3:5, 3:5].reshape(-1, 3).mean(axis=0)
    assert red > 190 and blue < 10 and green < 10


@pytest.mark.parametrize("name, pixel", [("BGR8", [10, 20, 30]), ("RGB8", [30, 20, 10])])
def test_packed_colours_come_out_in_bgr(name, pixel):
    image = to_image(bytes([10, 20, 30] * 12), name, 4, 3)
    assert image.shape == image_shape(name, 4, 3) and image[0, 0].tolist() == pixel


def test_too_few_bytes_are_no_image():
    with pytest.raises(ValueError, match="too few"):
        to_image(bytes(11), "Mono8", 4, 3)


def test_format_choice_follows_the_channels_wanted():
    offered = ["Mono8", "Mono12", "BayerGB8", "RGB8"]
    assert choose_format(offered, "auto") == "BayerGB8"
    assert choose_format(offered, "mono") == "Mono8"
    assert choose_format(["Mono8"], "colour") is None
