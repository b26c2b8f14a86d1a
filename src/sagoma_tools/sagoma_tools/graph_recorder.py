"""Records a graph that we started ourselves: its topics are known beforehand, and so is what made them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from sagoma_bringup.node_spec import NodeSpec, Role

from .recorder import Recorder
from .ros_link import RosLink
from .topics import DIAGNOSTICS, OUTPUT_TOPICS, Topic, camera_topics

CONNECT_TIMEOUT_S = 10.0


class GraphRecorder:
    """Subscribes to every topic of ``graph`` from a node of its own and writes them to ``bag`` until closed."""

    def __init__(
        self,
        graph: Sequence[NodeSpec],
        bag: str | Path,
        *,
        topics: Iterable[Topic] | None = None,
        domain_id: int | None = None,
        provenance: Mapping[str, Any] | None = None,
        canonical: bool = False,
    ) -> None:
        """``topics`` by default all of the graph and /diagnostics; ``provenance`` is added to the bag's sagoma.yaml."""
        self._topics = tuple(graph_topics(graph) if topics is None else topics)
        self._graph = tuple(graph)
        self._provenance = dict(provenance or {})
        self._link = RosLink("sagoma_recorder", domain_id=domain_id)
        try:
            self.recorder = Recorder(self._link.node, bag, self._topics, canonical=canonical)
        except BaseException:
            self._link.close()
            raise

    def wait_for_publishers(self, timeout_s: float = CONNECT_TIMEOUT_S) -> tuple[str, ...]:
        """Return once every topic but the latched ones has a publisher; returns those that have none in time.

        Nodes open their publishers when they are configured: call it between configure and activate.
        """
        return self.recorder.wait_for_publishers([t.name for t in self._topics if not t.latched], timeout_s)

    def close(self, **provenance: Any) -> dict[str, int]:
        """Finish the bag; returns the messages written by topic. May be called twice."""
        description = {"graph": graph_document(self._graph), **self._provenance, **provenance}
        counts = self.recorder.close(description, rig_file(self._graph))
        self._link.close()
        return counts

    def __enter__(self) -> GraphRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def graph_topics(graph: Sequence[NodeSpec]) -> list[Topic]:
    """What the nodes publish: cameras' topics, the server's, and diagnostics."""
    cameras = [node.label for node in graph if node.role is Role.CAMERA]
    return [*(topic for camera in cameras for topic in camera_topics(camera)), *OUTPUT_TOPICS, DIAGNOSTICS]


def graph_document(graph: Sequence[NodeSpec]) -> dict[str, Any]:
    """Full node name -> its parameters, as plain data for YAML."""
    return {node.full_name: dict(node.parameters) for node in graph}


def rig_file(graph: Sequence[NodeSpec]) -> Path | None:
    """The rig YAML that the nodes were given."""
    named = (node.parameters.get("rig_file") for node in graph)
    return next((Path(name) for name in named if name), None)
