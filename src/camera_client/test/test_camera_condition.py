"""What a client says of how sure it is: each cause by its code, with its remedy, and nothing of a sound room."""

import itertools

import cv2
import numpy as np
import pytest
from camera_pictures import learned

from camera_client.background.causes import KEY as FINDINGS_KEY
from camera_client.background.causes import find_causes, findings_text, read_findings
from camera_client.background.model import load_background, read_background
from camera_client.condition import Condition
from camera_client.diagnostics import background_values
from camera_client.frame_processor import FrameProcessor
from camera_client.frame_source import Frame
from camera_client.settings import BackgroundSettings, CameraClientSettings
from camera_client.sources.footage_reader import open_footage
from camera_client.sources.footage_source import FootageSource
from capture_rig.rig import load_rig
from capture_rig.verdict import GOOD, USABLE
from mocap_packets.silhouette import BODY, NOBODY, ForegroundSupport


class Room:
    """A camera's processor on the empty scene; ``see`` shows it changed frames, and reports."""

    def __init__(self, scene, colour=False, rule="adaptive"):
        self.scene, self.frames, self.stamp_ns = scene, 0, 0
        self.empty = scene.empty(20, seed=9, colour=colour)
        settings = CameraClientSettings(background_model=BackgroundSettings(rule=rule))
        self.processor = FrameProcessor(scene.camera(), settings)
        self.processor.use_background(learned(scene.empty(60, colour=colour)))

    def see(self, seconds, change=lambda image, second: image, others=None, hz=5):
        """Show frames; ``others``: what the other cameras see everywhere. Returns the condition then."""
        canvas = self.processor.camera.undistorted_view().camera
        for _ in range(round(hz * seconds)):
            self.frames += 1
            stamp_ns = self.stamp_ns = self.stamp_ns + 10**9 // hz
            if others is not None:
                cells = np.full((-(-canvas.height // 8), canvas.width // 8), others, np.uint8)
                self.processor.add_support(ForegroundSupport(stamp_ns, "cam01", canvas.width // cells.shape[1], cells))
            image = change(self.empty[self.frames % 20].astype(float), stamp_ns / 1e9)
            self.processor.run(Frame(np.clip(np.rint(image), 0, 255).astype(np.uint8), stamp_ns, self.frames, "test"))
        return self.processor.condition

    def findings(self):
        """Code -> finding; all have a remedy."""
        found = find_causes(self.processor.condition.figures())
        assert all(finding.remedy for finding in found)
        return {finding.code: finding for finding in found}


def at(factor):
    return lambda image, second: image * factor


@pytest.mark.parametrize("colour, others", [(False, None), (False, NOBODY), (True, NOBODY)])
def test_sound_room_and_a_person_in_it_give_no_finding(scene, colour, others):
    room = Room(scene, colour)
    room.see(6, others=others)
    assert room.findings() == {}
    room.see(6, lambda image, second: scene.with_person(image), others=None if others is None else BODY)
    assert room.findings() == {}
    assert room.processor.condition.person_faint < 0.1 and room.processor.condition.unexplained_foreground < 0.001


@pytest.mark.parametrize(
    "factor, text, grade",
    [
        (1.12, "the light has changed by +12 % since the background was learned", GOOD),
        (0.9, "by -10 %", GOOD),
        (1.4, "by +40 %", USABLE),
        (0.7, "by -30 %", USABLE),
    ],
)
def test_light_that_is_followed_is_told_in_percent(scene, factor, text, grade):
    room = Room(scene)
    room.see(3, at(factor))
    (finding,) = (finding for code, finding in room.findings().items() if code.startswith("light"))
    assert (finding.code, finding.grade) == ("light.level", grade) and text in finding.what
    assert ("sagoma background" in finding.remedy) == (grade == USABLE)


def test_lamps_that_are_switched_again_and_again_are_told_until_it_ends(scene):
    room = Room(scene)
    room.see(5)
    room.see(3, at(1.3))
    assert room.processor.condition.light_switches_recent == 1 and "light.unsteady" not in room.findings()
    for factor in (1.0, 1.3, 1.0):
        room.see(3, at(factor))
    assert "changed suddenly 4 times" in room.findings()["light.unsteady"].what
    room.see(40, hz=2)
    assert room.findings() == {}


def test_flicker_of_the_mains_is_measured_and_slow_light_is_none(scene):
    room, rng = Room(scene), np.random.default_rng(3)
    room.see(15, lambda image, second: image * (1 + 0.02 * rng.normal()), hz=10)
    assert room.processor.condition.light_flicker == pytest.approx(0.02, rel=0.3)
    assert "10 ms at 50 Hz" in room.findings()["light.flicker"].remedy
    slow = Room(scene)
    slow.see(30, lambda image, second: image * (1 + 0.2 * second / 60), hz=5)
    assert slow.processor.condition.light_flicker < 0.005


def test_noise_is_measured_and_told(scene):
    room, rng = Room(scene), np.random.default_rng(3)
    room.see(10, lambda image, second: image + 4.5 * rng.normal(size=image.shape), hz=10)
    assert room.processor.condition.noise_levels == pytest.approx(np.hypot(1.5, 4.5), rel=0.1)
    room.see(10, lambda image, second: image + 9 * rng.normal(size=image.shape))
    assert room.findings()["noise.high"].grade == USABLE


def test_touched_camera_is_told_in_pixels(scene):
    room = Room(scene)
    room.see(
        5, lambda image, second: cv2.warpAffine(image, np.array([[1, 0, 0.8], [0, 1, 0.6]]), (160, 120), borderMode=2)
    )
    assert room.processor.condition.displacement_px == pytest.approx(1.0, abs=0.2)
    assert "touched" in room.findings()["moved.followed"].what


def chair(image, second):
    image[80:110, 110:135] = 20
    return image


def test_thing_that_became_background_is_told_with_its_place(scene):
    room = Room(scene)
    room.see(3, others=NOBODY)
    room.see(8, chair, others=NOBODY)
    finding, condition = room.findings()["room.things_moved"], room.processor.condition
    assert finding.grade == GOOD and "lower right at" in finding.what
    assert condition.things_absorbed == 1
    assert 30 * 25 < 160 * 120 * condition.things_share < 3 * 30 * 25  # whole blocks of 8 px, and their neighbours
    room.see(4, others=NOBODY)
    assert "room.things_moved" not in room.findings()
    assert room.processor.condition.things_share == 0 and room.processor.condition.things_given_back >= 1


def test_film_on_a_screen_is_never_learned_as_background(scene):
    def film(image, second):
        grain = np.random.default_rng(round(10 * second)).uniform(0, 255, (10, 10))
        image[20:70, 100:150] = grain.repeat(5, axis=0).repeat(5, axis=1)
        return image

    room = Room(scene)
    room.see(5, others=NOBODY)
    assert room.see(60, film, others=NOBODY, hz=2).things_absorbed == 0


def test_foreground_far_from_the_person_is_unexplained(scene):
    def box(image, second):
        image = scene.with_person(image)
        for row, column in itertools.product((3, 13, 23), (128, 138, 148)):  # each too small for a second person
            image[row : row + 6, column : column + 6] = 250
        return image

    room = Room(scene)
    room.see(5, box)
    assert room.processor.condition.unexplained_foreground == pytest.approx(9 * 6 * 6 / (160 * 120), rel=0.15)
    assert room.findings()["room.unexplained"].grade == GOOD


def test_clothes_of_the_background_s_brightness_are_told(scene):
    room = Room(scene)

    def alike(image, second):
        mask = scene.person_mask() > 0
        image[mask] = image[mask] + np.where(np.arange(160) % 4 < 2, 4, 30)[None, :].repeat(120, 0)[mask]
        return image

    room.see(6, alike)
    assert room.processor.condition.person_faint > 0.3
    assert "clothes.like_background" in room.findings()


def test_picture_that_is_none_tells_nothing_of_the_background(scene):
    room = Room(scene)
    room.see(3)
    before = room.processor.condition
    room.see(5, at(0.05))  # the lens cap
    assert room.processor.condition == before and room.findings() == {}


def test_white_places_are_told_by_their_share(scene):
    room = Room(scene)
    images = scene.empty(40)
    for image in images:
        image[:30, :60] = 255
    room.processor.use_background(learned(images))
    room.see(1, lambda image, second: np.where(images[0] == 255, 255, image))
    assert room.processor.condition.background_doubtful == pytest.approx(30 * 60 / (160 * 120), rel=0.01)
    assert room.findings()["levels.clipped"].what.startswith("9 % of the background is white or black")


def test_thesis_rules_measure_no_faint_person_and_follow_no_light(scene):
    room = Room(scene, rule="tail")
    room.see(3, lambda image, second: scene.with_person(image))
    assert room.processor.condition.person_faint is None and room.processor.condition.light_gain is None


def test_figures_are_keys_of_the_diagnostics_before_and_after_there_is_a_background(scene):
    processor = FrameProcessor(scene.camera(), CameraClientSettings())
    none = background_values(processor, 0.0)
    assert set(none.values()) <= {"", False} and none["light_gain"] == ""
    room = Room(scene)
    room.see(1)
    values = background_values(room.processor, 0.0)
    assert set(none) < set(values) and values["light_gain"] == pytest.approx(1.0, abs=0.01)


def test_findings_survive_their_journey(scene):
    found = find_causes(Condition(light_gain=1.5, noise_levels=8.0, things_share=0.1).figures())
    assert [finding.code for finding in found] == ["light.level", "noise.high", "room.things_moved"]
    assert read_findings(findings_text(found)) == found
    assert read_findings("") == read_findings("[3]") == read_findings('[{"grade": "good"}]') == ()


@pytest.fixture
def looping(bench, session, monkeypatch):
    """Parameters of a node whose footage comes at its own rate, for ever."""
    monkeypatch.setattr("camera_client.camera_node.CONSUMER_WAIT_S", 0.1)
    return {**session.parameters, "footage.rate": 1.0, "footage.loop": True}


def test_node_says_the_worst_cause_and_publishes_figures_and_findings(bench, session, scene, looping):
    images = [np.clip(np.rint(1.4 * image), 0, 255).astype(np.uint8) for image in scene.empty(25, seed=5)]
    footage = scene.write_video(session.folder / "bright.avi", [scene.with_person(image) for image in images])
    camera = bench(**{**looping, "footage.path": footage}).start()
    camera.until_said("the light has changed by +40 % since the background was learned")
    values = camera.values()
    assert float(values["light_gain"]) == pytest.approx(1.4, rel=0.03)
    assert float(values["unexplained_foreground"]) < 0.005
    assert "light.level" in [finding.code for finding in read_findings(values[FINDINGS_KEY])]
    assert camera.diagnostics[-1].status[0].level == b"\1" and camera.masks


def test_node_refuses_the_background_of_another_camera_until_it_learned_its_own(
    bench, scene, session, looping, monkeypatch
):
    saved = session.folder / "learned.npz"
    learned(scene.empty(30), camera_serial="A").save(saved)
    monkeypatch.setattr(FootageSource, "details", {"camera_serial": "B"})
    empty = scene.write_video(session.folder / "empty.avi", scene.empty(25, seed=3))
    files = {"background": "", "background_file": str(saved), "footage.path": empty, "background_frames": 20}
    camera = bench(**{**looping, **files}).start()
    camera.until_said("the background was learned with camera A, this is B: clear the room and run sagoma background")
    assert [finding.code for finding in read_findings(camera.values()[FINDINGS_KEY])] == ["background.other_camera"]
    assert camera.masks == [] and camera.values()["background"] == ""
    assert camera.ask_to_learn().success
    camera.until(lambda: camera.masks)
    assert load_background(saved).provenance.camera_serial == "B"
    camera.until(lambda: read_findings(camera.values()[FINDINGS_KEY]) == ())


@pytest.mark.slow
@pytest.mark.parametrize("session, name", [("walk_ring5top", "cam03"), ("charleston2_ring5top_drift", "cam02")])
def test_rendered_sessions_give_no_finding_that_costs_silhouettes(shared_data, session, name):
    folder = shared_data("sessions", session)
    rig, video = load_rig(folder / "rig.yaml"), open_footage(folder / f"{name}.mp4")
    processor = FrameProcessor(rig.camera(name), CameraClientSettings(), rig.volume)
    processor.use_background(read_background(folder / f"{name}_background.mp4", video.probe()))
    grades = set()
    for k in range(120):
        processor.run(Frame(video.read(), 1 + k * 40_000_000, k, "test"))
        grades |= {finding.grade for finding in find_causes(processor.condition.figures())}
    video.close()
    assert grades <= {GOOD}
