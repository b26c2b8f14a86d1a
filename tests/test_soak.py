"""A soak of a minute and a half: faults at random, and what its report says of them; trends of made-up samples."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"


def bench_module(name):
    sys.path.insert(0, str(BENCH))
    try:
        return __import__(name)
    finally:
        sys.path.remove(str(BENCH))


@pytest.mark.parametrize("growth", [0.0, 2.0, 20.0])
def test_growth_of_memory_is_found_in_samples_that_hang_together_and_no_growth_is_none(growth):
    rng, hours = np.random.default_rng(5), 4.0
    seconds = np.arange(0.0, 3600 * hours, 10.0)
    wander = np.zeros(len(seconds))
    for k in range(1, len(seconds)):  # correlated over five minutes, 1 MiB
        wander[k] = 0.967 * wander[k - 1] + 0.25 * rng.normal()
    leap = 30.0 * (np.arange(len(seconds)) % 400 < 5)  # a fault, now and then
    found = bench_module("soak_slopes").trend(seconds, 300.0 + growth * seconds / 3600 + wander + leap)
    assert found.low <= growth <= found.high
    assert found.high - found.low < 1.5
    assert (found.verdict == "flat") == (growth == 0.0)


def test_every_kind_of_fault_comes_in_the_first_round_and_the_server_only_then():
    faults = bench_module("soak_faults")
    cameras = ["cam01", "cam02", "cam03"]
    drawn, kinds = faults.random_faults(3, cameras, ["cam01"]), {*faults.CAMERA_FAULTS, *faults.ROOM_FAULTS}
    first = [next(drawn) for _ in range(len(kinds) + len(faults.SERVER_FAULTS))]
    later = [next(drawn) for _ in range(200)]
    assert {fault.kind for fault in first} == kinds | {*faults.SERVER_FAULTS}
    assert {fault.kind for fault in later} == kinds
    assert all(fault.target != "cam01" for fault in first + later if fault.kind == "camera killed")
    again = faults.random_faults(3, cameras, ["cam01"])
    assert [next(again) for _ in first] == first


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
