"""Calibration of a capture rig: boards and their sightings, intrinsics, extrinsics, verdicts with remedies."""
