"""Drives the lifecycle of several nodes at once and reports which acknowledged, refused, or did not answer.

configure / activate / deactivate / cleanup are the thesis's connect / start / suspend / stop. A service request goes
to whoever offers that service: before one is sent, nodes of the graph's names that other processes run are looked for,
or a second graph would drive the first one's nodes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

from . import ANSWER_S, LOOK_S, PATIENCE_S, ROUND_S, START_TIMEOUT_S
from .ros_link import call_all, is_camera, node_names, settled


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


LABELS = tuple(state.value for state in State)
UP = (Transition.CONFIGURE, Transition.ACTIVATE)  # UP[i] leads from LABELS[i] to LABELS[i + 1]
DOWN = (Transition.CLEANUP, Transition.DEACTIVATE)  # DOWN[i] leads back
REACHED = {
    Transition.CONFIGURE: State.INACTIVE,
    Transition.ACTIVATE: State.ACTIVE,
    Transition.DEACTIVATE: State.INACTIVE,
    Transition.CLEANUP: State.UNCONFIGURED,
}
TIMEOUT_S: Mapping[Transition, float] = {
    Transition.CONFIGURE: START_TIMEOUT_S,  # learns a background, opens a camera, at its very first start compiles
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
        return tuple(answer.node for answer in self.answers if answer.verdict is Verdict.SILENT)

    def __add__(self, other: Outcome) -> Outcome:
        return Outcome(self.answers + other.answers)


def path_to(goal: State, label: str) -> tuple[Transition, ...]:
    """Return the transitions that lead from the state called ``label`` (one of LABELS) to ``goal``."""
    here, there = LABELS.index(label), LABELS.index(goal.value)
    return UP[here:there] if here <= there else DOWN[there:here][::-1]


def groups_of(names: Iterable[str], cameras_first: bool) -> list[list[str]]:
    """Return camera clients and server's nodes (full names) as two groups: cameras last on the way up, first down."""
    groups: list[list[str]] = [[], []]
    for name in names:
        groups[is_camera(name) != cameras_first].append(name)
    return groups


class LifecycleClient:
    """Sends lifecycle requests to many nodes concurrently through ``node``, which another thread must spin."""

    def __init__(self, node: Node, *, alive: Callable[[str], bool] = lambda name: True) -> None:
        """``alive(name)``: whether a node's process still runs; a dead one is not waited for."""
        self._node, self._alive = node, alive

    def states(self, nodes: Iterable[str], timeout_s: float = ANSWER_S) -> dict[str, str | None]:
        """Fully qualified node name -> state label, None where no answer came."""
        questions = {f"{name}/get_state": GetState.Request() for name in nodes}
        replies = call_all(self._node, GetState, questions, timeout_s, self._lives, repeatable=True)
        return {_owner(service): reply and reply.current_state.label for service, reply in replies.items()}

    def change(self, wanted: Mapping[str, Transition], timeout_s: float | None = None) -> Outcome:
        """Ask each node for its transition, all at once; ``timeout_s`` by default as long as the slowest may take."""
        requests = {f"{name}/change_state": ChangeState.Request() for name in wanted}
        for name, transition in wanted.items():
            requests[f"{name}/change_state"].transition.id = transition.value
        limit_s = max((TIMEOUT_S[t] for t in wanted.values()), default=0.0) if timeout_s is None else timeout_s

        def inferred(silent: set[str]) -> dict[str, Any]:
            """Success for nodes that are in the wanted state, though their reply was lost."""
            labels = self.states(map(_owner, silent), ROUND_S)
            reached = [name for name, label in labels.items() if label == REACHED[wanted[name]].value]
            return {f"{name}/change_state": ChangeState.Response(success=True) for name in reached}

        replies = call_all(self._node, ChangeState, requests, limit_s, self._lives, inferred=inferred)
        verdicts = {None: Verdict.SILENT, True: Verdict.ACKNOWLEDGED, False: Verdict.REFUSED}
        answers = {_owner(service): verdicts[reply and reply.success] for service, reply in replies.items()}
        return Outcome(tuple(Answer(name, wanted[name], verdict) for name, verdict in answers.items()))

    def bring(
        self, groups: Sequence[Sequence[str]], goal: State, timeout_s: float | None = None, contact_s: float = ANSWER_S
    ) -> Outcome:
        """Bring every node to ``goal`` from its present state, group after group, a group's nodes in step.

        ``contact_s`` is how long a node may take to report its state: long for a process that has just started.
        A node that refuses or stays silent keeps its state; the others go on.
        """
        outcome = Outcome(())
        for group in groups:
            labels = self.states(group, contact_s)
            unfit = {name: Verdict.STUCK if label else Verdict.SILENT for name, label in labels.items()}
            outcome += Outcome(tuple(Answer(n, None, unfit[n]) for n, label in labels.items() if label not in LABELS))
            paths = {name: list(path_to(goal, label)) for name, label in labels.items() if label in LABELS}
            while wanted := {name: path.pop(0) for name, path in paths.items() if path}:
                step = self.change(wanted, timeout_s)
                outcome += step
                for failure in step.failures:
                    paths[failure.node].clear()
        return outcome

    def _lives(self, service: str) -> bool:
        return self._alive(_owner(service))


def _owner(service: str) -> str:
    """Return the node that offers a service of its own."""
    return service.rpartition("/")[0]


# nodes of a graph's names that other processes run --------------------------------------------------------------------


def living_nodes(node: Node, names: Collection[str], cancel: threading.Event) -> list[str]:
    """Return which of these names nodes have already, before any of our own does.

    Not of those that end within ANSWER_S; who answers nothing may have died, and has PATIENCE_S to be forgotten.
    """

    def look() -> set[str]:
        return {*node_names(node)}.intersection(names)

    settled(look, 0, ANSWER_S)
    lifecycle, start_s = LifecycleClient(node), time.monotonic()
    while (found := look()) and not cancel.is_set():
        passed_s = time.monotonic() - start_s
        if passed_s > PATIENCE_S or (passed_s > ANSWER_S and any(lifecycle.states(found, ROUND_S).values())):
            break
        cancel.wait(LOOK_S)
    return sorted(found)


def run_already(names: Iterable[str]) -> str:
    """Say which nodes run already, and what to do about it."""
    remedy = "End that graph, or give this one another ROS_DOMAIN_ID (or, launched, a namespace:=NAME)"
    return f"{', '.join(names)} run already in this ROS domain. {remedy}."
