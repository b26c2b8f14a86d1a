"""Which cameras to use: faults that contradict the other cameras, and errors of the extrinsic calibration."""
