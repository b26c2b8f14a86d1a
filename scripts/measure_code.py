#!/usr/bin/env python3
"""Counts what a reviewer has to read: ``scripts/measure_code.py [ROOT ...]``, one column a source tree.

Product code is src/ without tests; functions that are used once are those whose name stands once besides their
definition in all product code; parameters are the leaves of the nodes' settings as `setting(...)` declares them.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from pathlib import Path

ARGUMENTS_AT_MOST = 9
IDENTIFIER = re.compile(r"[A-Za-z_]\w*")


def measure(root: Path) -> dict[str, int]:
    """The counts of one source tree, by name."""
    everything = [p for p in sorted((root / "src").rglob("*.py")) if "__pycache__" not in p.parts]
    tests = [p for p in everything if "test" in p.parts] + sorted((root / "tests").rglob("*.py"))
    product = [p for p in everything if "test" not in p.parts]
    texts = {path: path.read_text(encoding="utf-8") for path in product + tests}
    trees = {path: ast.parse(texts[path]) for path in product}
    names = Counter(word for path in product for word in IDENTIFIER.findall(texts[path]))
    functions = [
        f for t in trees.values() for f in ast.walk(t) if isinstance(f, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    calls = [c for t in trees.values() for c in ast.walk(t) if isinstance(c, ast.Call) and isinstance(c.func, ast.Name)]
    counts = {
        "product lines": sum(text.count("\n") for path, text in texts.items() if path in trees),
        "product modules": len(product),
        "... without __init__.py and setup.py": sum(path.name not in ("__init__.py", "setup.py") for path in product),
        "modules of at most 100 lines": sum(texts[path].count("\n") <= 100 for path in product),
        "functions": len(functions),
        "functions used once": sum(names[f.name] == 2 for f in functions if not f.name.startswith("__")),
        f"functions over {ARGUMENTS_AT_MOST} arguments": sum(_arguments(f) > ARGUMENTS_AT_MOST for f in functions),
        "settings declared": sum(call.func.id == "setting" for call in calls),  # type: ignore[attr-defined]
        "fmt: skip, off": sum(len(re.findall(r"# fmt: (?:skip|off)", text)) for text in texts.values()),
        "test lines": sum(texts[path].count("\n") for path in tests),
        "test functions": sum(len(re.findall(r"^\s*def test_", texts[path], re.M)) for path in tests),
    }
    for package in sorted({path.relative_to(root / "src").parts[0] for path in product}):
        mine = [path for path in product if path.relative_to(root / "src").parts[0] == package]
        counts[f"  {package} lines"] = sum(texts[path].count("\n") for path in mine)
        counts[f"  {package} modules"] = len(mine)
    return counts


def _arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    signature = function.args
    named = [a.arg for a in (*signature.posonlyargs, *signature.args, *signature.kwonlyargs)]
    return len([name for name in named if name not in ("self", "cls")])


def main(roots: list[str]) -> None:
    """Print the table."""
    columns = [measure(Path(root)) for root in roots or [str(Path(__file__).resolve().parent.parent)]]
    keys = list(dict.fromkeys(key for column in columns for key in column))
    for key in keys:
        print(f"{key:40s}" + "".join(f"{column.get(key, 0):10d}" for column in columns))


if __name__ == "__main__":
    main(sys.argv[1:])
