"""One prediction and one correction against an independent dense EKF written from the textbook, and the prediction's
matrices against integration of the process they stand for."""

import numpy as np
import pytest
from ekf_person import ALL, NONE, Person, dense_matrices, isotropic
from scipy.linalg import expm
from scipy.optimize import least_squares

from capture_rig.errors import InputError
from ekf_tracker.kernels import Estimate, UpdateOptions, correct_estimate, predict_estimate
from ekf_tracker.measurement import Measurement, Sizes, linearised
from ekf_tracker.motion_model import POSE, VELOCITY, DampedVelocity, Identity
from stick_figure.joint_limits import BALL_RATES
from stick_figure.kernels import HINGE_SLOT, SLOT_OF_JOINT_AXIS
from stick_figure.kinematics import forward
from stick_figure.pose import Pose


def random_spd(rng, n, sd):
    A = rng.standard_normal((n, n)) / np.sqrt(n) + 0.3 * np.eye(n)
    S = sd**2 * A @ A.T
    return 0.5 * (S + S.T)


@pytest.fixture
def problem(body):
    """A prior with a full covariance, and points about 20 mm off it with full covariances."""
    rng = np.random.default_rng(3)
    pose = Person(body).pose(1.7)
    P = np.zeros((48, 48))
    P[:] = random_spd(rng, 48, 0.03)
    prior = Estimate(pose.arrays, rng.normal(0.0, 1.0, 24), P)
    R = np.array([random_spd(rng, 3, 0.02) for _ in range(15)])
    points = forward(body, pose.retract(0.02 * rng.standard_normal(24))) + 0.01 * rng.standard_normal((15, 3))
    return prior, Measurement.checked(points, R, ALL, 1e-6)


def corrected(body, prior, z, options):
    return correct_estimate(Sizes.of(body), prior, prior.arrays, z, options)


def numeric_jacobian(body, pose, step=1e-6):
    columns = [
        (forward(body, pose.retract(step * e)) - forward(body, pose.retract(-step * e))).ravel() / (2 * step)
        for e in np.eye(24)
    ]
    return np.stack(columns, axis=1)


def dense(at):
    """(15, 3, 24) Jacobian of a linearisation that keeps only the columns that matter."""
    H = np.zeros((15, 3, 24))
    for point in range(15):
        H[point][:, at.slots[point, : at.columns[point]]] = at.J[point, :, : at.columns[point]]
    return H


