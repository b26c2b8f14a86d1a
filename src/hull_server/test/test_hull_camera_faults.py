"""Cameras that lie: found, named, left out and taken back; honest cameras are believed whatever happens."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hull_scenes import capsule_person, carve_brute_force, look_at, ring_rig, silhouettes

from capture_rig import InputError, Rig
from hull_server.consistency.camera_fault_detector import CameraFaultDetector
from hull_server.consistency.silhouette_residuals import Hearing
from hull_server.settings import CameraFaultSettings
from hull_server.views import RigViews, min_seeing

PERIOD_S, SET_NS = 0.1, 100_000_000
LAP = 16  # judged frame sets in which the person walks once round
SIZE, FOCAL_PX = (208, 156), 152.0
OF_SIX = {3: (0, 2, 4), 4: (0, 1, 3, 4), 5: (0, 1, 2, 3, 4), 6: (0, 1, 2, 3, 4, 5)}


@cache
def rig_of(cameras):
    """The ring of six, or some of it, its cameras named in order."""
    six = ring_rig(6, size=SIZE, focal_px=FOCAL_PX)
    chosen = (six.cameras[index] for index in OF_SIX[cameras])
    return Rig(tuple(replace(camera, name=f"cam{n:02d}") for n, camera in enumerate(chosen, 1)), six.volume)


def body(frame):
    """A person who walks in a circle of half a metre and turns."""
    angle = 2 * np.pi * frame / LAP
    return capsule_person(angle, 0.5 * np.cos(angle), 0.5 * np.sin(angle))


@cache
def walking(cameras):
    """The masks of one lap; rendering them is what costs time."""
    if cameras == 6:
        return [silhouettes(rig_of(6), body(frame)) for frame in range(LAP)]
    return [
        {f"cam{n:02d}": masks[f"cam{index + 1:02d}"] for n, index in enumerate(OF_SIX[cameras], 1)}
        for masks in walking(6)
    ]


def watch_of(rig, **settings):
    return CameraFaultDetector(rig, RigViews.from_rig(rig), CameraFaultSettings(period_s=PERIOD_S, **settings))


class Session:
    """Shows a watch one frame set after another; remembers when each camera was left out."""

    def __init__(self, rig, frames, **settings):
        self.watch, self.frames, self.sets = watch_of(rig, **settings), frames, 0
        self.left_out_after, self.verdict = {}, None

    def show(self, sets, lie=lambda masks: {}):
        """``lie(masks)`` gives what the liars deliver instead."""
        begin = self.sets
        for _ in range(sets):
            masks = self.frames[self.sets % len(self.frames)]
            self.verdict = self.watch.update(masks | lie(masks), self.sets * SET_NS)
            self.sets += 1
            for name in self.verdict.left_out:
                self.left_out_after.setdefault(name, self.sets - begin)
        return self.verdict


def blank(*names):
    return lambda masks: {name: np.zeros_like(masks[name]) for name in names}


def without_legs(name):
    def lie(masks):
        cut = masks[name].copy()
        rows = np.flatnonzero(cut.any(1))
        cut[(rows[0] + rows[-1]) // 2 :] = 0
        return {name: cut}

    return lie


def turned(rig, name, axis, degrees):
    """The picture of a camera that has been turned: pixels move by K R K^-1."""
    K = rig.camera(name).undistorted_view().camera.K
    R = cv2.Rodrigues(np.radians(degrees) * np.array(axis, float))[0]
    H = K @ R @ np.linalg.inv(K)

    def lie(masks):
        return {name: cv2.warpPerspective(masks[name], H, masks[name].shape[::-1], flags=cv2.INTER_NEAREST)}

    return lie


@pytest.mark.parametrize("cameras", [3, 4, 5, 6])
def test_honest_cameras_are_all_believed_and_deny_next_to_nothing(cameras):
    session = Session(rig_of(cameras), walking(cameras))
    verdict = session.show(LAP)
    assert verdict.updated and session.left_out_after == {} and verdict.suspects == () and verdict.reasons == {}
    assert max(verdict.denied.values()) < 0.01 and max(verdict.excess.values()) < 0.01
    assert verdict.conflict < 0.05 and verdict.warning == ""
    assert all(np.hypot(*push) < 2 for push in verdict.silhouette_offset_px.values())


@pytest.mark.parametrize("liar", rig_of(5).names)
@pytest.mark.parametrize(("lie", "words"), [(blank, "is empty"), (without_legs, "denies")])
def test_camera_that_is_covered_is_named_and_left_out_within_half_a_second(lie, words, liar):
    session = Session(rig_of(5), walking(5))
    session.show(5)
    verdict = session.show(5, lie(liar))
    assert verdict.left_out == (liar,) and session.left_out_after[liar] <= 5
    assert liar in verdict.reasons[liar] and words in verdict.reasons[liar] and "other 4" in verdict.reasons[liar]


def test_leaving_the_liar_out_brings_the_body_back():
    rig, masks = rig_of(5), walking(5)[0]
    lying = masks | without_legs("cam02")(masks)
    honest, cut = (int(carve_brute_force(rig, m, 0.04, min_seeing(5)).sum()) for m in (masks, lying))
    left_out = Session(rig, walking(5)).show(6, without_legs("cam02")).left_out
    rest = {name: mask for name, mask in lying.items() if name not in left_out}
    assert cut < 0.8 * honest
    assert honest <= carve_brute_force(rig, rest, 0.04, min_seeing(4)).sum() < 1.5 * honest


@pytest.mark.parametrize(("axis", "push"), [((0, 1, 0), (-1, 0)), ((1, 0, 0), (0, 1))])
def test_camera_turned_by_two_degrees_is_left_out_and_the_push_back_is_measured(axis, push):
    """A turn about the camera's y axis moves the picture to the right: the push that cures it goes to the left."""
    rig = rig_of(6)
    session = Session(rig, walking(6))
    verdict = session.show(2 * LAP, turned(rig, "cam04", axis, 2.0))
    assert verdict.left_out == ("cam04",)
    expected_px = FOCAL_PX * np.tan(np.radians(2.0))
    assert np.dot(verdict.silhouette_offset_px["cam04"], push) == pytest.approx(expected_px, rel=0.5)
    assert verdict.misfit["cam04"] > 3 * max(share for name, share in verdict.misfit.items() if name != "cam04")
    assert "pixels" in verdict.reasons["cam04"] or "denies" in verdict.reasons["cam04"]


