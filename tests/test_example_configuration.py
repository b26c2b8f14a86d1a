"""What we ship can be used as it is: parameter files, viewers' layouts, units and containers; graph and replay give a
node what it declares."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from camera_client.settings import CameraClientSettings
from capture_rig.settings import build_settings, leaves
from ekf_tracker.settings import EkfNodeSettings
from hull_server.settings import NodeSettings as HullNodeSettings
from icp_tracker.settings import IcpNodeSettings
from sagoma_bringup.graph import build_graph, camera_from_file
from sagoma_tools.doctor.cameras import read_file
from sagoma_tools.graph.topics import DIAGNOSTICS, OUTPUT_TOPICS

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "config"
RIG = CONFIG / "rig" / "ring4.yaml"
LIVE = sorted((CONFIG / "camera").glob("*.yaml"))
FOOTAGE = sorted((CONFIG / "camera" / "footage").glob("*.yaml"))
SETTINGS = {
    "camera_client": CameraClientSettings,
    "hull_server": HullNodeSettings,
    "icp_tracker": IcpNodeSettings,
    "ekf_tracker": EkfNodeSettings,
}
CHOSEN = {
    *("rig_file", "camera_name", "source", "background_file"),
    *("aravis.address", "aravis.exposure_us", "aravis.gain", "aravis.frame_rate"),
}
"""What a file spells out as a choice of this example; the rest is the default."""


def accepted(graph):
    """Each node's settings by label; raises where it is given what it does not declare."""
    given = {node.label: {k: v for k, v in node.parameters.items() if k != "autostart"} for node in graph}
    return {node.label: build_settings(SETTINGS[node.name], given[node.label], node.full_name) for node in graph}


@pytest.mark.parametrize("path", LIVE + FOOTAGE, ids=lambda path: f"{path.parent.name}_{path.stem}")
def test_parameter_file_has_only_known_parameters_with_possible_values_and_a_rig_that_knows_the_camera(
    path, monkeypatch
):
    monkeypatch.chdir(ROOT)
    file = read_file(path)
    assert file.name == path.stem == file.settings.camera_name
    assert file.settings.source == ("aravis" if path in LIVE else "footage")
    if path in LIVE:
        defaults = {leaf.key: leaf.default for leaf in leaves(CameraClientSettings)}
        given = {key: value for key, value in camera_from_file(path).parameters.items() if key != "autostart"}
        assert {key for key, value in given.items() if value != defaults[key]} == CHOSEN
        assert file.calibration.placed and file.camera.name == path.stem


def test_example_rig_with_its_cameras_and_body_makes_one_graph():
    graph = build_graph(rig=RIG, cameras=CONFIG / "camera", body=CONFIG / "body/default.yaml")
    settings, cameras = accepted(graph), ["cam01", "cam02", "cam03", "cam04"]
    assert [node.label for node in graph] == ["hull_server", "icp_tracker", "ekf_tracker", *cameras]
    assert [settings[name].aravis.address for name in cameras] == [f"192.168.1.1{k}" for k in (1, 2, 3, 4)]
    assert {settings[name].rig_file for name in (*cameras, "hull_server")} == {str(RIG)}
    assert not any(node.parameters["autostart"] for node in graph[3:])  # driven by whoever starts the graph
    assert settings["icp_tracker"].body_file and "body_file" not in graph[2].parameters  # fits bring it to the filter


# --- viewers and the aggregator


def test_layouts_show_topics_of_the_graph_in_a_panel_each():
    known = {topic.name for topic in (*OUTPUT_TOPICS, DIAGNOSTICS)} | {"/mocap/skeletons"}
    layout = json.loads((CONFIG / "foxglove/sagoma.json").read_text())
    panels = layout["configById"]
    shown = set(panels["3D!body"]["topics"]) | {panels["RawMessages!state"]["topicPath"]}
    shown |= {path["value"].partition(".")[0] for path in panels["Plot!angles"]["paths"]}
    shown.add(panels["DiagnosticSummary!nodes"]["topicToRender"])
    rviz = set(re.findall(r"Value: (/\S+?)}", (CONFIG / "rviz/sagoma.rviz").read_text()))
    assert len(rviz) > 3 and rviz | shown <= known
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))) == set(panels)


def test_aggregator_puts_every_node_s_status_into_one_group():
    (node,) = yaml.safe_load((CONFIG / "diagnostics/aggregator.yaml").read_text()).values()
    groups = [group["contains"] for group in node["ros__parameters"].values() if isinstance(group, dict)]
    names = [node.full_name for node in build_graph(rig=RIG, cameras=CONFIG / "camera")]
    for name in [*names, "/vmc_bridge", "/lsl_bridge", "/isb_angles"]:
        assert sum(any(part in name for part in parts) for parts in groups) == 1, name


# --- units and containers

EXAMPLES = ROOT / "docs" / "examples"
UNITS = sorted((EXAMPLES / "systemd").glob("*.service"))
PYTHON = "/opt/sagoma/.venv/bin/python"


def started_modules(text):
    return re.findall(r"-m[, ]+([\w.]+)", text)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_systemd_accepts_the_unit(unit, tmp_path):
    # the paths of an installation are not there: this interpreter, and no user of that name
    here = unit.read_text().replace(PYTHON, sys.executable).replace("User=sagoma\n", "")
    copy = tmp_path / unit.name.replace("@", "@cam01")
    copy.write_text(here)
    done = subprocess.run(["systemd-analyze", "verify", str(copy)], capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_unit_starts_a_program_of_ours_and_restarts_it_as_sagoma_up_does(unit):
    text = unit.read_text()
    (module,) = started_modules(text)
    assert importlib.util.find_spec(module) is not None
    restart = "Restart=on-failure RestartSec=1 StartLimitBurst=5 StartLimitIntervalSec=300 KillSignal=SIGINT"
    assert all(line in text for line in restart.split())


def test_containers_start_programs_of_ours_and_come_back_after_a_crash():
    services = yaml.safe_load((EXAMPLES / "compose.yaml").read_text())["services"]
    assert {"server", "cam01"} <= services.keys()
    for service in services.values():
        (module,) = started_modules(" ".join(service["command"]))
        assert importlib.util.find_spec(module) is not None
        assert service["restart"] == "on-failure:5" and service["stop_signal"] == "SIGINT"
        assert service["ipc"] == service["network_mode"] == "host"
        assert (EXAMPLES / service["build"] / "Dockerfile").is_file()


def test_image_is_set_up_where_the_services_look_for_it_and_without_this_checkout_s_builds():
    said = (ROOT / "Dockerfile").read_text()
    (folder,) = re.findall(r"^WORKDIR (\S+)", said, re.M)
    assert f"{folder}/.venv/bin/python" == PYTHON and "COPY . .\n" in said
    scripts = re.findall(r"&& (scripts/\S+)", said)
    assert scripts and all(os.access(ROOT / script, os.X_OK) for script in scripts)
    assert {".venv", ".git", "output"} <= set((ROOT / ".dockerignore").read_text().split())
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())
    assert (ROOT / ".devcontainer" / container["build"]["dockerfile"]).resolve() == ROOT / "Dockerfile"
