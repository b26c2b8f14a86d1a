"""The prediction's matrices against integration of the process they stand for."""

import numpy as np
import pytest
from ekf_person import dense_matrices
from scipy.linalg import expm

from capture_rig.settings import build_settings
from ekf_tracker.motion_model import DampedVelocity, Identity
from ekf_tracker.settings import EkfSettings, motion_model
from ekf_tracker.state import POSE, VELOCITY, per_slot


def van_loan(damping, density, dt):
    """Transition and noise (2, 2) of dx = v dt, dv = -damping v dt + white noise, by Van Loan's matrix exponential."""
    A = np.array([[0.0, 1.0], [0.0, -damping]])
    M = np.zeros((4, 4))
    M[:2, :2], M[:2, 2:], M[2:, 2:] = -A, np.diag([0.0, density]), A.T
    E = expm(M * dt)
    F = E[2:, 2:].T
    return F, F @ E[:2, 2:]


def slot_blocks(F, Q, slot):
    both = np.ix_([slot, 24 + slot], [slot, 24 + slot])
    return F[both], Q[both]


@pytest.mark.parametrize("dt", [1e-6, 1e-4, 1 / 1000, 1 / 60, 1 / 40, 0.5, 2.0])
@pytest.mark.parametrize(("slot", "acceleration"), [(1, 8.0), (4, 30.0), (8, 60.0), (14, 80.0)])
@pytest.mark.parametrize(("kept", "period"), [(0.9, 1 / 40), (0.8, 0.05)])
def test_damped_velocity_equals_the_integrated_process_for_every_kind_of_joint(dt, slot, acceleration, kept, period):
    model = DampedVelocity(kept=kept, reference_period=period)
    F, Q = slot_blocks(*dense_matrices(model.transition(dt)), slot)
    F_true, Q_true = van_loan(-np.log(kept) / period, acceleration**2 * period, dt)
    np.testing.assert_allclose(F, F_true, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(Q, Q_true, rtol=1e-6)


def test_unknown_velocity_has_the_variance_that_the_process_settles_at():
    model = DampedVelocity()
    _, Q = dense_matrices(model.transition(60.0))
    np.testing.assert_allclose(np.diag(Q)[VELOCITY], model.velocity_variance(), rtol=1e-9)


def test_identity_model_moves_nothing_and_grows_the_pose_by_the_thesis_noise():
    F, Q = dense_matrices(Identity().transition(0.05))
    moved = F @ np.concatenate([np.zeros(24), np.ones(24)])
    np.testing.assert_array_equal(moved, 0.0)
    np.testing.assert_array_equal(F[POSE, POSE], np.eye(24))
    np.testing.assert_allclose(np.diag(Q)[POSE], (per_slot(1.0, 1.5, 3.0, 3.0) * 0.05) ** 2)


def test_identity_model_lets_the_velocity_follow_from_the_pose_it_explains():
    """The velocity of the step just made: (new pose - old pose) / dt, whatever the velocity was before."""
    dt = 0.05
    P_before = np.diag(np.concatenate([np.full(24, 1e-4), np.full(24, 7.0)]))
    F, Q = dense_matrices(Identity().transition(dt))
    P = F @ P_before @ F.T + Q
    gain = P[VELOCITY, POSE] @ np.linalg.inv(P[POSE, POSE] - 1e-4 * np.eye(24))
    np.testing.assert_allclose(gain, np.eye(24) / dt, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("model", [DampedVelocity(), Identity()])
def test_noise_is_a_covariance_for_every_time_step(model):
    for dt in (0.0, 1e-4, 1 / 60, 1.0):
        _, Q = dense_matrices(model.transition(dt))
        np.testing.assert_array_equal(Q, Q.T)
        assert np.linalg.eigvalsh(Q)[0] > -1e-12


def test_settings_choose_the_model():
    assert motion_model(build_settings(EkfSettings, {"motion_model": "identity"}, "test")) == Identity()
    assert motion_model(EkfSettings()) == DampedVelocity()
