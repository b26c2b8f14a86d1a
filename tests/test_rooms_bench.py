"""What bench/rooms.py does to footage is what it says: light, movement, noise, things; and its scores."""

import json

import numpy as np
import pytest
import room_rivals
from room_clips import RoomClip, open_clip
from room_disturbances import Disturbance
from room_methods import CanvasTruth, Score
from room_studio import Look, studio_clip

SECONDS = 2.0


@pytest.fixture(scope="module")
def clip():
    return studio_clip(Look(), SECONDS)


def background_levels(clip: RoomClip, camera: str, frame: int, reference: RoomClip) -> tuple[np.ndarray, np.ndarray]:
    """Levels of pixels that never show the person, as they are and in the reference."""
    free = reference.truth[camera].max(axis=0) == 0
    return clip.take[camera][frame][free].astype(float), reference.take[camera][frame][free].astype(float)


def test_light_changes_slowly_to_the_stated_share_and_the_background_keeps_it(clip):
    changed, camera = Disturbance(brightness=0.1).apply(clip), clip.scored_cameras[0]
    for frame, share in ((0, 1.0), (clip.frames // 2, 1.05), (clip.frames - 1, 1.1)):
        now, before = background_levels(changed, camera, frame, clip)
        assert now.mean() / before.mean() == pytest.approx(share, abs=0.004)
    assert changed.empty[camera] is clip.empty[camera]


def test_sudden_light_is_a_step_and_half_a_second_after_it_is_not_scored(clip):
    changed, camera, middle = Disturbance(brightness=-0.2, sudden=True).apply(clip), clip.rig.names[0], clip.frames // 2
    ratios = []
    for frame in (middle - 1, middle):
        now, before = background_levels(changed, camera, frame, clip)
        ratios.append(now.mean() / before.mean())
    assert ratios == pytest.approx([1.0, 0.8], abs=0.004)
    unscored = [frame for frame in clip.scored if frame not in changed.scored]
    assert unscored and all(0 <= (frame - middle) / clip.fps < 0.5 for frame in unscored)


def test_moved_picture_takes_the_exact_mask_along(clip):
    changed, camera = Disturbance(shift_px=2.0).apply(clip), clip.scored_cameras[1]
    frame = clip.frames // 2
    before, now = (np.argwhere(c.truth[camera][frame]).mean(axis=0) for c in (clip, changed))
    assert np.linalg.norm(now - before) == pytest.approx(2.0, abs=0.3)  # masks move by whole pixels


def test_noise_is_added_to_take_and_background(clip):
    changed, camera = Disturbance(noise=4.0).apply(clip), clip.scored_cameras[0]
    for before, now in ((clip.empty, changed.empty), (clip.take, changed.take)):
        added = now[camera][3].astype(float) - before[camera][3]
        assert added.std() == pytest.approx(4.0, rel=0.05)


def test_things_never_lie_under_the_person_and_come_and_go(clip):
    changed, camera = Disturbance(things=2).apply(clip), clip.rig.names[0]
    assert changed.frames == 2 * clip.frames
    ever = clip.truth[camera].max(axis=0) > 0
    put_in = np.abs(changed.take[camera][0].astype(int) - clip.take[camera][0]) > 6
    taken_out = np.abs(changed.empty[camera][0].astype(int) - clip.empty[camera][0]) > 6
    for place in (put_in, taken_out):
        assert place.sum() > 300
        assert not (place & ever).any()


def test_clip_is_the_same_after_saving_and_opening(clip, tmp_path):
    clip.save(tmp_path / "kept")
    opened = open_clip(tmp_path / "kept")
    assert opened.fps == clip.fps and opened.rig.names == clip.rig.names
    assert room_rivals.checksum(opened) == room_rivals.checksum(clip)


def test_exact_masks_score_one_and_false_foreground_counts_in_percent_of_the_picture(clip):
    truth, camera = CanvasTruth(clip), clip.scored_cameras[0]
    mask = truth.of(camera, clip.scored[0])
    score = Score()
    score.add(mask, mask)
    assert score.means() == (1.0, 1.0, 0.0)
    wrong = mask.copy()
    wrong[mask == 0] = 255
    other = Score()
    other.add(wrong, mask)
    iou, recall, false_percent = other.means()
    person = np.count_nonzero(mask) / mask.size
    assert (iou, recall, false_percent) == pytest.approx((person, 1.0, 100 * (1 - person)))


def test_recorded_figures_of_rivals_count_for_the_frames_they_were_measured_on_alone(clip, tmp_path, monkeypatch):
    monkeypatch.setattr(room_rivals, "RECORD", tmp_path / "record.json")
    figures = {"GSOC": {"iou": 0.5}}
    room_rivals.record("a row", room_rivals.checksum(clip), figures)
    assert json.loads(room_rivals.RECORD.read_text())["a row"]["methods"] == figures
    assert room_rivals.recorded("a row", clip) == figures
    room_rivals.record("a row", room_rivals.checksum(clip), {"KNN": {"iou": 0.4}})
    assert room_rivals.recorded("a row", clip) == figures | {"KNN": {"iou": 0.4}}
    assert room_rivals.recorded("a row", Disturbance(noise=1.0).apply(clip)) == {}
