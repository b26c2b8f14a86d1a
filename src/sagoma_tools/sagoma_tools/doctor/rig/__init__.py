"""A rig file, its calibration and footage of it."""
