"""Every camera parameter file that we ship can be used as it is."""

from pathlib import Path

import pytest

from camera_client.configuration import load_camera
from camera_client.settings import CameraClientSettings
from capture_rig.settings import build_settings, leaves
from sagoma_bringup.graph import camera_from_file, rig_cameras
from sagoma_tools.doctor.cameras import read_file

ROOT = Path(__file__).resolve().parent.parent
LIVE = sorted((ROOT / "config" / "camera").glob("*.yaml"))
FOOTAGE = sorted((ROOT / "config" / "camera" / "footage").glob("*.yaml"))


@pytest.mark.parametrize("path", LIVE + FOOTAGE, ids=lambda path: f"{path.parent.name}_{path.stem}")
def test_parameter_file_has_only_known_parameters_with_possible_values(path):
    file = read_file(path)
    assert file.name == path.stem == file.settings.camera_name
    assert file.settings.source == ("aravis" if path in LIVE else "footage")


@pytest.mark.parametrize("path", LIVE, ids=lambda path: path.stem)
def test_camera_of_the_file_is_in_the_rig_that_it_names(path, monkeypatch):
    monkeypatch.chdir(ROOT)
    settings = read_file(path).settings
    assert load_camera(settings, settings.camera_name)[0].name == path.stem


def test_files_of_the_folder_serve_the_example_rig_with_an_address_each():
    nodes = rig_cameras(ROOT / "config" / "rig" / "ring4.yaml", ROOT / "config" / "camera")
    assert [node.label for node in nodes] == ["cam01", "cam02", "cam03", "cam04"]
    assert len({node.parameters["aravis.address"] for node in nodes}) == 4


def test_values_written_into_the_files_are_no_surprises():
    """What a file spells out and does not explain as a choice of this example is the default."""
    chosen = {
        "rig_file",
        "camera_name",
        "source",
        "background_file",
        "aravis.address",
        "aravis.exposure_us",
        "aravis.gain",
        "aravis.frame_rate",
    }
    defaults = {leaf.key: leaf.default for leaf in leaves(CameraClientSettings)}
    for path in LIVE:
        given = {key: value for key, value in camera_from_file(path).parameters.items() if key != "autostart"}
        build_settings(CameraClientSettings, given, str(path))
        assert {key for key, value in given.items() if value != defaults[key]} == chosen
