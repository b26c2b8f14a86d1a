"""A background that was good once: another camera or setting, its age, and what stands in the room for minutes."""

import datetime
from types import SimpleNamespace

import numpy as np
import pytest
from camera_pictures import learned

from camera_client.background.adaptive import FixedBackground, samples_of
from camera_client.background.causes import age_h, find_causes, other_setting, unfit
from camera_client.background.kernels import STEP_PX
from camera_client.background.model import Provenance, read_background
from camera_client.background.moved_things import MovedThings
from camera_client.background.verdict import describe_regions, find_regions
from camera_client.condition import Condition
from camera_client.diagnostics import background_findings
from camera_client.frame_source import Connection, ConnectionState
from camera_client.settings import BackgroundSettings, CameraClientSettings
from camera_client.sources.footage_reader import open_footage
from capture_rig.rig import load_rig
from capture_rig.verdict import REDO

PERIOD_S = 0.4


class Room:
    """What was foreground and kept still in frames of a learned scene, one each PERIOD_S."""

    def __init__(self, camera, background):
        self.camera, self.background, self.stamp_ns = camera, background, 0
        self.fixed = FixedBackground(background, BackgroundSettings())
        self.moved = MovedThings(camera, background.sigma)

    def see(self, seconds, frame_at):
        """Show ``frame_at(second)``; return what is told then."""
        for _ in range(round(seconds / PERIOD_S)):
            self.stamp_ns += round(PERIOD_S * 1e9)
            image = frame_at(self.stamp_ns * 1e-9)
            foreground = np.ascontiguousarray(self.fixed.distance(image, image)[::STEP_PX, ::STEP_PX])
            self.moved.update(image, samples_of(image), foreground, self.look, self.stamp_ns)
        places = describe_regions(find_regions(self.moved.static, 0.0, self.moved.block_px), self.background.shape)
        share = float(self.moved.static.mean())
        found = Condition(background_static_foreground=share, background_static_places=places)
        return find_causes(found.figures())

    def look(self, image, box):
        top, left, bottom, right = box
        at = slice(top, bottom), slice(left, right)
        return self.background.mean[at], self.fixed.distance(image, image)[at]


def room_of(scene, colour=False):
    """The empty scene, learned; and frames of it with a change."""
    frames = scene.empty(20, seed=7, colour=colour)
    room = Room(scene.camera(), learned(scene.empty(60, colour=colour)))

    def see(seconds, change=lambda image, second: image):
        return room.see(seconds, lambda second: change(frames[round(second / PERIOD_S) % 20].copy(), second))

    return room, see


def walk(scene):
    def change(image, second):
        column = int(80 + 70 * np.sin(second / 3))
        shadowed = slice(max(column - 25, 0), column + 25)
        image[90:, shadowed] = image[90:, shadowed] * 0.7
        return scene.with_person(image, np.roll(scene.person_mask(), column - 80, axis=1))

    return change, 400


def jog_on_the_spot(scene):
    def change(image, second):
        mask, clothes = scene.person_mask() > 0, 60 + 40 * np.sin(9 * second + np.arange(scene.width) / 3)
        image[mask] = np.broadcast_to(clothes, mask.shape)[mask]
        return image

    return change, 400


def stand_still(scene):
    return lambda image, second: scene.with_person(image), 120


@pytest.mark.parametrize("behaviour", [walk, jog_on_the_spot, stand_still])
def test_person_is_no_furniture(scene, behaviour):
    (room, see), (change, seconds) = room_of(scene), behaviour(scene)
    assert see(seconds, change) == () and not room.moved.static.any()


def test_chair_that_was_left_in_the_room_is_told_after_five_minutes_with_its_place(scene):
    def chair(image, second):
        image[80:110, 100:130] = 20
        return image

    room, see = room_of(scene)
    assert see(240, chair) == ()
    (finding,) = see(120, chair)
    assert room.moved.static.mean() == pytest.approx(30 * 30 / (160 * 120), rel=0.4)  # whole blocks of 8 px
    assert finding.code == "background.static" and "run sagoma background" in finding.line
    assert "5 minutes" in finding.what and "lower right at 96..135, 80.." in finding.what
    assert see(60) == ()  # taken away again


