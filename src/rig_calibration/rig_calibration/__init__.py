"""Calibration of a capture rig: boards and their detections, intrinsics, extrinsics, verdicts with remedies."""
