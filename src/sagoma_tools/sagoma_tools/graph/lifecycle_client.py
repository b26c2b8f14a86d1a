"""Drives the lifecycle of several nodes at once and reports which acknowledged, refused, or did not answer.

configure / activate / deactivate / cleanup are the thesis's connect / start / suspend / stop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

from sagoma_bringup.graph import CAMERA_NODE

from .ros_link import call_all

STATE_TIMEOUT_S = 5.0
INFER_TIMEOUT_S = 1.5


class Transition(Enum):
    """Lifecycle transitions with their ids in lifecycle_msgs/Transition."""

    CONFIGURE = 1
    CLEANUP = 2
    ACTIVATE = 3
    DEACTIVATE = 4


class State(Enum):
    """The states in which a healthy node can rest, from stopped to running."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"


LADDER = tuple(State)
LABELS = tuple(state.value for state in LADDER)
UP = (Transition.CONFIGURE, Transition.ACTIVATE)  # UP[i] leads from LADDER[i] to LADDER[i + 1]
DOWN = (Transition.CLEANUP, Transition.DEACTIVATE)  # DOWN[i] leads back
REACHED = {
    Transition.CONFIGURE: State.INACTIVE,
    Transition.ACTIVATE: State.ACTIVE,
    Transition.DEACTIVATE: State.INACTIVE,
    Transition.CLEANUP: State.UNCONFIGURED,
}
TIMEOUT_S: Mapping[Transition, float] = {
    Transition.CONFIGURE: 300.0,  # learns a background, opens a camera; at the very first start compiles kernels
    Transition.ACTIVATE: 60.0,
    Transition.DEACTIVATE: 10.0,
    Transition.CLEANUP: 10.0,
}


class Verdict(Enum):
    """A node's answer to a transition."""

    ACKNOWLEDGED = "acknowledged"
    REFUSED = "refused"
    SILENT = "did not answer"
    STUCK = "is in a state with no way on (finalized, or in transition)"


@dataclass(frozen=True)
class Answer:
    """One node's answer to one request; ``transition`` is None when it was only asked for its state."""

    node: str
    transition: Transition | None
    verdict: Verdict

    def __str__(self) -> str:
        asked = self.transition.name.lower() if self.transition else "get_state"
        return f"{self.node}: {asked} {self.verdict.value}"


@dataclass(frozen=True)
class Outcome:
    """All answers to one command."""

    answers: tuple[Answer, ...]

    @property
    def ok(self) -> bool:
        return not self.failures

    @property
    def failures(self) -> tuple[Answer, ...]:
        return tuple(answer for answer in self.answers if answer.verdict is not Verdict.ACKNOWLEDGED)

    @property
    def silent(self) -> tuple[str, ...]:
        return self._nodes(Verdict.SILENT)

    @property
    def refused(self) -> tuple[str, ...]:
        return self._nodes(Verdict.REFUSED)

    def __add__(self, other: Outcome) -> Outcome:
        return Outcome(self.answers + other.answers)

    def _nodes(self, verdict: Verdict) -> tuple[str, ...]:
        return tuple(answer.node for answer in self.answers if answer.verdict is verdict)


def path_to(goal: State, label: str) -> tuple[Transition, ...]:
    """Return the transitions that lead from the state called ``label`` (one of LABELS) to ``goal``."""
    here, there = LABELS.index(label), LADDER.index(goal)
    return UP[here:there] if here <= there else DOWN[there:here][::-1]


def groups_of(names: Iterable[str], cameras_first: bool) -> list[list[str]]:
    """Return camera clients and server's nodes (full names) as two groups: cameras last on the way up, first down."""
    everybody = list(names)
    cameras = [name for name in everybody if name.endswith(f"/{CAMERA_NODE}")]
    server = [name for name in everybody if name not in cameras]
    return [cameras, server] if cameras_first else [server, cameras]


