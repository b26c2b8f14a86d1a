"""Calibration targets: what they look like, and where an image shows their corners."""
