"""Recorded motion: BVH files, read as joint positions and turned into the stick figure's motion."""
