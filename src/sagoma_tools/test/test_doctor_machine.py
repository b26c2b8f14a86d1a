"""What the doctor finds on this machine as it is, and once something about it is changed; how findings are shown."""

import io
import os
from dataclasses import replace
from types import SimpleNamespace

import pytest

from capture_rig.errors import InputError
from sagoma_tools.console import CommandConsole
from sagoma_tools.doctor import machine
from sagoma_tools.doctor.findings import Severity, error, exit_status, note, ok, show, summary, warning
from sagoma_tools.doctor.machine import Interface, domains_of_ports, examine_machine, interface_to, interfaces

LINK = Interface("enp3s0", "192.168.1.1", mtu=1500, speed_mbit=1000)
VARIABLES = (
    *("ROS_DOMAIN_ID", "ROS_DISTRO", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "RMW_IMPLEMENTATION"),
    *("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"),
)
GIB = 1 << 30


def told(**figures):
    """Who tells these figures, whatever he is asked."""
    return lambda *asked: SimpleNamespace(**figures)


def small_shared_memory(path):
    """As a container has it."""
    return SimpleNamespace(free=60 << 20, total=64 << 20) if path == "/dev/shm" else PLENTY(path)


def fails(error):
    def fail(*asked):
        raise error

    return fail


def answers(**programs):
    """What programs print: by name, or that they are not there."""
    return lambda *command: programs.get(command[0], f"{command[0]} is not there")


NO_RMW = fails(RuntimeError("no lib"))
PLENTY, NO_ARAVIS = told(free=50 * GIB, total=100 * GIB), InputError("Aravis is not available", remedy="Install it.")
GOOD = {
    "machine.os.getloadavg": lambda: (0.0, 0.0, 0.0),
    "machine.os.sched_getaffinity": lambda pid: set(range(8)),
    "machine.psutil.virtual_memory": told(available=8 * GIB),
    "machine.psutil.disk_usage": PLENTY,
    "machine.import_aravis": lambda: None,
    "machine._answer": answers(chronyc="A29FC87B,10.0.0.1,3,1763712345.6,0.000012345,0.00001"),
    "machine.interfaces": lambda: [LINK],
    "machine.Path.read_text": lambda path, **options: str(8 << 20),
}


@pytest.fixture
def examined(monkeypatch, tmp_path):
    """Examines a machine as it should be, with changes of what it answers and of environment variables."""

    def examine(changes):
        for name in VARIABLES:
            monkeypatch.delenv(name, raising=False)
        (tmp_path / "kernel.nbi").touch()
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
        for name, value in {**GOOD, **changes}.items():
            if name.isupper():
                monkeypatch.setenv(name, value)
            else:
                monkeypatch.setattr(f"sagoma_tools.doctor.{name}", value)
        found = [finding for finding in examine_machine() if finding.severity > Severity.OK]
        assert all(finding.remedy for finding in found if finding.severity >= Severity.WARNING)
        return [(finding.severity.name, finding.code, finding.what + finding.remedy) for finding in found]

    return examine


def test_machine_as_it_should_be_has_nothing_but_ok(examined):
    assert examined({}) == []


