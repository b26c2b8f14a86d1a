"""Facts about the running graph, heard in a few seconds, as plain data. None means unknown or not heard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..machine.announcements import Announcement

OK, WARN, ERROR = 0, 1, 2  # levels of diagnostic_msgs/DiagnosticStatus


@dataclass(frozen=True)
class NodeFacts:
    """One node of the graph.

    state : its lifecycle state, None when it did not answer; round_trip_s : its fastest answer.
    machine : which machine it runs on, by the middleware's number; copies : how many nodes have this name, machines :
        where they run.
    reports : diagnostics heard, the last one's level, message and values; rate_hz : how often.
    lead_s : of each report, its stamp (the node's clock) minus its arrival (ours): never more than what the clocks
        differ by, and less by the time it took.
    """

    name: str
    state: str | None = None
    machine: str = ""
    copies: int = 1
    reports: int = 0
    level: int = OK
    message: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float = 0.0
    lead_s: tuple[float, ...] = ()
    round_trip_s: float | None = None
    machines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Canvas:
    """Size and pinhole parameters of a camera_info, pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class SilhouetteFacts:
    """What one camera sent while the doctor listened.

    publishers : of its silhouettes; infos : camera_infos heard, ``canvas`` the last; masks : silhouettes heard, of
    which ``bad`` could not be decoded and ``lost`` were missing between the first and the last; sizes (width, height).
    shares : of foreground, of those looked at; changes : how many differed from the one before.
    age_s : from capture to arrival here, the median; largest_bytes : of one message.
    """

    camera: str
    publishers: int = 0
    infos: int = 0
    canvas: Canvas | None = None
    masks: int = 0
    bad: str = ""
    lost: int = 0
    sizes: tuple[tuple[int, int], ...] = ()
    shares: tuple[float, ...] = ()
    changes: int = 0
    age_s: float | None = None
    rate_hz: float = 0.0
    largest_bytes: int = 0


@dataclass(frozen=True)
class FrameSetFacts:
    """The hull server's frame sets: of each its spread, latency from capture to published, and number
    of centerline points; and how often each camera was missing or left out."""

    sets: int
    rate_hz: float
    spread_ms: tuple[float, ...] = ()
    latency_ms: tuple[float, ...] = ()
    points: tuple[int, ...] = ()
    missing: Mapping[str, int] = field(default_factory=dict)
    left_out: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class GraphFacts:
    """The running graph as heard from here. ``domains_here`` : ROS domains with nodes on this machine; ``announced`` :
    announcements by multicast, in any domain; ``peers`` : addresses that are asked by unicast."""

    domain: int
    discovery_range: str
    seconds: float
    machine: str = ""
    nodes: tuple[NodeFacts, ...] = ()
    cameras: tuple[SilhouetteFacts, ...] = ()
    frame_sets: FrameSetFacts | None = None
    simulated_time: bool = False
    rig_files: Mapping[str, str] = field(default_factory=dict)
    domains_here: tuple[int, ...] = ()
    announced: tuple[Announcement, ...] = ()
    peers: tuple[str, ...] = ()

    def node(self, name: str) -> NodeFacts | None:
        """Return the node with this fully qualified name."""
        return next((node for node in self.nodes if node.name == name), None)

    def domains_elsewhere(self) -> list[int]:
        """Return the other ROS domains in which nodes are known, on whatever machine."""
        return sorted(({one.domain for one in self.announced} | {*self.domains_here}) - {self.domain})

    def elsewhere(self, domain: int) -> list[str]:
        """Return the addresses of other machines with nodes in this domain."""
        return sorted({one.address for one in self.announced if one.domain == domain and one.machine != self.machine})

    def machine_name(self, machine: str) -> str:
        """Return a name for a machine: "here", its addresses, or "another machine" where they are not known."""
        if machine == self.machine:
            return "here"
        addresses = sorted({one.address for one in self.announced if one.machine == machine and machine})
        return f"on {', '.join(addresses)}" if addresses else "on another machine"
