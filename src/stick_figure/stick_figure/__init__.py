"""The articulated stick figure: body, pose, forward and inverse kinematics, Jacobians, error metrics."""
