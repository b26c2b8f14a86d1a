"""bench/joint_centres.py finds the regression that made its data, and writes the table that is read."""

import joint_centres as bench
import numpy as np
import pytest

from stick_figure import joint_centres as table
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.trunk_bend import REST_SD

BODY = Body.from_stature(1.7)


def track(seed: int, constant_m: float) -> bench.Tracked:
    """Random poses of somebody whose joints lie where the tree's table says, and off ahead and up by a constant."""
    random = np.random.default_rng(seed)
    poses = [
        Pose.from_angles(random.normal(size=3), np.eye(3), T_POSE_ANGLES + random.uniform(-0.7, 0.7, 18))
        for _ in range(150)
    ]
    bodies = [BODY.bent(REST_SD * random.normal(size=len(REST_SD))) for _ in poses]
    points = np.array([forward(body, pose) for body, pose in zip(bodies, poses, strict=True)])
    truth = np.array([table.with_joint_centres(*row) for row in zip(bodies, poses, points, strict=True)])
    return bench.Tracked(bodies, poses, points, truth + constant_m * np.array([1.0, 0.0, 1.0]))


def test_the_regression_is_found_again(monkeypatch) -> None:
    monkeypatch.setattr(bench, "RIDGE", 1e-9)
    found = bench.regressed([track(1, 0.0), track(2, 0.0)])
    assert found.per_feature == pytest.approx(table.joint_centres().per_feature, abs=2e-4)


def test_what_is_constant_is_not_learnt() -> None:
    assert bench.regressed([track(3, 0.05)]).per_feature == pytest.approx(
        bench.regressed([track(3, 0.0)]).per_feature, abs=1e-9
    )


def test_errors_are_those_of_the_table() -> None:
    one = track(4, 0.0)
    assert one.errors_mm(centres=True).max() < 1e-6
    assert one.errors_mm(centres=False).max() > 5.0


def test_table_is_read_as_it_was_written(tmp_path) -> None:
    bench.write(tmp_path / "joint_centres.csv", table.joint_centres())
    assert (tmp_path / "joint_centres.csv").read_text() == table.TABLE.read_text()
