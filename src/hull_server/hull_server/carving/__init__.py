"""Silhouettes to occupied voxels: who carves, and the CPU's way."""
