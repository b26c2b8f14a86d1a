"""How long the tests wait for the nodes of a graph."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def graphs_start_within(timeout_s: float) -> Iterator[None]:
    """A node that never appears or answers fails its test soon; a user's machine has five minutes for it.

    What looks for nodes waits 0.2 s for more of them, not 1 s: tests say how many there are.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module in ("supervisor", "lifecycle_client"):
            patch.setattr(f"sagoma_tools.graph.{module}.START_TIMEOUT_S", timeout_s)
        for module in ("supervisor", "ros_link"):
            patch.setattr(f"sagoma_tools.graph.{module}.ROUND_S", 0.2)
        yield
