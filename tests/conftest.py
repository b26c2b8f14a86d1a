"""Fixtures of the tests that run across packages."""

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from graph_timeouts import graphs_start_within

from capture_rig.rig import Rig
from stick_figure.body import Body
from virtual_studio.recording.session import RenderSettings, write_session
from virtual_studio.rig import ring

START_TIMEOUT_S = 150.0  # with kernels to compile


@pytest.fixture(scope="session", autouse=True)
def _graphs_start_soon() -> Iterator[None]:
    with graphs_start_within(START_TIMEOUT_S):
        yield


@pytest.fixture(scope="session")
def built_in_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short session of the virtual studio: four cameras and one above, a T-pose, then movement; read only."""
    return rendered_once("built_in_session", ring(4, True), 2.0, tmp_path_factory)


@pytest.fixture(scope="session")
def three_cameras(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Less of it before three cameras around: enough for most tests, in half the time; read only."""
    return rendered_once("three_cameras", ring(3, ceiling=False), 1.6, tmp_path_factory)


def rendered_once(name: str, rig: Rig, seconds: float, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session's folder, rendered once for all processes of a test run."""
    common = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        common = common.parent
    folder, done = common / name, common / f"{name}.done"
    with (common / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            body, look = Body.from_stature(1.75), RenderSettings(seed=7)
            write_session(folder, rig, body, fps=30.0, seconds=seconds, settings=look)
            done.touch()
    return folder
