"""The commands that the documentation names, as programs read them: `sagoma`, `python bench/...` or models, `make`."""

import ast
import re
import shlex
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

from sagoma_tools.cli import build_parser

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = [*sorted(ROOT.glob("bench/*.py")), *sorted(ROOT.glob("models/*.py"))]
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
    commands, unknown = documented("python bench/") + documented("python models/"), []
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


def names_of_ours(program: Path) -> Iterator[tuple[str, str]]:
    """The modules of ours, of benches too, that a program imports from, and the names."""
    ours = {path.name for path in (ROOT / "src").iterdir()} | {path.stem for path in PROGRAMS}
    for node in ast.walk(ast.parse(program.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] in ours:
            yield from ((node.module, alias.name) for alias in node.names)


def test_what_benches_and_models_import_of_ours_is_there_and_models_import_no_bench(monkeypatch):
    wrong = []
    for folder in ("bench", "models"):
        monkeypatch.syspath_prepend(ROOT / folder)
    for program in PROGRAMS:
        for module, name in names_of_ours(program):
            try:
                there = hasattr(import_module(module), name) or import_module(f"{module}.{name}")
            except ImportError:
                there = False
            if not there or (program.parent.name == "models" and (ROOT / "bench" / f"{module}.py").is_file()):
                wrong.append(f"{program.name}: {module}.{name}")
    assert wrong == []
