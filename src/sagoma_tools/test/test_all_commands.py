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
RING4 = ROOT / "config" / "rig" / "ring4.yaml"
PARSER = build_parser()
EVERY = sorted(name for name, _, _ in commands_of(PARSER))


def test_the_tables_name_every_command_and_no_other():
    assert set(HELP) < set(EVERY)
    assert {name.split()[0] for name in EVERY} == {one for commands in COMMANDS.values() for one in commands}


def test_the_page_of_commands_is_printed_from_the_table():
    remedy = "run: python scripts/commands_page.py > docs/reference/commands.md"
    assert (ROOT / "docs" / "reference" / "commands.md").read_text() == commands_page.page(PARSER), remedy


@pytest.mark.parametrize("name", EVERY)
def test_help_has_what_the_command_does_statuses_and_examples_that_can_be_given(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as ended:
        main([*name.split(), "--help"])
    said = capsys.readouterr().out
    assert ended.value.code == 0 and f"usage: sagoma {name}" in said and "\nexit status: 0 " in said
    sentence = next(block for block in said.split("\n\n")[1:] if block)
    assert len(sentence.split()) > 2 and sentence[0].isupper() and sentence[-1] in ".?"
    others = [line for line in said.splitlines() if not line.startswith("  sagoma ")]
    assert all(len(line) <= 80 or " " not in line.strip() for line in others)
    for example in HELP[name].examples if name in HELP else ():
        assert f"  sagoma {example}\n" in said and PARSER.parse_args(shlex.split(example)).command == name


@pytest.mark.parametrize("name", ["demo", "takes verify", "studio"])
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


OF_NOTHING_OR_BROKEN = [
    "demo --session FOLDER",
    "calibrate board FILE",
    "calibrate intrinsics FILE --board 'checkerboard 9x6 25mm'",
    "calibrate extrinsics --intrinsics FILE --floor FILE --board 'checkerboard 9x6 25mm'",
    "background show FILE",
    "background --from-footage FILE",
    "up FOLDER",
    "up --rig FILE",
    "up --rig RIG --cameras FILE",
    "studio --session FOLDER",
    "record bag --rig FILE",
    "replay FOLDER",
    "compare FOLDER FOLDER",
    "takes verify FOLDER",
    "takes video FOLDER",
    "smooth FOLDER",
    "view FOLDER",
    "evaluate FOLDER",
    "export FOLDER",
    "urdf --body FILE",
    "doctor --no-machine --rig FILE",
    "doctor --no-machine --camera FILE",
]
OF_NOTHING = [
    "recover FOLDER",
    "takes show FOLDER",
    "takes rename FOLDER there",
    "takes trim FOLDER there",
    "takes delete FOLDER",
    "takes restore FOLDER",
    "takes measure FOLDER",
    "import humaneva FOLDER there --subject S2 --action Walking",
    "import biocv FOLDER there",
]


@pytest.mark.parametrize(
    ("line", "name"),
    [(line, "nowhere") for line in OF_NOTHING_OR_BROKEN + OF_NOTHING]
    + [(line, "broken") for line in OF_NOTHING_OR_BROKEN],
)
def test_what_is_missing_or_broken_is_named_with_a_remedy(line, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken").mkdir()
    for broken in ("broken.yaml", *(f"broken/{file}" for file in ("rig.yaml", "metadata.yaml", "a.mcap"))):
        (tmp_path / broken).write_bytes(b"\x00\xffno such thing: [")
    for word, value in (("FOLDER", name), ("FILE", f"{name}.yaml"), ("RIG", str(RING4))):
        line = line.replace(word, value)
    status = main(shlex.split(line))
    said = capsys.readouterr()
    expected = (1, BAD_INPUT) if "takes" in line else (BAD_INPUT,)
    assert status in expected, said
    assert "Traceback" not in said.err + said.out
    assert name in said.err + said.out, said
    if "doctor" not in line and "takes" not in line:
        assert said.err.startswith("sagoma: ")


EXTRINSICS = "calibrate extrinsics --intrinsics none --board 'checkerboard 7x4 120mm' "
INTRINSICS = "calibrate intrinsics --board 'checkerboard 9x6 100mm' "


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("replay bag --graph --lockstep", "--graph and --output belong together"),
        ("replay bag --output out", "--graph and --output belong together"),
        ("replay bag --graph --output out", "with --lockstep"),
        (f"replay {'x' * 5000}", "there is no such bag"),
        ("record bag --namespace 'my studio'", "--namespace"),
        ("background --wait 0.3", "found 0 camera clients"),
        (f"up --rig {RING4} --set hull_server.voxel_size_m=[1", "--set hull_server.voxel_size_m: is not"),
        (f"up --rig {RING4} --set hull_server.voxel_size_m", "'hull_server.voxel_size_m' has no value"),
        ("studio set gain=[1", "sagoma studio: gain: is not valid YAML"),
        *((f"view --host '{host}'", f"--host: cannot listen on '{host}'") for host in ("", "203.0.113.7", "a" * 100)),
        (INTRINSICS, "give either footage or --topic"),
        (INTRINSICS + "somewhere --topic /cam01/image_raw", "give either footage or --topic"),
        (EXTRINSICS, "no pictures are given"),
        (EXTRINSICS + "--floor-points points.yaml --floor floor", "both give the floor"),
        (EXTRINSICS + "--floor floor --floor-at 12", "other pictures show the floor"),
        (EXTRINSICS + "--moving moving --floor-at soon", "'soon' is no frame"),
        (EXTRINSICS + "--floor floor --origin there", "--origin: 'there' cannot be read"),
        (EXTRINSICS + "--floor floor --check cam01 cam02 far", "--check: 'far' cannot be read"),
        (EXTRINSICS + "--floor floor --check cam01 cam02 1e300", "--check: '1e300' cannot be read"),
        (EXTRINSICS + "--wand wand", "the wand's markers are not given"),
        (EXTRINSICS + "--moving", "--moving: no footage is given"),
        (EXTRINSICS + "--live --floor floor", "pictures come from the cameras"),
    ],
)
def test_arguments_that_mean_nothing_or_contradict_each_other_are_refused(line, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(line)) == BAD_INPUT
    said = capsys.readouterr().err
    assert said.startswith("sagoma: ") and words in said and not list(tmp_path.iterdir())


def test_the_output_may_end_at_head():
    command = f"{shlex.quote(sys.executable)} -m sagoma_tools.cli takes --help | head -1"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, env={**os.environ, "COLUMNS": "20"}
    )
    assert done.stdout.startswith("usage: sagoma") and done.stderr == ""
