"""Things that moved become background, people never; rule by rule, in a room of 320 x 240 pixels at five frames
a second.

The room's people are as bad as can be: they do not move by a pixel, unless a test says that they sway.
"""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from camera_client.background.expected_image import samples_of
from camera_client.background.kernels import BLOCK_PX, STEP_PX
from camera_client.background.moved_evidence import APPLY_AFTER_S, SupportHistory
from camera_client.background.moved_things import OUTSIDE_STILL_S, STILL_S, MovedThings
from camera_client.background.training_verdict import find_regions
from capture_rig.camera import CameraModel
from mocap_packets.silhouette import BODY, LEVELS, NOBODY, OUTSIDE, UNJUDGED, ForegroundSupport

WIDTH, HEIGHT, FPS = 320, 240, 5
NOISE = 1.5
THING, PERSON, DOOR = (
    (slice(60, 110), slice(40, 80)),
    (slice(70, 220), slice(180, 220)),
    (slice(40, 160), slice(240, 300)),
)
CELL_PX = 8


def camera(distortion=(0.0,) * 5):
    K = np.array([[300.0, 0, WIDTH / 2], [0, 300.0, HEIGHT / 2], [0, 0, 1]])
    return CameraModel("cam01", WIDTH, HEIGHT, K, "plumb_bob", np.array(distortion), np.eye(4))


def wall(colour=False, seed=3):
    """A wall of soft texture, grey levels 90 to 150."""
    shape = (HEIGHT, WIDTH, 3) if colour else (HEIGHT, WIDTH)
    texture = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=shape), (0, 0), 4.0)
    return 120 + 8 * texture / texture.std()


def with_thing(image, place, level=60.0):
    """A thing of one colour, its edges as soft as a lens makes them."""
    mask = np.zeros(image.shape[:2], np.float32)
    mask[place] = 1
    mask = cv2.GaussianBlur(mask, (0, 0), 0.8)
    mask = mask if image.ndim == 2 else mask[..., None]
    return image * (1 - mask) + level * mask


def with_person(image, shift_px=0.0, place=PERSON):
    """Somebody in striped clothes; ``shift_px`` to the right."""
    top, bottom, left, right = place[0].start, place[0].stop, place[1].start, place[1].stop
    columns, rows = np.meshgrid(np.arange(WIDTH) - shift_px, np.arange(HEIGHT))
    inside = np.clip(np.minimum(columns - left, right - columns) + 0.5, 0, 1) * ((rows >= top) & (rows < bottom))
    clothes = 60 + 20 * np.sin(rows / 5) + 15 * np.sin(columns / 3)
    if image.ndim == 3:
        inside, clothes = inside[..., None], clothes[..., None]
    return image * (1 - inside) + clothes * inside


