"""Imports a rosbag of camera images, of any driver and writer, as a session.

Frame k of the session is the k-th image of the first camera, with the image of every other camera that is nearest in
time. Cameras need not be triggered together: stamps.csv holds the time of each image.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from camera_client.camera_ros import camera_from_message
from camera_client.configuration import unplaced_camera
from camera_client.settings import TopicSettings
from capture_rig.camera_info_file import save_camera_info
from capture_rig.errors import InputError
from capture_rig.files import replaced_folder
from capture_rig.rig import CAMERA_NAME, load_rig, save_rig
from capture_rig.session import STAMPS, write_table
from capture_rig.stamps import NS_PER_S
from capture_rig.video import VideoFile
from sagoma_ros.images import decode_image

from ..graph.topics import IMAGE_TYPES, image_topics
from ..recording.reader import BagMessage, bag_topics, read_messages
from .formats import save_description

LENSES, VIDEO = "lenses", ".mkv"
GREY_BITS = TopicSettings().bits
Progress = Callable[[int], None]


def import_bag(
    bag: Path,
    folder: Path,
    rig_file: Path | None = None,
    topics: Mapping[str, str] | None = None,
    background: Path | None = None,
    progress: Progress = lambda done: None,
) -> list[str]:
    """Write the session folder ``folder``, lossless, all or nothing; return its description, line by line, with the
    time spread of each frame's images.

    rig_file : without it lenses/CAMERA.yaml are written from the bag's camera_info. topics : of cameras whose name is
    in no topic's. background : a bag of the empty room, on the same topics. Raises InputError.
    """
    rig = None if rig_file is None else load_rig(rig_file)
    found = choose_topics(bag_topics(bag), None if rig is None else rig.names, topics or {}, bag)
    stamps_ns = _stamps(bag, found)
    sets_ns, period_ns = frame_sets(list(stamps_ns.values()))
    fps = NS_PER_S / period_ns
    with replaced_folder(folder) as partial:
        _copy_images(bag, found, partial, "", fps, sets_ns, progress)
        if background is not None:
            rooms_ns = _stamps(background, found)
            for name, topic in found.items():
                _copy_images(background, {name: topic}, partial, "_background", fps, rooms_ns[name][:, None], progress)
        seconds = (sets_ns - sets_ns[0].min()) / NS_PER_S  # after the first image of all
        write_table(partial / STAMPS, list(found), np.arange(len(seconds)), seconds, 9)
        if rig is not None:
            save_rig(rig, partial / "rig.yaml")
        else:
            _save_lenses(bag, found, partial / LENSES)
        save_description(partial, fps, f"images of {bag.resolve().name}", "bag", cameras=dict(found))
    spread_ms = 1e3 * float(np.ptp(sets_ns, axis=1).max()) / NS_PER_S
    incomplete = len(next(iter(stamps_ns.values()))) - len(sets_ns)
    left_out = f", {incomplete} left out without an image of every camera" if incomplete else ""
    lines = [f"{name}: {topic}" for name, topic in found.items()]
    apart = f"images of a frame up to {spread_ms:.1f} ms apart{left_out}"
    return [*lines, f"{len(sets_ns)} frames at {fps:.4g} Hz, {apart}"]


def choose_topics(
    types: Mapping[str, str], names: Sequence[str] | None, given: Mapping[str, str], bag: Path
) -> dict[str, str]:
    """Return the topic of each camera, in name order: the shortest with the camera's name as a part, which is the raw
    one. Without ``names`` a camera's name is its topic without the last part. Raises InputError."""
    images = sorted(image_topics(types), key=lambda topic: (len(topic), topic))
    parts = {topic: topic.removesuffix("/compressed").split("/") for topic in images}
    if names is None:
        names = sorted({*given, *(of[-2] for of in parts.values() if not given and CAMERA_NAME.fullmatch(of[-2]))})
    found = {name: given.get(name) or next((t for t in images if name in parts[t]), "") for name in sorted(names)}
    missing = [name for name, topic in found.items() if topic not in images]
    if missing or not found:
        what = f"has no images of {', '.join(missing) or 'any camera'}; topics of images: {', '.join(images) or 'none'}"
        example = f"--camera {missing[0] if missing else 'cam01'}={images[0] if images else '/TOPIC'}"
        raise InputError(what, where=str(bag), remedy=f"Name each camera's topic: {example}.")
    return found


