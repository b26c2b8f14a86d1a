"""Write every person of a recorded take as a BVH file, for Blender, MotionBuilder or Maya.

    python examples/04_take_to_bvh.py output/takes/NAME animations

The other formats have the same call: motion_export.animation_files.write_glb, .marker_files.write_trc and so on.
"""

import sys
from pathlib import Path

from motion_export.animation_files import write_bvh
from sagoma_tools.recording.recorded_motion import recorded_motions

take, folder = sys.argv[1], Path(sys.argv[2])
folder.mkdir(parents=True, exist_ok=True)
for motion in recorded_motions(take).values():
    path = folder / f"{motion.name}.bvh"
    write_bvh(motion, path)
    print(f"{path}: {len(motion)} frames at {motion.rate_hz:g} Hz, {len(motion.gaps)} gaps filled")
