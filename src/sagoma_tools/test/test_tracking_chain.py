"""The chain of hull, tracker and filter on exact silhouettes of the virtual studio."""

from dataclasses import replace

import numpy as np
import pytest

from sagoma_tools.evaluation.chain import Chain, Configuration
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import t_pose_only
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

FRAME_NS = 16_666_667
BODY = Body.from_stature(1.75)


@pytest.fixture(scope="module")
def t_pose():
    """Rig, silhouettes {camera: mask} and true points (15, 3) of somebody in a T-pose."""
    rig, pose = ring(5), t_pose_only(BODY, 0.1, 60.0).poses[0]
    return rig, ExactSilhouettes(rig).render(VolumetricBody(BODY).place(pose)), forward(BODY, pose)


@pytest.fixture
def standing(t_pose):
    """A chain that has tracked the T-pose, and the stamp of the set after."""
    rig, masks, _ = t_pose
    chain = Chain(rig, Configuration.of({"hull_server.backend": "cpu"}))
    steps = [chain.step(FRAME_NS * frame, masks) for frame in range(1, 31)]
    assert steps[-1].state is not None
    return chain, steps[-1], 31 * FRAME_NS


def test_chain_finds_and_follows_a_person_in_a_t_pose(standing, t_pose):
    _, step, _ = standing
    errors = np.linalg.norm(step.state.points_world - t_pose[2], axis=1)
    assert errors.mean() < 0.04
    assert errors.max() < 0.12


def test_misled_chain_believes_the_wrong_pose_and_starts_the_next_fit_from_it(standing):
    chain, step, stamp_ns = standing
    wrong = replace(step.state.pose, position_world=step.state.pose.position_world + np.array([0.0, 0.0, 0.3]))
    misled = chain.tracking.mislead(stamp_ns, wrong)
    body = chain.tracking.icp.body
    np.testing.assert_allclose(misled.state.points_world, forward(body, wrong), atol=5e-3)
    unseen = chain.step(stamp_ns + FRAME_NS, _no_masks(chain))
    assert unseen.fit.started_from == str(stamp_ns)
    np.testing.assert_allclose(unseen.fit.reference_points_world, forward(body, wrong), atol=0.02)


def test_misleading_a_chain_that_follows_nobody_is_refused(t_pose):
    chain = Chain(t_pose[0], Configuration.of({"hull_server.backend": "cpu"}))
    pose = t_pose_only(BODY, 0.1, 60.0).poses[0]
    with pytest.raises(ValueError, match="nobody"):
        chain.tracking.mislead(0, pose)


def test_chain_goes_on_with_a_camera_missing(standing, t_pose):
    chain, _, stamp_ns = standing
    masks = {name: mask for name, mask in t_pose[1].items() if name != "cam03"}
    step = chain.step(stamp_ns, masks, ("cam03",))
    assert np.linalg.norm(step.state.points_world - t_pose[2], axis=1).mean() < 0.04


def _no_masks(chain):
    return {
        name: np.zeros((height, width), np.uint8)
        for name, (width, height) in zip(chain.hull.views.names, chain.hull.views.sizes, strict=True)
    }
