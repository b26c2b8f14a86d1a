"""GigE Vision through Aravis: choosing, setting up and streaming, against simulated cameras on loopback."""

import gc
import threading
import weakref
from itertools import pairwise

import numpy as np
import pytest
from camera_pictures import frames_of, taken

from camera_client.frame_source import SourceUnavailable
from camera_client.settings import AravisSettings
from camera_client.sources.aravis_source import AravisSource
from capture_rig.errors import InputError
from virtual_studio.gige import PatternScene


def registers_of(camera):
    """The simulated camera's own registers by feature name: what it was really told."""
    return camera.loop.call(lambda: camera.registers)


def source_of(camera, channels="auto", **settings):
    return AravisSource(AravisSettings(address=camera.address, **settings), channels)


# --- choosing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", [{"serial": "S8"}, {"user_id": "right"}])
def test_camera_at_the_address_is_opened_when_serial_and_user_id_agree_and_refused_otherwise(gige_camera, wrong):
    camera = gige_camera(serial="S7", user_id="left")
    with source_of(camera, serial="S7", user_id="left") as source:
        assert source.details["camera_serial"] == "S7" and source.details["camera_user_id"] == "left"
    with pytest.raises(InputError, match=r"serial S7, user id left.*aravis\.serial") as raised:
        source_of(camera, **wrong).connect()
    assert not isinstance(raised.value, SourceUnavailable)  # waiting does not make it another camera


def test_camera_that_is_switched_off_is_unavailable(gige_camera):
    camera = gige_camera()
    camera.power_off()
    with pytest.raises(SourceUnavailable, match=r"no GigE Vision camera answers at 127\..*ping"):
        source_of(camera).connect()


def test_camera_in_use_is_unavailable(gige_camera):
    camera = gige_camera()
    with source_of(camera), pytest.raises(SourceUnavailable, match="controlled by another program"):
        source_of(camera).connect()


def test_failed_and_closed_connections_leave_the_camera_free_at_once_and_no_stream_behind(gige_camera):
    camera = gige_camera()
    with pytest.raises(InputError, match=r"does not offer pixel format 'BGR8' but Mono8.*aravis\.pixel_format"):
        source_of(camera, pixel_format="BGR8").connect()
    for _ in range(2):
        with source_of(camera) as source:
            assert source.shape == (192, 256)
            source.start()
            frames_of(source, 1)
            stream = weakref.ref(source._stream)
        gc.collect()
        assert stream() is None and camera.status()["controller"] == ""


@pytest.mark.slow  # Aravis asks a mute camera for seconds
def test_camera_that_dies_while_it_is_set_up_is_unavailable(gige_camera):
    camera = gige_camera()
    # its description is read first; from then on it is mute
    mute = {"PtpStatus": lambda: setattr(camera.faults, "unplugged", True) or 1}
    camera.loop.call(lambda: registers_of(camera).reads.update(mute))
    with pytest.raises(SourceUnavailable, match="went silent while it was set up"):
        source_of(camera).connect()


# --- features ----------------------------------------------------------------------------------------------------


def test_settings_are_set_and_read_back(gige_camera):
    camera = gige_camera()
    settings = {"exposure_us": 5000.0, "gain": 6.0, "frame_rate": 40.0, "packet_delay_ns": 2000}
    automatic = ["ExposureAuto=Continuous", "GainAuto=Continuous"]  # which locks what they steer
    with source_of(camera, features=automatic, **settings) as source:
        assert source.details["exposure_us"] == "5000" and source.details["gain"] == "6"
        registers = registers_of(camera)
        read = [registers[name] for name in ("ExposureTime", "Gain", "AcquisitionFrameRate", "GevSCPD")]
        assert read == [5000.0, 6.0, 40.0, 2000]
        assert registers.label("ExposureAuto") == registers.label("GainAuto") == "Off"


@pytest.mark.parametrize(
    "line, expected",
    [
        ("Nonsense=1", "no feature Nonsense"),
        ("Width=17000", r"refuses Width = 17000 .*Allowed: 16 to 256 in steps of 4"),
        ("ExposureAuto=Sometimes", "Allowed: Off, Once, Continuous"),
    ],
)
def test_feature_that_cannot_be_set_is_refused_by_name(gige_camera, line, expected):
    with pytest.raises(InputError, match=expected):
        source_of(gige_camera(), features=[line]).connect()


