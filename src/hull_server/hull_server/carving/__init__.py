"""Silhouettes to occupied voxels, on the CPU; the tables that every backend shares."""
