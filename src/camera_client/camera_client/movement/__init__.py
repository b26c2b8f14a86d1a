"""Detection that a camera was moved since its calibration, by aligning its picture with the background's."""
