"""The memory of a node's process: what messages took is given back, garbage is freed, what is in use is spared."""

import gc
import os
import subprocess
import sys
import weakref
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from sagoma_ros.middleware import MALLOC_VARIABLES, PROFILE, PROFILE_VARIABLES, QOS_FROM_PROFILE, bound_memory
from sagoma_ros.process import freeze_garbage_collector

MIB = 1 << 20
LARGE, BURST = 8, 12  # MiB of a message, and messages that wait at once
FOR_SEVERAL_MACHINES = Path(__file__).parents[3] / "config" / "dds" / "fastdds.xml"
NODE_AFTER_LARGE_MESSAGES = f"""
import ctypes, gc, sys, time
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import ByteMultiArray
from sagoma_ros.middleware import bound_memory

if sys.argv[1] == "bounded":
    bound_memory()


class Mallinfo(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in "arena b c d hblkhd f g uordblks i j".split()]


libc = ctypes.CDLL(None)
libc.mallinfo2.restype = Mallinfo


def held():
    gc.collect()
    info = libc.mallinfo2()
    return info.arena + info.hblkhd


rclpy.init()
node = rclpy.create_node("taker")
taken = []
qos = QoSProfile(depth={BURST})
node.create_subscription(ByteMultiArray, "large", lambda data: taken.append(len(data)), qos, raw=True)
publisher = node.create_publisher(ByteMultiArray, "large", qos)
executor = rclpy.executors.SingleThreadedExecutor()
executor.add_node(node)


def burst(mib):
    message, before = b"\\0\\1\\0\\0" + bytes(mib << 20), len(taken)
    for _ in range({BURST}):
        publisher.publish(message)
    end_s = time.monotonic() + 60.0
    while len(taken) < before + {BURST} and time.monotonic() < end_s:
        executor.spin_once(timeout_sec=1.0)


while not publisher.get_subscription_count():
    executor.spin_once(timeout_sec=0.1)
burst(0)
before = held()
burst({LARGE})
print(len(taken), held() - before)
"""


def bytes_kept(how: str) -> int:
    """Return what a process keeps of a burst of large messages that it has taken."""
    environment = {
        name: value for name, value in os.environ.items() if name not in (*PROFILE_VARIABLES, QOS_FROM_PROFILE)
    }
    command = [sys.executable, "-c", NODE_AFTER_LARGE_MESSAGES, how]
    told = subprocess.run(command, capture_output=True, text=True, env=environment, check=True, timeout=120.0).stdout
    taken, kept = map(int, told.split())
    assert taken == 2 * BURST
    return kept


@pytest.mark.slow
def test_what_large_messages_took_is_given_back() -> None:
    assert bytes_kept("as ROS has it") > BURST // 2 * LARGE * MIB  # the test can fail
    assert bytes_kept("bounded") < 2 * LARGE * MIB


def test_a_profile_of_the_user_is_left_alone() -> None:
    for name in (*PROFILE_VARIABLES, QOS_FROM_PROFILE):
        environment = {name: "mine", MALLOC_VARIABLES[0]: "65536"}
        bound_memory(environment)
        assert environment == {name: "mine", MALLOC_VARIABLES[0]: "65536"}
    environment = {MALLOC_VARIABLES[0]: "65536"}
    bound_memory(environment)
    assert environment[PROFILE_VARIABLES[0]] == str(PROFILE) and environment[QOS_FROM_PROFILE] == "1"


@pytest.mark.parametrize("profile", [PROFILE, FOR_SEVERAL_MACHINES], ids=["one machine", "several"])
def test_profiles_free_what_was_taken_and_let_a_new_process_find_a_node_within_a_second(profile: Path) -> None:
    space = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
    root = ElementTree.parse(profile).getroot()
    for end in ("data_writer", "data_reader"):
        (found,) = root.iter(space + end)
        assert found.get("is_default_profile") == "true"
        assert found.findtext(space + "historyMemoryPolicy") == "DYNAMIC"
        assert found.findtext(f"{space}qos/{space}data_sharing/{space}kind") == "OFF"
    (builtin,) = root.iter(space + "builtin")
    for end in ("reader", "writer"):
        assert builtin.findtext(f"{space}{end}HistoryMemoryPolicy") == "PREALLOCATED_WITH_REALLOC"
    (announcement,) = builtin.iter(space + "leaseAnnouncement")
    assert announcement.findtext(space + "sec") == "0" < announcement.findtext(space + "nanosec", "")


# --- Python's garbage collection


class Ring:
    """Refers to itself: only the collector can free it."""

    def __init__(self) -> None:
        self.next = self


@pytest.fixture
def collector_as_before() -> Iterator[None]:
    before = gc.get_threshold()
    yield
    gc.unfreeze()
    gc.set_threshold(*before)


@pytest.mark.usefixtures("collector_as_before")
def test_garbage_is_freed_and_what_is_in_use_is_left_alone_until_the_next_time() -> None:
    held, garbage = [Ring()], weakref.ref(Ring())
    once = weakref.ref(held[0])
    freeze_garbage_collector()
    assert garbage() is None
    assert gc.get_freeze_count() > 0 and not any(each is held[0] for each in gc.get_objects())
    held.clear()
    gc.collect()
    assert once() is not None
    freeze_garbage_collector()
    assert once() is None
