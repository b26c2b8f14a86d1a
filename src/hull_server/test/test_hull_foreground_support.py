"""What the others say of a camera's foreground: a body, something outside the volume, nobody, or nothing at all."""

import numpy as np
import pytest
from hull_scenes import VOLUME, capsule_person, ring_rig, silhouettes

from capture_rig import Rig, Volume
from hull_server.consistency.foreground_support import SupportReporter
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import CameraFaultSettings, HullSettings
from hull_server.views import RigViews
from mocap_packets.frame_set import FrameSet
from mocap_packets.silhouette import BODY, NOBODY, OUTSIDE, SUPPORT_PERIOD_S, UNJUDGED

STEP_NS = round(SUPPORT_PERIOD_S * 1e9)
WIDE = (640, 480)
SMALL = Volume(np.array([-0.9, -0.9, -0.05]), np.array([0.9, 0.9, 1.9]))  # all of it seen by all cameras


class Reports:
    """Reports on one rig, a period apart; every camera has shown a person at first."""

    def __init__(self, rig, proven=True):
        self.rig, self.reporter, self.sets = rig, SupportReporter(rig, RigViews.from_rig(rig)), 0
        if proven:
            self.of(silhouettes(rig, capsule_person()))

    def of(self, masks, left_out=()):
        self.sets += 1
        used = {name: mask for name, mask in masks.items() if name not in left_out}
        reports = self.reporter.update(masks, used, self.sets * STEP_NS)
        return {report.camera: report for report in reports}