def frame_sets(stamps_ns: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Return the stamps (F, C) of the images of each frame, ns, and the first camera's median period, ns.

    stamps_ns : of each camera's images (n,), rising. Frames begin in the widest gap that all images leave within the
    first camera's period; frames without an image of some camera are left out. Raises InputError where none is left.
    """
    first = stamps_ns[0]
    if min(map(len, stamps_ns)) < 2:
        raise InputError("a camera has fewer than two images", remedy="Record for longer.")
    period_ns = float(np.median(np.diff(first)))
    since_ns = [own - first[np.searchsorted(first, own, "right").clip(1) - 1] for own in stamps_ns]
    phases = np.sort(np.concatenate(since_ns) / period_ns % 1.0)
    gaps = np.diff(phases, append=1.0)  # the first camera's own phase is 0
    begin = phases[gaps.argmax()] + 0.5 * gaps.max()
    begins_ns = first - round((1.0 - begin) * period_ns)
    sets_ns = np.zeros((len(first), len(stamps_ns)), np.int64)
    for camera, own in enumerate(stamps_ns):
        frame = np.searchsorted(begins_ns, own, "right") - 1
        inside = (frame >= 0) & (own - begins_ns[frame] < period_ns)
        sets_ns[frame[inside], camera] = own[inside]
    sets_ns = sets_ns[(sets_ns > 0).all(axis=1)]
    if not len(sets_ns):
        raise InputError("no two cameras' images are of the same time", remedy="Set the clocks of their machines.")
    return sets_ns, period_ns


def _stamp_ns(message: BagMessage) -> int:
    """Return the header's stamp, or where a driver leaves it empty, when the message was logged."""
    return message.stamp_ns or message.log_ns


def _stamps(bag: Path, topics: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Return the stamps (n,) of each camera's images, ns, rising, without repeated and decreasing ones."""
    series: dict[str, list[int]] = {topic: [] for topic in topics.values()}
    for message in read_messages(bag, series.__contains__):
        own, stamp_ns = series[message.topic], _stamp_ns(message)
        if not own or stamp_ns > own[-1]:
            own.append(stamp_ns)
    return {name: np.array(series[topic], np.int64) for name, topic in topics.items()}


def _copy_images(
    bag: Path, topics: Mapping[str, str], folder: Path, tail: str, fps: float, sets_ns: np.ndarray, progress: Progress
) -> None:
    """Write the images of frames (F, C), the cameras in the order of ``topics``, into a video each."""
    wanted = {topic: set(column.tolist()) for topic, column in zip(topics.values(), sets_ns.T, strict=True)}
    done = 0
    with ExitStack() as stack:
        files = {
            topic: stack.enter_context(VideoFile(folder / f"{name}{tail}{VIDEO}", fps))
            for name, topic in topics.items()
        }
        for message in read_messages(bag, files.__contains__):
            if (stamp_ns := _stamp_ns(message)) in wanted[message.topic]:
                wanted[message.topic].discard(stamp_ns)
                raw = IMAGE_TYPES.index(message.msgtype) == 0
                image = decode_image(message.decode(Image if raw else CompressedImage), message.topic, GREY_BITS)
                files[message.topic].write(image)
                done += 1
                progress(done // len(topics))


def _save_lenses(bag: Path, topics: Mapping[str, str], folder: Path) -> None:
    """Write the lens of each camera, from the camera_info beside its images. Raises InputError where one lacks."""
    wanted = {topic.removesuffix("/compressed").rpartition("/")[0] + "/camera_info": n for n, topic in topics.items()}
    infos: dict[str, CameraInfo] = {}
    for message in read_messages(bag, wanted.__contains__):
        if message.topic not in infos:
            infos[message.topic] = message.decode(CameraInfo)
        if len(infos) == len(wanted):
            break
    folder.mkdir()
    for topic, name in wanted.items():
        if topic not in infos:
            what = f"has no {topic}: the lens of {name} is not known"
            raise InputError(what, where=str(bag), remedy="Give the rig: --rig RIG.yaml.")
        info = infos[topic]
        camera = unplaced_camera(name, info.width, info.height)
        save_camera_info(folder / f"{name}.yaml", camera_from_message(info, camera, f"{bag}: {topic}"))
