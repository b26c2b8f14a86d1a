"""A background that was good once: another camera or setting, and its age."""

import datetime
from types import SimpleNamespace

import pytest

from camera_client.background.causes import age_h, unfit
from camera_client.background.model import Provenance
from camera_client.condition import Condition
from camera_client.diagnostics import background_findings
from camera_client.frame_source import Connection, ConnectionState
from camera_client.settings import CameraClientSettings
from capture_rig.verdict import REDO

LEARNED_AT = Provenance("camera", 100, 1.5, camera_serial="4711", exposure_us="5000", gain="0")


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


@pytest.mark.parametrize("now", [{}, {"exposure_us": "8000"}, {"exposure_us": "auto"}, {"camera_serial": "4711"}])
def test_settings_that_can_be_corrected_or_are_unknown_are_no_concern(now):
    assert unfit(LEARNED_AT, now) is None
    assert unfit(Provenance("video", 100, 1.5), {"camera_serial": "1", "exposure_us": "90000"}) is None


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
