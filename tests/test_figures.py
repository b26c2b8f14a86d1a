"""Recorded figures: what a bench records, what pages take from it, what is older than its code; and the tree's size."""

import json
import os
import subprocess
import sys
from pathlib import Path

import measure_code
import pytest
from figures import Figures, main, pages_of, records_of

ROOT = Path(__file__).resolve().parents[1]
RECORD = {
    "command": "python bench/a.py --quick",
    "commit": None,
    "date": "2026-11-23 21:00",
    "machine": {"cores": 2, "load": 5.2},
    "figures": {"off_mm": 1.25},
    "tables": [[["way", "mm"], ["on", "1"]]],
}
PAGE = "<!-- figures: {} -->\nwhatever stood here\n<!-- /figures -->\n"
ROWS = """
tables: {all: [way], short: [way], printed: a_quick}
rows:
  way: {what: the way, figure: "{a_quick[off_mm]:.1f} mm", more: " (tried once)", measures: [walker]}
"""


def test_the_pages_say_what_the_records_say():
    figures = Figures(ROOT)
    differing = [page.name for page in pages_of(ROOT) if figures.rendered(page) != page.read_text(encoding="utf-8")]
    assert not differing, "run make figures"


def test_every_record_names_its_command_and_stands_in_a_row():
    figures = Figures(ROOT)
    rows, tables = figures.described["rows"], figures.described["tables"]
    used = {record for row in rows.values() for record in records_of(row["figure"] + row.get("more", ""))}
    lists = [table for table in tables.values() if isinstance(table, list)]
    assert used | {table for table in tables.values() if isinstance(table, str)} == set(figures.records)
    assert {name for table in lists for name in table} == set(rows)
    assert all({"command", "commit", "date", "figures"} <= set(record) for record in figures.records.values())
    assert all((ROOT / "src" / package / package).is_dir() for row in rows.values() for package in row["measures"])


@pytest.fixture
def tree(tmp_path):
    """A small tree under git with a record, its row and two pages."""
    for folder in ("docs/figures", "src/walker/walker"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "docs/figures/rows.yaml").write_text(ROWS)
    (tmp_path / "README.md").write_text(f"before\n{PAGE.format('short')}after\n")
    (tmp_path / "docs/long.md").write_text(PAGE.format("all") + PAGE.format("printed"))
    (tmp_path / "src/walker/walker/gait.py").write_text("STEP_M = 0.7\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "src")
    git(tmp_path, "commit", "-qm", "Walk")
    record(tmp_path, commit=git(tmp_path, "rev-parse", "HEAD"))
    return tmp_path


def git(tree, *words):
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    return subprocess.run(["git", *who, *words], cwd=tree, check=True, capture_output=True, text=True).stdout.strip()


def record(tree, **changed):
    (tree / "docs/figures/a_quick.json").write_text(json.dumps({**RECORD, **changed}))


def test_make_figures_fills_the_tables_and_a_page_that_says_something_else_is_named(tree, capsys):
    assert [main(tree, check=check) for check in (True, False, True)] == [1, 0, 0]
    rows = ["|---|---|---|", "| the way | 1.2 mm | `python bench/a.py --quick` |", "<!-- /figures -->", "after"]
    assert (tree / "README.md").read_text().splitlines()[3:] == rows
    commit, long = git(tree, "rev-parse", "HEAD"), (tree / "docs/long.md").read_text()
    assert f"| 1.2 mm (tried once) | `python bench/a.py --quick` | 2026-11-23, {commit[:7]}, load 5 |" in long
    assert "-->\n| way | mm |\n|---|---|\n| on | 1 |\n<!-- /figures -->" in long
    record(tree, figures={"text": "about a millimetre"}, commit=commit)
    capsys.readouterr()
    assert main(tree, check=True) == 1
    named = [f"{page}: differs from the records; run make figures" for page in ("README.md", "docs/long.md")]
    assert capsys.readouterr().out.splitlines() == named
    assert main(tree, check=False) == 0 and "| the way | about a millimetre |" in (tree / "README.md").read_text()


def test_a_row_is_stale_once_a_commit_has_changed_its_code_or_where_its_commit_is_unknown_or_dirty(tree):
    (tree / "README.md").write_text("another page\n")
    git(tree, "add", ".")
    git(tree, "commit", "-qm", "Page")
    head = git(tree, "rev-parse", "HEAD")
    assert Figures(tree).stale() == []
    for commit, said in ((None, "no commit"), ("0" * 40, "0000000"), (f"{head}-dirty", "with changes that no commit")):
        record(tree, commit=commit)
        assert [said in line for line in Figures(tree).stale()] == [True]
    record(tree, commit=head)
    (tree / "src/walker/walker/gait.py").write_text("STEP_M = 0.8\n")
    git(tree, "commit", "-qam", "Walk faster")
    (line,) = Figures(tree).stale()
    assert line.startswith("way: a_quick is of ") and line.endswith(git(tree, "rev-parse", "--short", "HEAD"))


BENCH = """
import json, sys
from pathlib import Path
import report
report.FIGURES = Path(sys.argv[1])

def bench():
    given = report.parser("A bench of nothing.", quick="nothing")
    given.add_argument("--hz")
    hz = given.parse_args().hz
    report.Table("way:<8 | off:>6.1f").row("there", 1.5)
    if hz != "0":
        report.finish({"off_mm": 1.5, "lost": float("nan")})

for sys.argv[1:] in ["--quick", "--record"], ["--record=way", "--hz", "60"], ["--record=refused", "--hz", "0"]:
    report.execute(bench)
"""


def test_record_keeps_figures_with_command_commit_and_machine_and_a_bench_without_figures_refuses_it(tmp_path):
    (tmp_path / "bench_of_nothing.py").write_text(BENCH)
    command = [sys.executable, str(tmp_path / "bench_of_nothing.py"), str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "bench"), *sys.path])}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    printed, head = done.stdout.splitlines(), git(ROOT, "rev-parse", "HEAD")
    kept_of = {path.stem: json.loads(path.read_text()) for path in tmp_path.glob("*.json")}
    words = {name: kept["command"].partition("bench_of_nothing.py ")[2] for name, kept in kept_of.items()}
    assert words == {"bench_of_nothing_quick": "--quick", "way": "--hz 60"}
    for kept in kept_of.values():
        assert kept["command"].startswith("python ")
        assert kept["figures"] == json.loads(printed[3]) == {"off_mm": 1.5, "lost": None}
        assert kept["tables"][-1] == [line.split() for line in printed[1:3]] == [["way", "off"], ["there", "1.5"]]
        assert (kept["commit"] or "").partition("-")[0] == head
        assert kept["machine"]["cores"] >= 1 and kept["machine"]["processor"]
    assert done.returncode == 2 and "without a line of JSON" in done.stderr


# --- the size of the tree, against the budget in docs/figures/size.json


def test_the_tree_keeps_within_its_recorded_size():
    counts = measure_code.measure(measure_code.TREE)
    sizes = json.loads((measure_code.TREE / measure_code.BUDGET).read_text())
    assert {"product lines", "tuned constants", "settings", "test lines", "docs words"} <= set(sizes)
    over = measure_code.exceeded(counts, sizes)
    assert not over, f"{over}: make it smaller, or record what it is worth (scripts/measure_code.py --record)"
