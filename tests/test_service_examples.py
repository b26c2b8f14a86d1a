"""The examples of units and containers: systemd accepts them, and what they start is there."""

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

ROOT = Path(__file__).resolve().parents[1]
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
    lines = [
        "Restart=on-failure",
        "RestartSec=1",
        "StartLimitBurst=5",
        "StartLimitIntervalSec=300",
        "KillSignal=SIGINT",
    ]
    assert all(line in text for line in lines)


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
