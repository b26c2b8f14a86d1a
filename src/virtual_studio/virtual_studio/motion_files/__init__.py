"""Recorded motion: BVH and Acclaim ASF/AMC files, read as joint positions and turned into the stick figure's motion."""
