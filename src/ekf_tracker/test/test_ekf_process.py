"""What only a fresh process shows: equal bytes from run to run, and nothing left to compile after the warm-up."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
from ekf_person import Person, isotropic, stamp

from capture_rig import small_matrices
from ekf_tracker import bias, measurement
from ekf_tracker import kernels as ekf_kernels
from ekf_tracker.filter import ArticulatedEkf, warm_up
from stick_figure import joint_limits, kernels
from stick_figure.body import Body

PATIENCE_S = 60.0
MODULES = (small_matrices, bias, ekf_kernels, joint_limits, measurement, kernels)


def compilations():
    functions = [f for module in MODULES for f in vars(module).values() if hasattr(f, "signatures")]
    return sum(len(f.signatures) for f in functions)


def run():
    """Digest of all that a filter says of sixty sets, and how many kernels were compiled for it after the warm-up."""
    warm_up()
    before = compilations()
    person, digest = Person(Body.from_stature(1.75)), hashlib.sha256()
    ekf, rng = ArticulatedEkf(person.body), np.random.default_rng(0)
    for k in range(60):
        points = person.points(k / 60) + 0.02 * rng.standard_normal((15, 3))
        state = ekf.step(stamp(k), points, isotropic(0.02), rng.random(15) < 0.8)
        for array in (*state.pose.arrays, state.velocity, state.covariance, state.angles, state.rates):
            digest.update(array.tobytes())
    return digest.hexdigest(), compilations() - before


def test_two_processes_give_the_same_bytes_and_the_rehearsal_leaves_nothing_to_compile():
    here, code = Path(__file__), f"from {Path(__file__).stem} import run; print(*run())"
    fresh = subprocess.run(
        [sys.executable, "-c", code], cwd=here.parent, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert fresh.returncode == 0, fresh.stderr
    digest, compiled_after_rehearsal = fresh.stdout.split()
    assert compiled_after_rehearsal == "0" and digest == run()[0]
