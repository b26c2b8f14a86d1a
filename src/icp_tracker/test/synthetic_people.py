"""Synthetic people for the ICP tracker's tests: a body, a smooth random motion, clouds of centerline points."""

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.visibility import EVERYWHERE
from icp_tracker.articulated_fit import TOLERANCE_M, ArticulatedSettings, assess, make_data, minimise
from mocap_packets.hull import NO_CONTOUR_RAYS, NO_VOXELS
from stick_figure.kinematics import sticks
from stick_figure.least_squares.contour_factor import RayArrays
from stick_figure.least_squares.gauss_newton import Data
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place, surface_distances
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_HIGH, ANGLE_LOW, T_POSE_ANGLES

# ranges of an energetic person, well inside the joints' (rad), in the order of the angles
MOTION_LOW = np.array(
    [-0.4, -0.2, -1.4, np.pi - 0.6, -1.0, -1.0, -0.6, -0.8, -1.9, -1.9, -0.1, -0.5, -1.3, -1.3, 0.1, 0.1, -0.3, -0.3]
)
MOTION_HIGH = np.array(
    [0.4, 0.6, 0.6, np.pi + 1.4, 0.3, 0.3, 0.8, 0.6, -0.1, -0.1, 0.5, 0.1, 0.4, 0.4, 1.7, 1.7, 0.3, 0.3]
)
assert (MOTION_LOW > ANGLE_LOW).all() and (MOTION_HIGH < ANGLE_HIGH).all()


def t_pose(position=(0.0, 0.0, 1.2), heading=0.0):
    return Pose.from_angles(np.array(position), Rotation.from_rotvec([0, 0, heading]).as_matrix(), T_POSE_ANGLES)


def smooth_motion(frames, seed, fps=40.0, speed=1.0):
    """Poses of a smooth random motion: every angle a sum of three sines within its range, torso turning and walking."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames) / fps

    def wave(count):
        frequency = speed * rng.uniform(0.1, 0.9, (count, 3, 1))
        phase = rng.uniform(0, 2 * np.pi, (count, 3, 1))
        return np.sin(2 * np.pi * frequency * t + phase).mean(1).T  # (frames, count) in [-1, 1]

    angles = (MOTION_LOW + MOTION_HIGH) / 2 + (MOTION_HIGH - MOTION_LOW) / 2 * wave(18)
    position = np.array([0.0, 0.0, 1.2]) + [0.5, 0.5, 0.1] * wave(3)
    turn = wave(3) * [0.15, 0.15, 1.5]
    rotations = Rotation.from_rotvec(turn).as_matrix()
    return [Pose.from_angles(p, R, a) for p, R, a in zip(position, rotations, angles, strict=True)]


def stick_cloud(body, pose, rng, count=300, sigma=0.034):
    """Points spread evenly over the ten sticks with Gaussian noise: (about ``count``, 3)."""
    ends = sticks(body, pose)
    numbers = np.maximum(2, np.round(count * body.lengths / body.lengths.sum()).astype(int))
    along = [(np.arange(n) + 0.5) / n for n in numbers]
    clean = np.concatenate([a + u[:, None] * (b - a) for (a, b), u in zip(ends, along, strict=True)])
    return clean + sigma * rng.normal(size=clean.shape)


def fit(body, start, points, sigma_m=0.0, voxels=NO_VOXELS, settings=None, contour_rays=NO_CONTOUR_RAYS):
    """The figure fitted to points (n, 3) m with noise ``sigma_m``, voxels and contour rays, from ``start``."""
    settings = settings or ArticulatedSettings()
    data = make_data(points, sigma_m, voxels, settings, contour_rays)
    pose, iterations, moved = minimise(body, start, data, settings)
    return assess(body, pose, data, iterations, moved < TOLERANCE_M, settings)


def placed(body, pose):
    """The body of average build in a pose, as the kernels take it."""
    return place(PoseState.of(pose), BodyModel.of(body))


def voxels(body, pose, spacing=0.03):
    """Grid points (m, 3) inside the body's surface."""
    posed = placed(body, pose)
    P, Q = posed.P, posed.Q
    low, high = np.minimum(P, Q).min(0) - 0.15, np.maximum(P, Q).max(0) + 0.15
    axes = [np.arange(a, b, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[surface_distances(grid, posed)[2] < 0.0]


NO_POINTS = np.empty((0, 3))
NO_RAYS = RayArrays(np.empty((13, 0)), np.empty(0))
NO_DATA = Data(NO_POINTS, np.empty(0), np.empty(0), NO_POINTS, NO_POINTS, NO_RAYS, EVERYWHERE)
WIDE_M = 1e6  # a gate this wide makes Geman-McClure plain least squares


def data(**kinds):
    """Data of one kind and nothing else."""
    return NO_DATA._replace(**kinds)


def equations(term, *arguments):
    """Both triangles of H, and g, of one term of the fit, given what it takes before H and g."""
    H, g = np.zeros((24, 24)), np.zeros(24)
    term(*arguments, H, g)
    assert not np.tril(H, -1).any()
    return H + np.triu(H, 1).T, g
