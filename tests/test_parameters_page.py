"""docs/parameters.md against the code: its parameters, its constants and its benches exist."""

import ast
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
from reference import SETTINGS, with_tables

from capture_rig.settings import leaves

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "parameters.md").read_text()


class Row(NamedTuple):
    node: str
    cells: list[str]


def rows_under(heading):
    """The rows of the table under a heading; an empty first cell is that of the row above."""
    section = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", PAGE, re.M | re.S)
    assert section, f"docs/parameters.md has no section '{heading}'"
    rows, node = [], ""
    for line in section[1].splitlines():
        if line.startswith("|") and not line.startswith("|---"):
            first, *cells = [cell.strip() for cell in line[1:-1].split("|")]
            node = first or node
            rows.append(Row(node, cells))
    return rows[1:]


def quoted(text):
    return re.findall(r"`([^`]+)`", text)


THRESHOLDS = rows_under("Thresholds that are constants")


@cache
def constants_of(path):
    """Names that are assigned at the module's level."""
    names = set()
    for statement in ast.parse((ROOT / "src" / path.split("/")[0] / path).read_text()).body:
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        names |= {name.id for target in targets if target for name in ast.walk(target) if isinstance(name, ast.Name)}
    return names


def constants_and_files(text):
    names = quoted(text)
    return [n for n in names if re.fullmatch(r"_?[A-Z][A-Z0-9_]*", n)], [n for n in names if n.endswith(".py")]


@pytest.mark.parametrize("row", THRESHOLDS, ids=lambda row: row.node)
def test_thresholds_are_constants_of_their_files(row):
    constants, files = constants_and_files(f"{row.node} {row.cells[0]}")
    assert constants and files
    assert [c for c in constants if not any(c in constants_of(file) for file in files)] == []
    assert [file for file in files if not constants_of(file) & set(constants)] == []


@pytest.mark.parametrize("row", THRESHOLDS, ids=lambda row: row.node)
def test_every_threshold_says_what_chose_it(row):
    reason = row.cells[2]
    assert re.search(r"\bfrom\b|(chosen|measured|fitted) (with|by|to)|judgement; no bench", reason)
    if "with `python" in reason or "measured by" in reason:
        assert "bench/" in reason
    mentioned, _ = constants_and_files(reason)
    assert set(mentioned) <= set(quoted(row.cells[0]))


@pytest.mark.parametrize("bench", sorted(set(re.findall(r"bench/\w+\.py", PAGE))))
def test_benches_can_be_run(bench):
    assert '__name__ == "__main__"' in (ROOT / bench).read_text()


@pytest.mark.parametrize("test", sorted(set(re.findall(r"test_\w+\.py", PAGE))))
def test_named_tests_exist(test):
    assert [*ROOT.glob(f"src/*/test/{test}"), *ROOT.glob(f"tests/{test}")]


def test_the_tables_of_parameters_are_those_of_the_settings():
    assert with_tables(PAGE) == PAGE, "run python scripts/reference.py"
    assert all(f"| `{leaf.key}` |" in PAGE for settings in SETTINGS.values() for leaf in leaves(settings))
