"""What simulated cameras see: the pattern, a session's footage, the rendered room."""

import time

import cv2
import numpy as np
import pytest
from gige_client import eventually

from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from capture_rig.session import load_session
from stick_figure.body import Body
from virtual_studio.gige.rendered_scenes import RoomScene
from virtual_studio.gige.scenes import PatternScene, load_session_scene
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.camera import WHITE, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow
from virtual_studio.rig import ring

SECOND_NS = 1_000_000_000
NOW_NS = 1_800_000_000 * SECOND_NS
FPS, FRAMES = 25.0, 12


@pytest.mark.parametrize("colour", [False, True])
def test_pattern_tells_its_number_and_instant_even_when_dimmed(colour):
    scene = PatternScene(colour=colour)
    for expected in range(3):
        picture = scene.image(NOW_NS + expected)
        assert picture.shape == scene.shape
        assert PatternScene.read(picture) == (expected, NOW_NS + expected)
        assert PatternScene.read((picture * 0.6).astype(np.uint8)) == (expected, NOW_NS + expected)


def test_pattern_too_small_for_its_numbers_is_refused():
    with pytest.raises(InputError, match=r"64 x 48.*at least 128 x 12"):
        PatternScene(64, 48)


def write_video(path, frames, colour=False):
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), FPS, (width, height), colour)
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame)
    writer.release()


def grey_frames(base):
    return [np.full((480, 640), base + 10 * i, np.uint8) for i in range(FRAMES)]


@pytest.fixture
def session(tmp_path):
    """Two cameras whose frames tell their number by their grey level; cam02 is in colour."""
    save_rig(ring(2, ceiling=False), tmp_path / "rig.yaml")
    write_video(tmp_path / "cam01.mkv", grey_frames(20))
    tinted = [cv2.merge([g // 2, g, g]) for g in grey_frames(20)]
    write_video(tmp_path / "cam02.mkv", tinted, colour=True)
    cv2.imwrite(str(tmp_path / "cam01_background.png"), np.full((480, 640), 7, np.uint8))
    cv2.imwrite(str(tmp_path / "cam02_background.png"), np.full((480, 640), 7, np.uint8))
    return load_session(tmp_path)


def test_session_s_cameras_see_the_same_frame_at_one_instant_in_grey_and_in_colour(session):
    scene = load_session_scene(session)
    epoch_ns = scene.playback.play(NOW_NS)
    for frame in (0, 5, FRAMES - 1, FRAMES + 2):
        instant = epoch_ns + round((frame + 0.1) * SECOND_NS / FPS)
        expected = 20 + 10 * (frame % FRAMES)
        assert scene.views["cam01"].image(instant)[3, 3] == expected
        assert scene.views["cam02"].image(instant)[3, 3] == pytest.approx([expected / 2, expected, expected], abs=1)
    assert scene.views["cam01"].shape == (480, 640)
    assert scene.views["cam02"].shape == scene.views["cam02"].background[0].shape == (480, 640, 3)


def test_empty_room_is_seen_while_nobody_is_there(session):
    scene = load_session_scene(session)
    assert scene.can_be_empty
    scene.playback.occupy(False)
    later = time.time_ns() + SECOND_NS
    assert scene.views["cam01"].image(later).max() == 7
    scene.playback.occupy(True)
    assert scene.views["cam01"].image(time.time_ns() + SECOND_NS).max() >= 20
    (session.folder / "cam02_background.png").unlink()
    assert not load_session_scene(load_session(session.folder)).can_be_empty


def test_frames_that_do_not_fit_into_memory_are_left_out_for_every_camera_alike(session):
    colour_frame_mb = 480 * 640 * 3 / 1e6
    scene = load_session_scene(session, memory_mb=2 * 4.1 * colour_frame_mb / 0.75)
    assert (scene.playback.frames, scene.total_frames) == (4, FRAMES)
    assert {len(view.frames) for view in scene.views.values()} == {4}
    with pytest.raises(InputError, match=r"one frame has 0\.9 MB.*--memory"):
        load_session_scene(session, memory_mb=1.0)


@pytest.fixture
def room():
    scene = RoomScene(ring(1, ceiling=False), seconds=2.0, most_hz=1000.0)
    scene.start()
    yield scene
    scene.close()


def test_room_shows_the_body_with_its_shadow_through_each_camera_s_lens(room):
    room.playback.hold()
    body = Body.from_stature(1.75)
    capsules = VolumetricBody(body).place(MOTIONS["tour"](body, 0.1, 60.0).poses[0])
    for model in ring(1, ceiling=False).cameras:
        camera = VirtualCamera(model)
        light, mask = camera.render(capsules, floor_shadow(capsules))
        expected = np.rint(light * WHITE).astype(np.uint8)
        # what was rendered before the person stood still is seen first
        eventually(lambda name=model.name, e=expected: np.array_equal(room.views[name].image(time.time_ns()), e))
        np.testing.assert_allclose(room.empty(model.name), camera.empty_room() * WHITE, atol=0.51)
        shaded = (expected.astype(int) < room.empty(model.name).astype(int) - 3) & (mask == 0)
        assert shaded.sum() > 500  # the shadow on the floor


def test_empty_room_has_nobody_in_it(room):
    room.playback.occupy(False)
    later = time.time_ns() + SECOND_NS
    np.testing.assert_array_equal(room.views["cam01"].image(later), room.empty("cam01"))


def test_renderer_follows_the_cameras_and_says_how_many_pictures_were_fresh(room):
    def look():
        instant = time.time_ns()
        return [room.views["cam01"].image(instant) for _ in range(2)]

    assert room.counters["sets_rendered"] == 0  # nobody looked yet
    eventually(lambda: look() and room.counters["views_fresh"] >= 3)
    assert 3 <= room.counters["views_fresh"] <= room.counters["sets_rendered"] + 1
    assert room.counters["views_repeated"] >= room.counters["views_fresh"] - 1  # everyone looked twice at once
