"""Footage as a camera: what comes, with which stamps, until when, and what is refused."""

import threading

import cv2
import numpy as np
import pytest
from camera_pictures import frames_of
from footage_clips import CODECS, cut_off, write_clip
from footage_clips import scene as square_scene

from camera_client.frame_source import EndOfFootage
from camera_client.settings import FootageSettings
from camera_client.sources.footage_reader import open_footage
from camera_client.sources.footage_source import LEAD_NS, FootageSource, SharedClock
from capture_rig.errors import InputError
from capture_rig.session import footage_stamp_ns

EPOCH_NS = 1_800_000_000_000_000_000
PATIENCE_S = 20.0  # only ever used up by a failing test
PNG = cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes()


def source_of(path, now_ns=lambda: EPOCH_NS, channels="auto", **settings):
    """Footage that nobody waits for: time stands still, and sleeping takes none."""
    settings.setdefault("epoch_ns", EPOCH_NS)
    return FootageSource(FootageSettings(path=str(path), **settings), channels, now_ns, sleep=lambda seconds: None)


def read_all(source):
    frames = []
    with pytest.raises(EndOfFootage):
        while True:
            frame = source.read(PATIENCE_S)
            if frame is not None:
                frames.append(frame)
    return frames


@pytest.fixture
def images(scene):
    return scene.empty(8, colour=True)


@pytest.fixture
def video(tmp_path, scene, images):
    return scene.write_video(tmp_path / "cam01.avi", images)


@pytest.mark.parametrize("loop", [False, True])
def test_every_frame_comes_in_order_with_its_stamp_once_or_over_and_over(video, images, scene, loop):
    with source_of(video, loop=loop) as source:
        source.start()
        frames = frames_of(source, 2 * len(images) + 1) if loop else read_all(source)
    assert len(frames) == (17 if loop else 8)
    for k, frame in enumerate(frames):
        assert np.array_equal(frame.image, images[k % 8])
        assert (frame.frame_id, frame.stamp_ns) == (k, footage_stamp_ns(EPOCH_NS, k, scene.fps))
    assert "footage" in frames[0].clock


def test_pause_goes_on_with_the_next_frame(video, scene):
    with source_of(video) as source:
        source.start()
        frames_of(source, 3)
        source.stop()
        source.start()
        frames = read_all(source)
    assert [frame.frame_id for frame in frames] == [3, 4, 5, 6, 7]
    assert frames[0].stamp_ns == footage_stamp_ns(EPOCH_NS, 3, scene.fps)
    assert not [t for t in threading.enumerate() if t.name == "footage decoder"]


@pytest.mark.parametrize(
    "given_ns, begin_ns, later_ns, ids",
    [(EPOCH_NS, EPOCH_NS, 0, range(8, 16)), (0, EPOCH_NS + LEAD_NS, 60 * 10**9, range(8))],
    ids=["epoch", "none"],
)
def test_start_after_the_end_counts_on_or_takes_a_new_epoch(video, images, scene, given_ns, begin_ns, later_ns, ids):
    now = [EPOCH_NS]
    with source_of(video, epoch_ns=given_ns, now_ns=lambda: now[0]) as source:
        source.start()
        first = read_all(source)
        now[0] += 60 * 10**9
        source.stop()
        source.start()
        again = read_all(source)
    assert [frame.frame_id for frame in again] == list(ids)
    assert first[0].stamp_ns == begin_ns and np.array_equal(again[0].image, images[0])
    assert again[0].stamp_ns == footage_stamp_ns(begin_ns + later_ns, ids[0], scene.fps)


@pytest.mark.parametrize("channels, shape", [("mono", (120, 160)), ("colour", (120, 160, 3))])
def test_channels_of_the_settings_win(video, channels, shape):
    with source_of(video, channels=channels) as source:
        source.start()
        assert source.shape == frames_of(source, 1)[0].image.shape == shape


@pytest.mark.parametrize("pattern", ["", "f*.png"])
def test_stills_play_in_the_order_of_their_names_without_those_that_cannot_be_decoded(tmp_path, images, pattern):
    for k in (2, 0, 3):
        cv2.imwrite(str(tmp_path / f"f{k}.png"), images[k])
    (tmp_path / "f1.png").write_bytes(b"\x89PNG broken")
    (tmp_path / "notes.txt").write_text("no image")
    with source_of(tmp_path / pattern, fps=10.0) as source:
        source.start()
        frames = read_all(source)
        assert source.counters["undecodable"] == 1
        assert source.statistics.counts() == dict(expected=4, delivered=3, incomplete=1, lost=0, repeated=0)
    assert [frame.frame_id for frame in frames] == [0, 2, 3]  # the gap shows, the stamps stay true
    assert frames[1].stamp_ns == EPOCH_NS + 200_000_000
    assert all(np.array_equal(frame.image, images[frame.frame_id]) for frame in frames)


