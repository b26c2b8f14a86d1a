"""The console that commands print to: words whole at any width, plain text into files, colours unless NO_COLOR."""

from __future__ import annotations

import argparse
import atexit
import shutil
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn

from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from capture_rig.verdict import GOOD, REDO, USABLE

GRADE_STYLE = {GOOD: "green", USABLE: "yellow", REDO: "red"}
WIDEST = 10_000  # characters of a table's row


class CommandConsole(Console):
    """A rich console that breaks no word: paths stay whole, and a row of a table is one line, however long.

    Into a file, lines of text are not broken at all, so that grep finds them.
    """

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does, by default without markup and highlighting, as paths hold brackets, too."""
        if len(objects) == 1 and isinstance(objects[0], str | Text):
            markup, highlight = options.pop("markup", False), options.pop("highlight", False)
            text = objects[0]
            objects = (self.render_str(text, markup=markup, highlight=highlight) if isinstance(text, str) else text,)
            options = {"overflow": "ignore", "crop": False, "soft_wrap": not self.is_terminal, **options}
        for table in (one for one in objects if isinstance(one, Table)):
            table.width = Measurement.get(self, self.options.update(max_width=WIDEST), table).maximum
            options["crop"] = False
        super().print(*objects, **options)


def plain_table(title: str, left: Sequence[str], right: Sequence[str], texts: Sequence[str] = ()) -> Table:
    """Return a table without lines: columns of words, columns of numbers, columns of sentences."""
    table = Table(title=title or None, title_justify="left", box=None, pad_edge=False)
    for name in left:
        table.add_column(name, no_wrap=True)
    for name in right:
        table.add_column(name, justify="right", no_wrap=True)
    for name in texts:
        table.add_column(name)
    return table


# progress -------------------------------------------------------------------------------------------------------------


_lock = threading.RLock()
_shown: list[Progress] = []  # that of the present step, on a terminal


def doing(what: str, total: int | None = None) -> Callable[..., None]:
    """Show the present step ("tracking frames") on a terminal; the returned function updates it with the number done of
    ``total``, or a text, and, where it was not known before, with the total."""
    console = Console(stderr=True, soft_wrap=True)  # other output passes through it unchanged
    columns = TextColumn("{task.description}{task.fields[done]}", markup=False), BarColumn(), TimeElapsedColumn()
    progress = Progress(*columns, console=console, transient=True, redirect_stdout=sys.stdout.isatty())
    task = progress.add_task(what, total=total, done="")
    with _lock:
        until_stopped()
        if console.is_terminal:
            progress.start()
            _shown.append(progress)

    def update(done: int | str, total: int | None = None) -> None:
        if isinstance(done, str):
            progress.update(task, done=f": {done}")
            return
        whole = total or progress.tasks[0].total
        share = f" of {whole:.0f} ({100 * done / whole:.0f} %)" if whole else ""
        progress.update(task, completed=done, total=total, done=f": {done}{share}")

    return update


@atexit.register
def until_stopped() -> None:
    """End the present step: from here on the command runs until somebody stops it, and shows no progress."""
    with _lock:
        while _shown:
            _shown.pop().stop()


# help -----------------------------------------------------------------------------------------------------------------


OK, FAILED, BAD_INPUT, INTERRUPTED, NO_READER = 0, 1, 2, 130, 141
STATUSES = {
    OK: "done",
    FAILED: "the graph failed, or what was asked for was not reached",
    BAD_INPUT: "input or arguments cannot be used; the message says what, where and the remedy",
    INTERRUPTED: "interrupted by Ctrl-C (128 + SIGINT)",
    NO_READER: "whoever read the output went away, as `head` does (128 + SIGPIPE)",
}
ENDED = "ended by Ctrl-C, SIGTERM or --seconds, in order"


class CommandHelp(NamedTuple):
    """Examples of one command, if its usage is not enough; statuses with a meaning of their own."""

    examples: tuple[str, ...] = ()
    statuses: Mapping[int, str] = MappingProxyType({})


SESSION, RIG, TAKE, BOARD = "my_session", "rig.yaml", "output/takes/walk1", "'checkerboard 9x6 25mm'"
HELP: Mapping[str, CommandHelp] = {
    "demo": CommandHelp(
        ("demo", f"demo --session {SESSION}", "demo --rate 0"),
        {FAILED: "the capture is not sound: too few frame sets answered, or nobody tracked; the last lines say why"},
    ),
    "calibrate board": CommandHelp((f"calibrate board {BOARD} --output board.pdf",)),
    "calibrate intrinsics": CommandHelp(
        (f"calibrate intrinsics footage/ --board {BOARD}",), {FAILED: "a camera has to be done again"}
    ),
    "calibrate extrinsics": CommandHelp(
        (f"calibrate extrinsics --intrinsics output/intrinsics --floor floor/ --moving moving/ --board {BOARD}",),
        {FAILED: "the verdict is redo"},
    ),
    "background": CommandHelp(
        ("background", "background --cameras cam01 cam03 --countdown 20"),
        {FAILED: "a camera is only usable", BAD_INPUT: "a camera has to be done again, or did not answer"},
    ),
    "up": CommandHelp(
        (f"up {SESSION}", f"up --rig {RIG} --cameras config/camera --view", f"up {SESSION} --rate 0 --record {TAKE}"),
        {OK: ENDED, FAILED: "the graph did not start, or a node did not end in order"},
    ),
    "start": CommandHelp(("start --expect 8",), {FAILED: "a node refused, or did not answer"}),
    "suspend": CommandHelp(("suspend",), {FAILED: "a node refused, or did not answer"}),
    "stop": CommandHelp(("stop",), {FAILED: "a node refused, or did not answer"}),
    "studio": CommandHelp(("studio --write output/studio", "studio status"), {OK: ENDED}),
    "record": CommandHelp(
        (f"record {TAKE} --rig {RIG}",), {OK: ENDED, FAILED: "the recording could not be kept whole"}
    ),
    "replay": CommandHelp(
        (f"replay {TAKE} --rate 0.5", f"replay {TAKE} --graph --lockstep --output output/again"),
        {FAILED: "in lockstep: a frame set was not answered"},
    ),
    "compare": CommandHelp((f"compare {TAKE} output/again",), {FAILED: "the bags differ"}),
    "takes show": CommandHelp(("takes show walk1",), {FAILED: "the take cannot be read"}),
    "takes verify": CommandHelp(("takes verify walk1",), {FAILED: "a check found an error"}),
    "takes trim": CommandHelp(("takes trim walk1 walk1_middle --from 2 --to 8",)),
    "takes video": CommandHelp(("takes video walk1 --output walk1.mp4",)),
    "takes empty": CommandHelp(("takes empty --yes",)),
    "smooth": CommandHelp((f"smooth {TAKE}",)),
    "view": CommandHelp(("view", f"view {TAKE}", "view --host 0.0.0.0"), {OK: ENDED}),
    "evaluate": CommandHelp((f"evaluate {SESSION} --video", "evaluate output/demo/bag")),
    "export": CommandHelp((f"export {TAKE} --format bvh csv", "export walk1 --rate 60")),
    "import bag": CommandHelp(("import bag studio_bag walk --rig rig.yaml --background empty_room_bag",)),
    "import humaneva": CommandHelp(("import humaneva HumanEva_I s2_walk --subject S2 --action Walking",)),
    "import biocv": CommandHelp(("import biocv P03/P03_WALK_01 p03_walk",)),
    "urdf": CommandHelp(("urdf --stature 1.82",)),
    "doctor": CommandHelp(
        ("doctor", f"doctor --rig {RIG} --live", "doctor --camera cam01.yaml --open", "doctor --host 192.168.1.11"),
        {OK: "all is well, or notes only", FAILED: "warnings", BAD_INPUT: "errors, or arguments that cannot be used"},
    ),
}


class CommandParser(argparse.ArgumentParser):
    """A parser whose errors name the help."""

    def error(self, message: str) -> NoReturn:
        """Print the error and the help's command, and exit."""
        self.exit(BAD_INPUT, f"sagoma: {message} (arguments of `{self.prog}`). See `{self.prog} --help`.\n")


