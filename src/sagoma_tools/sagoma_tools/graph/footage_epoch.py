"""The common epoch of footage: every camera of a graph that plays files stamps its frames from one instant.

Footage without an epoch of its own starts at a whole span of EPOCH_STEP_NS, or at once when it is not played by the
clock. Cameras that are activated before and after such an instant would choose epochs a span apart, and no frame set
would ever be complete.
"""

from __future__ import annotations

from collections.abc import Sequence

from camera_client.sources.footage_pace import EPOCH_STEP_NS
from sagoma_bringup.graph import NodeSpec

ACTIVATION_NS = 2_500_000_000  # within this every camera's activation is acknowledged, even on a busy machine


def with_common_epoch(graph: Sequence[NodeSpec], epoch_ns: int) -> tuple[NodeSpec, ...]:
    """Return the graph, its footage that is not played by the clock (rate 0) stamped from one epoch; any will do."""
    unpaced = [spec.full_name for spec in graph if chooses_epoch(spec) and spec.parameters.get("footage.rate") == 0]
    if len(unpaced) < 2:
        return tuple(graph)
    epoch = {"footage.epoch_ns": epoch_ns}
    return tuple(spec.with_parameters(epoch) if spec.full_name in unpaced else spec for spec in graph)


def seconds_to_start_window(now_ns: int) -> float:
    """How long to wait until enough is left of the current span of EPOCH_STEP_NS to activate every camera within it."""
    into_ns = now_ns % EPOCH_STEP_NS
    return 0.0 if into_ns <= EPOCH_STEP_NS - ACTIVATION_NS else (EPOCH_STEP_NS - into_ns) / 1e9


def chooses_epoch(camera: NodeSpec) -> bool:
    """Return whether a node is a camera that plays footage whose epoch nobody has given."""
    return camera.parameters.get("source") == "footage" and not camera.parameters.get("footage.epoch_ns")