class Room:
    """One camera that looks at a wall; ``says`` is what the others say of each cell, a level or a map of them."""

    def __init__(self, background=None, colour=False, late_s=0.0, fps=FPS):
        self.background = wall(colour) if background is None else background
        self.expected = np.rint(self.background).astype(np.uint8)
        self.moved = MovedThings(camera(), NOISE)
        self.frames, self.late_s, self.fps = 0, late_s, fps
        self.noise = NOISE * np.random.default_rng(1).normal(size=(7, *self.background.shape)).astype(np.float32)
        self.waiting = []
        self.picture, self.shots = None, {}

    def shot(self, picture):
        """The image that is taken of a picture now, and its foreground; one that stays is not computed again."""
        if picture is not self.picture:
            self.picture, self.shots = picture, {}
        phase = self.frames % len(self.noise)
        if phase not in self.shots:
            image = np.clip(np.rint(picture + self.noise[phase]), 0, 255).astype(np.uint8)
            difference = np.abs(image - self.background)
            difference = difference if difference.ndim == 2 else difference.max(axis=2)
            self.shots[phase] = image, np.where(difference > 4 * NOISE, np.uint8(255), np.uint8(0))
        image, foreground = self.shots[phase]
        return image, foreground.copy()

    def see(self, picture, says=None):
        """One frame; returns what is foreground of it."""
        stamp_ns = self.frames * 10**9 // self.fps
        self.frames += 1
        image, foreground = self.shot(picture)
        looked_at = np.ascontiguousarray(foreground[::STEP_PX, ::STEP_PX])
        self.moved.update(image, samples_of(image), looked_at, self.subtracted(foreground), stamp_ns)
        self.moved.clear_absorbed(image, foreground)
        if says is not None:
            cells = np.full((HEIGHT // CELL_PX, WIDTH // CELL_PX), says, np.uint8)
            self.waiting.append((stamp_ns, ForegroundSupport(stamp_ns, "cam01", CELL_PX, cells)))
        while self.waiting and self.waiting[0][0] <= stamp_ns - self.late_s * 1e9:
            self.moved.others.add(self.waiting.pop(0)[1])
        return foreground

    def subtracted(self, foreground):
        """The background, which tells its picture and the foreground of any part."""
        distance = np.stack([foreground, foreground])

        def compare(_, box, rows):
            at = slice(box[0], box[2]), slice(box[1], box[3])
            return self.expected[at], distance[:, *at]

        light, noise = SimpleNamespace(brightness=1.0), SimpleNamespace(typical_sigma=NOISE)
        return SimpleNamespace(light=light, noise=noise, step_px=STEP_PX, threshold=0, compare=compare)

    def watch(self, picture, seconds, says=None):
        """The same picture, or one a frame from a function of the time; returns the last frame's foreground."""
        for frame in range(round(seconds * self.fps)):
            foreground = self.see(picture(frame / self.fps) if callable(picture) else picture, says)
        return foreground


def share(foreground, place):
    return float((foreground[place] > 0).mean())


def level_map(level, *others):
    """Cells of one level, but for ``others``: places and their levels."""
    cells = np.full((HEIGHT // CELL_PX, WIDTH // CELL_PX), level, np.uint8)
    for place, at in others:
        rows, columns = (slice(part.start // CELL_PX, -(-part.stop // CELL_PX)) for part in place)
        cells[rows, columns] = at
    return cells


# --- what nobody else sees


@pytest.mark.parametrize("colour", [False, True])
def test_thing_that_nobody_else_sees_is_absorbed_after_three_seconds(colour):
    room = Room(colour=colour)
    picture = with_thing(room.background, THING)
    assert share(room.watch(picture, STILL_S - 0.2, NOBODY), THING) > 0.95
    assert share(room.watch(picture, APPLY_AFTER_S + 1.0, NOBODY), THING) < 0.01
    (place,) = find_regions(room.moved.replaced > 0)
    assert place.left <= 40 < 79 <= place.right and place.top <= 60 < 109 <= place.bottom
    assert 0 < place.share < 0.06 and room.moved.absorbed == 1


def test_thing_is_unsupported_before_it_is_absorbed_and_a_person_never():
    room = Room()
    picture = with_person(with_thing(room.background, THING))
    room.watch(picture, 2.5, level_map(NOBODY, (PERSON, BODY)))
    assert room.moved.absorbed == 0
    assert (room.moved.unsupported[THING] > 0).all() and not room.moved.unsupported[PERSON].any()
    room.watch(picture, 1.0, OUTSIDE)
    assert room.moved.absorbed == 0 and room.moved.unsupported is None


@pytest.mark.parametrize("says", [None, UNJUDGED, BODY])
def test_thing_of_which_the_others_do_not_say_that_nobody_is_there_stays(says):
    room = Room()
    assert share(room.watch(with_thing(room.background, THING), 60, says), THING) > 0.95


def test_what_may_be_a_person_beside_the_volume_has_to_keep_still_for_longer():
    room = Room()
    picture = with_thing(room.background, THING)
    assert share(room.watch(picture, OUTSIDE_STILL_S - 1, OUTSIDE), THING) > 0.95
    assert share(room.watch(picture, 3, OUTSIDE), THING) < 0.01


@pytest.mark.slow
def test_visitor_whom_nobody_else_sees_sways_and_is_no_thing():
    """Who stands upright sways by some millimetres several times in three seconds: here by 0.6 px to each side."""
    room = Room()
    foreground = room.watch(lambda t: with_person(room.background, 0.6 * np.sin(2 * np.pi * 0.4 * t)), 60, NOBODY)
    assert share(foreground, PERSON) > 0.9 and room.moved.absorbed == 0


@pytest.mark.parametrize(
    "colour, seen", [(False, "by all"), (False, "by this camera alone"), (True, "by others most of the time")]
)
def test_person_who_stands_still_for_ten_minutes_stays_whole(colour, seen):
    room, random = Room(colour=colour, fps=1), np.random.default_rng(2)
    picture = with_person(room.background)
    first = room.watch(picture, 2)
    for _ in range(600):
        holes = seen == "by others most of the time" and random.random() < 0.3
        says = None if seen == "by this camera alone" else level_map(NOBODY, (PERSON, NOBODY if holes else BODY))
        last = room.see(picture, says)
    assert share(last, PERSON) >= share(first, PERSON) - 0.01 > 0.9
    assert room.moved.absorbed == 0


def test_limb_that_the_others_miss_is_not_absorbed_while_it_hangs_on_a_body():
    room = Room()
    arm = (slice(90, 102), slice(110, 182))
    picture = with_thing(with_person(room.background), arm, 70.0)
    foreground = room.watch(picture, 30, level_map(NOBODY, (PERSON, BODY)))
    assert share(foreground, arm) > 0.9 and share(foreground, PERSON) > 0.9


def test_person_before_an_absorbed_thing_is_foreground_and_leaves_it_absorbed():
    room = Room()
    picture = with_thing(room.background, THING, 190.0)
    room.watch(picture, 5, NOBODY)
    before = with_person(picture, place=(slice(50, 200), slice(50, 90)))
    foreground = room.watch(before, 20, level_map(NOBODY, ((slice(50, 200), slice(50, 90)), BODY)))
    assert share(foreground, (slice(62, 108), slice(52, 78))) > 0.85
    assert share(room.watch(picture, 1, NOBODY), THING) < 0.02


def test_person_absorbed_while_others_missed_her_is_given_back_when_they_see_her():
    room = Room()
    picture = with_person(room.background)
    room.watch(picture, 10, NOBODY)
    assert room.moved.absorbed > 0
    assert share(room.watch(picture, 8, level_map(NOBODY, (PERSON, BODY))), PERSON) > 0.9


# --- doors


def test_door_closed_again_is_background_at_once_and_open_again_is_absorbed_again():
    room = Room()
    opened = with_thing(room.background, DOOR, 170.0)
    assert share(room.watch(opened, 5, NOBODY), DOOR) < 0.01
    assert share(room.see(room.background, NOBODY), DOOR) < 0.01
    room.watch(room.background, 4, NOBODY)
    assert room.moved.reverted >= 1 and room.moved.share == 0
    assert share(room.see(opened, NOBODY), DOOR) > 0.95
    assert share(room.watch(opened, 5, NOBODY), DOOR) < 0.01


# --- things taken away


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("says", [None, BODY])
def test_thing_that_was_taken_away_is_absorbed_whatever_the_others_say(colour, says):
    plain = wall(colour)
    room = Room(with_thing(plain, THING))
    assert share(room.watch(plain, 2.4, says), THING) < 0.01
    assert room.moved.absorbed == 1
    assert share(room.watch(plain, 20, says), THING) < 0.01


def test_person_before_the_place_of_a_thing_that_was_taken_away_stays():
    """Her outline lies within that of the cupboard, on which nothing stands any more."""
    plain, cupboard = wall(), (slice(50, 230), slice(150, 260))
    room = Room(with_thing(plain, cupboard, 190.0))
    foreground = room.watch(with_person(plain), 30)
    assert share(foreground, PERSON) > 0.85 and room.moved.absorbed == 0


def test_thing_taken_away_beside_a_person_is_absorbed_without_her():
    plain, chair = wall(), (slice(150, 215), slice(214, 275))
    room = Room(with_thing(plain, chair))
    beside = (slice(70, 220), slice(172, 225))
    foreground = room.watch(with_person(plain), 4, level_map(NOBODY, (beside, BODY)))
    assert share(foreground, (slice(150, 215), slice(236, 275))) < 0.02
    assert share(foreground, PERSON) > 0.85


# --- bounds, time, and geometry


def test_of_a_room_that_changes_without_end_no_more_than_half_is_absorbed():
    room = Room()
    picture = room.background.copy()
    for left in range(0, 280, 40):
        picture = with_thing(picture, (slice(8, 232), slice(left, left + 36)), 60.0 + left / 4)
        room.watch(picture, 5, NOBODY)
    assert 0.3 < room.moved.share <= 0.5


def test_reports_count_from_the_same_frame_whenever_they_come_in_time():
    early, late = Room(), Room(late_s=APPLY_AFTER_S - 0.1)
    picture = with_thing(early.background, THING)
    for _ in range(6 * FPS):
        assert np.array_equal(early.see(picture, NOBODY), late.see(picture, NOBODY))
    assert early.moved.absorbed == late.moved.absorbed == 1


def test_clock_set_back_does_no_harm():
    room = Room()
    picture = with_thing(room.background, THING)
    room.watch(picture, 5, NOBODY)
    room.frames = 0
    assert share(room.watch(picture, 10, NOBODY), THING) < 0.01


def test_reports_on_the_canvas_lie_on_the_same_blocks_of_a_distorted_image():
    lens = camera((-0.25, 0.06, 0.0, 0.0, 0.0))
    view = lens.undistorted_view()
    image = np.full((HEIGHT, WIDTH), 120, np.uint8)
    shown = np.zeros_like(image)
    shown[16:56, 8:56] = 255  # in a corner, where the lens bends most
    canvas = view.undistort_mask(shown)
    height, width = (-(-n // CELL_PX) for n in canvas.shape)
    padded = np.zeros((height * CELL_PX, width * CELL_PX), np.uint8)
    padded[: canvas.shape[0]] = canvas
    filled = padded.reshape(height, CELL_PX, width, CELL_PX).mean(axis=(1, 3)) > 127
    cells = np.where(filled, np.uint8(NOBODY), np.uint8(UNJUDGED))
    report = ForegroundSupport.of_canvas(0, "cam01", cells, view.camera.width)
    levels = SupportHistory(lens, BLOCK_PX, STILL_S).levels(report)
    assert set(LEVELS) >= set(np.unique(levels))
    blocks = levels == NOBODY
    expected = shown.reshape(HEIGHT // 8, 8, WIDTH // 8, 8).mean(axis=(1, 3)) > 127
    assert (blocks & expected).sum() >= 0.9 * expected.sum()
    assert (blocks & ~cv2.dilate(expected.astype(np.uint8), np.ones((3, 3))).astype(bool)).sum() == 0