@pytest.mark.parametrize(
    "changes, severity, code, value",
    [
        ({"machine.sys.version_info": (3, 13, 0)}, "WARNING", "python.untested", "3.13"),
        ({"machine.os.getloadavg": lambda: (7.5, 0, 0)}, "WARNING", "cores.busy", "0.5 of"),
        ({"machine.psutil.virtual_memory": told(available=100 << 20)}, "WARNING", "memory.low", "100 MiB"),
        ({"machine.psutil.disk_usage": small_shared_memory}, "WARNING", "shm.small", "60 of 64 MiB"),
        ({"machine.psutil.disk_usage": told(free=3 * GIB, total=GIB)}, "WARNING", "disk.low", "3.0 GiB"),
        ({"machine.psutil.disk_usage": told(free=150 << 20, total=GIB)}, "ERROR", "disk.full", "0.1 GiB"),
        ({"machine.Path.read_text": fails(FileNotFoundError())}, "NOTE", "rmem_max.unknown", "container"),
        ({"machine.import_aravis": fails(NO_ARAVIS)}, "ERROR", "aravis.unusable", "Aravis is not available"),
        ({"machine._answer": answers(chronyc="0,,0,0.0,0.0")}, "WARNING", "clock.unsynchronised", "chrony"),
        ({"machine._answer": answers(chronyc="A,B,3,0.0,-0.005")}, "WARNING", "clock.off", "5 ms"),
        ({"machine._answer": answers(timedatectl="no")}, "WARNING", "clock.unsynchronised", "systemd"),
        ({"machine._answer": answers()}, "NOTE", "clock.unknown", "timedatectl is not there"),
        ({"machine.Path.read_text": lambda path: "212992"}, "WARNING", "rmem_max.small", "rmem_max=4194304"),
        ({"machine.get_rmw_implementation_identifier": lambda: "rmw_x"}, "NOTE", "ros.untested_rmw", "rmw_x"),
        ({"machine.interfaces": lambda: [replace(LINK, speed_mbit=100)]}, "WARNING", "network.slow", "100 Mbit/s"),
        ({"machine.get_rmw_implementation_identifier": NO_RMW}, "ERROR", "ros.no_middleware", "no lib"),
        ({"ROS_DOMAIN_ID": "300"}, "ERROR", "ros.domain_invalid", "300"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "WARNING", "ros.discovery_local", "LOCALHOST"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "WARNING", "ros.discovery_local", "ROS_LOCALHOST_ONLY"),
        ({"ROS_DISTRO": "humble"}, "WARNING", "ros.other_distro", "humble"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/x.xml"}, "ERROR", "dds_profile.missing", "/x.xml"),
    ],
)
def test_machine_that_is_not_ready_or_misleads_nodes_is_found_with_a_remedy(examined, changes, severity, code, value):
    (found,) = examined(changes)
    assert found[:2] == (severity, code) and value in found[2]


@pytest.mark.parametrize(
    "compiled, writable, code", [(0, True, "kernels.not_compiled"), (1, False, "kernels.read_only")]
)
def test_kernels_that_compile_at_every_start_are_found(monkeypatch, tmp_path, compiled, writable, code):
    for number in range(compiled):
        (tmp_path / f"{number}.nbi").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda path, mode: writable)
    assert machine.check_kernels().code == code


def test_domains_are_told_from_well_known_ports():
    # RTPS 9.6.1.1: 7400 + 250 x domain; + 10 + 2 x participant for its discovery, + 11 + 2 x participant for its data
    assert domains_of_ports({7400, 7411, 18900, 18910, 18913, 22, 3956, 40000}) == (0, 46)


def test_interfaces_of_this_machine_agree_with_the_system():
    if os.path.isdir("/sys/class/net"):  # not in a chroot without it
        assert {each.name for each in interfaces()} <= set(os.listdir("/sys/class/net"))
    link = interface_to("127.0.0.1")
    assert link.loopback and link.up and link.mtu > 1500


# --- how findings are shown


def on(subject, *findings):
    return [replace(finding, subject=subject) for finding in findings]


LENS = ok("lens", "f 468 px"), note("report.missing", "none"), error("place.below_floor", "below the floor", "redo")
FINDINGS = [
    *on("this machine", ok("disk", "is large"), warning("clock.off", "is off", "chrony"), ok("memory", "is there")),
    *on("camera cam01", *LENS),
    *on("graph", error("nodes.none", "no node is heard", "start the graph")),
]


def test_findings_are_shown_by_subject_the_gravest_first_cameras_last_and_counted():
    sink = io.StringIO()
    show(FINDINGS, CommandConsole(file=sink))
    *lines, last = sink.getvalue().splitlines()
    assert [line for line in lines if line and line[0] != " "] == ["this machine", "graph", "camera cam01"]
    about_cam01 = lines[lines.index("camera cam01") + 1 :]
    assert [line.split()[0] for line in about_cam01[:4]] == ["ERROR", "->", "note", "ok"]
    assert "ok      disk, memory" in "\n".join(lines) and not any("is large" in line for line in lines)
    assert last == "errors: 2, warnings: 1; first: camera cam01: below the floor"
    assert summary([ok("a", ""), note("b", "")]) == "no errors, no warnings (1 passed)"


@pytest.mark.parametrize("kind, status", [(note, 0), (warning, 1), (error, 2)])
def test_exit_status_is_the_gravest_findings(kind, status):
    assert exit_status([note("b", "", ""), kind("a", "", "do")]) == status and exit_status([]) == 0
