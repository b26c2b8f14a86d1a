"""The solver of the rig: poses of cameras and targets from detections of targets of known size in many cameras."""
