"""The solver of the rig: poses of cameras and targets from what many cameras saw of targets of known size."""
