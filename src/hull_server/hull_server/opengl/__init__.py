"""Silhouettes to occupied voxels on a graphics processor: OpenGL 4.3 compute shaders without a display."""