def describe(parser: argparse.ArgumentParser) -> None:
    """Give every command below ``parser`` its description, examples and exit statuses."""
    width = max(shutil.get_terminal_size().columns - 2, 20)
    for name, leaf, text in commands_of(parser):
        known, first = HELP.get(name, CommandHelp()), leaf.description or text
        sentence = first[:1].upper() + first[1:].rstrip(".") + ("" if first.endswith("?") else ".")
        leaf.description = textwrap.fill(sentence, width)
        leaf.set_defaults(command=name, leaf=leaf)
        leaf.formatter_class = argparse.RawDescriptionHelpFormatter
        examples = "\n".join(["examples:", *(f"  sagoma {example}" for example in known.examples)])
        statuses = "; ".join(f"{status} {meaning}" for status, meaning in {**STATUSES, **known.statuses}.items())
        notes = [textwrap.fill(leaf.epilog, width)] if leaf.epilog else []
        notes += [examples] if known.examples else []
        leaf.epilog = "\n\n".join([*notes, textwrap.fill(f"exit status: {statuses}", width)])


def commands_of(parser: argparse.ArgumentParser, above: str = "") -> Iterator[tuple[str, argparse.ArgumentParser, str]]:
    """Yield every command that runs by itself: its name ("takes list"), its parser, and its line in the list."""
    for action in parser._actions:
        if not isinstance(action, argparse._SubParsersAction):
            continue
        texts = {choice.dest: choice.help or "" for choice in action._choices_actions}
        for name, child in action.choices.items():
            full = f"{above} {name}".strip()
            if child.get_default("run") is not None:
                yield full, child, texts.get(name, "")
            yield from commands_of(child, full)
