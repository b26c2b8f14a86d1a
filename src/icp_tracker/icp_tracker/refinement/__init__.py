"""A body's sizes from contour rays in many poses, while it is tracked."""
