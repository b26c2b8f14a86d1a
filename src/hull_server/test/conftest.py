"""Scene and node of the tests of the hull node."""

import time
from types import SimpleNamespace

import pytest
from hull_probe import HullProbe
from hull_scenes import capsule_person, ring_rig, silhouettes

from capture_rig import load_rig, save_rig
from hull_server import hull_node, silhouette_input_ros


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Rig file, the rig as read back, silhouettes of a person."""
    rig_file = tmp_path_factory.mktemp("rig") / "rig.yaml"
    save_rig(ring_rig(4), rig_file)
    rig = load_rig(rig_file)
    return rig_file, rig, silhouettes(rig, capsule_person(0.3))


@pytest.fixture
def clock(monkeypatch):
    """The node's monotonic clock, which a test may put forward."""
    clock = SimpleNamespace(ahead_ns=0)
    for module in (hull_node, silhouette_input_ros):
        monkeypatch.setattr(module, "monotonic_ns", lambda: time.monotonic_ns() + clock.ahead_ns)
    return clock


@pytest.fixture
def make_bench(open_probe, scene, clock):
    return lambda **parameters: open_probe(HullProbe, clock, **({"rig_file": str(scene[0])} | parameters))


@pytest.fixture
def bench(make_bench, scene):
    return make_bench().start(scene[1])