class LifecycleClient:
    """Sends lifecycle requests to many nodes concurrently through ``node``, which another thread must spin."""

    def __init__(self, node: Node, *, alive: Callable[[str], bool] = lambda name: True) -> None:
        """``alive(name)``: whether a node's process still runs; a dead one is not waited for."""
        self._node = node
        self._alive = alive

    def states(self, nodes: Iterable[str], timeout_s: float = STATE_TIMEOUT_S) -> dict[str, str | None]:
        """Fully qualified node name -> state label, None where no answer came."""
        questions = {name: GetState.Request() for name in nodes}
        replies = self._ask(GetState, "get_state", questions, timeout_s, repeatable=True)
        return {name: reply and reply.current_state.label for name, reply in replies.items()}

    def change(self, wanted: Mapping[str, Transition], timeout_s: float | None = None) -> Outcome:
        """Ask each node for its transition, all at once; ``timeout_s`` by default as long as the slowest may take."""
        requests = {}
        for name, transition in wanted.items():
            requests[name] = ChangeState.Request()
            requests[name].transition.id = transition.value
        limit = max((TIMEOUT_S[t] for t in wanted.values()), default=0.0) if timeout_s is None else timeout_s

        def inferred(silent: set[str]) -> dict[str, Any]:
            """Success for nodes that are in the wanted state, though their reply was lost."""
            labels = self.states(silent, INFER_TIMEOUT_S)
            return {n: ChangeState.Response(success=True) for n in silent if labels[n] == REACHED[wanted[n]].value}

        replies = self._ask(ChangeState, "change_state", requests, limit, inferred=inferred)
        return Outcome(tuple(Answer(name, wanted[name], _verdict(reply)) for name, reply in replies.items()))

    def bring(
        self,
        groups: Sequence[Sequence[str]],
        goal: State,
        timeout_s: float | None = None,
        contact_s: float = STATE_TIMEOUT_S,
    ) -> Outcome:
        """Bring every node to ``goal`` from its present state, group after group, a group's nodes in step.

        ``contact_s`` is how long a node may take to report its state: long for a process that has just started.
        A node that refuses or stays silent keeps its state; the others go on.
        """
        outcome = Outcome(())
        for group in groups:
            labels = self.states(group, contact_s)
            outcome += Outcome(tuple(Answer(n, None, _unfit(s)) for n, s in labels.items() if s not in LABELS))
            paths = {name: list(path_to(goal, label)) for name, label in labels.items() if label in LABELS}
            while wanted := {name: path.pop(0) for name, path in paths.items() if path}:
                step = self.change(wanted, timeout_s)
                outcome += step
                for failure in step.failures:
                    paths[failure.node].clear()
        return outcome

    def _ask(
        self,
        srv_type: Any,
        service: str,
        requests: Mapping[str, Any],
        timeout_s: float,
        *,
        repeatable: bool = False,
        inferred: Callable[[set[str]], Mapping[str, Any]] = lambda nodes: {},
    ) -> dict[str, Any]:
        """Full node name -> reply or None."""
        suffix = f"/{service}"

        def inferred_replies(services: set[str]) -> dict[str, Any]:
            return {n + suffix: r for n, r in inferred({s.removesuffix(suffix) for s in services}).items()}

        replies = call_all(
            self._node,
            srv_type,
            {name + suffix: request for name, request in requests.items()},
            timeout_s,
            lambda n: self._alive(n.removesuffix(suffix)),
            repeatable=repeatable,
            inferred=inferred_replies,
        )
        return {name.removesuffix(suffix): reply for name, reply in replies.items()}


def _verdict(reply: Any) -> Verdict:
    if reply is None:
        return Verdict.SILENT
    return Verdict.ACKNOWLEDGED if reply.success else Verdict.REFUSED


def _unfit(label: str | None) -> Verdict:
    return Verdict.SILENT if label is None else Verdict.STUCK
