"""Broken files of every kind, read by every reader and command: an error that says what, where and what to do.

Seeded: the same files are broken the same way each time. The slow test breaks each some hundred times.
"""

from __future__ import annotations

import contextlib
import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pose_file import save_initial_pose
from sensor_msgs.msg import CompressedImage
from take_bags import write_take

from camera_client.background.model import BackgroundModel, Provenance, load_background
from capture_rig.camera_info_file import read_camera_info, save_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import load_rig, save_rig
from capture_rig.session import load_truth, stated_rate
from capture_rig.yaml_file import save_mapping
from icp_tracker.initialization.initial_pose import load_initial_pose
from rig_calibration.boards.board import read_board
from sagoma_bringup.graph import camera_from_file
from sagoma_tools.calibration.rig_detections import read_corners
from sagoma_tools.cli import main
from sagoma_tools.recording.reader import read_messages, read_provenance
from sagoma_tools.recording.writer import BagWriter
from sagoma_tools.takes.folder import TakesFolder
from stick_figure.body import Body, load_body, save_body
from stick_figure.pose import T_POSE_ANGLES, Pose
from virtual_studio.motions.bvh import read_bvh
from virtual_studio.motions.catalogue import t_pose_only
from virtual_studio.recording.session import write_truth
from virtual_studio.rig import ring

VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 2**63, 1e300, float("nan"), float("inf"), "", "text", "../../x", "x" * 10_000),
    *([], [1], [[1, 2], [3]], [["a"]], {}, {"a": 1}, {1: 2}),
)


def damaged_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return ``data`` with flipped bytes, cut, or with a part doubled or of zeros."""
    changed, kind = bytearray(data), rng.integers(5)
    if not changed:
        return b"\0"
    place = int(rng.integers(len(changed)))
    length = int(rng.integers(1, max(len(changed) // 4, 2)))
    if kind <= 1:
        for where in rng.integers(0, len(changed), int(rng.integers(1, 9))):
            changed[where] ^= int(rng.integers(1, 256))
    elif kind == 2:
        del changed[place:]
    elif kind == 3:
        changed[place:place] = changed[place : place + length]
    else:
        changed[place : place + length] = bytes(min(length, len(changed) - place))
    return bytes(changed)


def damaged_yaml(text: str, rng: np.random.Generator) -> bytes:
    """Return a YAML text in which one value is of another type, missing, or under another name; or damaged bytes."""
    if rng.integers(3) == 0:
        return damaged_bytes(text.encode(), rng)
    document = yaml.safe_load(text)
    holder, key = _place(document, rng)
    kind = rng.integers(4)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, dict):
        holder[VALUES[int(rng.integers(12))]] = holder.pop(key)
    else:
        holder[key] = VALUES[int(rng.integers(len(VALUES)))]
    return yaml.safe_dump(document, sort_keys=False).encode()


def _place(document: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return a random mapping or list in the document, and a key in it."""
    while True:
        keys = list(document) if isinstance(document, dict) else range(len(document))
        key = keys[int(rng.integers(len(keys)))]
        inner = document[key]
        if not isinstance(inner, dict | list) or not inner or rng.integers(4) == 0:
            return document, key
        document = inner


def damage(path: Path, rng: np.random.Generator) -> None:
    if path.suffix == ".yaml":
        path.write_bytes(damaged_yaml(path.read_text(encoding="utf-8"), rng))
    else:
        path.write_bytes(damaged_bytes(path.read_bytes(), rng))


FEW, MANY = 12, 400
BVH = """HIERARCHY
ROOT Hips { OFFSET 0 0 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
JOINT Chest { OFFSET 0 10 0
CHANNELS 3 Zrotation Xrotation Yrotation
End Site { OFFSET 0 10 0 } } }
MOTION
Frames: 2
Frame Time: 0.0333
0 0 0 0 0 0 1 2 3
1 0 0 0 0 0 4 5 6
"""


def write_background(path: Path) -> None:
    grey = np.full((6, 8), 90, np.float32)
    BackgroundModel(grey, grey / 30, Provenance("test", 10, 3.0)).save(path)


CAMERA = {"/cam01/camera_client": {"ros__parameters": {"camera_name": "cam01", "aravis": {"address": "127.0.1.1"}}}}
BOARD = {"type": "checkerboard", "columns": 8, "rows": 5, "square_m": 0.1}
BODY = Body.from_stature(1.7)
POSE = Pose.from_angles(np.array([0.0, 0.0, 1.1]), np.eye(3), T_POSE_ANGLES)
KINDS: dict[str, tuple[str, Callable[[Path], object], Callable[[Path], object]]] = {
    "rig": ("rig.yaml", lambda path: save_rig(ring(2), path), load_rig),
    "calibration": ("cam01.yaml", lambda path: save_camera_info(path, ring(1).cameras[0]), read_camera_info),
    "body": ("body.yaml", lambda path: save_body(BODY, path), load_body),
    "pose": ("pose.yaml", lambda path: save_initial_pose(POSE, path), load_initial_pose),
    "board": ("board.yaml", lambda path: save_mapping(path, BOARD), lambda path: read_board(str(path))),
    "corners": (
        "corners.yaml",
        lambda path: path.write_text("cam01: {corners: [[1, 0], [0, 1], [0, 0], [0, 0]], frame: 3}\n"),
        read_corners,
    ),
    "camera parameters": ("cam01.yaml", lambda path: save_mapping(path, CAMERA), camera_from_file),
    "session": ("session.yaml", lambda path: save_mapping(path, {"fps": 30.0, "units": "metres, pixels"}), stated_rate),
    "truth": ("truth.csv", lambda path: write_truth(path, BODY, t_pose_only(BODY, 0.1, 30.0)), load_truth),
    "background": ("cam01.npz", write_background, load_background),
    "motion": ("walk.bvh", lambda path: path.write_text(BVH), read_bvh),
}


