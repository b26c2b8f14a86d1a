"""How commands speak: progress, plain text into files, words whole at any width."""

import io
import sys

import pytest

from sagoma_tools.console import CommandConsole, doing, plain_table, until_stopped

PATH = "/a/path/that/is/longer/than/any/terminal/that/is/forty/columns/wide/overlay.png"


class Screen(io.StringIO):
    """A terminal."""

    def isatty(self):
        return True


def terminal(monkeypatch):
    """Let stdout and stderr be one terminal; not a fixture, since pytest replaces both between set-up and test."""
    screen = Screen()
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setattr(sys, "stdout", screen)
    monkeypatch.setattr(sys, "stderr", screen)
    return screen


def test_progress_on_a_terminal_goes_when_it_is_over_and_output_stays_whole(monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    screen = terminal(monkeypatch)
    done = doing("tracking frames", 400)
    done(100)
    print(f"a result in {PATH}")
    until_stopped()
    shown = screen.getvalue()
    print("running")
    assert "tracking frames: 100 of 400 (25 %)" in shown and f"a result in {PATH}\n" in shown
    assert screen.getvalue() == f"{shown}running\n"


def test_output_into_a_file_stays_there_while_progress_is_shown(monkeypatch):
    screen = terminal(monkeypatch)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    doing("reading the bag")
    print('{"frames": 3}')
    assert sys.stdout.getvalue() == '{"frames": 3}\n'
    until_stopped()
    assert "reading the bag" in screen.getvalue() and "frames" not in screen.getvalue()


@pytest.mark.parametrize("width", [40, 80, 200])
def test_no_word_of_a_table_or_text_is_broken(width):
    table = plain_table("errors", ["point"], ["RMSE mm", "median", "95 %", ">200 mm", "no offset", "NEES"])
    table.add_row("left shoulder", "12.3", "10.1", "22.2", "0.0 %", "9.9", "2.2")
    console = CommandConsole(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    console.print(table)
    console.print(f"picture: {PATH} [shown] at [{width}] columns, after which some more words follow")
    title, _, row, *text = console.file.getvalue().splitlines()
    assert title.strip() == "errors" and " ".join(row.split()) == "left shoulder 12.3 10.1 22.2 0.0 % 9.9 2.2"
    assert {PATH, "[shown]", f"[{width}]"} <= set(" ".join(text).split())
    assert all(len(line) <= width for line in text if PATH not in line)


def test_lines_into_a_file_are_plain_and_unbroken(monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    CommandConsole().print(f"picture: {PATH}" + 30 * " and more", style="bold red")
    assert sys.stdout.getvalue() == f"picture: {PATH}" + 30 * " and more" + "\n"
