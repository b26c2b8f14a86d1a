"""How commands speak: progress after silence, plain text into files, words whole at any width."""

import io
import sys

import pytest
from rich.table import Table

from sagoma_tools.console import CommandConsole, command_console
from sagoma_tools.progress_line import LOG_EVERY_S, SILENT_S, ProgressLine, doing, until_stopped

ESCAPE = "\x1b"
PATH = "/a/path/that/is/longer/than/any/terminal/that/is/forty/columns/wide/overlay.png"


class Screen(io.StringIO):
    """A terminal."""

    def isatty(self):
        return True


@pytest.fixture()
def told(monkeypatch):
    """``told(stream)``: a progress line on a clock of the test, and that clock; it speaks when it is told to."""

    def make(stream, **options):
        clock = [100.0]
        monkeypatch.setattr("sagoma_tools.progress_line.SILENT_S", SILENT_S)
        monkeypatch.setattr("sagoma_tools.progress_line.REFRESH_S", 1e6)  # the thread sleeps
        monkeypatch.setattr(sys, "stdout", io.StringIO())
        monkeypatch.setattr(sys, "stderr", stream)
        return ProgressLine("sagoma evaluate", now_s=lambda: clock[0], **options), clock

    return make


def test_silence_of_three_seconds_is_broken_on_a_terminal_and_the_next_output_takes_the_line_away(told, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    line, clock = told(Screen())
    with line:
        done = doing("tracking frames", 400)
        done(100)
        clock[0] += SILENT_S - 0.1
        line.speak()
        assert sys.stderr.getvalue() == ""
        clock[0] += 0.2
        line.speak()
        assert sys.stderr.getvalue() == f"\r{ESCAPE}[Ktracking frames: 100 of 400 (25 %), 3 s"
        print("a result")
        assert sys.stderr.getvalue().endswith(f"\r{ESCAPE}[K")
        assert sys.stdout.getvalue() == "a result\n"


def test_the_line_on_a_terminal_is_never_wider_than_it(told, monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    line, clock = told(Screen())
    with line:
        doing("reading a bag with a very long name")
        clock[0] += SILENT_S
        line.speak()
        assert sys.stderr.getvalue() == f"\r{ESCAPE}[Kreading a bag with "


def test_a_log_gets_a_plain_line_every_ten_seconds(told):
    line, clock = told(io.StringIO())
    with line:
        clock[0] += SILENT_S
        line.speak()
        doing("reading the bag")
        for _ in range(int(2 * LOG_EVERY_S)):
            clock[0] += 1.0
            line.speak()
        said = sys.stderr.getvalue()
    assert said.splitlines() == ["sagoma evaluate ... 3 s", "reading the bag ... 10 s", "reading the bag ... 20 s"]
    assert ESCAPE not in said and "\r" not in said


def test_a_log_of_what_runs_until_it_is_stopped_stays_quiet(told):
    line, clock = told(io.StringIO(), endless=True)
    with line:
        clock[0] += 100.0
        line.speak()
        doing("starting 8 nodes")
        clock[0] += SILENT_S
        line.speak()
        until_stopped("running")
        clock[0] += 100.0
        line.speak()
        assert sys.stderr.getvalue() == "starting 8 nodes ... 3 s\n"


def test_steps_outside_a_command_say_nothing(capsys):
    doing("tracking", 3)(1)
    until_stopped("running")
    assert capsys.readouterr() == ("", "")


def wide_table() -> Table:
    table = Table("point", "RMSE mm", "mean", "median", "95 %", ">200 mm", "no offset", "in 95 %", "NEES")
    for name in ("left shoulder", "right shoulder"):
        table.add_row(name, "12.3", "11.2", "10.1", "22.2", "0.0 %", "9.9", "96 %", "2.2")
    return table


@pytest.mark.parametrize("width", [40, 80, 200])
def test_no_word_of_a_table_or_text_is_broken(width):
    console = CommandConsole(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    console.print(wide_table())
    console.print(f"picture: {PATH} [shown] at [{width}] columns, after which some more words follow")
    said = console.file.getvalue()
    words = {word.strip("│┃:") for word in said.split()}
    assert {"left", "shoulder", "RMSE", "NEES", "offset", PATH, "[shown]", f"[{width}]"} <= words
    assert all(len(line) <= width for line in said.splitlines() if PATH not in line)


def test_lines_into_a_file_are_plain_and_unbroken(monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    command_console().print(f"picture: {PATH} " + 30 * "and more ", style="bold red")
    assert sys.stdout.getvalue() == f"picture: {PATH} " + (30 * "and more ").rstrip() + "\n"


@pytest.mark.parametrize(("columns", "expected"), [("60", 60), ("", 150)])
def test_tables_in_a_file_are_as_wide_as_columns_says(monkeypatch, columns, expected):
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    assert command_console().width == expected


def test_no_color_is_honoured_on_a_terminal(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setattr(sys, "stdout", Screen())
    command_console().print("trouble", style="red")
    assert "31m" not in sys.stdout.getvalue() and "trouble" in sys.stdout.getvalue()
