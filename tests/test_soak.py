"""A soak of a minute and a half: faults at random, and what its report says of them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"


@pytest.mark.slow
def test_studio_with_faults_counts_every_frame_and_is_whole_again_after_each(tmp_path):
    command = [sys.executable, str(BENCH / "soak.py"), "--quick", "--output", str(tmp_path / "soak")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout.splitlines()[-1])
    assert figures["faults"] >= 2
    assert all(rule["verdict"] == "holds" for rule in figures["sum_rule"].values()), figures["sum_rule"]
    assert all(kind["not_recovered"] == 0 for kind in figures["recovery_s"].values()), figures["recovery_s"]
    assert figures["exposures"]["all"]["tracked"] > 0.0
    assert (tmp_path / "soak" / "soak.png").stat().st_size > 10_000