def dense_ekf(body, prior, z, visible):
    """Thesis Table 5.7 literally, on the flattened points, with a numeric Jacobian and (I - K H) P."""
    rows = np.repeat(visible, 3)
    H = np.hstack([numeric_jacobian(body, prior.pose), np.zeros((45, 24))])[rows]
    R = np.zeros((45, 45))
    for i in range(15):
        R[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = z.covariance[i]
    R = R[np.ix_(rows, rows)]
    y = (z.points_world - forward(body, prior.pose)).ravel()[rows]
    P = prior.covariance
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return K @ y, (np.eye(48) - K @ H) @ P


@pytest.mark.parametrize("hidden", [[], [1, 12], [0, 3, 7, 11]])
def test_one_iteration_equals_the_dense_textbook_update(body, problem, hidden):
    prior, z = problem
    visible = ALL.copy()
    visible[hidden] = False
    posterior = corrected(body, prior, z._replace(visible=visible), UpdateOptions(1))
    x, P = dense_ekf(body, prior, z, visible)
    np.testing.assert_allclose(posterior.pose.minus(prior.pose), x[POSE], atol=1e-7)
    np.testing.assert_allclose(posterior.velocity, prior.velocity + x[VELOCITY], atol=1e-7)
    np.testing.assert_allclose(posterior.covariance, P, atol=1e-9)


def test_iterations_end_at_the_most_probable_pose(body, problem):
    """The minimum of points' and prior's squared residuals, found by a general solver."""
    prior, z = problem
    P_half = np.linalg.cholesky(np.linalg.inv(prior.covariance[POSE, POSE]))
    R_half = np.array([np.linalg.cholesky(np.linalg.inv(R)) for R in z.covariance])

    def residuals(d):
        y = z.points_world - forward(body, prior.pose.retract(d))
        return np.concatenate([np.einsum("iab,ia->ib", R_half, y).ravel(), P_half.T @ d])

    best = least_squares(residuals, np.zeros(24), xtol=1e-12, ftol=1e-12, gtol=1e-12).x
    posterior = corrected(body, prior, z, UpdateOptions(20))
    found = forward(body, posterior.pose)
    assert np.linalg.norm(found - forward(body, prior.pose.retract(best)), axis=1).max() < 5e-4
    once = forward(body, corrected(body, prior, z, UpdateOptions(1)).pose)
    assert np.abs(found - once).max() > 1e-4  # there was something to iterate


@pytest.mark.parametrize("model", [DampedVelocity(), Identity()])
def test_prediction_equals_dense_matrices_and_moves_the_pose_along_the_velocity(body, problem, model):
    prior, _ = problem
    F, Q = dense_matrices(model.transition(0.02))
    ahead = predict_estimate(prior, model.transition(0.02), 100.0)
    np.testing.assert_allclose(ahead.covariance, F @ prior.covariance @ F.T + Q, atol=1e-12)
    np.testing.assert_array_equal(ahead.covariance, ahead.covariance.T)
    np.testing.assert_allclose(ahead.pose.minus(prior.pose), F[0, 24] * prior.velocity, atol=1e-9)
    np.testing.assert_allclose(ahead.velocity, F[24, 24] * prior.velocity, rtol=1e-12)


def test_prediction_stops_a_knee_at_straight_and_an_update_gives_no_hip_an_impossible_rate(body, problem):
    prior, z = problem
    hinges, velocity = prior.arrays[3].copy(), prior.velocity.copy()
    knee, hip = HINGE_SLOT[2], SLOT_OF_JOINT_AXIS[3]
    hinges[2], velocity[knee] = 0.3, -30.0  # straight after a hundredth of a second
    ahead = predict_estimate(
        Estimate((*prior.arrays[:3], hinges), velocity, prior.covariance), DampedVelocity().transition(0.02), 100.0
    )
    assert ahead.pose.hinges[2] == 0.0 and ahead.velocity[knee] == 0.0
    velocity[hip] = 0.0, 90.0, 0.0
    fast = Estimate(prior.arrays, velocity, prior.covariance)
    limited = corrected(body, fast, z, UpdateOptions(5, limit_weight=25.0))
    assert np.linalg.norm(limited.velocity[hip]) == pytest.approx(BALL_RATES[3])
    assert np.linalg.norm(corrected(body, fast, z, UpdateOptions(5)).velocity[hip]) > 50.0


@pytest.mark.parametrize("hinge", range(4))
def test_turned_hinge_leaves_points_and_their_covariance_as_they_were(body, hinge):
    """Elbow or knee bent 0.4 rad past straight: the other description of the same limb, velocity and covariance too."""
    rng = np.random.default_rng(hinge)
    pose, P, velocity = Person(body).pose(0.9), random_spd(rng, 48, 0.1), rng.standard_normal(24)
    past = pose.hinges.copy()
    past[hinge] = 0.4 if hinge < 2 else -0.4
    before = Pose(pose.position_world, pose.R_world_torso, pose.R_joints, past)
    nothing = Measurement(np.zeros((15, 3)), isotropic(1.0), NONE)  # an update without points: description alone
    options = UpdateOptions(1, 0.0, 0.15)
    prior = Estimate(before.arrays, velocity, P)
    arrays, turned_velocity, turned = corrected(body, prior, nothing, options)
    assert arrays[3][hinge] == pytest.approx(-past[hinge])

    (h0, H0), (h1, H1) = ((at.h, dense(at)) for at in (linearised(body, before), linearised(body, Pose(*arrays))))
    np.testing.assert_allclose(h1, h0, atol=1e-12)
    np.testing.assert_allclose(H1 @ turned_velocity, H0 @ velocity, atol=1e-9)
    joint = np.block([[H0.reshape(45, 24), np.zeros((45, 24))], [np.zeros((45, 24)), H0.reshape(45, 24)]])
    joint_turned = np.block([[H1.reshape(45, 24), np.zeros((45, 24))], [np.zeros((45, 24)), H1.reshape(45, 24)]])
    np.testing.assert_allclose(joint_turned @ turned @ joint_turned.T, joint @ P @ joint.T, atol=1e-9)


@pytest.mark.parametrize(
    ("spoil", "point"),
    [
        (lambda p, C, v: p.__setitem__((7, 1), np.nan), "left_elbow"),
        (lambda p, C, v: C.__setitem__((2, 0, 0), np.inf), "neck"),
        (lambda p, C, v: C.__setitem__((14, 0, 1), 0.5), "right_foot"),
        (lambda p, C, v: C.__setitem__((0, 2, 2), -0.1), "torso"),
    ],
)
def test_bad_measurement_is_refused_by_the_name_of_its_point(spoil, point):
    points, covariance, visible = np.zeros((15, 3)), isotropic(0.02), ALL.copy()
    spoil(points, covariance, visible)
    with pytest.raises(InputError, match=f"point '{point}'"):
        Measurement.checked(points, covariance, visible, 0.001)


def test_numbers_of_invisible_points_do_not_matter():
    points, covariance, visible = np.zeros((15, 3)), isotropic(0.02), ALL.copy()
    points[4], covariance[4], visible[4] = np.nan, np.nan, False
    z = Measurement.checked(points, covariance, visible, 0.001)
    assert np.isfinite(z.points_world).all() and np.isfinite(z.covariance).all()


# --- the prediction's matrices ----------------------------------------------------------------------------------------


def van_loan(damping, density, dt):
    """Transition and noise (2, 2) of dx = v dt, dv = -damping v dt + white noise, by Van Loan's matrix exponential."""
    A = np.array([[0.0, 1.0], [0.0, -damping]])
    M = np.zeros((4, 4))
    M[:2, :2], M[:2, 2:], M[2:, 2:] = -A, np.diag([0.0, density]), A.T
    E = expm(M * dt)
    F = E[2:, 2:].T
    return F, F @ E[:2, 2:]


@pytest.mark.parametrize("dt", [1e-6, 1e-4, 1 / 1000, 1 / 60, 1 / 40, 0.5, 2.0])
@pytest.mark.parametrize(("slot", "acceleration"), [(1, 8.0), (4, 30.0), (8, 60.0), (14, 80.0)])
@pytest.mark.parametrize(("kept", "period"), [(0.9, 1 / 40), (0.8, 0.05)])
def test_damped_velocity_equals_the_integrated_process_for_every_kind_of_joint(dt, slot, acceleration, kept, period):
    model = DampedVelocity(kept=kept, reference_period=period)
    both = np.ix_([slot, 24 + slot], [slot, 24 + slot])
    F, Q = (matrix[both] for matrix in dense_matrices(model.transition(dt)))
    F_true, Q_true = van_loan(-np.log(kept) / period, acceleration**2 * period, dt)
    np.testing.assert_allclose(F, F_true, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(Q, Q_true, rtol=1e-6)
