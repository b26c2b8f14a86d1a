"""docs/parameters.md against the code: every parameter with its default and range, as the settings classes have it."""

from pathlib import Path

from reference import SETTINGS, with_lists

from capture_rig.settings import leaves

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "parameters.md").read_text(encoding="utf-8")


def test_the_lists_of_parameters_are_those_of_the_settings():
    assert with_lists(PAGE) == PAGE, "run python scripts/reference.py"
    assert all(f"\n- `{leaf.key}`" in PAGE for settings in SETTINGS.values() for leaf in leaves(settings))
