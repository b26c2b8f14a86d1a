"""A bag's silhouettes, played to the server over and over with fresh stamps, and the faults that a player can play."""

from __future__ import annotations

import os
import random
import signal
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from soak_faults import LONGEST_S, LONGEST_STOPPED_S, SERVER, SHORTEST_S, Fault

from capture_rig.errors import InputError
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.supervisor import Supervisor
from sagoma_tools.graph.topics import camera_topics, cameras_in
from sagoma_tools.recording.reader import BagMessage, bag_topics, read_messages
from sagoma_tools.recording.replayer import InputPublishers

SECOND_NS = 1_000_000_000
STAMP = struct.Struct("<iI")  # behind the four bytes that lead in a serialised message (CDR, little-endian)
TOGETHER_NS = 8_000_000  # half a period of 60 Hz
SLOWER = 2.0  # the bag is played at half speed: at a low rate the person seems to move as at twice the rate
LOST_SHARE = 0.3
KINDS = ("camera silent", "masks lost", "pause", "server suspended", "server killed")


class BagPlayer:
    """Plays the whole frame sets of a bag forth and back for ever, ``hz`` of them a second, at instants in step.

    ``silent``, ``lossy`` : cameras that send nothing, or lose LOST_SHARE of their masks; ``paused`` : nobody sends.
    Raises InputError for a bag without whole sets.
    """

    def __init__(self, bag: Path, hz: float, seed: int) -> None:
        kinds = bag_topics(bag)
        self.cameras = cameras_in(kinds)
        self._of_camera = {name: camera_topics(name) for name in self.cameras}
        names = {topic.name for topics in self._of_camera.values() for topic in topics}
        sets, bag_hz = whole_sets(bag, names)
        there = sets[:: max(1, round(bag_hz / (SLOWER * hz)))]
        self._sets, self._hz = there + there[::-1], hz
        self.silent, self.lossy, self.paused = set[str](), set[str](), False
        self._draw, self._stop = random.Random(seed), threading.Event()
        self._link = RosLink("soak_player")
        self._publishers = InputPublishers(self._link.node, {name: kinds[name] for name in names})
        self._names = names
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)

    def __enter__(self) -> BagPlayer:
        self._publishers.wait_for_subscribers(self._names, LONGEST_S)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()
        self._link.close()

    def _play(self) -> None:
        number = round(time.time() * self._hz)
        while not self._stop.is_set():
            number += 1
            self._stop.wait(max(0.0, number / self._hz - time.time()))
            if not self.paused:
                self._send(self._sets[number % len(self._sets)], round(number * SECOND_NS / self._hz))

    def _send(self, messages: dict[str, bytearray], stamp_ns: int) -> None:
        stamp = divmod(stamp_ns, SECOND_NS)
        for camera, topics in self._of_camera.items():
            lost = camera in self.lossy and self._draw.random() < LOST_SHARE
            if camera not in self.silent and not lost:
                for topic in topics:
                    STAMP.pack_into(messages[topic.name], 4, *stamp)
                    self._publishers.publish(
                        BagMessage(topic.name, topic.msgtype, stamp_ns, bytes(messages[topic.name]))
                    )


def whole_sets(bag: Path, topics: set[str]) -> tuple[list[dict[str, bytearray]], float]:
    """Return the sets (topic -> message) in which no topic lacks, and how many there are a second of the bag.

    Messages of a set are those nearest to one of the first topic, TOGETHER_NS at most. Raises InputError without two.
    """
    by_topic: dict[str, dict[int, bytes]] = {topic: {} for topic in sorted(topics)}
    for message in read_messages(bag, topics.__contains__):
        by_topic[message.topic][message.stamp_ns] = message.data
    stamps = {topic: np.array(sorted(messages), np.int64) for topic, messages in by_topic.items()}
    found, instants = [], []
    for instant in stamps[min(stamps)] if all(map(len, stamps.values())) else ():
        nearest = {topic: int(own[np.abs(own - instant).argmin()]) for topic, own in stamps.items()}
        if max(abs(stamp - instant) for stamp in nearest.values()) < TOGETHER_NS:
            found.append({topic: bytearray(by_topic[topic][stamp]) for topic, stamp in nearest.items()})
            instants.append(int(instant))
    if len(found) < 2:
        raise InputError("has no whole frame sets", where=str(bag), remedy="Give a bag of the cameras' silhouettes.")
    return found, (len(found) - 1) * SECOND_NS / (instants[-1] - instants[0])


def replay_faults(seed: int, cameras: tuple[str, ...]) -> Iterator[Fault]:
    """Draw faults without end, in rounds; the server is hit in the first one only, as by `random_faults`."""
    draw, kinds = random.Random(seed), list(KINDS)
    while True:
        draw.shuffle(kinds)
        for kind in kinds:
            seconds = draw.uniform(SHORTEST_S, LONGEST_S)
            if kind.startswith("server"):
                yield Fault(kind, SERVER, 0.0 if kind.endswith("killed") else min(seconds, LONGEST_STOPPED_S))
            else:
                yield Fault(kind, "all" if kind == "pause" else draw.choice(cameras), seconds)
        kinds = [kind for kind in KINDS if not kind.startswith("server")]


class ReplayInjector:
    """Begins and undoes faults of the player and of the server."""

    def __init__(self, player: BagPlayer, supervisor: Supervisor) -> None:
        self._player, self._supervisor = player, supervisor

    def begin(self, fault: Fault) -> None:
        if fault.target == SERVER:
            number = signal.SIGSEGV if fault.kind.endswith("killed") else signal.SIGSTOP
            os.kill(self._supervisor.processes.pids()["/hull_server"], number)
        elif fault.kind == "pause":
            self._player.paused = True
        else:
            (self._player.silent if fault.kind == "camera silent" else self._player.lossy).add(fault.target)

    def undo(self, fault: Fault) -> None:
        if fault.kind == "server suspended":
            os.kill(self._supervisor.processes.pids()["/hull_server"], signal.SIGCONT)
        self._player.paused = False
        self._player.silent.clear()
        self._player.lossy.clear()
