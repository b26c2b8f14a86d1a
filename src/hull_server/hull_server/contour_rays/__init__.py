"""Rays along the silhouettes' contours, tangent to the body."""