def test_camera_that_is_frozen_is_named_as_such_while_the_person_walks_on():
    session = Session(rig_of(5), walking(5))
    session.show(6)
    old = walking(5)[5]["cam03"]
    verdict = session.show(8, lambda masks: {"cam03": old})
    assert verdict.left_out == ("cam03",)
    assert "has not changed for" in verdict.reasons["cam03"]


def test_camera_whose_view_is_all_foreground_is_left_out_although_it_vetoes_nothing():
    session = Session(rig_of(5), walking(5))
    verdict = session.show(5, lambda masks: {"cam01": np.full_like(masks["cam01"], 255)})
    assert verdict.left_out == ("cam01",) and verdict.denied["cam01"] == 0.0
    assert "has the light changed" in verdict.reasons["cam01"]


def test_camera_is_taken_back_after_it_has_agreed_for_the_time_set_and_not_before():
    session = Session(rig_of(5), walking(5), reinstate_s=1.0)
    session.show(5, blank("cam05"))
    assert session.show(9).left_out == ("cam05",)
    verdict = session.show(4)
    assert verdict.left_out == () and verdict.reasons == {}
    assert session.show(LAP).left_out == ()


def test_camera_that_stays_blank_is_never_taken_back():
    session = Session(rig_of(5), walking(5), reinstate_s=1.0)
    assert session.show(3 * LAP, blank("cam05")).left_out == ("cam05",)
    assert all(record.agreed_s == 0.0 for record in session.watch._records)


@pytest.mark.parametrize("liars", [("cam01", "cam02"), ("cam02", "cam06")])
def test_two_cameras_that_are_covered_at_once_are_both_left_out_and_no_other(liars):
    session = Session(rig_of(6), walking(6))
    assert session.show(12, blank(*liars)).left_out == liars
    assert set(session.left_out_after) == set(liars)


