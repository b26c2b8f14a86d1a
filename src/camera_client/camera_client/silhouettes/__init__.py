"""Segmentation of a frame: likelihood of foreground, shadows, people's components, the undistorted mask."""
