"""The commands that the documentation names, as the programs read them: `sagoma`, `python bench/...`, `make`."""

import ast
import importlib.util
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from sagoma_tools.cli import build_parser

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "src").glob("*/README.md"))]
GENERATED = {"commands.md"}  # from the parser itself
BLOCK = re.compile(r"^```[a-z]*\n(.*?)^```|((?:^    \S.*\n)+)", re.M | re.S)
SHORTENED = re.compile(r"\.\.\.|[|\[\]<>]")  # notation, not a command as it is typed


def commands_of(page: Path) -> Iterator[tuple[str, bool]]:
    """The commands of a page, and whether each stands in a block, to be typed as it is; else it is but named."""
    text = page.read_text(encoding="utf-8")
    blocks = [block[1] or block[2] for block in BLOCK.finditer(text)]
    lines = [(line, True) for block in blocks for line in block.replace("\\\n", " ").split("\n")]
    lines += [(span, False) for span in re.findall(r"`([^`\n]+)`", BLOCK.sub("", text))]
    for line, typed in lines:
        for command in re.split(r";|&&", re.split(r"(?:^|\s)# ", line.strip())[0]):
            yield command.strip(), typed


def documented(beginning: str) -> list[tuple[str, str, bool]]:
    """Page, command, and whether it stands in a block, of all commands with this beginning."""
    return [
        (page.name, command, typed)
        for page in PAGES
        if page.name not in GENERATED
        for command, typed in commands_of(page)
        if command.startswith(beginning)
    ]


@cache
def parser():
    return build_parser()


def test_every_sagoma_command_is_one_that_the_command_line_takes(capsys):
    commands, refused = documented("sagoma "), []
    assert len(commands) > 100
    for page, command, typed in commands:
        if SHORTENED.search(command):
            continue
        try:
            parser().parse_args(shlex.split(command)[1:])
        except SystemExit as end:
            said = capsys.readouterr().err
            named_only = "are required" in said or "expected one argument" in said or "VERB" in command
            if end.code and (typed or not named_only):
                refused.append(f"{page}: {command}: {said.splitlines()[0]}")
    assert not refused


def test_every_option_of_a_bench_is_one_that_it_declares():
    shared = (ROOT / "bench" / "report.py").read_text(encoding="utf-8")
    commands, unknown = documented("python bench/"), []
    assert len(commands) > 20
    for page, command, _ in commands:
        script, *words = command.split()[1:]
        source = (ROOT / script).read_text(encoding="utf-8") + shared
        options = {word.partition("=")[0] for word in words if re.match(r"--[a-z]", word)}
        unknown += [f"{page}: {command}: {option}" for option in options if f'"{option}"' not in source]
    assert not unknown


def test_every_make_target_exists():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    named = {(page, command.split()[1]) for page, command, _ in documented("make ")}
    assert len(named) > 5
    assert not {(page, target) for page, target in named if target not in targets}


@pytest.mark.parametrize("bench", sorted((ROOT / "bench").glob("*.py")), ids=lambda path: path.stem)
def test_what_a_bench_imports_of_the_packages_is_there(bench):
    packages = {path.name for path in (ROOT / "src").iterdir()}
    missing = []
    for node in ast.walk(ast.parse(bench.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in packages:
            if importlib.util.find_spec(node.module) is None:
                missing.append(node.module)
                continue
            module = importlib.import_module(node.module)
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                if not hasattr(module, alias.name) and importlib.util.find_spec(submodule) is None:
                    missing.append(submodule)
    assert missing == []
