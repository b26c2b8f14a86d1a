"""Calibration targets: their drawing, and detection of their corners in images."""
