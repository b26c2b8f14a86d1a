"""Occupied voxels to blobs of slices, centerline points, voxel samples and separate bodies."""
