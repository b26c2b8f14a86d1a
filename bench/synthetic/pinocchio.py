"""The stick figure as a pinocchio model, and two solvers on its Jacobians (``pip install pin``)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from stick_figure.body import Body
from stick_figure.least_squares.point_factor import foot_points
from stick_figure.pose import Pose
from stick_figure.skeleton import BALL_ANGLES, HINGE_ANGLES, PARENT

from .clips import Clip
from .solvers import ASSIGNMENTS, POINT_ENDS, PRIOR, STOP_M, Solver, along_stick, local_ends

BALL_AXES = ("xy", "xzy", "xzy", "xyz", "xyz")
HINGE_AXES = ("z", "z", "y", "y")
JOINTS = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}
LEAST_DAMPING = 1e-6
LARGEST_STEP = 0.5


class Figure:
    """Model, data, and the frames at both ends of every stick."""

    def __init__(self, body: Body) -> None:
        self.model, self._joint = pin.Model(), {}
        self._joint[0] = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "torso")
        origins = body.stick_origins_torso
        for stick, axes in enumerate(BALL_AXES, 1):
            self._joint[stick] = self._chain(0, stick, axes, origins[stick])
        for stick, axis in enumerate(HINGE_AXES, 6):
            parent = int(PARENT[stick])
            self._joint[stick] = self._chain(parent, stick, axis, along_stick(parent, body.lengths[parent]))
        self._frames = {(j, end): self._frame(j, end, at) for j in range(10) for end, at in local_ends(body, j).items()}
        self.points = [self._frames[key] for key in POINT_ENDS]
        self.data = self.model.createData()

    def _chain(self, parent: int, stick: int, axes: str, at: np.ndarray) -> int:
        joint = self._joint[parent]
        for axis in axes:
            joint = self.model.addJoint(joint, JOINTS[axis](), _shift(at), f"{stick}{axis}")
            at = np.zeros(3)
        return joint

    def _frame(self, stick: int, end: str, at: np.ndarray) -> int:
        frame = pin.Frame(f"{stick}{end}", self._joint[stick], _shift(at), pin.FrameType.OP_FRAME)
        return self.model.addFrame(frame)

    def configuration(self, pose: Pose) -> np.ndarray:
        """pinocchio's q of a pose."""
        angles = pose.angles()
        balls = [angles[slot] for slots in BALL_ANGLES for slot in slots if slot >= 0]
        quaternion = pin.Quaternion(pose.R_world_torso).coeffs()
        return np.concatenate([pose.position_world, quaternion, balls, angles[HINGE_ANGLES]])

    def place(self, q: np.ndarray, frames: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) of frames, and their Jacobians (n, 3, 24)."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        at = np.array([self.data.oMf[f].translation for f in frames])
        J = [pin.getFrameJacobian(self.model, self.data, f, pin.LOCAL_WORLD_ALIGNED)[:3] for f in frames]
        return at, np.array(J)

    def ends(self, end: str) -> list[int]:
        return [self._frames[(j, end)] for j in range(10)]

    def moved(self, q: np.ndarray, step: np.ndarray) -> np.ndarray:
        return pin.integrate(self.model, q, step * min(1.0, LARGEST_STEP / max(np.abs(step).max(), 1e-12)))


def _shift(at: np.ndarray) -> pin.SE3:
    return pin.SE3(np.eye(3), np.asarray(at, float))


def inverse_kinematics(clip: Clip) -> Solver:
    """Damped Gauss-Newton on 15 labelled points."""
    figure = Figure(clip.body)
    q = figure.configuration(clip.poses[0])

    def step(z: np.ndarray) -> np.ndarray:
        nonlocal q
        for _ in range(10):
            at, J = figure.place(q, figure.points)
            flat, r = J.reshape(45, -1), (z - at).ravel()
            d = np.linalg.solve(flat.T @ flat + LEAST_DAMPING * np.eye(flat.shape[1]), flat.T @ r)
            q = figure.moved(q, d)
            if np.abs(d).max() < 1e-4:
                break
        return figure.place(q, figure.points)[0]

    return step


def articulated_icp(clip: Clip) -> Solver:
    """Gauss-Newton on unlabelled points: the nearest stick, sliding feet, as in our solve, in numpy."""
    figure, sigma = Figure(clip.body), clip.sigma_m
    q = figure.configuration(clip.poses[0])
    prior = _prior(figure)

    def step(points: np.ndarray) -> np.ndarray:
        nonlocal q
        start = q
        for _ in range(ASSIGNMENTS):
            H, g = _normal_equations(figure, q, points, sigma)
            back = pin.difference(figure.model, q, start)
            d = np.linalg.solve(H + np.diag(prior), g + prior * back)
            before = figure.place(q, figure.points)[0]
            q = figure.moved(q, d)
            if np.linalg.norm(figure.place(q, figure.points)[0] - before, axis=1).max() < STOP_M:
                break
        return figure.place(q, figure.points)[0]

    return step


def _prior(figure: Figure) -> np.ndarray:
    information = np.full(figure.model.nv, 1.0 / PRIOR.ball_sd**2)
    information[:3], information[3:6] = 1.0 / PRIOR.position_sd_m**2, 1.0 / PRIOR.rotation_sd**2
    information[-4:] = 1.0 / PRIOR.hinge_sd**2
    return information


def _normal_equations(figure: Figure, q: np.ndarray, points: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    A, J_A = figure.place(q, figure.ends("start"))
    B, J_B = figure.place(q, figure.ends("end"))
    n = len(points)
    stick, along, feet = np.empty(n, np.int64), np.empty(n), np.empty((n, 3))
    foot_points(points, A, B, stick, along, feet, np.empty(n))
    u = along[:, None, None]
    J = (1.0 - u) * J_A[stick] + u * J_B[stick]
    direction = (B - A)[stick] / np.linalg.norm(B - A, axis=1)[stick, None]
    slides = ((along > 0.0) & (along < 1.0))[:, None, None]
    J = J - slides * direction[:, :, None] * np.einsum("ni,nik->nk", direction, J)[:, None]
    flat = J.reshape(3 * n, -1)
    return flat.T @ flat / sigma**2, flat.T @ (points - feet).ravel() / sigma**2
