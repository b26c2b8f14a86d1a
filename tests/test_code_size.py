"""The size of the tree against the budget in docs/figures/size.json, and how it is counted."""

import ast
import json

import measure_code


def test_the_tree_keeps_within_its_recorded_size():
    counts = measure_code.measure(measure_code.TREE)
    sizes = json.loads((measure_code.TREE / measure_code.BUDGET).read_text())
    assert {"product lines", "tuned constants", "settings", "test lines", "docs words"} <= set(sizes)
    over = measure_code.exceeded(counts, sizes)
    assert not over, f"{over}: make it smaller, or record what it is worth (scripts/measure_code.py --record)"


def test_growth_beyond_the_budget_is_named_and_recorded():
    sizes = {"settings": {"budget": 3, "aim": 2}, "test lines": {"budget": 10, "aim": 5}}
    counts = {"settings": 4, "test lines": 9}
    assert measure_code.exceeded(counts, sizes) == ["settings: 4, 1 over the budget of 3"]
    recorded = json.loads(measure_code.record(counts, sizes))
    assert recorded == {"settings": {"budget": 4, "aim": 2}, "test lines": {"budget": 9, "aim": 5}}
    assert measure_code.exceeded(counts, recorded) == []


def test_constants_are_numbers_with_a_fraction_that_follow_from_no_other():
    counted = "GATE = 0.5\nLOW: float = -1.5\nTILT = np.deg2rad(5)\nHALF = 1 / 12.0\n"
    others = "SIZE = 3\nTWICE = 2.0 * GATE\nNAME = 'a'\nON = True\nAXES = (0.5, 1.0)\nmean = 0.5\nSIGMA = sqrt(2.0)\n"
    assert list(measure_code.tuned_constants(ast.parse(counted + others))) == ["GATE", "LOW", "TILT", "HALF"]


def test_a_small_tree_is_counted(tmp_path):
    package = tmp_path / "src" / "walker" / "walker"
    package.mkdir(parents=True)
    text = "STEP_M = 0.7\nspeed: float = setting(1, 'm/s')\nloud: bool = setting(True, 'x')\n"
    (package / "gait.py").write_text(text)
    (tmp_path / "src/walker/test").mkdir()
    (tmp_path / "src/walker/test/test_gait.py").write_text("def test_gait(): ...\n")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/gait.md").write_text("How it walks.\n")
    counts = measure_code.measure(tmp_path)
    expected = {"product lines": 3, "product modules": 1, "tuned constants": 2, "settings": 2, "test lines": 1}
    assert {name: counts[name] for name in expected} == expected
    assert counts["docs words"] == 3 and counts["bench lines"] == 0 and counts["  walker constants"] == 1
