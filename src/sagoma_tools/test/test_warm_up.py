"""What the set-up compiles: the kernels of a live capture, all of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TRACK = """
import sys
from numba.core import event
from capture_rig.session import load_session
from sagoma_tools import warm_up
from sagoma_tools.evaluation.in_process import track_session
warm_up.write_short_session(sys.argv[1])
session = load_session(sys.argv[1])
with event.install_recorder("numba:compile") as recorder:
    track_session(session, warm_up.settings())
names = {event.data["dispatcher"].py_func.__qualname__ for _, event in recorder.buffer}
assert not names, f"compiled anew: {sorted(names)}"
"""


@pytest.mark.slow
def test_set_up_compiles_every_kernel_that_tracking_needs(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    subprocess.run([sys.executable, "-m", "sagoma_tools.warm_up"], env=environment, check=True)
    script = [sys.executable, "-c", TRACK, str(tmp_path / "session")]
    tracked = subprocess.run(script, env=environment, capture_output=True, text=True)
    assert tracked.returncode == 0, tracked.stderr
