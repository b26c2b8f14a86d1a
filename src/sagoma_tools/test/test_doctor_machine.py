"""What the doctor concludes of a made-up machine, and collects of this one."""

import hashlib
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

import hull_server
from sagoma_tools.doctor.collect import judge_kernel_clock, kernel_clock
from sagoma_tools.doctor.facts import (
    ClockFacts,
    DiskFacts,
    GraphicsFacts,
    HostFacts,
    InterfaceFacts,
    KernelFacts,
    LimitFacts,
    MachineFacts,
    NetworkFacts,
    SharedMemoryFacts,
    SoftwareFacts,
)
from sagoma_tools.doctor.findings import Severity
from sagoma_tools.doctor.machine.ask_gl import collect_graphics
from sagoma_tools.doctor.machine.checks import check_machine
from sagoma_tools.doctor.machine.collect import (
    collect_disk,
    collect_kernels,
    collect_limits,
    collect_shared_memory,
    collect_software,
    fingerprint_of,
)
from sagoma_tools.doctor.machine.network import (
    ReachFacts,
    check_reach,
    collect_network,
    collect_reach,
    domains_of_ports,
)

LINK = InterfaceFacts("enp3s0", "192.168.1.1", "255.255.255.0", mtu=1500, speed_mbit=1000)
MACHINE = MachineFacts(
    host=HostFacts(8 << 20, 8, 1.0, 8 << 30, ("performance",), ClockFacts("chrony", True, 1e-5), {}),
    software=SoftwareFacts("debian", "12", (3, 11), "jazzy", "rmw_fastrtps_cpp"),
    graphics=GraphicsFacts("", "NVIDIA RTX", "4.6.0", True),
    kernels=KernelFacts("/src", 120, True, True),
    disk=DiskFacts("output", "", 100 << 30, 400e6),
    shared_memory=SharedMemoryFacts(8 << 30, 7 << 30),
    limits=LimitFacts(1 << 20, 95, -1),
    network=NetworkFacts((LINK,), 8 << 20),
)


def worst(findings):
    found = list(findings)
    assert all(finding.remedy for finding in found if finding.severity >= Severity.WARNING)
    return max(found, key=lambda finding: finding.severity)


def test_machine_as_it_should_be_has_nothing_but_ok():
    assert worst(check_machine(MACHINE)).severity is Severity.OK


@pytest.mark.parametrize(
    "changes, severity, code, value",
    [
        ({"software": replace(MACHINE.software, system="fedora")}, "NOTE", "system.untested", "fedora 12"),
        ({"software": replace(MACHINE.software, python=(3, 13))}, "WARNING", "python.untested", "3.13"),
        ({"software": replace(MACHINE.software, ros_distro="humble")}, "WARNING", "ros.other_distro", "humble"),
        ({"software": replace(MACHINE.software, rmw_error="no lib")}, "ERROR", "ros.no_middleware", "no lib"),
        ({"kernels": KernelFacts("/src", 0, True, None)}, "WARNING", "kernels.not_compiled", ""),
        ({"kernels": KernelFacts("/src", 9, True, False)}, "NOTE", "kernels.stale", "9 "),
        ({"kernels": KernelFacts("/src", 9, False, True)}, "WARNING", "kernels.read_only", "/src"),
        ({"graphics": GraphicsFacts("EGL knows no device")}, "NOTE", "opengl.none", "EGL knows no device"),
        ({"graphics": GraphicsFacts("", "llvmpipe", "4.5", False)}, "NOTE", "opengl.software", "llvmpipe, OpenGL 4.5"),
        ({"disk": DiskFacts("out", "out may not be written")}, "ERROR", "disk.unusable", "out"),
        ({"disk": DiskFacts("out", "", 100 << 20, 1e8)}, "ERROR", "disk.full", "0.1 GiB"),
        ({"disk": DiskFacts("out", "", 1 << 30, 1e8)}, "WARNING", "disk.low", "1.0 GiB"),
        ({"disk": DiskFacts("out", "", 100 << 30, 5e6)}, "WARNING", "disk.slow", "5 MB/s"),
        ({"shared_memory": SharedMemoryFacts(64 << 20, 60 << 20)}, "WARNING", "shm.small", "60 of 64 MiB"),
        ({"shared_memory": SharedMemoryFacts(8 << 30, 7 << 30, 99)}, "NOTE", "shm.abandoned", "99 "),
        ({"limits": LimitFacts(256, 0, 8 << 20)}, "WARNING", "limits.open_files", "256 "),
        ({"network": NetworkFacts((LINK,), 212992)}, "NOTE", "wmem_max.small", "212992"),
        ({"network": NetworkFacts((LINK,), None)}, "NOTE", "wmem_max.unknown", ""),
        ({"network": NetworkFacts((replace(LINK, mtu=1280),), 8 << 20)}, "NOTE", "network.small_mtu", "1280"),
        ({"network": NetworkFacts((replace(LINK, up=False),), 8 << 20)}, "NOTE", "network.down", "enp3s0"),
        ({"network": NetworkFacts((), 8 << 20)}, "NOTE", "network.loopback_only", ""),
        ({"network": NetworkFacts((LINK,), 8 << 20, ("ufw",))}, "NOTE", "firewall.active", "ufw"),
        ({"network": NetworkFacts((LINK,), 8 << 20, (), "/x.xml", False)}, "ERROR", "dds_profile.missing", "/x.xml"),
    ],
)
def test_machine_that_is_not_ready_is_found_with_a_remedy(changes, severity, code, value):
    finding = worst(check_machine(replace(MACHINE, **changes)))
    assert (finding.severity.name, finding.code) == (severity, code) and value in finding.what


