"""A simulated graph under load, without clocks or threads: cameras, clients that follow the rule, two stages.

Time runs in nanoseconds from event to event; nothing depends on the machine that runs the test.
"""

from __future__ import annotations

import heapq
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

from hull_server.overload import ThinningControl
from mocap_packets.frame_set import FrameSet, FrameSetCollector
from mocap_packets.thinning import FrameDecimation, FrameSelector

EPOCH_NS = 1_790_000_000_000_000_000
MS, S = 1_000_000, 1_000_000_000
UPDATE_NS = S // 10


class Server:
    """Works on one item at a time; ``depth`` wait, one more drops the oldest; those not ``wanted`` take no time."""

    def __init__(
        self,
        world: Simulation,
        took_ns: Callable[[], int],
        depth: int,
        done: Callable,
        wanted: Callable[..., bool] = lambda item: True,
    ) -> None:
        self._world, self._took_ns, self._depth, self._done, self._wanted = world, took_ns, depth, done, wanted
        self._waiting: deque = deque()
        self._idle = True

    def put(self, item: object) -> None:
        self._waiting.append(item)
        if len(self._waiting) > self._depth + self._idle:
            self._waiting.popleft()
        if self._idle:
            self._next()

    def _next(self) -> None:
        while self._waiting and not self._wanted(self._waiting[0]):
            self._waiting.popleft()
        self._idle = not self._waiting
        if self._idle:
            return
        item, took_ns = self._waiting.popleft(), self._took_ns()

        def finish() -> None:
            self._done(item, took_ns)
            self._next()

        self._world.after(took_ns, finish)


@dataclass
class Answer:
    """A frame set that came out at the end: exposure and answer, both since the start, and whether it was whole."""

    exposed_ns: int
    answered_ns: int
    whole: bool

    @property
    def latency_ms(self) -> float:
        return (self.answered_ns - self.exposed_ns) / MS


@dataclass
class Simulation:
    """The graph; change its fields between calls of :meth:`run`.

    hz : cameras' rate; hull_ms, tracker_ms, client_ms : what a set or a frame takes; loss : share of the frames that
    never come; dead : cameras that are silent; deaf : clients that ignore the rule; half : cameras of half the rate.
    """

    cameras: int = 5
    hz: float = 60.0
    hull_ms: float = 5.0
    tracker_ms: float = 5.0
    client_ms: float = 2.0
    loss: dict[str, float] = field(default_factory=dict)
    dead: set[str] = field(default_factory=set)
    deaf: set[str] = field(default_factory=set)
    half: set[str] = field(default_factory=set)
    offset_ns: dict[str, int] = field(default_factory=dict)
    clock_error_ns: int = 0

    def __post_init__(self) -> None:
        self.now_ns = 0
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._order, self._random, self._exposure = count(), random.Random(7), count()
        self.names = [f"cam{k:02}" for k in range(1, self.cameras + 1)]
        self.control, self.rules, self.answers = ThinningControl(), list[FrameDecimation](), list[Answer]()
        self._followers = {name: FrameSelector() for name in self.names}
        self._collector: FrameSetCollector[int] = FrameSetCollector(
            self.names, tolerance_ns=3 * MS, deadline_ns=50 * MS, give_up=5
        )
        self._hull = Server(self, lambda: self._varied(self.hull_ms), 4, self._published)
        self._tracker = Server(self, lambda: self._varied(self.tracker_ms), 4, self._answered)
        self._clients = {
            name: Server(self, lambda: self._varied(self.client_ms), 16, self._received, self._keeps)
            for name in self.names
        }
        self.after(0, self._expose)
        self.after(UPDATE_NS, self._update)

    def after(self, delay_ns: int, event: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.now_ns + delay_ns, next(self._order), event))

    def run(self, seconds: float) -> list[Answer]:
        """Let time pass; returns the sets answered within it."""
        end_ns, first = self.now_ns + round(seconds * S), len(self.answers)
        while self._events[0][0] <= end_ns:
            self.now_ns, _, event = heapq.heappop(self._events)
            event()
        self.now_ns = end_ns
        return self.answers[first:]

    @property
    def fraction(self) -> float:
        return self.control.rule.fraction

    def _varied(self, milliseconds: float) -> int:
        return round(milliseconds * MS * self._random.uniform(0.8, 1.2))

    def _expose(self) -> None:
        number = next(self._exposure)
        for name in self.names:
            absent = name in self.dead or (name in self.half and number % 2 == 1)
            if absent or self._random.random() < self.loss.get(name, 0.0):
                continue
            stamp_ns = EPOCH_NS + self.now_ns + self.offset_ns.get(name, 0) + self._random.randint(-MS // 5, MS // 5)
            self.after(2 * MS, lambda name=name, stamp_ns=stamp_ns: self._clients[name].put((name, stamp_ns)))
        self.after(round(S / self.hz), self._expose)

    def _keeps(self, frame: tuple[str, int]) -> bool:
        name, stamp_ns = frame
        return name in self.deaf or self._followers[name].keeps(stamp_ns, self.now_ns)

    def _received(self, frame: tuple[str, int], _: int) -> None:
        name, stamp_ns = frame
        if self.control.admits(stamp_ns, self.now_ns):
            self._close(self._collector.add(name, stamp_ns, 0, self.now_ns))

    def _close(self, sets: list[FrameSet[int]]) -> None:
        for each in sets:
            age_ns = EPOCH_NS + self.now_ns - each.stamp_ns + self.clock_error_ns
            self.control.add_closed(each.stamp_ns, each.frames, age_ns, self.now_ns)
            self._hull.put(each)

    def _published(self, each: FrameSet[int], took_ns: int) -> None:
        self.control.add_work(each.stamp_ns, took_ns, 0, self.now_ns)
        self._tracker.put(each)

    def _answered(self, each: FrameSet[int], _: int) -> None:
        self.control.add_answer(each.stamp_ns, self.now_ns)
        self.answers.append(Answer(each.stamp_ns - EPOCH_NS, self.now_ns, not each.missing))

    def _update(self) -> None:
        self._collector.deadline_ns = self.control.deadline_ns(50 * MS)
        self._close(self._collector.poll(self.now_ns))
        rule = self.control.update(self.now_ns)
        if rule is not None:
            self.rules.append(rule)
            for follower in self._followers.values():
                wait_ns = self._random.randint(MS, 5 * MS)
                self.after(wait_ns, lambda f=follower, rule=rule: f.update(rule, self.now_ns))
        self.after(UPDATE_NS, self._update)
