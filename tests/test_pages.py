"""The pages: the README's code is the pipeline's own, what pages name is there, lists are those of the code, and
commands are such as programs read: `sagoma`, `python bench/...` or models, `make`."""

import ast
import re
import shlex
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

from packaging.requirements import Requirement
from reference import SETTINGS, with_lists

from camera_client.background.causes import CAUSES
from capture_rig.settings import leaves
from sagoma_tools.cli import build_parser
from sagoma_tools.graph.topics import DIAGNOSTICS, OUTPUT_TOPICS, camera_topics

ROOT = Path(__file__).resolve().parent.parent
PAGE = "src/mocap_pipeline/mocap_pipeline/pipeline.py"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "src").glob("*/README.md"))]
DOCS = ROOT / "docs"
MOST_PAGES = 25
CODE, NAMING = ("src", "bench", "models", "scripts", "examples", "config"), (".py", ".sh", ".xml", ".yaml")


PROGRAM = r"\b(?:bench|models|scripts|tests|src/[a-z_]+/test|examples)/[\w/]+\.(?:py|sh)\b"
CONFIGURATION = r"\bconfig/[a-z0-9_./-]*[a-z0-9_](?![\w/])"  # CAMERA.yaml stands for any
FILE = re.compile(r"(?:\w+/)*\w+\.(?:py|c)")
OWN = re.compile(r"\w+(?:/|\.py)")


def read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_every_statement_of_the_readme_s_page_stands_in_the_pipeline_in_the_same_order():
    pipeline, (block,) = read(ROOT / PAGE), re.findall(r"```python\n(# segment.*?)```", read(ROOT / "README.md"), re.S)
    statements = [line.split("  #")[0].strip() for line in block.splitlines() if not line.startswith("#")]
    places = [pipeline.find(statement) for statement in statements]
    assert len(statements) >= 7
    assert -1 not in places and places == sorted(places)


def code_spans(text: str) -> list[str]:
    """What stands between backticks outside blocks, also across the end of a line."""
    return re.findall(r"`([^`\n]+)`", re.sub(r"(?<!\n)\n(?!\n) *", " ", BLOCK.sub("\n\n", text)))


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", read(page), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def wrong_links() -> Iterator[str]:
    """Links of pages that lead to no file, or to no heading of it."""
    for page in [*PAGES, ROOT / "CHANGELOG.md"]:
        for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", read(page)):
            place = page.parent / target if target else page
            if not target.startswith(("http:", "https:")) and not (
                place.exists() and (not anchor or anchor in anchors(place))
            ):
                yield f"{page.relative_to(ROOT)}: {target}#{anchor}"


def test_every_link_image_page_and_program_that_pages_and_code_name_is_there():
    assert not [*wrong_links()]
    listed = set(re.findall(r"\]\(([\w/-]+\.md)\)", read(DOCS / "index.md")))
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    assert listed == pages - {"index.md"} and len(pages) <= MOST_PAGES
    text = "".join(map(read, PAGES))
    assert not [image.name for image in (DOCS / "images").iterdir() if f"images/{image.name})" not in text]
    code = [path for folder in CODE for path in (ROOT / folder).rglob("*.*") if path.suffix in NAMING]
    named = {page for path in [ROOT / "Makefile", *code] for page in re.findall(r"\bdocs/[\w/-]+\.md\b", read(path))}
    programs = set(re.findall(PROGRAM, text))
    assert len(named) > 12 < len(programs)
    assert not [path for path in sorted(named | programs) if not (ROOT / path).exists()]


def names_in_vain() -> Iterator[str]:
    """What pages name and the tree lacks: files of config/, parts of paths of sources (``view/server.py``); of a
    package's README also its own files and folders (``pipeline.py``, ``carving/``)."""
    sources = [f"/{path.relative_to(ROOT)}" for folder in (*CODE, "tests") for path in (ROOT / folder).rglob("*.[cp]*")]
    for page in PAGES:
        text, package = read(page), page.parent
        spans = set(code_spans(text))
        vain = {name for name in re.findall(CONFIGURATION, text) if not (ROOT / name).exists()}
        if package.parent == ROOT / "src":
            own = {name for name in spans if OWN.fullmatch(name)}
            vain |= {name for name in own if not [*package.rglob(name)] and not (ROOT / name).is_dir()}
        named = {name for name in spans if FILE.fullmatch(name)}
        vain |= {name for name in named if not any(path.endswith(f"/{name}") for path in sources)}
        yield from (f"{page.relative_to(ROOT)}: {name}" for name in vain)


def test_every_source_configuration_and_folder_that_a_page_names_is_there():
    assert len(re.findall(CONFIGURATION, "".join(map(read, PAGES)))) > 10
    assert [*names_in_vain()] == []


# --- reference pages


def test_the_lists_of_parameters_are_those_of_the_settings():
    page = read(DOCS / "reference" / "parameters.md")
    assert with_lists(page) == page, "run python scripts/reference.py"
    assert all(f"\n- `{leaf.key}`" in page for settings in SETTINGS.values() for leaf in leaves(settings))


def test_every_topic_of_the_graph_stands_in_its_table_with_its_type_and_whether_it_is_latched():
    rows = [line.split("|") for line in read(DOCS / "reference" / "ros.md").splitlines() if line[:3] == "| `"]
    table = {name: (row[2].strip(), "latched" in row[-2]) for row in rows for name in re.findall(r"`(/[^`]+)`", row[1])}
    topics = (*OUTPUT_TOPICS, DIAGNOSTICS, *camera_topics("CAM"))
    expected = {topic.name: (topic.msgtype.replace("/msg/", "/"), topic.latched) for topic in topics}
    assert expected.items() <= table.items()


