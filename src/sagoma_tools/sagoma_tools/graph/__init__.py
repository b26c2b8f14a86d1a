"""The node graph as processes: started, driven through its lifecycle, watched, restarted, and stopped."""

from __future__ import annotations

LOOK_S = 0.05  # rclpy has no event for a change of the graph, a service that appears, or a process's death
ROUND_S = 1.0  # in which an idle node answers; then requests are repeated, and unchanged lists have settled
ANSWER_S = 5.0  # within this any node that runs answers, and is found
PATIENCE_S = 30.0  # for requests to the nodes of a busy machine, and until dead ones leave discovery
START_TIMEOUT_S = 300.0  # to a process's first answer: seconds of imports, times the machine's load


class GraphError(RuntimeError):
    """The graph cannot run; names the failed node, its answer, and the end of its log."""
