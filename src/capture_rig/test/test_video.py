"""Footage as people have it: codecs, rates, sizes, grey stored as colour, and files that are cut off or uneven."""

from pathlib import Path

import numpy as np
import pytest
from footage_clips import CODECS, cut_off, place_of_square, scene, with_late_frames, write_clip

from capture_rig.errors import InputError
from capture_rig.verdict import REDO, USABLE
from capture_rig.video import Video, VideoFacts, ended_findings, examine_video, is_grey, video_findings

PLACES = 69.5 + 6 * np.arange(20)
"""Columns of the scene's square."""


def facts(path: str = "cam01.avi", frames: int = 100, header: int = 100, **passed: float) -> VideoFacts:
    return VideoFacts(Path(path), header, 50.0, frames, **passed)


def places(video: Video) -> list[float]:
    return [place_of_square(image) for image in video]


@pytest.mark.parametrize("threads", [0, 1])
@pytest.mark.parametrize(("codec", "fps"), [*((codec, 59.94) for codec in CODECS), ("mp4v", 25.0), ("MJPG", 60.0)])
def test_every_codec_gives_all_frames_in_order_at_its_rate(
    tmp_path: Path, codec: str, fps: float, threads: int
) -> None:
    path = write_clip(tmp_path / f"cam01{CODECS[codec]}", scene(20), fps, codec)
    with Video(path, threads=threads) as video:
        assert (video.size_px, video.frame_count) == ((644, 486), 20)
        assert video.fps == pytest.approx(fps, rel=1e-4)
        assert places(video) == pytest.approx(PLACES, abs=1.0)
        assert video.facts.frames == 20 and video.read() is None
        assert [video.facts.shortest_s, video.facts.longest_s] == pytest.approx([1 / fps, 1 / fps], abs=2e-3)
    assert list(video_findings(examine_video(path))) == []


def test_frames_are_skipped_exactly_and_only_those_that_exist(tmp_path: Path) -> None:
    with Video(write_clip(tmp_path / "cam01.avi", scene(5), 25.0, "MJPG")) as video:
        assert video.skip(3) == 3
        assert places(video) == pytest.approx(PLACES[3:5], abs=1.0)
        assert video.skip(3) == 0
        video.rewind()
        assert video.skip(9) == 5


@pytest.mark.parametrize("content", [None, b"no video"])
def test_file_that_is_no_video_is_an_input_error_with_the_remedy(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "no.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        Video(path, remedy="Copy it again.")
    assert (caught.value.where, caught.value.remedy) == (str(path), "Copy it again.")


@pytest.mark.parametrize("codec", ["XVID", "MJPG"])
def test_recording_that_was_cut_off_says_how_many_frames_there_are(tmp_path: Path, codec: str) -> None:
    path = cut_off(write_clip(tmp_path / "cam01.avi", scene(20), 50.0, codec), 0.7)
    seen = examine_video(path)
    assert 8 <= seen.frames < 20
    (finding,) = video_findings(seen)
    assert f"ends after {seen.frames} frames, its header promises 20" in finding.what


def test_variable_frame_rate_is_named_with_both_intervals_and_a_remedy(tmp_path: Path) -> None:
    path = with_late_frames(write_clip(tmp_path / "cam01.mp4", scene(20)), 15, 5)
    (finding,) = video_findings(examine_video(path))
    assert "variable frame rate: its frames are 20 to 40 ms apart" in finding.what
    assert "ffmpeg -i cam01.mp4 -fps_mode cfr" in finding.remedy


def test_time_stamps_in_whole_milliseconds_are_no_variable_rate() -> None:
    assert not list(video_findings(facts(shortest_s=0.016, longest_s=0.017)))
    assert not list(video_findings(facts(shortest_s=0.0, longest_s=0.0)))  # a raw stream has none


def test_shortest_of_videos_read_in_step_is_named_and_the_others_promise_nothing() -> None:
    seen = {"cam01": facts("cam01.avi", 94, 100), "cam02": facts("cam02.avi", 93, 100)}
    cut, first = ended_findings(seen)
    assert cut.what.startswith("cam02.avi: ends after 93 frames, its header promises 100")
    assert first.what.startswith("cam02.avi ended after 93 frames, before the others")
    assert cut.grade == first.grade == USABLE
    assert not list(ended_findings({"cam01": facts(), "cam02": facts()}))


def test_video_with_far_fewer_frames_than_its_header_or_the_others_say_must_be_done_again() -> None:
    (empty,) = video_findings(facts(frames=0))
    assert empty.grade == REDO and "no frame" in empty.what
    (damaged,) = video_findings(facts(frames=5, header=240))
    assert damaged.grade == REDO and "ends after 5 frames, its header promises 240" in damaged.what
    (short,) = ended_findings({"cam01": facts("cam01.avi", 5, 5), "cam02": facts("cam02.avi", 6, 240)})
    assert short.grade == REDO and "cam01.avi ended after 5 frames, before the others (up to 240)" in short.what


@pytest.mark.parametrize("codec", CODECS)
def test_grey_camera_stored_as_colour_is_grey_and_a_colour_camera_is_not(tmp_path: Path, codec: str) -> None:
    images = scene(4)
    with Video(write_clip(tmp_path / f"grey{CODECS[codec]}", images, 50.0, codec)) as video:
        assert all(is_grey(image) for image in video)
    coloured = [np.stack([image, image, image], axis=-1) for image in images]
    for image in coloured:
        image[200:230, 300:330, 2] = 200  # somebody's red shirt: 0.3 % of the picture
    with Video(write_clip(tmp_path / f"colour{CODECS[codec]}", coloured, 50.0, codec)) as video:
        assert not any(is_grey(image) for image in video)


def test_grey_with_chroma_quantised_by_one_step_is_grey() -> None:
    grey = np.full((48, 64, 3), 100, np.uint8)
    grey[:24] += np.array([4, 0, 0], np.uint8)  # 2 levels of chroma are 3.5 of blue
    grey[0, 0] = (90, 100, 140)  # one damaged pixel in 3072
    assert is_grey(grey) and is_grey(grey[..., 0])
    grey[:, :8] += np.array([9, 0, 0], np.uint8)
    assert not is_grey(grey)