def test_region_is_centred_unless_an_offset_is_given_and_whole_or_binned_when_asked_for(gige_camera):
    whole, camera = PatternScene(256, 192).picture(0, 0), gige_camera()
    for offset_x, expected_x in ((-1, 64), (32, 32)):
        with source_of(camera, width=128, height=96, offset_x=offset_x) as source:
            camera.scene.number = 0
            source.start()
            picture = frames_of(source, 1)[0].image
        assert source.shape == (96, 128)
        np.testing.assert_array_equal(picture, whole[48:144, expected_x : expected_x + 128])
    for binning in (1, 2):
        with source_of(camera, binning=binning, width=0, height=0) as source:
            source.start()
            assert frames_of(source, 1)[0].image.shape == source.shape == (192 // binning, 256 // binning)


def test_packet_size_is_negotiated_or_taken_as_given(gige_camera):
    camera = gige_camera(max_packet_size=4000)
    with source_of(camera) as source:
        assert 3900 <= int(source.details["packet_size"]) <= 4000  # Aravis searches in steps of four bytes
    with source_of(camera, packet_size=1400) as source:
        assert source.details["packet_size"] == "1400"
        source.start()
        assert len(frames_of(source, 3)) == 3
    with pytest.raises(InputError, match=r"aravis\.packet_size"):
        source_of(camera, packet_size=9000).connect()


# --- formats -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name, most", [("Mono8", 0), ("BayerRG8", 3)])
def test_every_format_gives_the_same_picture(gige_camera, name, most):
    scene = PatternScene(256, 192, colour=name != "Mono8")
    (frame,) = taken(source_of(gige_camera(scene), pixel_format=name), 1)
    difference = np.abs(frame.image.astype(int) - scene.picture(*PatternScene.read(frame.image)))
    assert frame.image.shape == scene.shape
    assert np.median(difference[20:-4, 4:60], axis=(0, 1)).max() <= most  # away from the jumps of the stripes, mostly


def test_frame_in_another_format_than_agreed_is_counted_and_not_misread(gige_camera):
    camera = gige_camera()
    with source_of(camera) as source:
        source.start()
        frames_of(source, 2)
        camera.faults.wrong_format = True
        while source.counters["wrong_format"] < 3:
            source.read(1.0)
        camera.faults.wrong_format = False
        assert frames_of(source, 1)[0].image.shape == (192, 256)
    statistics = source.statistics
    assert statistics.incomplete >= 3
    assert statistics.expected == statistics.delivered + statistics.incomplete + statistics.lost


# --- streaming ---------------------------------------------------------------------------------------------------


def test_frames_arrive_in_order_with_rising_stamps_and_none_is_missing(gige_camera):
    with source_of(gige_camera(), frame_rate=100.0) as source:
        source.start()
        frames = frames_of(source, 40)
    assert [frame.frame_id for frame in frames] == list(range(1, 41))
    assert [PatternScene.read(frame.image)[0] for frame in frames] == list(range(40))
    assert all(b.stamp_ns > a.stamp_ns for a, b in pairwise(frames))
    assert not np.shares_memory(frames[0].image, frames[17].image)  # copies: the pool goes round after 16
    assert (source.statistics.expected, source.statistics.delivered) == (40, 40)


def test_stop_pauses_and_start_counts_on(gige_camera):
    with source_of(gige_camera(), frame_rate=20.0) as source:  # none is under way when it is stopped
        source.start()
        last = frames_of(source, 3)[-1]
        source.stop()
        source.start()
        again = frames_of(source, 5)
    assert again[0].stamp_ns > last.stamp_ns
    assert [frame.frame_id for frame in again] == [1, 2, 3, 4, 5]  # the camera begins at 1 again, and so do we
    assert (source.statistics.expected, source.statistics.lost) == (8, 0)


def test_lost_packets_are_asked_for_again(gige_camera):
    camera = gige_camera()
    with source_of(camera, frame_rate=100.0, packet_size=1000) as source:
        source.start()
        camera.faults.packet_loss = 0.02
        frames = frames_of(source, 40)
        source.stop()
    assert source.counters["resent_packets"] > 10
    truth = [PatternScene(256, 192).picture(*PatternScene.read(frame.image)) for frame in frames]
    assert all((frame.image == picture).all() for frame, picture in zip(frames, truth, strict=True))
    assert source.statistics.delivered == 40


def test_every_frame_is_accounted_for_when_the_camera_cannot_resend(gige_camera):
    camera = gige_camera()
    camera.faults.no_resend = True
    with source_of(camera, frame_rate=100.0, packet_size=8000) as source:
        assert any("lost packets" in warning for warning in source.warnings)
        source.start()
        camera.faults.packet_loss = 0.1  # of 9 packets, the leader among them
        frames_of(source, 15)
        camera.faults.packet_loss = 0.0
        last = frames_of(source, 3)[-1]
        source.stop()
    statistics = source.statistics
    assert statistics.expected == last.frame_id == statistics.delivered + statistics.incomplete + statistics.lost
    assert statistics.incomplete > 5 and statistics.delivered == 18


def test_frames_that_nobody_fetches_are_lost_and_counted(gige_camera):
    camera = gige_camera()
    with source_of(camera, frame_rate=200.0, buffers=2) as source:
        source.start()
        frames_of(source, 1)
        sent = camera.counters["frames_sent"]
        while camera.counters["frames_sent"] < sent + 10:
            threading.Event().wait(0.01)
        last = frames_of(source, 5)[-1]
        source.stop()
    statistics = source.statistics
    assert statistics.lost >= 6 and source.counters["underruns"] >= 6
    assert statistics.expected == last.frame_id == statistics.delivered + statistics.lost + statistics.incomplete


def test_taken_control_is_noticed(gige_camera):
    camera = gige_camera()
    with source_of(camera, features=["GevHeartbeatTimeout=500"]) as source:
        source.start()
        frames_of(source, 1)
        camera.power_off()
        camera.power_on()  # it has forgotten us
        for _ in range(200):
            if source.lost:
                break
            source.read(0.1)
        assert source.lost


def test_other_threads_run_while_a_frame_is_awaited(gige_camera):
    """Fails when waiting inside Aravis holds the interpreter."""
    camera = gige_camera()
    camera.faults.stall = True
    steps, done = [], threading.Event()

    def work():
        while not done.wait(0.001):
            steps.append(1)

    with source_of(camera) as source:
        source.start()
        thread = threading.Thread(target=work)
        thread.start()
        assert source.read(0.5) is None
        done.set()
        thread.join()
    assert len(steps) > 20
