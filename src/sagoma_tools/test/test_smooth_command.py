"""``sagoma smooth`` on a recorded take: the same topics, quieter and nearer, and never over another bag."""

import numpy as np
import pytest
from poses import pose_with
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from mocap_packets.fit import FIRST_PERSON, ReferencePoints
from mocap_packets.people import PeoplePoints, format_bodies
from sagoma_ros.packets import people_cloud
from sagoma_tools.cli import main
from sagoma_tools.evaluation.track import tracks_from_bag
from sagoma_tools.recording.reader import bag_topics, read_messages
from sagoma_tools.recording.smoothing import SMOOTHED
from sagoma_tools.recording.writer import BagWriter
from stick_figure.body import Body, format_body
from stick_figure.kinematics import forward

FPS, SETS, GAP, NOISE_M = 60, 60, range(30, 36), 0.01
FIRST_NS = 1_700_000_000_000_000_000


def stamp_ns(k):
    return FIRST_NS + round(k * 1e9 / FPS)


def points_of(body, k):
    bent = -0.6 - 0.5 * np.sin(2 * np.pi * k / FPS)
    return forward(body, pose_with(at=(0.01 * k, 0.0, 1.0), left_elbow=bent, right_elbow=bent))


OTHER, ASIDE_M = 2, np.array([0.0, 1.5, 0.0])
OTHERS_SETS, AWAY = range(10, 50), range(20, 30)  # comes later, is away for a while, and leaves before the end
TOGETHER = f"/mocap/bodies/b{OTHER:04d}"


@pytest.fixture
def bag(tmp_path):
    """Fits of a walker whose elbows bend, with noise; six sets in which nothing is seen. A smaller one comes later."""
    body, rng, folder = Body.from_stature(1.75), np.random.default_rng(4), tmp_path / "take"
    smaller = Body.from_stature(1.55)
    with BagWriter(folder) as writer:
        writer.add_topic("/icp/body", "std_msgs/msg/String")
        writer.add_topic("/icp/bodies", "std_msgs/msg/String")
        writer.add_topic("/icp/reference_points", "sensor_msgs/msg/PointCloud2")
        writer.add_topic(f"{TOGETHER}/reference_points", "sensor_msgs/msg/PointCloud2")
        bodies = String(data=format_bodies({OTHER: smaller}))
        writer.write("/icp/bodies", stamp_ns(OTHERS_SETS.start), serialize_message(bodies))
        writer.write("/icp/body", FIRST_NS, serialize_message(String(data=format_body(body))))
        for k in range(SETS):
            people = {FIRST_PERSON: (points_of(body, k), k not in GAP)}
            if k in OTHERS_SETS and k not in AWAY:
                people[OTHER] = (points_of(smaller, k) + ASIDE_M, True)
            fitted = PeoplePoints({person: fit_of(*seen, rng) for person, seen in people.items()})
            cloud = people_cloud(fitted, stamp_ns(k), "map")
            writer.write("/icp/reference_points", stamp_ns(k), serialize_message(cloud))
    return folder, *(np.array([points_of(one, k) for k in range(SETS)]) for one in (body, smaller))


def fit_of(points_world, seen, rng):
    measured = points_world + NOISE_M * rng.standard_normal((15, 3))
    return ReferencePoints(measured, np.tile(NOISE_M**2 * np.eye(3), (15, 1, 1)), np.full(15, seen))


def frame_of(ns):
    return round((ns - FIRST_NS) * FPS / 1e9)


def test_take_is_smoothed_into_a_new_bag_with_a_state_at_every_set(bag, capsys):
    folder, truth, truth_other = bag
    assert main(["smooth", str(folder), "--set", "ekf_tracker.filter.lost_after_s=1.5"]) == 0
    assert f"smoothed {SETS} of {SETS} frame sets" in capsys.readouterr().out
    smoothed = folder.with_name("take_smoothed")
    made = {f"{prefix}/{what}" for prefix in ("/mocap", TOGETHER) for what in SMOOTHED}
    assert made | {"/icp/body", "/icp/bodies", "/icp/reference_points"} == set(bag_topics(smoothed))
    assert sum(message.topic == "/mocap/joint_covariance" for message in read_messages(smoothed)) == SETS
    tracks = tracks_from_bag(smoothed, frame_of)
    errors = np.linalg.norm(tracks[1].points_world - truth, axis=2)
    assert errors.mean() < 0.95 * NOISE_M * np.sqrt(8 / np.pi)  # mean length of the noise, taken for a lasting error
    assert errors[GAP.start : GAP.stop].max() < 0.12
    other = tracks[OTHER]
    assert other.frames.tolist() == [k for k in OTHERS_SETS if k not in AWAY]
    errors = np.linalg.norm(other.points_world - truth_other[other.frames] - ASIDE_M, axis=2)
    assert errors.mean() < NOISE_M * np.sqrt(8 / np.pi)


def test_no_bag_is_replaced_and_one_without_fits_is_refused(bag, tmp_path, capsys):
    folder, *_ = bag
    assert main(["smooth", str(folder), str(folder)]) == 2
    assert "exists already" in capsys.readouterr().err
    with BagWriter(tmp_path / "other") as writer:
        writer.add_topic("/icp/body", "std_msgs/msg/String")
    assert main(["smooth", str(tmp_path / "other")]) == 2
    assert "/icp/reference_points" in capsys.readouterr().err
    assert not (tmp_path / "other_smoothed").exists()
