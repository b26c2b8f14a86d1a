"""Every parameter that the graph, the lockstep replay and the example files give to a node is one that it declares."""

from pathlib import Path

import pytest

from camera_client.settings import CameraClientSettings
from capture_rig.settings import build_settings
from ekf_tracker.settings import EkfNodeSettings
from hull_server.settings import NodeSettings as HullNodeSettings
from icp_tracker.settings import IcpNodeSettings
from sagoma_bringup.graph import LOSSLESS_SETTINGS, build_graph, cameras_from_files

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "config"
SETTINGS = {
    "camera_client": CameraClientSettings,
    "hull_server": HullNodeSettings,
    "icp_tracker": IcpNodeSettings,
    "ekf_tracker": EkfNodeSettings,
}


def accepted(node):
    given = {key: value for key, value in node.parameters.items() if key != "autostart"}
    return build_settings(SETTINGS[node.name], given, node.full_name)


def test_example_rig_with_its_cameras_and_body():
    graph = build_graph(rig=CONFIG / "rig" / "ring4.yaml", cameras=CONFIG / "camera", body=CONFIG / "body/default.yaml")
    settings = {node.label: accepted(node) for node in graph}
    assert settings["cam02"].aravis.address == "192.168.1.12"
    assert settings["hull_server"].rig_file.endswith("ring4.yaml")


def test_example_footage_camera():
    (node,) = cameras_from_files(CONFIG / "camera" / "footage")
    assert accepted(node).footage.path == "session/cam01.mp4"


def test_lossless_settings():
    graph = build_graph(rig=CONFIG / "rig" / "ring4.yaml", settings=LOSSLESS_SETTINGS)
    settings = {node.label: accepted(node) for node in graph}
    assert settings["hull_server"].reliable
    assert min(settings[n].queue_depth for n in ("hull_server", "icp_tracker")) >= 1000


def test_session_of_real_footage():
    folder = ROOT.parent / "shared" / "data" / "real_4cam"
    if not folder.is_dir():
        pytest.skip("the real footage is not on this machine")
    for rate in (0.0, 1.0):
        settings = {node.label: accepted(node) for node in build_graph(session=folder, rate=rate)}
        assert settings["hull_server"].tolerance_s == pytest.approx(0.5 / 60)
        assert settings["hull_server"].reliable == (rate == 0.0)
        assert settings["cam03"].footage.fps == pytest.approx(60.0)
