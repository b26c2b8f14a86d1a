"""Fixtures of the tests that run across packages."""

from pathlib import Path

import pytest

from stick_figure.body import Body
from virtual_studio.recording.session import RenderSettings, write_session
from virtual_studio.rig import ring


@pytest.fixture(scope="session")
def built_in_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short session of the virtual studio: four cameras and one above, a T-pose, then movement."""
    folder = tmp_path_factory.mktemp("studio") / "session"
    return write_session(
        folder, ring(4, True), Body.from_stature(1.75), fps=30.0, seconds=2.0, settings=RenderSettings(seed=7)
    )
