#!/usr/bin/env python3
"""Counts what a reviewer has to read: ``scripts/measure_code.py [ROOT ...] [--record]``, one column a source tree.

Beside the counts of this tree stand those that docs/figures/size.json allows (a test holds the tree to them) and those
that the project aims at. ``--record`` writes the counts of this tree into that file: growth is a decision, and the
commit that records it says what it buys.

Product code is src/ without tests. A tuned constant is a module-level name of capitals whose value is a number with a
fraction that follows from no other name (whole numbers are mostly sizes and indices), or the numeric default of a
setting; a setting is a ``setting(...)`` of the nodes' configuration.
"""

from __future__ import annotations

import argparse
import ast
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

TREE = Path(__file__).resolve().parent.parent
BUDGET = Path("docs/figures/size.json")
ARGUMENTS_AT_MOST = 9
IN_RADIANS = ("np.deg2rad", "np.radians", "math.radians")


def measure(root: Path) -> dict[str, int]:
    """Return the counts of one source tree, by name."""
    sources = {path: path.read_text(encoding="utf-8") for path in _python(root / "src")}
    product = {path: text for path, text in sources.items() if "test" not in path.parts}
    tests = [text for path, text in sources.items() if "test" in path.parts]
    tests += [path.read_text(encoding="utf-8") for path in _python(root / "tests")]
    trees = {path: ast.parse(text) for path, text in product.items()}
    constants = {path: len(list(tuned_constants(tree))) for path, tree in trees.items()}
    nodes = [node for path, tree in trees.items() if "setting(" in product[path] for node in ast.walk(tree)]
    settings = [node for node in nodes if _is_setting(node)]
    counts = {
        "product lines": _lines(product.values()),
        "product modules": len(product),
        "tuned constants": sum(constants.values()) + sum(_is_number(call.args[0], int, float) for call in settings),
        "settings": len(settings),
        "bench lines": _lines(path.read_text(encoding="utf-8") for path in _python(root / "bench")),
        "models lines": _lines(path.read_text(encoding="utf-8") for path in _python(root / "models")),
        "test lines": _lines(tests),
        "docs words": _words((root / "docs").rglob("*.md")),
        "README words": _words([root / "README.md", *(root / "src").glob("*/README.md")]),
        f"functions over {ARGUMENTS_AT_MOST} arguments": sum(
            _arguments(node) > ARGUMENTS_AT_MOST for tree in trees.values() for node in _functions(tree.body)
        ),
    }
    for package in sorted({path.relative_to(root / "src").parts[0] for path in product}):
        mine = {path: text for path, text in product.items() if path.relative_to(root / "src").parts[0] == package}
        counts[f"  {package} lines"] = _lines(mine.values())
        counts[f"  {package} modules"] = len(mine)
        counts[f"  {package} constants"] = sum(constants[path] for path in mine)
    return counts


def tuned_constants(tree: ast.Module) -> Iterator[str]:
    """Yield the names of a module's tuned constants (without the settings' defaults)."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets, value = [node.target], node.value
        else:
            continue
        yield from (t.id for t in targets if isinstance(t, ast.Name) and t.id.isupper() and _is_number(value, float))


def _is_number(value: ast.expr, *types: type) -> bool:
    """Whether a value is a literal number, one with a sign or unit, or arithmetic of such numbers."""
    if isinstance(value, ast.UnaryOp):
        return _is_number(value.operand, *types)
    if isinstance(value, ast.BinOp):
        return any(_is_number(side, *types) for side in (value.left, value.right)) and all(
            _is_number(side, int, float) for side in (value.left, value.right)
        )
    if isinstance(value, ast.Call):
        return ast.unparse(value.func) in IN_RADIANS and _is_number(value.args[0], int, float)
    return isinstance(value, ast.Constant) and type(value.value) in types


def _is_setting(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "setting"


def _functions(body: Iterable[ast.stmt]) -> Iterator[ast.FunctionDef]:
    """Yield the functions that stand in modules, classes and functions."""
    for node in body:
        if isinstance(node, ast.FunctionDef):
            yield node
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield from _functions(node.body)


def _python(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.rglob("*.py")) if "__pycache__" not in path.parts]


def _lines(texts: Iterable[str]) -> int:
    return sum(text.count("\n") for text in texts)


def _words(pages: Iterable[Path]) -> int:
    return sum(len(page.read_text(encoding="utf-8").split()) for page in pages if page.exists())


def _arguments(function: ast.FunctionDef) -> int:
    signature = function.args
    named = [a.arg for a in (*signature.posonlyargs, *signature.args, *signature.kwonlyargs)]
    return len([name for name in named if name not in ("self", "cls")])


def exceeded(counts: dict[str, int], sizes: dict[str, dict[str, int]]) -> list[str]:
    """Return a line for each count above its budget."""
    over = [(name, counts[name], size["budget"]) for name, size in sizes.items() if counts[name] > size["budget"]]
    return [f"{name}: {count}, {count - budget} over the budget of {budget}" for name, count, budget in over]


def record(counts: dict[str, int], sizes: dict[str, dict[str, int]]) -> str:
    """Return the text of the budget's file with these counts as the budgets."""
    lines = [f" {json.dumps(name)}: {json.dumps(size | {'budget': counts[name]})}" for name, size in sizes.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def main(roots: list[Path], keep: bool) -> None:
    """Print the table; with ``keep`` the first tree's counts become its budget."""
    columns = [measure(root) for root in roots]
    file = roots[0] / BUDGET
    sizes = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    print(f"{'':40s}" + "".join(f"{root.resolve().name[-9:]:>10s}" for root in roots) + "    budget       aim")
    for key in dict.fromkeys(key for column in columns for key in column):
        size = sizes.get(key, {})
        line = f"{key:40s}" + "".join(f"{column.get(key, 0):10d}" for column in columns)
        print((line + "".join(f"{size.get(part, ''):>10}" for part in ("budget", "aim"))).rstrip())
    for line in exceeded(columns[0], sizes):
        print(line)
    if keep:
        file.write_text(record(columns[0], sizes), encoding="utf-8")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("roots", nargs="*", type=Path, default=[TREE])
    arguments.add_argument("--record", action="store_true", help="make these counts the budget")
    given = arguments.parse_args()
    main(given.roots, given.record)