def test_small_receive_buffer_comes_with_its_sysctl_line():
    small = replace(MACHINE, host=replace(MACHINE.host, rmem_max=212992))
    finding = worst(check_machine(small))
    assert finding.code == "rmem_max.small" and "sysctl -w net.core.rmem_max=4194304" in finding.remedy


def test_domains_are_told_from_well_known_ports():
    # RTPS 9.6.1.1: 7400 + 250 x domain; + 10 + 2 x participant for its discovery, + 11 + 2 x participant for its data
    assert domains_of_ports({7400, 7411, 18900, 18910, 18913, 22, 3956, 40000}) == (0, 46)


@pytest.mark.parametrize(
    "answer, error_us, expected",
    [
        (5, 16_000_000, ClockFacts("no service, by the kernel's account", False)),
        (0, 250, ClockFacts("a service that the kernel knows of", True, 250e-6)),
        (0, 16_000_000, ClockFacts("a service that the kernel knows of", True)),
    ],
)
def test_kernel_says_whether_its_clock_is_in_step(answer, error_us, expected):
    found = judge_kernel_clock(answer, error_us)
    assert (found.in_step, found.keeper) == (expected.in_step, expected.keeper)
    assert found.offset_s == pytest.approx(expected.offset_s) if expected.offset_s else found.offset_s is None


def test_facts_of_this_machine_agree_with_the_system(tmp_path):
    release = dict(line.split("=", 1) for line in Path("/etc/os-release").read_text().splitlines() if "=" in line)
    assert collect_software().system == release["ID"].strip('"') and not collect_software().rmw_error
    assert collect_limits().open_files == int(subprocess.check_output(["bash", "-c", "ulimit -n"]))
    size = os.statvfs("/dev/shm")
    assert collect_shared_memory().size_bytes == size.f_blocks * size.f_frsize
    names = set(os.listdir("/sys/class/net"))
    assert {interface.name for interface in collect_network().interfaces} <= names - {"lo"}
    assert kernel_clock().in_step is not None or kernel_clock().unknown_because
    disk = collect_disk(tmp_path / "not" / "yet" / "there")
    assert not disk.error and disk.free_bytes > 0 and disk.write_bytes_per_s > 0


def test_folder_that_is_a_file_cannot_take_bags(tmp_path):
    (tmp_path / "bags").write_text("")
    assert "is not a folder" in collect_disk(tmp_path / "bags").error


def test_fingerprint_of_the_sources_is_the_one_that_the_set_up_writes(tmp_path):
    texts = {"b/x.py": "b", "a/y.py": "a", "a-b/_.py": "-", "a/test/test_z.py": "never read", "a/z.txt": "no source"}
    for path, text in texts.items():
        (tmp_path / "src" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "src" / path).write_text(text)
    assert fingerprint_of(tmp_path / "src") == hashlib.sha256(b"-ab").hexdigest()
    script = Path(hull_server.__file__).parents[3] / "scripts" / "setup.sh"
    sources = next(line for line in script.read_text().splitlines() if line.startswith("sources()"))
    said = subprocess.check_output(["bash", "-c", f"{sources}; sources"], cwd=tmp_path, text=True)
    assert said.split()[0] == fingerprint_of(tmp_path / "src")


def test_kernels_of_this_installation_are_counted():
    packages = Path(hull_server.__file__).parents[2]
    assert collect_kernels().compiled == len(list(packages.rglob("*.nbi"))) or "NUMBA_CACHE_DIR" in os.environ


def test_graphics_are_asked_for_in_a_process_of_their_own():
    found = collect_graphics()
    assert bool(found.error) != bool(found.renderer)
    assert found.error or found.version[0].isdigit()


def test_loopback_carries_every_packet_and_says_that_it_is_this_machine():
    facts = collect_reach("127.0.0.1")
    assert facts.answers and facts.largest == 9000
    assert [finding.severity.name for finding in check_reach(facts)] == ["OK", "NOTE"]


@pytest.mark.parametrize(
    "facts, severity, code, value",
    [
        (ReachFacts("10.0.0.2", None), "ERROR", "way.none", "10.0.0.2"),
        (ReachFacts("10.0.0.2", LINK), "WARNING", "answer.none", "10.0.0.2"),
        (ReachFacts("10.0.0.2", LINK, True, 1500), "OK", "mtu.ok", "1500 bytes"),
        (ReachFacts("10.0.0.2", replace(LINK, mtu=9000), True, 1500), "ERROR", "mtu.too_large", "1500 bytes"),
        (ReachFacts("10.0.0.2", LINK, True, 0), "ERROR", "mtu.too_large", "1280 bytes"),
    ],
)
def test_way_to_another_machine_is_judged_by_what_gets_there(facts, severity, code, value):
    finding = worst(check_reach(facts))
    assert (finding.severity.name, finding.code) == (severity, code) and value in finding.what