@pytest.mark.slow
def test_rendered_dance_on_the_spot_for_ten_minutes_is_no_furniture(shared_data):
    folder = shared_data("sessions", "charleston_ring5top")
    video = open_footage(folder / "cam01.mp4")
    background = read_background(folder / "cam01_background.mp4", video.probe(), BackgroundSettings())
    frames = [video.read() for _ in range(200)]
    video.close()
    room = Room(load_rig(folder / "rig.yaml").camera("cam01"), background)
    assert room.see(600, lambda second: frames[7 * round(second / PERIOD_S) % len(frames)]) == ()
    assert not room.moved.static.any()


LEARNED_AT = Provenance("camera", 100, 1.5, camera_serial="4711", exposure_us="5000", gain="0")


@pytest.mark.parametrize(
    "now, text",
    [
        (
            {"exposure_us": "8000"},
            "the exposure is 8000 us, the background was learned at 5000 us (corrected by x 1.60)",
        ),
        ({"gain": "6"}, "the gain is 6, the background was learned at 0 (corrected by x 1.60)"),
        ({"gain": "high"}, "the gain is high, the background was learned at 0 (corrected by x 1.60)"),
    ],
)
def test_setting_that_it_was_not_learned_at_is_named_with_the_correction(now, text):
    (said,) = other_setting(LEARNED_AT, now, corrected=1.6)
    assert said.line.startswith(text) and "sagoma background" in said.line and said.code
    (said,) = other_setting(LEARNED_AT, now, None)
    assert "corrected" not in said.line
    assert unfit(LEARNED_AT, now) is None


@pytest.mark.parametrize(
    "now, code",
    [
        ({"camera_serial": "4712"}, "background.other_camera"),  # the next one of the series
        ({"exposure_us": "21000"}, "background.other_exposure"),
        ({"exposure_us": "1200"}, "background.other_exposure"),
    ],
)
def test_background_that_cannot_be_corrected_is_unfit(now, code):
    reason = unfit(LEARNED_AT, now)
    assert (reason.grade, reason.code) == (REDO, code) and "sagoma background" in reason.line


@pytest.mark.parametrize("now", [{}, {"exposure_us": "5000.02"}, {"gain": "0.005"}, {"camera_serial": "4711"}])
def test_settings_that_are_the_same_or_unknown_are_no_concern(now):
    assert other_setting(LEARNED_AT, now, None) == () and unfit(LEARNED_AT, now) is None
    unknown, other = Provenance("video", 100, 1.5), {"camera_serial": "1", "gain": "6", "exposure_us": "90000"}
    assert other_setting(unknown, other, None) == () and unfit(unknown, other) is None


@pytest.mark.parametrize(
    "hours, live, limit_h, told",
    [(13, True, 12.0, True), (11, True, 12.0, False), (13, True, 0.0, False), (13, False, 12.0, False)],
)
def test_old_background_of_a_live_camera_is_told_in_hours_and_footage_is_never_old(hours, live, limit_h, told):
    created = datetime.datetime(2026, 3, 1, 8, tzinfo=datetime.UTC)
    about = Provenance("camera", 100, 1.5, created=created.isoformat())
    processor = SimpleNamespace(background=SimpleNamespace(provenance=about), condition=Condition(), refused=None)
    source = SimpleNamespace(details={}, connection=Connection(ConnectionState.STREAMING) if live else None)
    now_s = created.timestamp() + hours * 3600
    found = background_findings(processor, source, CameraClientSettings(background_age_h=limit_h), now_s)
    assert [finding.what for finding in found] == ["the background is 13 h old"] * told
    assert age_h(about, now_s) == pytest.approx(hours)
    assert age_h(Provenance("video", 100, 1.5), now_s) is None