def test_three_cameras_name_the_suspect_but_leave_nobody_out():
    """Of two cameras that contradict each other either may be right."""
    session = Session(rig_of(3), walking(3))
    verdict = session.show(8, blank("cam02"))
    assert verdict.left_out == () and verdict.suspects == ("cam02",) and "cam02" in verdict.reasons
    assert session.show(8).suspects == ()


def test_contradiction_that_cannot_be_blamed_on_anybody_is_a_warning():
    session = Session(rig_of(3), walking(3))
    verdict = session.show(2 * LAP, lambda masks: {"cam02": np.ascontiguousarray(masks["cam02"][:, ::-1])})
    assert verdict.left_out == () and verdict.conflict > 0.15
    assert "cam01, cam02, cam03 contradict each other" in verdict.warning
    assert session.show(2 * LAP).warning == ""


def test_as_many_cameras_remain_as_must_see_a_place():
    rig = rig_of(5)
    watch = CameraFaultDetector(rig, RigViews.from_rig(rig), CameraFaultSettings(period_s=PERIOD_S), min_seeing=5)
    for frame in range(8):
        masks = walking(5)[frame]
        verdict = watch.update(masks | blank("cam02")(masks), frame * SET_NS)
    assert verdict.left_out == ()


def test_empty_room_tells_nothing_and_changes_nothing():
    session = Session(rig_of(5), walking(5))
    session.show(6, blank("cam02"))
    empty = {name: np.zeros_like(mask) for name, mask in walking(5)[0].items()}
    for _ in range(60):
        verdict = session.show(1, lambda masks: empty)
        assert not verdict.updated and verdict.left_out == ("cam02",) and verdict.warning == ""


def test_lights_that_one_camera_alone_sees_in_an_empty_room_tell_nothing():
    session = Session(rig_of(5), [{name: np.zeros_like(mask) for name, mask in walking(5)[0].items()}])
    verdict = session.show(20, lambda masks: {"cam01": np.full_like(masks["cam01"], 255)})
    assert not verdict.updated and verdict.left_out == () and verdict.suspects == ()


def test_room_that_is_all_foreground_for_everyone_tells_nothing():
    session = Session(rig_of(5), [{name: np.full_like(mask, 255) for name, mask in walking(5)[0].items()}])
    verdict = session.show(5)
    assert not verdict.updated and verdict.left_out == ()


def test_camera_that_cannot_see_the_person_is_not_blamed_for_its_empty_silhouette():
    away = look_at("cam06", np.array([3.2, 0.0, 2.0]), np.array([3.2, 3.0, 1.5]), 300.0, SIZE)
    rig = Rig((*rig_of(5).cameras, away), rig_of(5).volume)
    frames = [masks | silhouettes(Rig((away,), rig.volume), body(0)) for masks in walking(5)]
    assert not frames[0]["cam06"].any()
    session = Session(rig, frames)
    verdict = session.show(LAP)
    assert verdict.left_out == () and verdict.denied["cam06"] == 0.0


def test_person_at_the_edge_of_the_volume_seen_by_few_cameras_blames_nobody():
    rig = ring_rig(5, size=SIZE, focal_px=270.0)  # long lenses: each sees a part
    frames = [silhouettes(rig, capsule_person(0.3 * f, 0.95 - 0.1 * f, 0.8)) for f in range(6)]
    session = Session(rig, frames)
    verdict = session.show(24)
    assert session.left_out_after == {} and verdict.suspects == ()


def test_floor_shadows_that_all_cameras_but_one_take_for_the_person_blame_nobody():
    """The one that removed the shadow is alone in denying it, and right."""
    rig, frames = rig_of(6), []
    for frame in range(0, LAP, 4):
        foot = body(frame)[-1][1] * [1, 1, 0]
        shadow = [(foot + np.array([0, k, 0]), foot + np.array([0.8, k + 0.4, 0]), 0.03) for k in (-0.05, 0.0, 0.05)]
        masks = silhouettes(rig, body(frame) + shadow)
        frames.append(masks | {"cam03": silhouettes(Rig((rig.camera("cam03"),), rig.volume), body(frame))["cam03"]})
    session = Session(rig, frames)
    verdict = session.show(24)
    assert session.left_out_after == {} and verdict.suspects == ()


