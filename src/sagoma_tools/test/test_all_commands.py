"""What every command keeps to: help, examples, exit statuses, and no traceback for what a user can cause."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import commands_page
import pytest

from sagoma_tools import cli
from sagoma_tools.cli import COMMANDS, build_parser, main
from sagoma_tools.console import BAD_INPUT, HELP, INTERRUPTED, NO_READER, commands_of

ROOT = Path(__file__).resolve().parents[3]
EVERY = sorted(HELP)


@pytest.fixture(scope="module")
def parser():
    return build_parser()


def test_the_table_of_help_names_every_command_and_no_other(parser):
    assert sorted(name for name, _, _ in commands_of(parser)) == EVERY
    assert {name.split()[0] for name in EVERY} == {one for commands in COMMANDS.values() for one in commands}


def test_the_page_of_commands_is_printed_from_the_table(parser):
    remedy = "run: python scripts/commands_page.py > docs/commands.md"
    assert (ROOT / "docs" / "commands.md").read_text() == commands_page.page(parser), remedy


@pytest.mark.parametrize("name", EVERY)
def test_help_has_what_the_command_does_examples_and_statuses(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as ended:
        main([*name.split(), "--help"])
    said = capsys.readouterr().out
    assert ended.value.code == 0
    others = said.splitlines()
    sentence = next(block for block in said.split("\n\n")[1:] if block)
    assert len(sentence.split()) > 2 and sentence[0].isupper() and sentence[-1] in ".?"
    assert f"usage: sagoma {name}" in said and "examples:" in said
    (status,) = [line for line in others if line.startswith("exit status: 0 ")]
    assert status
    examples = said[said.index("examples:") :].splitlines()
    assert all(len(line) <= 80 or line in examples or " " not in line.strip() for line in others)


@pytest.mark.parametrize("name", EVERY)
def test_every_example_can_be_given(name, parser):
    for example in HELP[name].examples:
        assert parser.parse_args(shlex.split(example)).command == name


@pytest.mark.parametrize("name", ["demo", "takes list", "studio"])
def test_an_unknown_option_is_named_with_where_to_look(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([*shlex.split(HELP[name].examples[0]), "--no-such-option"])
    said = capsys.readouterr().err
    assert ended.value.code == BAD_INPUT
    assert "--no-such-option" in said and said.startswith("sagoma: ") and said.count("\n") == 1
    assert f"See `sagoma {name} --help`" in said


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [(KeyboardInterrupt, INTERRUPTED, "sagoma: interrupted\n"), (BrokenPipeError, NO_READER, "")],
)
def test_ctrl_c_and_a_reader_that_goes_away_end_a_command_without_a_traceback(error, status, said, capsys, monkeypatch):
    def run(argv):
        raise error

    monkeypatch.setattr(cli, "run", run)
    monkeypatch.setattr(cli, "_drop_output", lambda: None)
    assert main(["replay", "bag"]) == status
    assert capsys.readouterr().err == said


NOT_THERE = [
    "demo --session nowhere",
    "calibrate board nowhere.yaml",
    "calibrate intrinsics nowhere --board 'checkerboard 9x6 25mm'",
    "calibrate extrinsics --intrinsics nowhere --floor nowhere --board 'checkerboard 9x6 25mm'",
    "background show nowhere.npz",
    "up nowhere",
    "up --rig nowhere.yaml",
    "up --rig RIG --cameras nowhere",
    "studio --session nowhere",
    "record bag --rig nowhere.yaml",
    "replay nowhere",
    "compare nowhere nowhere",
    "recover nowhere",
    "takes show nowhere",
    "takes verify nowhere",
    "takes rename nowhere there",
    "takes trim nowhere there",
    "takes video nowhere",
    "takes delete nowhere",
    "takes restore nowhere",
    "takes measure nowhere",
    "smooth nowhere",
    "view nowhere",
    "evaluate nowhere",
    "export nowhere",
    "import humaneva nowhere there --subject S2 --action Walking",
    "import biocv nowhere there",
    "urdf --body nowhere.yaml",
    "doctor --no-machine --rig nowhere.yaml",
]
BROKEN = [
    "demo --session BROKEN_FOLDER",
    "calibrate board BROKEN",
    "calibrate intrinsics BROKEN --board 'checkerboard 9x6 25mm'",
    "calibrate extrinsics --intrinsics BROKEN --floor BROKEN --board 'checkerboard 9x6 25mm'",
    "background show BROKEN",
    "up BROKEN_FOLDER",
    "up --rig BROKEN",
    "up --rig RIG --cameras BROKEN",
    "studio --session BROKEN_FOLDER",
    "record bag --rig BROKEN",
    "replay BROKEN_FOLDER",
    "compare BROKEN_FOLDER BROKEN_FOLDER",
    "takes verify BROKEN_FOLDER",
    "takes video BROKEN_FOLDER",
    "smooth BROKEN_FOLDER",
    "view BROKEN_FOLDER",
    "evaluate BROKEN_FOLDER",
    "export BROKEN_FOLDER",
    "urdf --body BROKEN",
    "doctor --no-machine --rig BROKEN",
]


@pytest.mark.parametrize("line", NOT_THERE + BROKEN)
def test_what_is_missing_or_broken_is_named_with_a_remedy(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "broken_folder"
    folder.mkdir()
    for name in ("broken.yaml", *(f"broken_folder/{name}" for name in ("rig.yaml", "metadata.yaml", "a.mcap"))):
        (tmp_path / name).write_bytes(b"\x00\xffno such thing: [")
    rig = ROOT / "config" / "rig" / "ring4.yaml"
    for word, value in (("BROKEN_FOLDER", "broken_folder"), ("BROKEN", "broken.yaml"), ("RIG", str(rig))):
        line = line.replace(word, value)
    status = main(shlex.split(line))
    said = capsys.readouterr()
    expected = (1, BAD_INPUT) if "takes" in line else (BAD_INPUT,)
    assert status in expected, said
    assert "Traceback" not in said.err + said.out
    assert any(word in said.err + said.out for word in ("nowhere", "broken")), said
    if "doctor" not in line and "takes" not in line:
        assert said.err.startswith("sagoma: ")


def test_the_output_may_end_at_head():
    command = f"{shlex.quote(sys.executable)} -m sagoma_tools.cli takes --help | head -1"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, env={**os.environ, "COLUMNS": "20"}
    )
    assert done.stdout.startswith("usage: sagoma") and done.stderr == ""
