"""Video files: what is in them, in order, and what is said of a file that is none."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_rig.errors import InputError
from capture_rig.video import Video

LEVELS = (10, 60, 110, 160, 210)


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    for level in LEVELS:
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    return path


def levels(video: Video) -> list[int]:
    return [round(float(image.mean())) for image in video]


@pytest.mark.parametrize("threads", [0, 1])
def test_frames_come_in_order_with_what_the_header_says(clip: Path, threads: int) -> None:
    with Video(clip, threads=threads) as video:
        assert (video.fps, video.frame_count, video.size_px) == (25.0, 5, (64, 48))
        assert levels(video) == pytest.approx(LEVELS, abs=2)
        assert video.read() is None
        video.rewind()
        assert levels(video) == pytest.approx(LEVELS, abs=2)


def test_frames_are_skipped_exactly_and_only_those_that_exist(clip: Path) -> None:
    with Video(clip) as video:
        assert video.skip(3) == 3
        assert levels(video) == pytest.approx(LEVELS[3:], abs=2)
        assert video.skip(3) == 0
        video.rewind()
        assert video.skip(9) == len(LEVELS)


@pytest.mark.parametrize("content", [None, b"no video"])
def test_file_that_is_no_video_is_an_input_error_with_the_remedy(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "no.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        Video(path, remedy="Copy it again.")
    assert (caught.value.where, caught.value.remedy) == (str(path), "Copy it again.")


def test_file_that_went_away_is_noticed_when_it_is_rewound(clip: Path) -> None:
    with Video(clip) as video:
        clip.unlink()
        with pytest.raises(InputError):
            video.rewind()