def test_camera_that_delivers_nothing_is_not_judged_and_the_others_are():
    frames = [{name: mask for name, mask in masks.items() if name != "cam03"} for masks in walking(5)]
    session = Session(rig_of(5), frames)
    assert session.show(LAP).left_out == ()
    assert session.show(6, blank("cam01")).left_out == ("cam01",)


def test_frame_sets_are_heard_once_a_period_and_after_stamps_have_gone_back():
    watch, masks = watch_of(rig_of(4)), walking(4)[0]
    stamps_ms = [0, 17, 33, 50, 67, 83, 100, 117, 205, 50, 60, 150]
    heard = [ms for ms in stamps_ms if watch.update(masks, ms * 1_000_000).updated]
    assert heard == [0, 100, 205, 50, 150]


def test_watch_that_is_switched_off_leaves_nobody_out():
    assert not Session(rig_of(5), walking(5), enabled=False).show(10, blank("cam02")).left_out


def test_verdicts_are_the_same_when_the_session_is_run_again():
    def run():
        session = Session(rig_of(6), walking(6))
        return [session.show(1, turned(rig_of(6), "cam02", (0, 1, 0), 1.5)) for _ in range(20)]

    assert run() == run()


def test_mask_of_the_wrong_size_is_refused():
    masks = walking(4)[0]
    with pytest.raises(InputError, match="cam02"):
        watch_of(rig_of(4)).update(masks | {"cam02": np.zeros((7, 9), np.uint8)}, 0)


@pytest.mark.parametrize("cameras", [3, 6])
def test_hull_without_a_camera_has_the_volume_of_the_brute_force_hull_of_the_others(cameras):
    rig, masks = rig_of(cameras), walking(cameras)[3]
    hearing = Hearing(rig, RigViews.from_rig(rig), 0.04)
    for camera, name in enumerate(rig.names):
        hearing.open(camera, masks[name])
    evidence = hearing.hear(tuple(range(cameras)), ())
    for camera, name in enumerate(rig.names):
        others = {other: mask for other, mask in masks.items() if other != name}
        dense = carve_brute_force(rig, others, 0.04, min_seeing(cameras - 1))
        litres = dense[:, :, round((0.15 + 0.05) / 0.04) :].sum() * 0.04**3 * 1e3  # the floor's layers aside
        assert evidence.body_litres[camera] == pytest.approx(litres, rel=0.15)


def test_share_denied_is_the_share_of_the_others_silhouettes_that_a_cut_takes_away():
    """Brute force: the dense hulls with and without the veto, drawn voxel by voxel into the other pictures."""
    rig, masks = rig_of(6), walking(6)[7]
    masks = masks | without_legs("cam05")(masks)
    hearing = Hearing(rig, RigViews.from_rig(rig), 0.04)
    for camera, name in enumerate(rig.names):
        hearing.open(camera, masks[name])
    denied = hearing.hear(tuple(range(6)), ()).denied[rig.names.index("cam05")]
    others = {name: mask for name, mask in masks.items() if name != "cam05"}
    hulls = [carve_brute_force(rig, m, 0.02, 4) for m in (masks, others)]
    covered = [[_drawn(rig.camera(name), rig.volume, hull, masks[name]) for name in others] for hull in hulls]
    expected = 1 - np.sum(covered[0]) / np.sum(covered[1])
    assert 0.2 < expected < 0.6 and denied == pytest.approx(expected, abs=0.08)


def _drawn(camera, volume, hull, mask):
    """Pixels of the mask that the hull's voxels of 20 mm cover."""
    points = volume.low + (np.argwhere(hull) + 0.5) * 0.02
    view = camera.undistorted_view()
    in_camera = points @ camera.R_camera_world.T + camera.t_camera_world
    pixels = in_camera @ view.camera.K.T
    u, v = np.round(pixels[:, :2] / pixels[:, 2:]).astype(int).T
    image = np.zeros_like(mask)
    inside = (u >= 0) & (v >= 0) & (u < mask.shape[1]) & (v < mask.shape[0])
    image[v[inside], u[inside]] = 1
    return int((cv2.dilate(image, np.ones((3, 3), np.uint8)) & (mask > 0)).sum())
