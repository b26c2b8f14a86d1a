"""How long the tests wait for the nodes of a graph."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from sagoma_tools.graph import lifecycle_client
from sagoma_tools.graph.lifecycle_client import Transition


@contextmanager
def graphs_start_within(timeout_s: float) -> Iterator[None]:
    """A node that never appears or answers fails its test soon; a user's machine has five minutes for it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sagoma_tools.graph.supervisor.START_TIMEOUT_S", timeout_s)
        patch.setitem(lifecycle_client.TIMEOUT_S, Transition.CONFIGURE, timeout_s)
        yield
