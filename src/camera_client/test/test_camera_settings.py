"""The settings of today, and parameter files of former versions."""

from pathlib import Path

import yaml

from camera_client.settings import CameraClientSettings
from capture_rig.settings import build_settings, leaves, resolve_renamed

OLD = Path(__file__).parent / "data" / "parameters_0_1.yaml"


def old_parameters():
    return yaml.safe_load(OLD.read_text())["/cam01/camera_client"]["ros__parameters"]


def test_parameter_file_of_version_0_1_is_read_with_a_warning_for_every_name_that_has_gone(caplog):
    settings = build_settings(CameraClientSettings, old_parameters(), "cam01.yaml")
    assert (settings.camera_name, settings.silhouette.closing, settings.silhouette.outline_contrast) == (
        "cam01",
        0.01,
        0.2,
    )
    gone = {*CameraClientSettings.renamed, *CameraClientSettings.removed}
    assert len(caplog.records) == len(gone)
    assert all(any(f"'{name}'" in record.getMessage() for record in caplog.records) for name in gone)


def test_names_of_version_0_1_lead_to_settings_of_today():
    flat, _ = resolve_renamed(CameraClientSettings, old_parameters())
    assert set(flat) <= {leaf.key for leaf in leaves(CameraClientSettings)}


def test_no_setting_of_today_has_the_name_of_one_that_was_renamed_or_removed():
    today = {leaf.key for leaf in leaves(CameraClientSettings)}
    assert not today & {*CameraClientSettings.renamed, *CameraClientSettings.removed}
