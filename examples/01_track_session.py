"""Track a session folder in this process, without ROS, and print each frame's joint angles in degrees as CSV.

    python examples/01_track_session.py my_session > angles.csv

A session folder holds camNN.mp4, camNN_background.mp4 (or .png) and rig.yaml: docs/how-to/sessions.md.
"""

import sys

import numpy as np

from capture_rig.session import load_session
from mocap_pipeline.session_footage import frame_sets, pipeline_of
from stick_figure.skeleton import ANGLE_NAMES

session = load_session(sys.argv[1])
pipeline = pipeline_of(session)
print("frame", *ANGLE_NAMES, sep=",")
for frame, (stamp_ns, images) in enumerate(frame_sets(session)):
    step = pipeline.step(stamp_ns, images)
    if step.state is None:  # nobody yet: the first pose is found in a T-pose or while somebody walks
        print(f"frame {frame}: {step.fit.state}", file=sys.stderr)
    else:
        print(frame, *np.degrees(step.state.angles).round(1), sep=",")
