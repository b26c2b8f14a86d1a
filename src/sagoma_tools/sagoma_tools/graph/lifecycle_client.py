"""Drives the lifecycle of several nodes at once and reports which acknowledged, refused, or did not answer.

configure / activate / deactivate / cleanup are the thesis's connect / start / suspend / stop. A service request goes to
any node that offers that service: before one is sent, nodes of the graph's names in other processes are searched for,
or a second graph would drive the first one's nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

from . import ANSWER_S, PATIENCE_S, ROUND_S, START_TIMEOUT_S
from .ros_link import ServiceCalls, call_all, is_camera, node_names, settled


class LifecycleState(StrEnum):
    """The states in which a healthy node can rest, from stopped to running."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"


STATES = tuple(LifecycleState)
TRANSITIONS = {
    (LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE): ("configure", Transition.TRANSITION_CONFIGURE),
    (LifecycleState.INACTIVE, LifecycleState.ACTIVE): ("activate", Transition.TRANSITION_ACTIVATE),
    (LifecycleState.ACTIVE, LifecycleState.INACTIVE): ("deactivate", Transition.TRANSITION_DEACTIVATE),
    (LifecycleState.INACTIVE, LifecycleState.UNCONFIGURED): ("cleanup", Transition.TRANSITION_CLEANUP),
}
"""(From, to) -> name and number of the transition."""


@dataclass
class Outcome:
    """What came of a command, by full node name: the state that each node acknowledged last, and why one did not go on
    ("/hull_server: configure refused")."""

    reached: dict[str, LifecycleState] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)

    def fail(self, node: str, asked: str, said: str | None) -> None:
        """Add a node that did not make the requested transition, with its message; None: no answer."""
        self.failures[node] = f"{node}: {asked} {said or 'did not answer'}"


def next_on_the_way(state: LifecycleState, goal: LifecycleState) -> LifecycleState:
    """Return the state that lies next on the way to another one."""
    here, there = STATES.index(state), STATES.index(goal)
    return STATES[here + (1 if there > here else -1)]


class LifecycleClient:
    """Sends lifecycle requests to many nodes concurrently through ``node``, which another thread must spin."""

    def __init__(self, node: Node, *, alive: Callable[[str], bool] = lambda name: True) -> None:
        """``alive(name)``: whether a node's process still runs; a dead one is not waited for."""
        self._node, self._alive = node, alive

    def states(self, nodes: Iterable[str], timeout_s: float = ANSWER_S) -> dict[str, str | None]:
        """Fully qualified node name -> state label, None where no answer came."""
        questions = {name: GetState.Request() for name in nodes}
        replies = call_all(
            self._node, GetState, questions, timeout_s, self._alive, suffix="/get_state", repeatable=True
        )
        return {name: reply and reply.current_state.label for name, reply in replies.items()}

    def bring(
        self, nodes: Collection[str], goal: LifecycleState, timeout_s: float | None = None, contact_s: float = ANSWER_S
    ) -> Outcome:
        """Bring every node (full names) to ``goal`` from its present state: cameras last on the way up, or first on the
        way down, and each kind in step.

        timeout_s : for each answer; None: the longest start of a node on the way up (it learns a background, opens a
        camera, at its very first start compiles), and the longest stop on the way down. contact_s : for a node to
        report its state, long for a process that has just started. A node that refuses or stays silent keeps its state;
        the others go on.
        """
        outcome, states = Outcome(), dict[str, LifecycleState]()
        for name, label in self.states(nodes, contact_s).items():
            if label in STATES:
                states[name] = LifecycleState(label)
            else:  # finalized, or in transition
                outcome.fail(name, "get_state", label and f"tells of {label}, from where no way leads on")
        down = any(STATES.index(state) > STATES.index(goal) for state in states.values())
        for cameras in (down, not down):
            moving = {name: state for name, state in states.items() if is_camera(name) == cameras}
            while moving := {name: state for name, state in moving.items() if state != goal}:
                ways = {name: (state, next_on_the_way(state, goal)) for name, state in moving.items()}
                moving = self._change(ways, timeout_s, outcome)
        return outcome

    def _change(
        self, ways: Mapping[str, tuple[LifecycleState, LifecycleState]], timeout_s: float | None, outcome: Outcome
    ) -> dict[str, LifecycleState]:
        """Request each node's transition between its two states; return those that acknowledged and their states."""
        requests = {name: ChangeState.Request() for name in ways}
        for name, way in ways.items():
            requests[name].transition.id = TRANSITIONS[way][1]
        up = any(STATES.index(goal) > STATES.index(state) for state, goal in ways.values())
        limit_s = (START_TIMEOUT_S if up else PATIENCE_S) if timeout_s is None else timeout_s
        calls = ServiceCalls(self._node, ChangeState, requests, "/change_state")
        for silent in calls.rounds(limit_s, self._alive):
            for name, label in self.states(silent, ROUND_S).items():
                if label == ways[name][1]:  # the reply was lost
                    calls.add(name, ChangeState.Response(success=True))
        changed = {}
        for name, way in ways.items():
            reply = calls.replies[name]
            if reply is not None and reply.success:
                changed[name] = way[1]
            else:
                outcome.fail(name, TRANSITIONS[way][0], reply and "refused")
        outcome.reached |= changed
        return changed


# nodes of a graph's names that other processes run --------------------------------------------------------------------


def living_nodes(node: Node, names: Collection[str]) -> list[str]:
    """Return which of these names nodes have that answer, before any of our own does: dead ones are seen, too."""
    found = settled(lambda: {*node_names(node)}.intersection(names), 0, ANSWER_S)
    return [name for name, label in LifecycleClient(node).states(found).items() if label]
