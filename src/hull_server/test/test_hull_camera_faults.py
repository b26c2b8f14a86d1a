"""Faulty cameras are found, named, left out and reinstated; sound cameras are used whatever happens."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hull_scenes import capsule_person, look_at, ring_rig, rotated_mask, silhouettes, walking_person

from capture_rig import Rig
from hull_server.consistency.camera_fault_detector import CameraFaultDetector
from hull_server.settings import CameraFaultSettings
from hull_server.views import RigViews

SET_NS = 100_000_000
LAP = 16  # judged frame sets in which the person walks once round
SIZE, FOCAL_PX = (208, 156), 152.0
OF_SIX = {3: (0, 2, 4), 4: (0, 1, 3, 4), 5: (0, 1, 2, 3, 4), 6: (0, 1, 2, 3, 4, 5)}


@cache
def rig_of(cameras):
    """The ring of six, or some of it, its cameras named in order."""
    six = ring_rig(6, size=SIZE, focal_px=FOCAL_PX)
    chosen = (six.cameras[index] for index in OF_SIX[cameras])
    return Rig(tuple(replace(camera, name=f"cam{n:02d}") for n, camera in enumerate(chosen, 1)), six.volume)


@cache
def walking(cameras):
    """The masks of one lap; rendering them is what costs time."""
    if cameras == 6:
        return [silhouettes(rig_of(6), walking_person(frame / LAP)) for frame in range(LAP)]
    return [
        {f"cam{n:02d}": masks[f"cam{index + 1:02d}"] for n, index in enumerate(OF_SIX[cameras], 1)}
        for masks in walking(6)
    ]


class Session:
    """Shows a detector one frame set after another; remembers when each camera was left out."""

    def __init__(self, rig, frames, min_seeing=0, **settings):
        self.detector = CameraFaultDetector(rig, RigViews.from_rig(rig), CameraFaultSettings(**settings), min_seeing)
        self.frames, self.sets = frames, 0
        self.left_out_after, self.faults = {}, None

    def show(self, sets, fault=lambda masks: {}):
        """``fault(masks)`` gives what the faulty cameras deliver instead."""
        begin = self.sets
        for _ in range(sets):
            masks = self.frames[self.sets % len(self.frames)]
            self.faults = self.detector.update(masks | fault(masks), self.sets * SET_NS)
            self.sets += 1
            for name in self.faults.left_out:
                self.left_out_after.setdefault(name, self.sets - begin)
        return self.faults


def blank(*names):
    return lambda masks: {name: np.zeros_like(masks[name]) for name in names}


def flooded(*names):
    return lambda masks: {name: np.full_like(masks[name], 255) for name in names}


def without_legs(name):
    def fault(masks):
        cut = masks[name].copy()
        rows = np.flatnonzero(cut.any(1))
        cut[(rows[0] + rows[-1]) // 2 :] = 0
        return {name: cut}

    return fault


def rotated(rig, name, rotation_deg):
    return lambda masks: {name: rotated_mask(rig, name, masks[name], rotation_deg)}


def mirrored(name):
    return lambda masks: {name: np.ascontiguousarray(masks[name][:, ::-1])}


@pytest.mark.parametrize("cameras", [3, 4, 5, 6])
def test_sound_cameras_are_all_used_and_veto_next_to_nothing(cameras):
    session = Session(rig_of(cameras), walking(cameras))
    faults = session.show(LAP)
    assert faults.updated and session.left_out_after == {} and faults.suspects == () and faults.reasons == {}
    assert all(mean.veto_fraction < 0.01 and mean.excess < 0.01 for mean in faults.means.values())
    assert faults.warning == ""


@pytest.mark.parametrize(
    ("cameras", "fault", "sets"),
    [
        (5, blank("cam01"), 5),
        (5, without_legs("cam04"), 5),
        (5, flooded("cam01"), 5),
        (5, lambda masks: {"cam03": walking(5)[5]["cam03"]}, 8),
        (6, rotated(rig_of(6), "cam04", (0.0, 2.0, 0.0)), 2 * LAP),
        (6, rotated(rig_of(6), "cam04", (2.0, 0.0, 0.0)), 2 * LAP),
        (6, blank("cam01", "cam02"), 12),
        (6, blank("cam02", "cam06"), 12),
    ],
    ids=["covered", "half covered", "flooded", "frozen", "panned", "tilted", "two at once", "two far apart"],
)
def test_faulty_cameras_are_named_and_left_out_and_no_other(cameras, fault, sets):
    session = Session(rig_of(cameras), walking(cameras))
    session.show(6)
    faulty = tuple(fault(walking(cameras)[0]))
    faults = session.show(sets, fault)
    assert faults.left_out == faulty and set(session.left_out_after) == set(faulty)
    assert all(f"{name} contradicts the other {cameras - len(faulty)}" in faults.reasons[name] for name in faulty)


def test_camera_is_reinstated_after_it_has_agreed_for_the_time_set_and_not_before():
    session = Session(rig_of(5), walking(5), reinstate_s=1.0)
    assert session.show(3 * LAP, blank("cam05")).left_out == ("cam05",)  # blank is no agreement
    assert session.show(9).left_out == ("cam05",)
    faults = session.show(4)
    assert faults.left_out == () and faults.reasons == {}
    assert session.show(LAP).left_out == ()


def test_three_cameras_name_the_suspect_but_leave_nobody_out():
    """Of two cameras that contradict each other either may be right."""
    session = Session(rig_of(3), walking(3))
    faults = session.show(8, blank("cam02"))
    assert faults.left_out == () and faults.suspects == ("cam02",) and "cam02" in faults.reasons
    assert session.show(8).suspects == ()


def test_contradiction_that_cannot_be_blamed_on_anybody_is_a_warning():
    session = Session(rig_of(3), walking(3))
    faults = session.show(2 * LAP, mirrored("cam02"))
    assert faults.left_out == ()
    assert "cam01, cam02, cam03 contradict each other" in faults.warning
    assert session.show(2 * LAP).warning == ""


def test_as_many_cameras_remain_as_must_see_a_place():
    assert Session(rig_of(5), walking(5), min_seeing=5).show(8, blank("cam02")).left_out == ()


@pytest.mark.parametrize(
    "shown",
    [blank(*rig_of(5).names), lambda masks: blank(*masks)(masks) | flooded("cam01")(masks), flooded(*rig_of(5).names)],
    ids=["empty", "lights for one camera", "all foreground"],
)
def test_room_in_which_nobody_is_seen_tells_nothing_and_reinstates_nobody(shown):
    session = Session(rig_of(5), walking(5), reinstate_s=1.0)
    session.show(6, blank("cam02"))
    for _ in range(20):
        faults = session.show(1, shown)
        assert not faults.updated and faults.left_out == ("cam02",) and faults.warning == ""


def test_camera_that_cannot_see_the_person_is_not_blamed_for_its_empty_silhouette():
    away = look_at("cam06", np.array([3.2, 0.0, 2.0]), np.array([3.2, 3.0, 1.5]), 300.0, SIZE)
    rig = Rig((*rig_of(5).cameras, away), rig_of(5).volume)
    frames = [masks | silhouettes(Rig((away,), rig.volume), walking_person(0.0)) for masks in walking(5)]
    assert not frames[0]["cam06"].any()
    session = Session(rig, frames)
    faults = session.show(LAP)
    assert faults.left_out == () and faults.means["cam06"].veto_fraction == 0.0


def test_person_at_the_edge_of_the_volume_seen_by_few_cameras_blames_nobody():
    rig = ring_rig(5, size=SIZE, focal_px=270.0)  # long lenses: each sees a part
    frames = [silhouettes(rig, capsule_person(0.3 * f, 0.95 - 0.1 * f, 0.8)) for f in range(6)]
    session = Session(rig, frames)
    faults = session.show(24)
    assert session.left_out_after == {} and faults.suspects == ()


def test_floor_shadows_that_all_cameras_but_one_take_for_the_person_blame_nobody():
    """The one that removed the shadow is alone in vetoing it, and right."""
    rig, frames = rig_of(6), []
    for frame in range(0, LAP, 4):
        person = walking_person(frame / LAP)
        foot = person[-1][1] * [1, 1, 0]
        shadow = [(foot + np.array([0, k, 0]), foot + np.array([0.8, k + 0.4, 0]), 0.03) for k in (-0.05, 0.0, 0.05)]
        masks = silhouettes(rig, person + shadow)
        frames.append(masks | {"cam03": silhouettes(Rig((rig.camera("cam03"),), rig.volume), person)["cam03"]})
    session = Session(rig, frames)
    faults = session.show(24)
    assert session.left_out_after == {} and faults.suspects == ()


def test_camera_that_delivers_nothing_is_not_judged_and_the_others_are():
    frames = [{name: mask for name, mask in masks.items() if name != "cam03"} for masks in walking(5)]
    session = Session(rig_of(5), frames)
    assert session.show(LAP).left_out == ()
    assert session.show(6, blank("cam01")).left_out == ("cam01",)


def test_consistency_is_near_one_for_sound_cameras_and_low_for_one_that_shows_what_is_not_there():
    session = Session(rig_of(6), walking(6))
    assert min(mean.consistency for mean in session.show(LAP).means.values()) > 0.9
    faults = session.show(4 * LAP, mirrored("cam03"))
    found = {name: mean.consistency for name, mean in faults.means.items()}
    assert found["cam03"] < 0.6 < min(share for name, share in found.items() if name != "cam03")
