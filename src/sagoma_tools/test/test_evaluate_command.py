"""``sagoma evaluate`` from the footage to the line of JSON, on a short session of the virtual studio."""

import json
import shutil

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage

from capture_rig.errors import InputError
from mocap_packets.fit import ReferencePoints
from sagoma_ros.messages import to_stamp
from sagoma_ros.packets import joint_state_message, packet_cloud
from sagoma_tools.cli import main
from sagoma_tools.commands.evaluate import find
from sagoma_tools.evaluation.in_process import OURS, ROWS, THESIS
from sagoma_tools.evaluation.track import tracks_from_bag
from sagoma_tools.recording.writer import BagWriter
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

FRAMES = 12
DOUBT = ("flagged_of_bad", "false_alarms", "identity_switches")
FIGURES = {
    *DOUBT,
    "frames",
    "tracked",
    "mean_mm",
    "p95_mm",
    "over_200mm",
    "thesis_mean_mm",
    "mean_mm_without_offset",
    "inside_95",
    "time_to_track_s",
}


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Half a second of T-pose, seen by five cameras."""
    folder = tmp_path_factory.mktemp("studio") / "standing"
    return write_session(folder, ring(4, True), Body.from_stature(1.75), "t_pose_only", fps=20.0, seconds=FRAMES / 20.0)


def evaluated(capsys, *arguments) -> dict:
    assert main(["evaluate", *map(str, arguments), "--set", "hull_server.backend=cpu"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_evaluate_prints_every_figure_and_compares_with_the_thesis_method(session, capsys):
    figures = evaluated(capsys, session, "--start", "session", "--exact-masks", "--json")
    assert set(figures) >= FIGURES
    assert (figures["frames"], figures["tracked"], figures["time_to_track_s"]) == (FRAMES, FRAMES, 0.0)
    assert 0.0 < figures["mean_mm"] < 40.0
    assert figures["mean_mm"] != figures["thesis_mean_mm"] > 0.0
    assert figures["states"] == {"tracking": FRAMES}
    assert tuple(figures[key] for key in DOUBT) == (None, 0.0, 0)


@pytest.mark.slow
def test_the_ablation_ends_with_our_figures_and_begins_with_the_thesis(session, capsys, tmp_path):
    arguments = (session, "--start", "session", "--exact-masks", "--ablation", "--plots", tmp_path)
    assert main(["evaluate", *map(str, arguments), "--set", "hull_server.backend=cpu"]) == 0
    said = capsys.readouterr().out
    figures = json.loads(said.splitlines()[-1])
    assert tuple(figures["ablation"]) == ROWS
    assert figures["ablation"][OURS]["mean_mm"] == figures["mean_mm"]
    assert figures["ablation"][THESIS]["mean_mm"] == figures["thesis_mean_mm"]
    assert "ablation: each row adds one part" in said
    assert {path.name for path in tmp_path.iterdir()} >= {"point_errors.png", "errors.png", "overlay.png", "worst.png"}


def test_a_session_without_truth_is_tracked_and_judged_by_what_can_be_said(session, capsys, tmp_path):
    blind = shutil.copytree(session, tmp_path / "blind")
    (blind / "truth.csv").unlink()
    figures = evaluated(capsys, blind, "--exact-masks", "--json")
    assert figures["frames"] == FRAMES
    assert figures["time_to_track_s"] is not None
    assert not {"mean_mm", "thesis_mean_mm", "inside_95"} & set(figures)
    assert main(["evaluate", str(blind), "--ablation"]) == 2
    assert "Leave out --ablation" in capsys.readouterr().err


class Arguments:
    """What the command line gives."""

    def __init__(self, session, bag=None):
        self.session, self.bag = str(session), bag


def test_a_bag_is_judged_on_the_session_that_it_names(session, tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/mocap/joint_states", "sensor_msgs/msg/JointState")
    bag.describe({"session": str(session)})
    found, path = find(Arguments(tmp_path / "bag"))
    assert found.folder == session
    assert path == str(tmp_path / "bag")


def test_a_bag_of_unknown_origin_asks_for_its_session(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/mocap/joint_states", "sensor_msgs/msg/JointState")
    with pytest.raises(InputError, match="neither of which session it is nor"):
        find(Arguments(tmp_path / "bag"))


def test_a_bag_of_live_cameras_is_judged_by_what_can_be_said(session, tmp_path, capsys):
    bag = write_live_bag(tmp_path / "bag", session / "rig.yaml")
    figures = evaluated(capsys, bag, "--json")
    assert figures.pop("states") == {"doubtful": 2, "tracking": 34}
    assert {key: figures.pop(key) for key in DOUBT} == dict.fromkeys(DOUBT)  # there is no truth
    assert figures == {"frames": 40, "tracked": 36, "time_to_track_s": 0.3, "jitter_mm": 0.0}
    for option, said in (("--thesis", "Leave out --thesis"), ("--ablation", "one track and no variants")):
        assert main(["evaluate", str(bag), option]) == 2
        assert said in capsys.readouterr().err


def test_a_bag_holds_a_track_of_each_person(session, tmp_path, capsys):
    bag = write_live_bag(tmp_path / "bag", session / "rig.yaml", others={"b0003": 8, "anna": 30})
    first_ns = 1_700_000_000_000_000_000
    tracks = tracks_from_bag(bag, lambda stamp_ns: (stamp_ns - first_ns) // 50_000_000)
    assert [(person, int(track.frames[0]), len(track)) for person, track in tracks.items()] == [
        (1, 4, 36),
        (3, 8, 32),  # the third of b0001, b0002, ...
        (5, 30, 10),  # of no number of ours
    ]
    figures = evaluated(capsys, bag, "--json")
    assert figures["tracked"] == 36 and "persons" not in figures  # there is no truth of several persons


def write_live_bag(folder, rig, others=()):
    """40 silhouettes at 20 Hz; from the fifth on somebody who stands still, for two frames doubtful; ``others`` : id
    and first frame of further bodies."""
    of_person = {
        "reference_points": "sensor_msgs/msg/PointCloud2",
        "joint_states": "sensor_msgs/msg/JointState",
        "state": "diagnostic_msgs/msg/DiagnosticStatus",
    }
    prefixes = {"/mocap": 4} | {f"/mocap/bodies/{body_id}": frame for body_id, frame in dict(others).items()}
    topics = {"/cam01/silhouette/compressed": "sensor_msgs/msg/CompressedImage"}
    topics |= {f"{prefix}/{what}": kind for prefix in prefixes for what, kind in of_person.items()}
    body = Body.from_stature(1.75)
    points = forward(body, Pose.from_angles([0.0, 0.0, 1.0], np.eye(3), T_POSE_ANGLES))
    measured = ReferencePoints(points, np.broadcast_to(np.eye(3) * 1e-4, (15, 3, 3)), np.ones(15, bool))
    with BagWriter(folder) as bag:
        for topic, msgtype in topics.items():
            bag.add_topic(topic, msgtype)
        for frame in range(40):
            stamp_ns = 1_700_000_000_000_000_000 + 50_000_000 * frame
            silhouette = CompressedImage()
            silhouette.header.stamp = to_stamp(stamp_ns)
            messages = {"/cam01/silhouette/compressed": silhouette}
            for prefix in [prefix for prefix, begins in prefixes.items() if frame >= begins]:
                state = "tracking" if frame >= 6 else "doubtful"
                angles = joint_state_message(ANGLE_NAMES, T_POSE_ANGLES, np.zeros(18), stamp_ns, "map")
                said = DiagnosticStatus(message=state, values=[KeyValue(key="stamp_ns", value=str(stamp_ns))])
                messages |= {
                    f"{prefix}/reference_points": packet_cloud(measured, stamp_ns, "map"),
                    f"{prefix}/joint_states": angles,
                    f"{prefix}/state": said,
                }
            for topic, message in messages.items():
                bag.write(topic, stamp_ns, serialize_message(message))
    bag.describe({}, rig)
    return folder