def break_and_read(kind: str, folder: Path, times: int) -> int:
    """Break a file of this kind so often; return how often that was noticed. Anything but an InputError is raised."""
    name, write, read = KINDS[kind]
    rng, refused = np.random.default_rng(len(kind)), 0
    write(folder / name)
    read(folder / name)
    whole = (folder / name).read_bytes()
    for _ in range(times):
        (folder / name).write_bytes(whole)
        damage(folder / name, rng)
        try:
            read(folder / name)
        except InputError as error:
            refused += 1
            assert error.where and error.remedy and len(str(error)) < 3000, str(error)
    return refused


@pytest.mark.parametrize("times", [FEW, pytest.param(MANY, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_a_broken_file_is_an_input_error(kind: str, times: int, tmp_path: Path) -> None:
    assert break_and_read(kind, tmp_path, times) > times // 10


# --- bags, by every command that reads them


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_take(tmp_path_factory.mktemp("takes") / "walk", 20)


def run(*words: object) -> tuple[int, str]:
    """Run a command; its status and what it said on stderr."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        status = main([str(word) for word in words])
    return status, said.getvalue()


COMMANDS = (
    *("compare BAG BAG", "export BAG --format csv --output OUT/csv", "smooth BAG OUT/smooth"),
    *("recover BAG OUT/recovered", "takes show BAG", "takes verify BAG"),
)


def is_refused(bag: Path) -> bool:
    """Read all of a bag; whether that raises an InputError, which has to say where and what to do."""
    try:
        for _ in read_messages(bag):
            pass
        read_provenance(bag)
    except InputError as error:
        assert error.where and error.remedy
        return True
    return False


@pytest.mark.parametrize("times", [FEW, pytest.param(20 * FEW, marks=pytest.mark.slow)])
def test_a_broken_bag_is_a_clear_error_of_every_command(take: Path, tmp_path: Path, times: int) -> None:
    """Break a bag so often, each time one of its files, and give it to one command after the other."""
    rng, refused, statuses = np.random.default_rng(7), 0, set()
    names = ["walk.mcap", "walk.mcap", "metadata.yaml", "sagoma.yaml"]
    for number in range(times):
        bag, out = tmp_path / f"{number}" / "walk", tmp_path / f"{number}" / "out"
        shutil.copytree(take, bag)
        out.mkdir()
        damage(bag / names[number % len(names)], rng)
        refused += is_refused(bag)
        command = COMMANDS[number % 6].replace("BAG", str(bag)).replace("OUT", str(out))
        status, said = run(*command.split())
        statuses.add(status)
        assert status in (0, 1, 2) and "Traceback" not in said, (command, said)
        assert status != 2 or said.startswith("sagoma: "), (command, said)
        assert TakesFolder(bag.parent).takes()
        shutil.rmtree(tmp_path / f"{number}")
    assert refused and 2 in statuses


# --- found by trying


def test_a_camera_whose_name_no_topic_can_have_is_refused(tmp_path: Path) -> None:
    save_rig(ring(1, False), tmp_path / "rig.yaml")
    spaced = (tmp_path / "rig.yaml").read_text().replace("cam01", "left camera")
    (tmp_path / "rig.yaml").write_text(spaced)
    with pytest.raises(InputError, match="'left camera' cannot be a camera's name"):
        load_rig(tmp_path / "rig.yaml")


def bag_of(folder: Path, kind: str, data: bytes) -> Path:
    """A bag of one message on a topic of silhouettes."""
    with BagWriter(folder) as writer:
        writer.add_topic("/cam01/silhouette/compressed", kind)
        writer.write("/cam01/silhouette/compressed", 1234, data)
    return folder


def test_a_bag_with_a_topic_of_another_type_is_refused(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / "bag", "std_msgs/msg/String", b"\0\1\0\0\1\0\0\0\0")
    status, said = run("replay", bag)
    assert status == 2 and "holds messages of type std_msgs/msg/String, not sensor_msgs/msg/CompressedImage" in said


def test_a_message_shorter_than_its_stamp_is_an_error_with_its_place(tmp_path: Path) -> None:
    (message,) = read_messages(bag_of(tmp_path / "bag", "sensor_msgs/msg/CompressedImage", b"\0\1\0\0\1\0"))
    for read in (lambda: message.stamp_ns, lambda: message.decode(CompressedImage)):
        with pytest.raises(InputError, match=r"bag: /cam01/silhouette.*the message logged at 1234 ns.*sagoma recover"):
            read()