@pytest.mark.parametrize(
    "name, content, text",
    [
        ("none.mp4", None, r"none\.mp4: does not exist"),
        ("broken.mp4", b"this is no video" * 100, r"broken\.mp4: cannot be opened as a video"),
        ("", None, "no still image"),
        ("", PNG, r"no frame rate.*footage\.fps"),
    ],
)
def test_footage_that_cannot_be_played_is_refused_with_the_reason(tmp_path, name, content, text):
    if content is not None:
        (tmp_path / (name or "still.png")).write_bytes(content)
    with pytest.raises(InputError, match=text):
        source_of(tmp_path / name).connect()


def test_epoch_far_ahead_is_refused(video):
    with pytest.raises(InputError, match=r"epoch_ns = .* ahead of the system clock"):
        source_of(video, epoch_ns=EPOCH_NS * 1000).connect()


@pytest.mark.parametrize("first_black", [False, True])
def test_colour_camera_whose_first_picture_is_black_is_a_colour_camera(tmp_path, scene, first_black):
    images = scene.empty(5, colour=True)
    images[0] = np.zeros_like(images[0]) if first_black else images[0]
    reader = open_footage(write_clip(tmp_path / "cam01.avi", images, 50.0, "XVID"))
    assert reader.probe() == images[0].shape
    reader.close()


@pytest.mark.parametrize("codec", CODECS)
def test_grey_camera_stored_as_colour_plays_as_grey_with_its_levels(tmp_path, codec):
    images = square_scene(6)
    with source_of(write_clip(tmp_path / f"cam01{CODECS[codec]}", images, 50.0, codec)) as source:
        source.start()
        frames = read_all(source)
    assert source.fps == pytest.approx(50.0) and len(frames) == 6
    for frame, image in zip(frames, images, strict=True):
        assert frame.image.shape == image.shape
        assert abs(float(frame.image.mean()) - float(image.mean())) < 3.0
        assert np.abs(frame.image.astype(float) - image).mean() < 8.0


def test_rate_in_the_header_that_no_camera_has_asks_for_the_setting(tmp_path):
    source = source_of(write_clip(tmp_path / "cam01.mp4", square_scene(3), 1000.0))
    with pytest.raises(InputError, match=r"cam01.mp4: has no frame rate of its own.*Set the parameter footage.fps"):
        source.connect()
    with source_of(tmp_path / "cam01.mp4", fps=50.0) as source:
        source.start()
        assert frames_of(source, 2)[1].stamp_ns == EPOCH_NS + 20_000_000


def test_footage_that_was_cut_off_ends_after_its_last_whole_frame(tmp_path):
    path = cut_off(write_clip(tmp_path / "cam01.avi", square_scene(20), 50.0, "MJPG"), 0.6)
    with source_of(path) as source:
        source.start()
        frames = read_all(source)
    assert 6 < len(frames) < 20 and frames[0].image.ndim == 2  # of a grey camera
    assert [frame.frame_id for frame in frames] == list(range(len(frames)))


def test_frames_whose_time_has_passed_are_left_out_and_counted(tmp_path):
    fps, late_frames = 50.0, 20
    path = write_clip(tmp_path / "square.avi", [np.full((48, 64, 3), level, np.uint8) for level in range(10, 50)], fps)
    with source_of(path, now_ns=lambda: EPOCH_NS + round(1e9 * late_frames / fps), keep_up=True) as source:
        source.start()
        (frame,) = frames_of(source, 1)
        left_out = source.counters["left_out"]
    assert 0 < left_out < late_frames  # those of the last quarter of a second still join their sets
    assert frame.frame_id == left_out and frame.stamp_ns == footage_stamp_ns(EPOCH_NS, left_out, fps)
    assert source.statistics.counts()["lost"] == 0


