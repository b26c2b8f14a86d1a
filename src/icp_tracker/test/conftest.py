"""The body of the ICP tracker's tests."""

import pytest

from stick_figure.body import Body


@pytest.fixture(scope="session")
def body():
    """A man of 1.75 m."""
    return Body.from_stature(1.75)