def levels_at(report, mask):
    """The levels of the cells in which a canvas mask shows something."""
    rows, columns = np.nonzero(mask)
    return set(report.cells[rows // report.cell_px, columns // report.cell_px].tolist())


def with_thing(rig, masks, name, side=16):
    """A square thing in one camera's picture, away from the person; and where it is."""
    thing = np.zeros_like(masks[name])
    left = int(np.flatnonzero(masks[name].any(axis=0))[-1]) + 10
    row = 4 * masks[name].shape[0] // 7
    thing[row : row + side, left : left + side] = 255
    thing[~rig.camera(name).undistorted_view().seen] = 0
    assert thing.any()
    return masks | {name: masks[name] | thing}, thing


@pytest.fixture(scope="module")
def rig():
    return ring_rig(6, volume=SMALL, size=WIDE, focal_px=300.0)


def test_person_is_a_body_to_every_camera_and_a_thing_in_one_picture_is_nobody(rig):
    masks = silhouettes(rig, capsule_person(0.4))
    shown, thing = with_thing(rig, masks, "cam02")
    reports = Reports(rig).of(shown)
    assert set(reports) == set(rig.names)
    for name, mask in masks.items():
        assert levels_at(reports[name], mask) == {BODY}
    assert levels_at(reports["cam02"], thing) == {NOBODY}


@pytest.mark.parametrize("missing", [1, 2])
def test_person_whom_some_of_the_others_miss_is_still_a_body(rig, missing):
    masks = silhouettes(rig, capsule_person(0.4))
    holes = {name: np.zeros_like(masks[name]) for name in rig.names[1 : 1 + missing]}
    report = Reports(rig).of(masks | holes)["cam01"]
    assert levels_at(report, masks["cam01"]) == {BODY}


def test_what_a_camera_shows_does_not_change_its_own_report(rig):
    masks = silhouettes(rig, capsule_person(0.4))
    clean, blind = Reports(rig).of(masks), Reports(rig).of(masks | {"cam03": np.zeros_like(masks["cam03"])})
    np.testing.assert_array_equal(clean["cam03"].cells, blind["cam03"].cells)


def test_person_who_waits_beside_the_volume_is_something_outside(rig):
    visitor = silhouettes(rig, capsule_person(1.0, 1.9, 0.4))
    reports = Reports(rig).of(silhouettes(rig, capsule_person(0.4) + capsule_person(1.0, 1.9, 0.4)))
    seen = {name: levels_at(reports[name], mask) for name, mask in visitor.items()}
    assert sum(OUTSIDE in levels for levels in seen.values()) >= 3
    for name, mask in visitor.items():  # all but her feet where she is next to a camera
        cells = reports[name].cells.repeat(8, axis=0).repeat(8, axis=1)[: mask.shape[0], : mask.shape[1]]
        assert np.mean(cells[mask > 0] == NOBODY) < 0.2


def test_nobody_is_said_only_of_rays_that_two_others_see_all_through_the_volume():
    rig = ring_rig(4, focal_px=420.0, volume=Volume(np.array([-1.5, -1.5, -0.05]), np.array([1.5, 1.5, 2.1])))
    cells = Reports(rig).of(silhouettes(rig, capsule_person()))["cam01"].cells
    points = np.random.default_rng(0).uniform(rig.volume.low + 0.1, rig.volume.high - 0.1, (20_000, 3))
    first, *others = (camera.undistorted_view() for camera in rig.cameras)
    hidden = sum(_is_seen(view, points) for view in others) < 2
    pixels = first.camera.project(points)
    shown = hidden & _is_seen(first, points)
    columns, rows = np.rint(pixels[shown]).astype(int).T // 8
    assert shown.sum() > 100
    assert np.mean(cells[rows, columns] == NOBODY) < 0.01  # of points at the edge of a picture


def _is_seen(view, points):
    height, width = view.seen.shape
    columns, rows = np.rint(np.nan_to_num(view.camera.project(points), nan=-1.0)).astype(int).T
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    return inside & view.seen[np.where(inside, rows, 0), np.where(inside, columns, 0)]


def test_two_cameras_are_too_few_to_judge_either():
    rig = ring_rig(2, volume=SMALL, size=WIDE, focal_px=300.0)
    for report in Reports(rig).of(silhouettes(rig, capsule_person())).values():
        assert set(report.cells.ravel()) == {UNJUDGED}


def test_cameras_that_never_showed_a_body_are_no_witnesses(rig):
    """Lenses may be covered: a person in the picture of the one that sees must not become its background."""
    masks = silhouettes(rig, capsule_person(0.4))
    blind = {name: mask if name == "cam01" else np.zeros_like(mask) for name, mask in masks.items()}
    report = Reports(rig, proven=False).of(blind)["cam01"]
    assert levels_at(report, masks["cam01"]) == {UNJUDGED}


def test_excluded_cameras_have_no_say(rig):
    masks = silhouettes(rig, capsule_person(0.4))
    shown, _ = with_thing(rig, masks, "cam02")
    absent = Reports(rig).of({name: mask for name, mask in shown.items() if name not in ("cam04", "cam05")})
    things = {name: with_thing(rig, masks, name, 100)[0][name] for name in ("cam04", "cam05")}
    reports = Reports(rig).of(shown | things, ("cam04", "cam05"))
    np.testing.assert_array_equal(reports["cam02"].cells, absent["cam02"].cells)
    assert "cam04" in reports


def test_shadow_supports_nothing_and_denies_nothing(rig):
    masks = silhouettes(rig, capsule_person(0.4))
    shown, thing = with_thing(rig, masks, "cam02")
    everywhere = {name: np.maximum(mask, np.uint8(60)) for name, mask in masks.items() if name != "cam02"}
    reporter = Reports(rig).reporter
    (report,) = [r for r in reporter.update(shown | everywhere, masks, 2 * STEP_NS) if r.camera == "cam02"]
    assert levels_at(report, masks["cam02"]) == {BODY} and NOBODY not in levels_at(report, thing)


def test_pipeline_reports_unless_faulty_cameras_are_not_looked_for():
    rig = Rig(ring_rig(4).cameras, VOLUME)
    frames = FrameSet.of_instant(0, silhouettes(rig, capsule_person()))
    for enabled in (True, False):
        settings = HullSettings(backend="cpu", voxel_size_m=0.04, camera_fault=CameraFaultSettings(enabled=enabled))
        names = [report.camera for report in HullPipeline(rig, settings).run(frames).support]
        assert names == (list(rig.names) if enabled else [])
