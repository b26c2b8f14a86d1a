"""Fixtures of the tests that run across packages."""

import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from graph_timeouts import graphs_start_within

from capture_rig.rig import Rig, load_rig, save_rig
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
    """A short session of the virtual studio: four cameras and one above, a T-pose, then movement.

    Rendered once for all processes of a test run; nobody may change it.
    """
    common = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        common = common.parent
    folder, done = common / "built_in_session", common / "built_in_session.done"
    with (common / "built_in_session.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            body, look = Body.from_stature(1.75), RenderSettings(seed=7)
            write_session(folder, ring(4, True), body, fps=30.0, seconds=2.0, settings=look)
            done.touch()
    return folder


@pytest.fixture(scope="module")
def three_cameras(built_in_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The session of its first three cameras."""
    folder, rig = tmp_path_factory.mktemp("three") / "session", load_rig(built_in_session / "rig.yaml")
    left_out = [f"{camera.name}*" for camera in rig.cameras[3:]]
    shutil.copytree(built_in_session, folder, ignore=shutil.ignore_patterns(*left_out))
    save_rig(Rig(rig.cameras[:3], rig.volume), folder / "rig.yaml")
    return folder