def test_every_cause_of_a_bad_silhouette_that_the_page_names_is_one_that_a_client_finds():
    section = read(DOCS / "how-to" / "silhouettes.md").partition("## Causes of bad silhouettes")[2]
    named = {code for row in re.findall(r"^\| (`.+?) \|", section, re.M) for code in re.findall(r"`(\w+\.\w+)`", row)}
    assert len(named) > 10
    assert named <= {cause.code for cause in CAUSES}


# --- licences: docs/reference/dependencies.md against requirements.txt


def licence(name: str) -> str:
    """What the installed package says of its licence: an SPDX expression, else classifiers, else a short text."""
    about = metadata(name)
    classes = [entry.rpartition("::")[2] for entry in about.get_all("Classifier", []) if entry.startswith("License")]
    return about.get("License-Expression") or "; ".join(classes) or (about.get("License") or "").partition("\n")[0]


def is_gpl(text: str) -> bool:
    """Is it a licence whose conditions a product under Apache-2.0 could not be given on by?"""
    return any(words in re.sub(r"lgpl|lesser general", "", text.lower()) for words in ("gpl", "general public"))


def with_their_own(names: set[str]) -> set[str]:
    """The installed packages among ``names``, and those that they need, directly or not."""
    found, open_names = set(), list(names)
    while open_names:
        name = open_names.pop()
        try:
            needs = metadata(name).get_all("Requires-Dist", [])
        except PackageNotFoundError:
            continue
        if name.lower() not in found:
            found.add(name.lower())
            wanted = map(Requirement, needs)
            open_names += [one.name for one in wanted if one.marker is None or one.marker.evaluate({"extra": ""})]
    return found


def test_every_requirement_has_a_row_with_its_licence_and_none_is_under_the_gpl():
    lines = [line.partition("#")[0] for line in read(ROOT / "requirements.txt").splitlines()]
    required = {Requirement(line).name.lower() for line in lines if line.strip()}
    rows = [line.strip("|").split("|") for line in read(DOCS / "reference" / "dependencies.md").splitlines()]
    listed = {
        name.strip().lower()
        for row in rows
        if len(row) == 4 and row[-1].strip()
        for name in re.sub(r"\(.*?\)", "", row[0]).split(",")
    }
    assert required - listed == set(), "give it a row in docs/reference/dependencies.md"
    said = {name: licence(name) for name in with_their_own(required)}
    assert len(said) > len(required)
    assert not {name: text for name, text in said.items() if is_gpl(text)}
    for text in ("GPL-3.0-or-later", " GNU General Public License v3 (GPLv3)", "GNU GENERAL PUBLIC LICENSE"):
        assert is_gpl(text) and not is_gpl(text.replace("GPL", "LGPL").lower().replace("general", "lesser general"))


# --- commands

PROGRAMS = [*sorted(ROOT.glob("bench/*.py")), *sorted(ROOT.glob("models/*.py"))]
GENERATED = {"commands.md"}  # from the parser itself
BLOCK = re.compile(r"^```[a-z]*\n(.*?)^```|((?:^    \S[^\n]*\n)+)", re.M | re.S)
SHORTENED = re.compile(r"\.\.\.|[|\[\]<>]")  # notation, not a command as it is typed


def commands_of(page: Path) -> Iterator[tuple[str, bool]]:
    """The commands of a page, and whether each stands in a block, to be typed as it is; else it is but named."""
    text = read(page)
    blocks = [block[1] or block[2] for block in BLOCK.finditer(text)]
    lines = [(line, True) for block in blocks for line in block.replace("\\\n", " ").split("\n")]
    lines += [(span, False) for span in code_spans(text)]
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


def test_every_sagoma_command_is_one_that_the_command_line_takes(capsys):
    commands, parser, refused = documented("sagoma "), build_parser(), []
    assert len(commands) > 100
    for page, command, typed in commands:
        if SHORTENED.search(command):
            continue
        try:
            parser.parse_args(shlex.split(command)[1:])
        except SystemExit as end:
            said = capsys.readouterr().err
            named_only = "are required" in said or "expected one argument" in said or "VERB" in command
            if end.code and (typed or not named_only):
                refused.append(f"{page}: {command}: {said.splitlines()[0]}")
    assert not refused


def test_every_option_of_a_bench_is_one_that_it_declares():
    shared = read(ROOT / "bench" / "report.py")
    commands, unknown = documented("python bench/") + documented("python models/"), []
    assert len(commands) > 20
    for page, command, _ in commands:
        script, *words = command.split()[1:]
        source = (ROOT / script).read_text(encoding="utf-8") + shared
        options = {word.partition("=")[0] for word in words if re.match(r"--[a-z]", word)}
        unknown += [f"{page}: {command}: {option}" for option in options if f'"{option}"' not in source]
    assert not unknown


def test_every_make_target_exists():
    targets = set(re.findall(r"^([a-z-]+):", read(ROOT / "Makefile"), re.M))
    named = {(page, command.split()[1]) for page, command, _ in documented("make ")}
    assert len(named) > 5
    assert not {(page, target) for page, target in named if target not in targets}


def names_of_ours(program: Path) -> Iterator[tuple[str, str]]:
    """The modules of ours, of benches too, that a program imports from, and the names."""
    ours = {path.name for path in (ROOT / "src").iterdir()} | {path.stem for path in PROGRAMS}
    for node in ast.walk(ast.parse(read(program))):
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