class Camera:
    """Footage of one camera by a clock of the test's own, of which every frame has a grey level of its own."""

    FPS, FRAMES = 25.0, 100

    def __init__(self, folder, rate, now_ns):
        self.told, self._now_ns = [], now_ns
        for k in range(self.FRAMES):
            cv2.imwrite(str(folder / f"{k:03d}.png"), np.full((8, 8), 2 * k, np.uint8))
        self.shared = SharedClock(self.told.append)
        self.source = FootageSource(
            FootageSettings(path=str(folder / "*.png"), fps=self.FPS, rate=rate),
            now_ns=lambda: now_ns[0],
            sleep=self._sleep,
            shared=self.shared,
        )
        self.source.connect()

    def _sleep(self, seconds):
        self._now_ns[0] += round(seconds * 1e9)

    def play(self, count):
        """Stamps of so many frames -> their number, by what they show."""
        return {frame.stamp_ns: round(frame.image.mean() / 2) for frame in frames_of(self.source, count)}


@pytest.mark.parametrize("rate", [0.25, 1.0, 8.0])
def test_frames_leave_when_they_are_due_and_late_ones_at_once(tmp_path, rate):
    now_ns = [EPOCH_NS]
    camera = Camera(tmp_path, rate, now_ns)
    camera.source.start()
    assert camera.source.read(0.2) is None and now_ns[0] <= EPOCH_NS + 200_000_000  # the first comes after LEAD_NS
    begin_ns, period_ns, left_ns = EPOCH_NS + LEAD_NS, round(1e9 / (25.0 * rate)), []
    for k in range(8):
        now_ns[0] += 70_000_000 if k == 4 else 0  # the consumer was slow
        (frame,) = frames_of(camera.source, 1)
        assert frame.stamp_ns == footage_stamp_ns(begin_ns, k, 25.0)
        left_ns.append(now_ns[0])
    late_ns = begin_ns + 3 * period_ns + 70_000_000
    due_ns = [begin_ns + k * period_ns for k in range(8)]
    assert left_ns == pytest.approx(due_ns[:4] + [max(due, late_ns) for due in due_ns[4:]], abs=1000)
    camera.source.close()


@pytest.mark.parametrize("rate", [0.1, 1.0])
@pytest.mark.parametrize("hears_at_once", [True, False])
def test_camera_that_starts_late_shows_the_same_frame_under_the_same_stamp(tmp_path, rate, hears_at_once):
    now_ns = [EPOCH_NS]
    first, late = Camera(tmp_path, rate, now_ns), Camera(tmp_path, rate, now_ns)
    first.source.start()
    shown = first.play(20)
    if hears_at_once:
        late.shared.offer(first.told[-1])
    late.source.start()
    if not hears_at_once:
        alone = late.play(2)
        assert set(alone.values()) == {0, 1} and not set(alone) & set(shown)
        late.shared.offer(first.told[-1])
    begun_ns = now_ns[0]
    in_step = late.play(20)
    now_ns[0] = begun_ns  # side by side with the other
    shown |= first.play(30)
    assert late.source.counters["left_out"] > 0
    both = set(shown) & set(in_step)
    assert len(both) == 20 and all(shown[stamp] == in_step[stamp] for stamp in both)
    assert late.source.epoch_ns == first.source.epoch_ns == EPOCH_NS + LEAD_NS
    first.source.close(), late.source.close()


def test_cameras_that_all_paused_go_on_together_where_they_stopped(tmp_path):
    now_ns = [EPOCH_NS]
    first, other = Camera(tmp_path, 1.0, now_ns), Camera(tmp_path, 1.0, now_ns)
    first.source.start()
    other.shared.offer(first.told[-1])
    other.source.start()
    seen = [max(first.play(10).values())]
    now_ns[0] = EPOCH_NS  # side by side
    seen.append(max(other.play(12).values()))
    assert seen == [9, 11]
    first.source.stop(), other.source.stop()
    now_ns[0] += 60 * 10**9
    other.source.start()
    first.shared.offer(other.told[-1])
    now_ns[0] += 10**8
    first.source.start()
    begun_ns = now_ns[0]
    went_on = other.play(10)
    now_ns[0] = begun_ns
    also = first.play(10)
    assert [min(also.values()), min(went_on.values())] == [number + 1 for number in seen]
    assert set(also) & set(went_on) and all(also[stamp] == went_on[stamp] for stamp in set(also) & set(went_on))
    assert min(also) == footage_stamp_ns(first.source.epoch_ns, seen[0] + 1, Camera.FPS)  # as if there was no pause
    first.source.close(), other.source.close()
