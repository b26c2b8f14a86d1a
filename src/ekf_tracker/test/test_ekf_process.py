"""What only fresh processes show: equal bytes from run to run, and nothing left to compile after the warm-up."""

import subprocess
import sys
from pathlib import Path

PATIENCE_S = 60.0

RUN = """
import hashlib
import numpy as np
from ekf_person import ALL, Person, isotropic, stamp
from capture_rig import small_matrices
from ekf_tracker import bias, measurement
from ekf_tracker import kernels as ekf_kernels
from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.filter import warm_up
from mocap_packets.fit import ReferencePoints
from stick_figure import joint_limits, kernels
from stick_figure.body import Body

def compilations():
    modules = (small_matrices, bias, ekf_kernels, joint_limits, measurement, kernels)
    functions = [f for module in modules for f in vars(module).values() if hasattr(f, "signatures")]
    return sum(len(f.signatures) for f in functions)

warm_up()
before = compilations()
person, digest = Person(Body.from_stature(1.75)), hashlib.sha256()
ekf, rng = ArticulatedEkf(person.body), np.random.default_rng(0)
for k in range(60):
    points = person.points(k / 60) + 0.02 * rng.standard_normal((15, 3))
    state = ekf.step(stamp(k), *ReferencePoints(points, isotropic(0.02), rng.random(15) < 0.8).as_sent())
    for array in (*state.pose.arrays, state.velocity, state.covariance, state.angles, state.rates):
        digest.update(array.tobytes())
print(digest.hexdigest(), compilations() - before)
"""


def fresh_run():
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=Path(__file__).parent,  # ekf_person is here
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_two_processes_give_the_same_bytes_and_the_rehearsal_leaves_nothing_to_compile():
    digest, compiled_after_rehearsal = fresh_run()
    assert compiled_after_rehearsal == "0"
    assert fresh_run()[0] == digest
