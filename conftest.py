"""Environment and data of all tests.

The environment is set when pytest loads this file, before a test module can import rclpy or numpy, which read it once.
Processes that tests start inherit it.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import hypothesis
import pytest

DOMAINS = range(30, 100)  # ports stay below those of outgoing connections
_FIRST_PORT, _PORTS = 7400, 250  # of DDS: those of domain d begin at 7400 + 250 d
_OF_PARTICIPANTS = 10  # the first of these that is one participant's own; those below are bound by who listens to all
_LOCKS: dict[int, IO[str]] = {}  # of the domains that no other test process takes until this one ends, however it ends


def domains_in_use() -> set[int]:
    """Return the domains in which some process of this machine, this one too, has a participant."""
    lines = Path("/proc/net/udp").read_text().splitlines()[1:]
    ports = (divmod(int(line.split()[1].rpartition(":")[2], 16) - _FIRST_PORT, _PORTS) for line in lines)
    return {domain for domain, port in ports if port >= _OF_PARTICIPANTS}


def quiet_domain() -> int:
    """Return a domain of this process in which no node runs. RuntimeError when every domain is in use.

    Contexts of earlier tests keep their nodes in the graph until Python has freed them; the nodes of processes that are
    ending are there, too. A graph of the same names would be refused beside them.
    """
    gc.collect()
    folder, in_use = Path(tempfile.gettempdir()) / f"sagoma_test_domains_{os.getuid()}", domains_in_use()
    folder.mkdir(exist_ok=True)
    for domain in (*_LOCKS, *DOMAINS):
        if domain in in_use:
            continue
        lock = _LOCKS.get(domain) or (folder / str(domain)).open("w")
        with contextlib.suppress(BlockingIOError):  # another test process has it
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _LOCKS[domain] = lock
            return domain
        lock.close()
    raise RuntimeError(f"all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use by other test runs")


hypothesis.settings.register_profile("any machine", deadline=None)  # a busy one fails no test
hypothesis.settings.load_profile("any machine")

_LOGS = tempfile.TemporaryDirectory(prefix="sagoma_test_logs_")  # removed when pytest ends

# nothing leaves this machine
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_LOG_DIR"] = _LOGS.name
# what the middleware of every node is told; the tests' own participants announce themselves as often
_PROFILE = Path(__file__).parent / "src/sagoma_ros/sagoma_ros/fastdds_memory.xml"
os.environ |= {"FASTRTPS_DEFAULT_PROFILES_FILE": str(_PROFILE), "RMW_FASTRTPS_USE_QOS_FROM_XML": "1"}
# two test runs side by side (or a live graph) do not hear each other; a domain that was chosen is that of one process:
# the graphs of several would hear each other
_CHOSEN_DOMAIN = None if "PYTEST_XDIST_WORKER" in os.environ else os.environ.get("ROS_DOMAIN_ID")
_domain_of: dict[Path, str] = {}  # file of tests -> its domain; of the current file alone

# a shell's background job inherits SIGINT ignored, and would hand that on to the processes that tests interrupt
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# on few cores the thread pools of BLAS cost more than they give
for _pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")

SHARED_DATA = Path(os.environ.get("SAGOMA_SHARED_DATA", Path(__file__).resolve().parent.parent / "shared" / "data"))


# whole graphs and simulated cameras keep time by the machine's clock: they never run beside each other
_REAL_TIME = (
    "tests/test_graph_live.py",
    "tests/test_people_live.py",
    "tests/test_studio_graph.py",
    "tests/test_sagoma_up.py",
    "tests/test_setup_drill.py",
    "tests/test_soak.py",
    "tests/test_supervision_live.py",
    "src/camera_client/test/test_camera_aravis",
    "src/virtual_studio/test/test_gige_camera",
    "src/virtual_studio/test/test_gige_timing",
)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With several processes (`make test`), a file stays in one of them, and all of _REAL_TIME in the same one."""
    from xdist.scheduler import LoadFileScheduling

    class RealTimeInOneProcess(LoadFileScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            return "real time" if nodeid.startswith(_REAL_TIME) else super()._split_scope(nodeid)

    return RealTimeInOneProcess(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A domain in which nobody is left for each file of tests, unless one was chosen."""
    if _CHOSEN_DOMAIN is None:
        if item.path not in _domain_of:
            _domain_of.clear()
            _domain_of[item.path] = str(quiet_domain())
        os.environ["ROS_DOMAIN_ID"] = _domain_of[item.path]


@pytest.fixture(scope="module")
def ros_context() -> Iterator[Any]:
    """A ROS context of a file's own."""
    import rclpy

    context = rclpy.Context()
    rclpy.init(context=context)
    yield context
    rclpy.shutdown(context=context)


@pytest.fixture
def open_probe(ros_context: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    """``open_probe(HullProbe, ...)``: a probe of tests/support/node_probe.py in the file's context; closed at the end.

    Its node reports on /diagnostics twenty times a second instead of once: tests wait for what it says.
    """
    monkeypatch.setattr("sagoma_ros.health.PERIOD_S", 0.05)
    probes: list[Any] = []

    def open_one(kind: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        probes.append(kind(ros_context, *arguments, **options))
        return probes[-1]

    yield open_one
    for probe in probes:
        probe.close()


@pytest.fixture(scope="session")
def body() -> Any:
    """A man of 1.75 m."""
    from stick_figure.body import Body

    return Body.from_stature(1.75)


@pytest.fixture(scope="session")
def shared_data() -> Callable[..., Path]:
    """``shared_data("sessions", "walk_ring5top")``: a path in the test data; skips the test where it is absent.

    The data is no part of the product. It is looked for in ../shared/data, or where SAGOMA_SHARED_DATA points.
    """

    def find(*parts: str) -> Path:
        path = SHARED_DATA.joinpath(*parts)
        if not path.exists():
            pytest.skip(f"test data {path} is not on this machine (SAGOMA_SHARED_DATA names its folder)")
        return path

    return find
