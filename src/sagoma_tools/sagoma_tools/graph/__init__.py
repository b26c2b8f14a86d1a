"""The node graph as processes: started, driven through its lifecycle, watched, restarted, and stopped."""

from __future__ import annotations


class GraphError(RuntimeError):
    """The graph cannot run; names the failed node, its answer, and the end of its log."""
