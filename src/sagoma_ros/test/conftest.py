"""Nodes of these tests, in a ROS context of their file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from node_probe import Spinner
from rclpy.context import Context


@pytest.fixture
def ros(ros_context: Context) -> Iterator[Spinner]:
    """Spins the nodes that a test adds, and destroys them at its end."""
    spinner = Spinner(ros_context)
    yield spinner
    spinner.close()
